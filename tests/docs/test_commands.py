"""The commands that the documents print exist, with every option that is shown."""

from __future__ import annotations

import io
import re
import runpy
import sys
import tomllib
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from importlib.util import find_spec

import pytest

from loose_env.cli.main import COMMANDS, main, options_class, options_of
from loose_env.diagnosis import LinkFindingSettings
from tests.docs.pages import PAGES, ROOT, commands

FOUND = [(page.name, words) for page in PAGES for words in commands(page)]
ELSEWHERE = ("pip", "pytest", "venv", "sphinx")
"""Modules of others that pages may run."""
NAMES = {".venv/bin/python": "python", "python3": "python", ".venv/bin/loose": "loose"}


def of(program: str) -> list[tuple[str, list[str]]]:
    return [(page, words[1:]) for page, words in FOUND if NAMES.get(words[0], words[0]) == program]


def help_of(run: Callable[..., object], program: str, *verb: str) -> str:
    """What a program, or a verb of it, says to ``--help``, in this process as if it were typed."""
    argv, path, said = sys.argv, sys.path.copy(), io.StringIO()
    sys.argv = [program, *verb, "--help"]
    try:
        with redirect_stdout(said), warnings.catch_warnings(action="ignore"):
            run(program, run_name="__main__")
    except SystemExit as ended:
        assert not ended.code, program
    finally:
        sys.argv, sys.path[:] = argv, path
    return said.getvalue()


def unknown_options(
    name: str, shown: list[tuple[str, list[str]]], run: Callable[..., object]
) -> list[str]:
    """Options that pages show with a program, and its help and that of its verbs do not."""
    said = help_of(run, name)
    after = {words[1] for _, words in shown if words[0] == name and len(words) > 1}
    for verb in sorted(v for v in after if re.search(rf"^\W*{re.escape(v)}: ", said, re.MULTILINE)):
        said += help_of(run, name, verb)
    known = set(re.findall(r"(?<![\w-])-{1,2}[a-zA-Z][\w-]*", said))
    options = {
        (page, word.partition("=")[0])
        for page, words in shown
        for word in words[1:]
        if words[0] == name and re.match(r"-{1,2}[a-zA-Z]", word)
    }
    return sorted(f"{page}: {option}" for page, option in options if option not in known)


@pytest.mark.parametrize("script", sorted({w[0] for _, w in of("python") if w[0][0] != "-"}))
def test_scripts_exist_and_know_the_options_shown(script: str) -> None:
    assert (ROOT / script).is_file(), f"{script} is shown and does not exist"
    unknown = unknown_options(script, of("python"), runpy.run_path)
    assert not unknown, f"{script} has no {unknown}"


def of_modules() -> list[tuple[str, list[str]]]:
    """What stands behind ``python -m``: the module and its options."""
    return [(page, words[1:]) for page, words in of("python") if words[0] == "-m"]


@pytest.mark.parametrize("module", sorted({words[0] for _, words in of_modules()}))
def test_modules_exist_and_know_the_options_shown(module: str) -> None:
    if module in ELSEWHERE:
        assert find_spec(module) is not None
        return
    pytest.importorskip(module.partition(".")[0])
    run = partial(runpy.run_module, alter_sys=True)
    unknown = unknown_options(module, of_modules(), run)
    assert not unknown, f"python -m {module} has no {unknown}"


@pytest.mark.parametrize(("page", "words"), of("loose"))
def test_command_lines_of_loose_are_understood(page: str, words: list[str]) -> None:
    del page
    if words[0] == "COMMAND":
        words = [next(iter(COMMANDS)), *words[1:]]
    if len(words) == 1:
        assert words[0] in COMMANDS or words[0].startswith("--")  # mentioned, not typed
    elif words[0] in COMMANDS and "--help" not in words:
        assert isinstance(options_of(words), options_class(words[0]))
    else:
        try:
            assert main(words) == 0
        except SystemExit as ended:
            assert ended.code == 0


def test_make_knows_every_verb_shown_and_helps_with_each() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    verbs = set(re.findall(r"^([a-z-]+):.*## ", makefile, flags=re.MULTILINE))
    phony = re.search(r"^\.PHONY: (.*)$", makefile, flags=re.MULTILINE)
    assert phony is not None and verbs == set(phony[1].split())
    shown = {word for _, words in of("make") for word in words if "=" not in word}
    assert shown <= verbs and {"run", "docs", "test", "check", "build"} <= shown


def test_pip_installs_extras_that_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"])
    for page, words in of("pip"):
        named = {e for w in words for part in re.findall(r"\[(.*?)\]", w) for e in part.split(",")}
        assert named <= extras, f"{page}: pip installs {named - extras}, which are no extras"


def test_files_that_pages_link_to_exist() -> None:
    for page in PAGES:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\((?!https?:|#)([^)\s]+)\)", text):
            file = page.parent / target.partition("#")[0]
            assert file.exists() and target[0] != "/", f"{page.name} links to {target}"


def test_thresholds_of_link_finding_are_the_defaults() -> None:
    text = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| ([\d.]+)°? \| `(\w+)` \|", text, re.MULTILINE)
    assert len(rows) == 7
    for cell, name in rows:
        assert float(cell) == getattr(LinkFindingSettings(), name), name


def test_no_part_of_the_package_is_forgotten_in_the_reference() -> None:
    parts = set(runpy.run_path(str(ROOT / "docs" / "reference.py"))["PARTS"])
    here = {
        path.stem
        for path in (ROOT / "loose_env").iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").is_file()) and path.stem[0] != "_"
    }
    assert here - parts == {"cli", "version"} and parts <= here
