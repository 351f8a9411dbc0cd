from __future__ import annotations

import re
from typing import Any

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from markupsafe import escape

from loose_env.errors import InvalidData
from loose_env.report import THEMED, FigureCard, new_figure
from loose_env.thesis.shared.page import LEFT_OUT, ranges, render_thesis_page
from loose_env.thesis.shared.sections import Outcome, Section, Table

SVG = b'<svg viewBox="0 0 5 4"><g id="a"/><use href="#a"/></svg>'
PNG = b"\x89PNG\r\n\x1a\nrest"


def outcome(key: str, **changes: Any) -> Outcome:
    settings: dict[str, Any] = {
        "key": key,
        "title": f"Title of {key}",
        "words": [f"Words of {key}."],
        "tables": [
            Table(
                caption=f"Table of {key}",
                columns=("name", "printed", "here", "remark"),
                rows=(("mode", "720 Hz", "885 Hz", "from its own figures, which do not agree"),),
            )
        ],
        "cards": [FigureCard(image=SVG, caption=f"Figure of {key}", title="A name")],
        "finding": f"Outcome of {key}, 7 of 9.",
        "equations": {"6.15": "loose_env.a.f", "6.2": "loose_env.a.g"},
        "left_out": [f"Something of {key}, because."],
    }
    return Outcome(key=key, seconds=1.5, section=Section(**settings | changes))


FAILED = Outcome(key="third_one", seconds=0.1, error="ValueError: a <b> c", trace="…")


def render(*outcomes: Outcome, **changes: Any) -> str:
    settings: dict[str, Any] = {
        "title": "T",
        "text": "Text.",
        "command": "python x.py --seed 7",
        "seed": 7,
        "versions": {"numpy": "1.2.3"},
    }
    return render_thesis_page(outcomes, **settings | changes)


def test_the_page_holds_every_section_and_links_to_it() -> None:
    page = render(outcome("first"), outcome("second"), FAILED)
    for key in ("first", "second"):
        for word in (f"Words of {key}.", f"Table of {key}", f"Figure of {key}", "885 Hz"):
            assert word in page
        assert f'<section id="{key}">' in page
        # In the summary and beside its equations at least.
        assert page.count(f'href="#{key}"') >= 2
    assert page.count("<svg") == page.count("<figure") == 2
    for word in ("python x.py --seed 7", "Seed 7", "numpy 1.2.3", "Text."):
        assert word in page


def test_a_failed_section_shows_its_error_and_keeps_the_others() -> None:
    page = render(outcome("first"), FAILED)
    assert "1 of 2 sections failed." in page
    assert "ValueError: a &lt;b&gt; c" in page
    assert "Words of first." in page
    assert "failed" not in render(outcome("first")).split("</style>")[1]


def test_ids_are_single_and_every_link_leads_somewhere() -> None:
    page = render(outcome("first"), outcome("second"), FAILED)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', page)) <= set(ids)


def test_the_page_loads_nothing_from_elsewhere() -> None:
    figure = new_figure(2.0)
    figure.add_subplot().plot([0, 1])
    cards = [FigureCard(image=figure, caption="f"), FigureCard(image=PNG, caption="p")]
    page = render(outcome("first", cards=cards))
    assert not re.search(r"""(?:src|href)\s*=\s*["']?\s*(?:https?:)?//""", page)
    assert not re.search(r"url\(\s*[\"']?(?!#)", page)
    assert "@import" not in page and "<script" not in page and "<link" not in page
    assert 'src="data:image/png;base64,' in page


def test_the_page_has_the_look_of_the_others() -> None:
    page = render(outcome("first"))
    for role in THEMED.values():
        assert page.count(f"--{role}:") == 3  # light, dark, printed
    assert page.startswith("<!doctype html>")


def test_equations_stand_in_the_order_of_their_numbers() -> None:
    other = outcome("second", equations={"3.41": "loose_env.b.f", "6.15": "loose_env.a.f"})
    page = render(outcome("first"), other)
    index = page[page.index('<section id="every-equation">') :]
    places = [index.index(f"({number})") for number in ("3.41", "6.2", "6.15")]
    assert places == sorted(places)
    # A function that two sections use stands once, with both.
    assert index.count("<code>loose_env.a.f</code>") == 1
    row = index[index.index("(6.15)") :].split("</tr>")[0]
    assert 'href="#first"' in row and 'href="#second"' in row


def test_an_equation_with_two_functions_has_two_rows() -> None:
    page = render(outcome("first"), outcome("second", equations={"6.2": "loose_env.c.h"}))
    assert page.count("(6.2)</td>") == 2


def test_what_is_left_out_is_said_with_its_section() -> None:
    page = render(outcome("first"), outcome("second", left_out=[]))
    end = page[page.index('<section id="left-out">') :]
    assert "Something of first, because." in end
    assert "Title of second" not in end
    for line in LEFT_OUT:
        assert str(escape(line)) in end
    assert all(word in " ".join(LEFT_OUT).lower() for word in ("sound", "bus", "telepresence"))


def test_columns_of_numbers_stand_right_and_long_cells_break() -> None:
    page = render(outcome("first"))
    assert '<td class="number">720 Hz</td>' in page
    assert '<td class="words">mode</td>' in page
    assert '<td class="words long">from its own figures' in page
    dashes = Table(caption="c", columns=("a", "b"), rows=(("x", "-0.5"), ("y", "–")))
    assert '<td class="number">–</td>' in render(outcome("first", tables=[dashes]))


def test_values_are_escaped() -> None:
    bad = Table(caption="<script>", columns=("<i>",), rows=(("<b>",),))
    page = render(outcome("first", title="<u>", words=["<q>"], tables=[bad]), command="<s>")
    assert not re.search(r"<(script|i|b|u|q|s)>", page)


def test_a_section_may_stand_only_once() -> None:
    with pytest.raises(InvalidData, match="first"):
        render(outcome("first"), outcome("first"))


def test_a_figure_that_is_none_is_refused() -> None:
    broken = outcome("first", cards=[FigureCard(image=b"GIF89a", caption="no picture")])
    with pytest.raises(InvalidData):
        render(broken)


def test_neighbouring_numbers_make_a_range() -> None:
    assert ranges(["6.9", "6.10", "6.11", "6.2", "A.1"]) == "6.2, 6.9 to 6.11, A.1"
    assert ranges([]) == ""
