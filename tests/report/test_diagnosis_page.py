"""The page of a diagnosis: words first and no surer than the numbers, nothing from elsewhere."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.instrument import Diagnosis, Fault
from loose_env.io import sentence
from loose_env.report.diagnosis.arm_figure import arm_figure
from loose_env.report.diagnosis.figures import (
    hypothesis_colours,
    loop_figure,
    posterior_figure,
    shown_hypotheses,
)
from loose_env.report.diagnosis.page import page_of, write_page
from loose_env.report.diagnosis.text import headline, percent, questions, steps
from loose_env.report.pages.svg import THEMED, to_svg
from tests.report.diagnosis_case import CASES, desk, diagnosis, flat
from tests.report.test_gap_page import Balanced


def words(page: str) -> str:
    """The text of a page, without its pictures."""
    body = re.sub(r"<svg.*?</svg>", " ", page[page.index("<body>") :], flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", body)))


@pytest.fixture(scope="module", params=list(CASES))
def case(request: pytest.FixtureRequest) -> tuple[Arm, Diagnosis, str]:
    arm, found = CASES[request.param]()
    return arm, found, page_of(found, arm, recording="cell <4>")


def test_every_page_is_whole_and_loads_nothing_from_elsewhere(
    case: tuple[Arm, Diagnosis, str],
) -> None:
    _, found, page = case
    parsed = Balanced()
    parsed.feed(page)
    assert not parsed.open and len(parsed.ids) == len(set(parsed.ids))
    assert not re.search(r'(?:src|href)\s*=\s*"(?!#|data:)(?!http://www.w3.org)', page)
    assert "@import" not in page and "<script" not in page and "<link" not in page
    assert "cell &lt;4&gt;" in page and "cell <4>" not in page
    assert not re.search(r"\b(nan|None|inf)\b", words(page))
    assert page.index("Next steps") < page.index("<svg")
    drawn = 2 + (found.next is not None) + sum(bool(r.loops) for r in found.records)
    assert page.count("<svg") == page.count("<figure") == drawn


def test_the_posterior_and_every_record_stand_in_numbers(case: tuple[Arm, Diagnosis, str]) -> None:
    _, found, page = case
    said = words(page)
    best = max(found.posterior, key=lambda name: found.posterior[name])
    assert best in said and percent(found.probability) in said
    for record in found.records:
        assert record.file in said
        for note in record.notes:
            assert note in said
    for warning in found.warnings:
        assert sentence(warning) in said


def test_the_page_is_the_same_every_time_and_written_whole(tmp_path: Path) -> None:
    arm, found = flat(), diagnosis(flat())
    file = write_page(tmp_path / "new" / "report.html", found, arm)
    assert file.read_text("utf-8") == page_of(found, arm)
    assert [each.name for each in file.parent.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("course", "settled", "said"),
    [
        ((0.7, 0.985), True, "Link 2 is loose."),
        ((0.985,), False, "Probably link 2 is loose."),
        ((0.8,), False, "Probably link 2 is loose."),
        ((0.45,), False, "Not decided yet. Most likely so far: link 2 is loose."),
    ],
)
def test_the_headline_is_no_surer_than_what_is_settled(
    course: tuple[float, ...], settled: bool, said: str
) -> None:
    found = diagnosis(flat(), course=course)
    assert found.settled == settled
    assert headline(found, flat()) == said


def test_the_reason_for_the_next_pose_is_in_words() -> None:
    found = diagnosis(flat(), course=(0.5,), following=True)
    assert found.next is not None
    reason = "it tells structural_looseness@link2 from backlash@joint1"
    said = steps(replace(found, next=replace(found.next, reason=reason)), flat())[0]
    assert said.endswith("It tells “link 2 is loose” from “joint 1 has play”.")


def test_certainty_is_never_rounded_up_to() -> None:
    assert percent(1.0) == "over 99.9 %" and percent(0.0) == "under 0.1 %"
    assert percent(0.9949) == "99.5 %"


def test_an_undecided_diagnosis_sends_nobody_to_the_bolts() -> None:
    unsure = diagnosis(flat(), course=(0.5,), following=True)
    said = " ".join(steps(unsure, flat()))
    assert "bolts" not in said and "Measure once more" in said
    assert "joint 1 and joint 2 in turn" in said
    early = " ".join(steps(diagnosis(flat(), course=(0.99,), following=True), flat()))
    assert "bolts" not in early and "Measure once more" in early
    sure = " ".join(steps(diagnosis(flat()), flat()))
    assert "bolts" in sure
    assert "further poses" in " ".join(steps(diagnosis(flat(), course=(0.5,)), flat()))


def test_a_sound_arm_is_said_with_its_limit() -> None:
    answers = dict(questions(diagnosis(flat(), kind="healthy", course=(0.99,)), flat()))
    assert "kept shut" in answers["Fault"][0]
    assert "Clearance" not in answers


def test_travel_is_in_the_unit_of_what_moves() -> None:
    slide = dict(questions(diagnosis(flat()), flat()))["Clearance"][0]
    assert slide == "0.12 mm from stop to stop, 95 % between 0.08 and 0.21."
    play = dict(questions(diagnosis(flat(), kind="backlash"), flat()))["Clearance"][0]
    assert play.startswith("2.8 arc minutes")  # 0.8 mrad
    unknown = diagnosis(flat(), known=False)
    assert "do not identify" in dict(questions(unknown, flat()))["Clearance"][0]


def test_what_the_arm_does_not_have_is_refused_with_what_it_has() -> None:
    found = diagnosis(flat())
    with pytest.raises(InvalidData, match=r"link2.*it has column, upper_arm"):
        page_of(found, desk())
    other = replace(found, fault=Fault(kind="healthy"), posterior={"healthy": 1.0})
    with pytest.raises(InvalidData, match=r"joints .*joint1.*it has base, shoulder"):
        page_of(other, desk())


def test_the_suspected_link_has_the_colour_of_the_fault() -> None:
    colour = {role: each for each, role in THEMED.items()}["truth"]
    for arm in (flat(), desk()):
        pose = dict.fromkeys(arm.joints, 0.3)
        sound = to_svg(arm_figure(arm, pose)).decode()
        loose = Fault(kind="structural_looseness", where=arm.seat_bodies[1])
        play = Fault(kind="backlash", where=arm.joints[1])
        assert colour not in sound
        assert colour in to_svg(arm_figure(arm, pose, fault=loose)).decode()
        assert colour in to_svg(arm_figure(arm, pose, fault=play)).decode()


def test_the_arrow_of_the_slide_turns_with_the_arm() -> None:
    arm = flat()
    fault = Fault(kind="structural_looseness", where="link2", direction=(1.0, 0.0, 0.0))
    ways = []
    for turn in (0.0, np.pi / 2):
        figure = arm_figure(arm, {"joint1": turn}, fault=fault)
        arrows = [a for a in figure.axes[0].texts if getattr(a, "arrow_patch", None)]
        spans = [np.subtract(a.xy, a.xyann) for a in arrows]
        ways.append(max(spans, key=lambda span: float(np.linalg.norm(span))))
    first, second = (way / np.linalg.norm(way) for way in ways)
    assert abs(first @ second) < 1e-6 and abs(abs(first[0]) - 1) < 1e-6


def test_bars_of_the_posterior_fill_the_row_and_keep_their_colour() -> None:
    steps_taken = [{"healthy": 0.5, "a": 0.3, "b": 0.2}, {"healthy": 0.05, "a": 0.9, "b": 0.05}]
    names = shown_hypotheses(steps_taken)
    figure = posterior_figure(steps_taken, ["record 1", "record 2"], {n: n for n in names})
    widths: dict[float, float] = {}
    for bar in figure.axes[0].patches:
        y = round(bar.get_y(), 3)  # type: ignore[attr-defined]
        widths[y] = widths.get(y, 0.0) + bar.get_width()  # type: ignore[attr-defined]
    assert np.allclose(list(widths.values()), 1.0) and len(widths) == 2
    colours = hypothesis_colours(names)
    assert len(set(colours.values())) == len(names)
    assert not set(colours.values()) & set(THEMED)


def test_a_loop_is_drawn_where_the_correlations_say() -> None:
    record = diagnosis(flat()).records[-1]
    axes = loop_figure(record).axes[0]
    loop = record.loops[0]
    curves = [np.asarray(line.get_xydata()) for line in axes.lines if len(line.get_xdata()) > 10]
    sizes = sorted(float(np.linalg.norm(curve, axis=1).max()) for curve in curves)
    expected = sorted(max(map(abs, each)) for each in (loop.correlation, loop.expected))
    assert np.allclose(sizes, expected)


def test_records_without_loops_or_probabilities_have_their_line() -> None:
    found = diagnosis(desk())
    bare = tuple(replace(r, loops=(), probabilities={}) for r in found.records)
    page = page_of(replace(found, records=bare), desk())
    assert "Correlation by record" not in page and page.count("run-0") == len(bare)
    assert page_of(replace(found, records=()), desk()).count("<svg") == 1
