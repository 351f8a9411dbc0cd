"""The command that reproduces the thesis, and its page."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.errors import InvalidData
from loose_env.report import FigureCard, new_figure
from scripts import reproduce_thesis as script
from scripts.thesis import index_tables, page
from scripts.thesis.page import (
    LEFT_OUT,
    SECTIONS,
    Outcome,
    Section,
    Table,
    choose,
    ranges,
    render_thesis_page,
    run_section,
    run_sections,
)

SVG = b'<svg viewBox="0 0 5 4"><g id="a"/><use href="#a"/></svg>'
FAILED = Outcome(key="third_one", seconds=0.1, error="ValueError: a <b> c", trace="Traceback")
ROW = ("mode", "720 Hz", "885 Hz", "from its own figures, which do not agree")


def outcome(key: str, **changes: Any) -> Outcome:
    columns = ("name", "printed", "here", "remark")
    settings: dict[str, Any] = {
        "key": key,
        "title": f"Title of {key}",
        "words": [f"Words of {key}."],
        "tables": [Table(caption=f"Table of {key}", columns=columns, rows=(ROW,))],
        "cards": [FigureCard(image=SVG, caption=f"Figure of {key}", title="A name")],
        "finding": f"Outcome of {key}, 7 of 9.",
        "equations": {"6.15": "loose_env.a.f", "6.2": "loose_env.a.g"},
        "left_out": [f"Something of {key}, because."],
    }
    return Outcome(key=key, seconds=1.5, section=Section(**settings | changes))


def render(*outcomes: Outcome, **changes: Any) -> str:
    about = {"title": "T", "text": ["Text."], "command": "python x.py --seed 7", "seed": 7}
    return render_thesis_page(outcomes, **about | {"versions": {"numpy": "1.2.3"}} | changes)


def test_the_page_holds_every_section_links_to_it_and_escapes_values() -> None:
    figure = new_figure(2.0)
    figure.add_subplot().plot([0, 1])
    bad = Table(caption="<script>", columns=("<i>",), rows=(("<b>",),))
    cards = [FigureCard(image=figure, caption="f")]
    odd = outcome("odd", cards=cards, tables=[bad], title="<u>", equations={"3.41": "loose_env.b"})
    html = render(outcome("first"), outcome("second"), odd, FAILED, command="<s> --seed 7")
    for key in ("first", "second"):
        for word in (f"Words of {key}.", f"Table of {key}", f"Figure of {key}", "885 Hz"):
            assert word in html
        assert f'<section id="{key}">' in html
    for word in ("--seed 7", "Seed 7", "numpy 1.2.3", "Text.", LEFT_OUT[1][:20]):
        assert word in html
    assert "1 of 4 sections failed." in html and "ValueError: a &lt;b&gt; c" in html
    for cell in ('number">720 Hz<', 'words">mode<', 'words long">from its own figures'):
        assert f'<td class="{cell}' in html  # numbers stand right, long cells break
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', html)) <= set(ids)
    assert not re.search(r"""(?:src|href)\s*=\s*["']?\s*(?:https?:)?//""", html)
    assert "@import" not in html and "<link" not in html
    assert not re.search(r"<(script|i|b|u|s)>", html)
    index = html.partition('<section id="every-equation">')[2]
    places = [index.index(f"({number})") for number in ("3.41", "6.2", "6.15")]
    assert places == sorted(places) and index.count("<code>loose_env.a.f</code>") == 1
    row = index[index.index("(6.15)") :].split("</tr>")[0]
    assert 'href="#first"' in row and 'href="#second"' in row
    assert ranges(["6.9", "6.10", "6.11", "6.2", "A.1"]) == "6.2, 6.9 to 6.11, A.1"
    with pytest.raises(InvalidData):
        render(outcome("first", cards=[FigureCard(image=b"GIF89a", caption="no picture")]))


def here(keys: list[str], *, seed: int, workers: int) -> Iterator[Outcome]:
    """Outcomes of some sections, the last first, as a race of workers might give them."""
    failed = Outcome(
        key="vera_link_finding", seconds=0.1, error="ZeroDivisionError: x", trace="Trace"
    )
    return (failed if key == "vera_link_finding" else outcome(key) for key in reversed(keys))


def test_one_failure_keeps_the_others_and_shows(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(script, "run_sections", here)
    arguments = ["--out", str(tmp_path), "--seed", "5", "--only", "signals"]
    with pytest.raises(SystemExit) as ended:
        script.main([*arguments, "vera_link_finding", "index_tables"])
    assert ended.value.code == 1
    html = (tmp_path / "index.html").read_text(encoding="utf-8")
    keys = ("signals", "index_tables", "vera_link_finding")  # in the order of the page
    places = [html.index(f'<section id="{key}">') for key in keys]
    assert places == sorted(places)
    assert f"reproduce_thesis.py --seed 5 --only {' '.join(keys)}<" in html
    said = capsys.readouterr()
    assert (
        "Failed: vera_link_finding" in said.out and f"Page: {tmp_path / 'index.html'}" in said.out
    )
    assert "3 of 3" in said.err and "Trace" in said.err
    script.main(arguments)  # all well: no exit with an error
    assert "Failed" not in capsys.readouterr().out
    script.main(["--list"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(SECTIONS) == choose()


@pytest.mark.parametrize("arguments", [["--only", "nothing"], ["--seed", "-1"], ["--workers", "0"]])
def test_wrong_options_end_in_one_line_and_write_nothing(
    arguments: list[str], tmp_path: Path
) -> None:
    with pytest.raises(SystemExit, match="reproduce_thesis: ") as ended:
        script.main(["--out", str(tmp_path), *arguments])
    assert "\n" not in str(ended.value.code)
    assert list(tmp_path.iterdir()) == []


def test_an_error_comes_back_as_the_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(seed: int) -> Section:
        raise ZeroDivisionError("nothing\nto divide by")

    monkeypatch.setattr(index_tables, "index_tables", broken)
    found = run_section("index_tables", 0)
    assert found.section is None and "in broken" in found.trace
    assert found.error == "ZeroDivisionError: nothing to divide by"


def die(key: str, seed: int) -> Outcome:
    """End the process of one section, as a crash of a simulation does."""
    if key == "signals":
        os._exit(3)
    return run_section(key, seed)


@pytest.mark.slow
def test_a_process_that_dies_takes_no_other_section_along(monkeypatch: pytest.MonkeyPatch) -> None:
    own = run_section("index_tables", 1)
    monkeypatch.setattr(page, "run_section", die)
    found = {o.key: o for o in run_sections(["signals", "index_tables"], seed=1)}
    assert found["signals"].error == "its process died"
    other = found["index_tables"].section
    assert other is not None and own.section is not None
    assert other.words == own.section.words and other.tables == own.section.tables
    assert [p.image for p in other.cards] == [p.image for p in own.section.cards]
