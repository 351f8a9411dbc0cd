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
from loose_env.report.diagnosis.hypotheses import data_words, hypothesis_table, travel_words
from loose_env.report.diagnosis.page import page_of, write_page
from loose_env.report.diagnosis.spectra import transmission_figure
from loose_env.report.diagnosis.text import headline, percent, short_name, steps, summary_words
from loose_env.report.pages.svg import THEMED, to_svg
from tests.report.diagnosis_case import CASES, desk, diagnosis, flat
from tests.report.gap.test_gap_page import Balanced


def words(page: str) -> str:
    """The text of a page, without its pictures."""
    body = re.sub(r"<svg.*?</svg>", " ", page[page.index("<body>") :], flags=re.DOTALL)
    body = body.replace("<wbr>", "")
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
    assert page.index("What to do next") < page.index("Hypotheses") < page.index("<svg")
    joints = {s.joint for s in found.spectra if found.records[s.record].condition == "suspect"}
    drawn = 2 + (found.next is not None) + sum(bool(r.loops) for r in found.records)
    drawn += min(2, len(joints))
    assert page.count("<svg") == page.count("<figure") == drawn


def test_the_posterior_and_every_record_stand_in_numbers(case: tuple[Arm, Diagnosis, str]) -> None:
    arm, found, page = case
    said = words(page)
    best = max(found.posterior, key=lambda name: found.posterior[name])
    assert short_name(arm, best) in said and percent(found.probability) in said
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
        ((0.45,), False, "Not decided. Most likely so far: link 2 is loose."),
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


def test_a_healthy_arm_is_said_with_its_limit() -> None:
    found = diagnosis(flat(), kind="healthy", course=(0.8, 0.99))
    assert headline(found, flat()) == "Nothing is loose."
    assert "kept shut" in summary_words(found, flat())[0]
    assert hypothesis_table(found, flat())["rows"][0]["Free travel"] == "–"


def test_travel_is_in_the_unit_of_what_moves() -> None:
    assert travel_words(diagnosis(flat()), flat()) == "0.12 (0.08 to 0.21) mm"
    play = travel_words(diagnosis(flat(), kind="backlash"), flat())
    assert play == "2.8 arc minutes"  # 0.8 mrad
    assert travel_words(diagnosis(flat(), known=False), flat()) == "not identified"


def test_one_table_has_probability_direction_travel_and_runs_of_each_hypothesis() -> None:
    found = diagnosis(flat())
    first = hypothesis_table(found, flat())["rows"][0]
    assert list(first) == ["Hypothesis", "Probability", "Direction", "Free travel", "Runs"]
    assert first["Hypothesis"] == "Link 2 is loose" and first["Runs"] == "3 of 3"
    assert first["Direction"].endswith("±6°")
    assert "3 records in 3 poses" in data_words(found)


def test_a_model_of_another_arm_is_sent_to_its_correction_with_commands() -> None:
    found = diagnosis(flat(), verdict="model_mismatch")
    assert headline(found, flat()) == "The model is not that of this arm: correct it first."
    said = words(page_of(found, flat(), recording="cell-4", folder="runs/cell 4"))
    assert "loose gap 'runs/cell 4' --out 'runs/cell 4-gap'" in said
    assert "--model 'runs/cell 4-gap/model.xml'" in said
    assert "bolts" not in said and "31 % of the record" in said
    assert "One run alone makes the fault probable" in said


def test_warnings_stand_by_severity_with_the_gravest_first() -> None:
    found = replace(
        diagnosis(flat()),
        warnings=("a lost sample", "another model", "a short run"),
        severities=("note", "critical"),
    )
    said = words(page_of(found, flat()))
    order = [said.index(w) for w in ("Another model", "A short run", "A lost sample")]
    assert order == sorted(order)
    assert found.graded_warnings[1] == ("warning", "a short run")


def test_date_version_and_hash_stand_at_the_end() -> None:
    said = words(page_of(diagnosis(flat()), flat()))
    assert "Measured 2026-03-18T14:05:00+00:00. Diagnosed by loose-env 0.1.0" in said
    assert "SHA-256 0123456789abcdef" in said


def test_the_transmission_is_drawn_as_measured_and_as_predicted() -> None:
    found = diagnosis(flat())
    own = [s for s in found.spectra if s.record == 1]
    names = {"healthy": "nothing is loose", found.fault.hypothesis: "link 2 is loose"}
    axes = transmission_figure(own, names).axes
    assert len(axes) == 3
    curves = [np.asarray(line.get_ydata()) for line in axes[0].lines]
    assert any(np.allclose(y, own[0].measured) for y in curves)
    assert any(np.allclose(y, own[0].predicted["healthy"]) for y in curves)


def test_what_the_arm_does_not_have_is_refused_with_what_it_has() -> None:
    found = diagnosis(flat())
    with pytest.raises(InvalidData, match=r"link2.*it has column, upper_arm"):
        page_of(found, desk())
    healthy = Fault(kind="healthy")
    other = replace(found, fault=healthy, posterior={"healthy": 1.0}, spectra=())
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


def test_reasons_name_hypotheses_in_words() -> None:
    found = diagnosis(flat())
    name = next(each for each in found.posterior if each.startswith("backlash"))
    why = f"the probability of {name} is 0.970; 0.98 is needed"
    words = summary_words(replace(found, verdict="open", open_because=(why,)), flat())
    assert words[-1] == f"The probability of “{short_name(flat(), name)}” is 0.970; 0.98 is needed."
