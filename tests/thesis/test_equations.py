"""Every function that a section names for an equation can be imported."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import pytest

from loose_env.errors import UnknownName
from loose_env.thesis.shared.sections import SECTIONS, choose, first_line, load


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


@pytest.mark.parametrize("key", list(SECTIONS))
def test_every_section_can_be_run_and_says_what_it_does(key: str) -> None:
    module = load(key)
    assert callable(module.section)
    assert first_line(key)


@pytest.mark.parametrize("key", list(SECTIONS))
def test_the_function_of_every_equation_exists(key: str) -> None:
    for number, path in load(key).EQUATIONS.items():
        assert number.strip("()") == number, "a number stands without brackets"
        assert path.startswith("loose_env."), path
        assert callable(function(path)), f"({number}): {path} is no function"


def test_a_wrong_path_is_noticed() -> None:
    assert callable(
        function("loose_env.statistics.correlation.comparative_index.comparative_index")
    )
    assert callable(function("loose_env.errors.LooseEnvError.with_traceback"))
    for path in (
        "loose_env.statistics.correlation.comparative_index.none_such",
        "loose_env.none_such.f",
    ):
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
