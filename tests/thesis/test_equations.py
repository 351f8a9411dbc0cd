"""Every function that a section names for an equation can be imported."""

from __future__ import annotations

import ast
import inspect
from importlib import import_module
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

from loose_env.errors import UnknownName
from loose_env.thesis.registry import SECTIONS, choose, first_line, load

WRITTEN = [key for key, module in SECTIONS.items() if find_spec(module) is not None]


def function(path: str) -> object:
    """The function or class at a dotted path; a method stands behind its class."""
    parts = path.split(".")
    for k in range(len(parts) - 1, 0, -1):
        name = ".".join(parts[:k])
        try:
            known = find_spec(name) is not None
        except ModuleNotFoundError:  # a parent is no package
            known = False
        if known:
            found: object = import_module(name)
            for part in parts[k:]:
                found = getattr(found, part)
            return found
    raise AssertionError(f"no module in {path}")


def equations_of(module: ModuleType) -> dict[str, str]:
    """The equations a module gives its section: EQUATIONS, or what stands in their place.

    Running every section would take minutes, so the argument is read from the source; it must
    be known without running the section.
    """
    found = getattr(module, "EQUATIONS", None)
    if found is not None:
        return dict(found)
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Section":
            for keyword in node.keywords:
                if keyword.arg == "equations":
                    return dict(eval(ast.unparse(keyword.value), dict(vars(module))))
    return {}


@pytest.mark.parametrize("key", WRITTEN)
def test_every_section_can_be_run_and_says_what_it_does(key: str) -> None:
    module = load(key)
    assert callable(module.section)
    assert first_line(key)


@pytest.mark.parametrize("key", WRITTEN)
def test_the_function_of_every_equation_exists(key: str) -> None:
    for number, path in equations_of(load(key)).items():
        assert number.strip("()") == number, "a number stands without brackets"
        assert path.startswith("loose_env."), path
        assert callable(function(path)), f"({number}): {path} is no function"


def test_a_wrong_path_is_noticed() -> None:
    assert callable(function("loose_env.statistics.index.comparative_index"))
    assert callable(function("loose_env.errors.LooseEnvError.with_traceback"))
    for path in ("loose_env.statistics.index.none_such", "loose_env.none_such.f"):
        with pytest.raises(AttributeError):
            function(path)


def test_sections_are_chosen_in_the_order_of_the_page() -> None:
    assert choose() == list(SECTIONS)
    assert choose(["link_finding", "sizing", "sizing"]) == ["sizing", "link_finding"]
    with pytest.raises(UnknownName, match=r"'nothing'.*index_tables"):
        choose(["nothing"])


def test_a_section_without_a_module_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SECTIONS, "sizing", "loose_env.thesis.none_such")
    with pytest.raises(UnknownName, match="none_such"):
        load("sizing")
    assert first_line("sizing") == "(no module)"


def test_equations_are_read_without_running_the_section(tmp_path: Path) -> None:
    source = (
        "MAP = {'6.2': 'a.b'}\ndef section(seed):\n    return Section(key='k', equations=MAP)\n"
    )
    path = tmp_path / "drawn_up.py"
    path.write_text(source, encoding="utf-8")
    spec = spec_from_file_location("drawn_up", path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    assert equations_of(module) == {"6.2": "a.b"}
    assert len(equations_of(load("index_tables"))) == 4
