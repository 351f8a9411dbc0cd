from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.report import FigureCard
from loose_env.thesis import SECTIONS, Outcome, run_sections
from loose_env.thesis.shared import sections as sections_module
from loose_env.thesis.shared.sections import Section, run_section


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return importlib.import_module("scripts.reproduce_thesis")


@pytest.fixture
def sections(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, ModuleType]]:
    """Three small sections in place of those of the thesis; the second of them fails."""
    from loose_env.report import new_figure

    def drawn(seed: int) -> Section:
        figure = new_figure(2.0)
        figure.add_subplot().plot([0, seed])
        cards = [FigureCard(image=figure, caption="a line")]
        return Section(
            key="drawn", title="Drawn", finding="A line.", words=[f"Seed {seed}."], cards=cards
        )

    def broken(seed: int) -> Section:
        raise ZeroDivisionError("nothing\nto divide by")

    def plain(seed: int) -> Section:
        return Section(key="plain", title="Plain", finding="Plain.", words=["Plain words."])

    made = {}
    for key, function in (("drawn", drawn), ("broken", broken), ("plain", plain)):
        made[key] = module = ModuleType(key, f"What {key} does.\n\nMore.")
        module.section = function  # type: ignore[attr-defined]
        # `find_spec` asks the module itself once it is imported.
        module.__spec__ = importlib.util.spec_from_loader(key, None)
        monkeypatch.setitem(sys.modules, key, module)
    monkeypatch.setattr("loose_env.thesis.shared.sections.SECTIONS", {key: key for key in made})
    yield made


def here(keys: list[str], *, seed: int, workers: int) -> Iterator[Outcome]:
    """Run sections in this process, the last first, as a race of workers might."""
    return (run_section(key, seed) for key in reversed(keys))


def test_an_error_comes_back_as_the_outcome(sections: dict[str, ModuleType]) -> None:
    outcome = run_section("broken", 0)
    assert outcome.section is None
    assert outcome.error == "ZeroDivisionError: nothing to divide by"
    assert "in broken" in outcome.trace
    sections["broken"].section = lambda seed: sys.exit("gave up")
    assert run_section("broken", 0).error == "SystemExit: gave up"
    assert "no section 'missing'" in run_section("missing", 0).error


def test_figures_are_drawn_where_the_section_runs(sections: dict[str, ModuleType]) -> None:
    section = run_section("drawn", 3).section
    assert section is not None
    assert section.words == ["Seed 3."]
    assert isinstance(section.cards[0].image, bytes)
    assert b"<svg" in section.cards[0].image
    assert section.cards[0].caption == "a line"


def test_a_section_that_calls_itself_otherwise_fails(sections: dict[str, ModuleType]) -> None:
    sections["drawn"].section = sections["plain"].section
    assert "calls itself 'plain'" in run_section("drawn", 0).error
    sections["drawn"].section = lambda seed: None
    assert "returned a NoneType" in run_section("drawn", 0).error


def test_one_failure_keeps_the_others_and_shows(
    script: ModuleType,
    sections: dict[str, ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(script, "run_sections", here)
    with pytest.raises(SystemExit) as ended:
        script.main(["--out", str(tmp_path), "--seed", "5"])
    assert ended.value.code == 1
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    # In the order of the registry, not in that of their ends.
    places = [page.index(f'<section id="{key}">') for key in ("drawn", "broken", "plain")]
    assert places == sorted(places)
    for words in ("Seed 5.", "Plain words.", "ZeroDivisionError", "1 of 3 sections failed."):
        assert words in page
    assert "python scripts/reproduce_thesis.py --seed 5<" in page
    said = capsys.readouterr()
    assert "Failed: broken" in said.out
    assert f"Page: {tmp_path / 'index.html'}" in said.out
    assert "3 of 3" in said.err and "Traceback" in said.err


def test_all_well_ends_with_zero(
    script: ModuleType,
    sections: dict[str, ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(script, "run_sections", here)
    with pytest.raises(SystemExit) as ended:
        script.main(["--out", str(tmp_path), "--only", "plain", "drawn"])
    assert ended.value.code == 0
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "--only drawn plain<" in page
    assert "failed" not in page.split("</style>")[1]


def test_the_list_says_what_each_section_does(
    script: ModuleType,
    sections: dict[str, ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(script, "SECTIONS", {key: key for key in sections})
    with pytest.raises(SystemExit) as ended:
        script.main(["--list"])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["drawn", "What", "drawn", "does."]
    assert len(lines) == 3


@pytest.mark.parametrize("arguments", [["--only", "nothing"], ["--seed", "-1"], ["--workers", "0"]])
def test_wrong_options_end_in_one_line_and_write_nothing(
    script: ModuleType, arguments: list[str], tmp_path: Path
) -> None:
    with pytest.raises(SystemExit, match="reproduce_thesis: ") as ended:
        script.main(["--out", str(tmp_path), *arguments])
    assert "\n" not in str(ended.value.code)
    assert list(tmp_path.iterdir()) == []


def test_settings_are_checked_before_anything_runs() -> None:
    with pytest.raises(InvalidSetting, match="workers"):
        list(run_sections(["sizing"], seed=0, workers=0))
    with pytest.raises(UnknownName):
        list(run_sections(["nothing"], seed=0))
    assert list(run_sections([], seed=0)) == []


def test_a_section_is_the_same_in_a_process_of_its_own() -> None:
    (other,) = run_sections(["index_tables"], seed=1, workers=1)
    own = run_section("index_tables", 1)
    assert other.section is not None and own.section is not None
    assert other.section.words == own.section.words
    assert other.section.tables == own.section.tables
    assert [p.image for p in other.section.cards] == [p.image for p in own.section.cards]


def test_a_process_that_dies_takes_no_other_section_along(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = ["sizing", "index_tables", "link_finding"]
    calls: list[list[str]] = []

    def pool(own: list[str], seed: int, workers: int) -> Iterator[tuple[str, Outcome | None]]:
        calls.append(list(own))
        for key in own:
            # The pool of all breaks at its second section; alone, only that one dies again.
            died = key == "index_tables" or (len(own) > 1 and key == "link_finding")
            yield key, None if died else Outcome(key=key, seconds=0.0, section=None, error="x")

    monkeypatch.setattr(sections_module, "_pool", pool)
    found = {o.key: o.error for o in run_sections(keys, seed=0)}
    assert found == {"sizing": "x", "index_tables": "its process died", "link_finding": "x"}
    assert calls == [keys, ["index_tables"], ["link_finding"]]


def test_the_registry_names_modules_of_the_package() -> None:
    assert len(set(SECTIONS.values())) == len(SECTIONS)
    assert all(module.startswith("loose_env.thesis.") for module in SECTIONS.values())
