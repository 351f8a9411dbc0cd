"""The report of a comparison: words first, every section in its place."""

from __future__ import annotations

import html
import math
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.doctor import Correction, Finding, Severity
from loose_env.errors import MissingExtra
from loose_env.gap import (
    ChannelVerdict,
    Correlation,
    EffectLocation,
    FittedEffect,
    Gap,
    GapResult,
    GapSolution,
    Identifiability,
    JointExcitation,
    NamedEffect,
    TolerancePull,
    Tolerances,
    VisibleEffect,
    write_gap,
)
from loose_env.report import (
    check_text,
    gap_headline,
    gap_html,
    gap_text,
    render_gap_page,
    to_svg,
    write_gap_report,
)
from loose_env.report import gap as gap_report
from loose_env.report.gap import (
    correlation_figure,
    gap_motions,
    gap_steps,
    overlay_figure,
    response_figure,
)
from tests.gap.cases.gap_case import record, solution_for
from tests.report.page_checks import checked, words


@pytest.fixture(scope="module")
def solution(tmp_path_factory: pytest.TempPathFactory) -> GapSolution:
    return solution_for(record(tmp_path_factory.mktemp("page") / "arm <3>"))


FINDINGS = tuple(
    Finding(
        check="sign", severity=severity, channel=f"sensor.{severity}", run="a.csv",
        found="runs backwards", consequence="it is wrong", remedy="turn it round",
        fix=Correction(kind="gravity", columns=("gravity",), vector=(0.0, 6.9, -6.9)),
    )
    for severity in get_args(Severity)
)  # fmt: skip
FRICTION = EffectLocation(kind="coulomb_friction", where="elbow")
LAG = FittedEffect(
    kind="actuator_lag", where="motor2", parameters={"time_constant": 0.02},
    units={"time_constant": "s"},
)  # fmt: skip
PULLED = TolerancePull(
    name="mass of upper", deviations=-2.4, value=-0.12, tolerance=0.05, unit="kg"
)
SHOWN = Identifiability(
    joints=(
        JointExcitation(joint="elbow", unit="rad", travel=1.2, speed=2, acceleration=9, used=0.8),
    ),
    effects=(
        VisibleEffect(kind="quadratic_drag", where="elbow", smallest={"drag": 0.2},
                      units={"drag": "N·m·s²/rad²"}, visible=False),
        VisibleEffect(kind="actuator_lag", where="motor2", smallest={"time_constant": 0.01},
                      units={"time_constant": "s"}, visible=True,
                      confusable_with=EffectLocation(kind="command_delay", where="motor2")),
    ),
)  # fmt: skip
OPEN = (
    ChannelVerdict(channel="shoulder", verdict="unexplained", before=80.0, after=40.0,
                   advice="all that was tried explains 75 %; most is left in run-02.csv"),
    ChannelVerdict(channel="wrist", verdict="cannot tell", effects=(FRICTION, LAG), before=4.0,
                   after=2.5, advice="move slowly"),
)  # fmt: skip


@pytest.fixture(scope="module")
def page(solution: GapSolution) -> str:
    result = replace(
        solution.result, identifiability=SHOWN, preflight=FINDINGS,
        warnings=("the step is coarse",),
        channels=(*solution.result.channels, *OPEN),
        pulled=(PULLED,),
        doubtful=(NamedEffect(kind="actuator_gain", where="motor2", parameters={"gain": 1.02},
                              doubt="held-out data do not confirm it"),),
    )  # fmt: skip
    assert GapResult.from_json(result.to_json()).preflight == FINDINGS
    assert "critical: In a.csv, sensor.error: runs backwards" in gap_text(result)
    return render_gap_page(replace(solution, result=result))


def test_the_page_is_whole_and_what_is_missing_comes_first(page: str) -> None:
    assert checked(page).headings == [
        "What the model lacks",
        "Joint by joint",
        "What to do next",
        "Warnings",
        "Measured against model",
        "Correlation of the residual",
        "Frequency response",
        "What to record next",
    ]
    assert "arm &lt;3&gt;" in page and "arm <3>" not in page
    assert "<h1>The model lacks dry friction (elbow); shoulder is unexplained.</h1>" in page
    assert 0 < page.index("Dry friction (elbow)") < page.index("<svg")


def test_everything_that_a_result_holds_stands_on_the_page(page: str) -> None:
    order = [
        "joint position ",
        "Another gain (motor2)",
        "do not confirm it",
        "explains 75 %; most is left in run-02.csv",
        "cannot tell",
        "all together",
    ]
    order += ["Simulate with model.xml", "mass of upper: -0.12 kg (tolerance 0.05 kg)"]
    order += ["Invalidates the result", "sensor.error", "Limits the result", "The step is coarse."]
    order += ["Notes", "measured", "The nominal model is off by ", "over its command"]
    order += ["How the joints moved", "wrist, cannot tell: move slowly."]
    order += ["drag that grows with the square of the speed (elbow): move at the highest speed"]
    order += ["To tell a lag from late commands: command a sweep", "Held out", "Tolerances: "]
    order += [f"mass {Tolerances().mass:g}"]
    text = words(page).replace("−", "-")
    places, at = [], 0
    for each in order:
        at = text.find(each, at)
        assert at >= 0, each
        places.append(at)
    assert re.search(r"\d{4}-\d\d-\d\d, loose-env \S+, [\d.]+ s\.", text)


def test_the_headline_says_what_is_missing_and_what_is_not_explained() -> None:
    effects = tuple(
        NamedEffect(kind="actuator_gain", where=f"m{k}", parameters={"gain": 2.0}) for k in range(3)
    )
    assert gap_headline(result("named", effects=effects)) == (
        "The model lacks another gain (m0, m1, m2)."
    )
    many = tuple(replace(effects[0], kind=f"kind_{k}_of_very_many_words") for k in range(5))
    named = tuple(
        replace(OPEN[0], channel=name, verdict="named", effects=many[:2], after=after)
        for name, after in (("hip", 1.2), ("knee", 7.0))
    )
    assert gap_headline(result("named", effects=many, channels=(*named, *OPEN))) == (
        "The model lacks kind 0 of very many words and kind 1 of very many words at hip and knee, "
        "and something more at knee that nothing tried explains; shoulder is unexplained."
    )
    text = gap_text(result("named", effects=many, channels=named))
    assert re.search("knee +named, more missing", text) and re.search("hip +named  ", text)
    assert gap_headline(result("unexplained", channels=OPEN)) == "Nothing tried explains shoulder."
    assert "cannot tell" in gap_headline(result("unexplained", channels=OPEN[1:]))
    tried = replace(OPEN[0], effects=(FRICTION, LAG))
    doubt = NamedEffect(**vars(LAG), doubt="improbable")
    assert "not named: a lag " in gap_text(
        result("unexplained", channels=(tried,), doubtful=(doubt,))
    )
    assert gap_headline(result("no_gap", channels=OPEN[1:])) == (
        "No model error found; the recording does not tell about wrist."
    )
    gap = Gap(before=4.0, after=1.1, by_quantity={"joint torque [N·m]": (2.0, 0.5)})
    torque = "missing along the measured motion: joint torque 2 N·m before, 0.5 N·m after"
    assert torque in gap_text(result("no_gap", gap=gap))
    assert ">5</td>" in gap_html(result("no_gap", gap=Gap(before=5.0, after=5.0)))


def test_every_open_question_gets_a_motion_that_answers_it() -> None:
    effect = NamedEffect(
        kind="coulomb_friction", where="joint1", parameters={"torque": 1.0},
        ambiguous_with=(
            FittedEffect(kind="backlash", where="joint1"),
            FittedEffect(kind="coulomb_friction", where="joint2"),
        ),
    )  # fmt: skip
    found = result(
        "named", effects=(effect,), channels=OPEN, pulled=(PULLED,), identifiability=SHOWN
    )
    motions = gap_motions(found)
    assert "gravity pulling to one side" in motions[0]
    assert "move joint1 while joint2 is held" in motions[1]
    assert motions[2] == "wrist, cannot tell: move slowly."
    assert "(elbow): move at the highest speed" in motions[3]
    assert gap_motions(replace(found, channels=(), effects=())) == []
    assert "mass of upper: -0.12 kg" in gap_steps(found)[-1]
    smear = replace(PULLED, value=math.nan)
    assert smear.words == "mass of upper: -2.4 times its tolerance"
    assert "strain what you suspect" in gap_steps(result("no_gap"))[0]


def test_what_model_xml_cannot_do_alone_is_told() -> None:
    lag = NamedEffect(kind="actuator_lag", where="motor1", parameters={"time_constant": 0.016})
    assert "fill the filter, data.act" in gap_steps(result("named", effects=(lag,)))[1]
    late = NamedEffect(kind="sensor_delay", where="gyro", parameters={"delay": 0.01})
    assert "gyro in data.sensordata" in gap_steps(result("named", effects=(late,)))[1]
    gain = NamedEffect(kind="sensor_gain", where="gyro", parameters={"gain": 1.1}, in_model=False)
    lacks = "model.xml lacks a sensor whose scale is off (gyro)"
    for others, code in (((), ""), ((lag,), "reading *= 1.1")):
        found = result("named", effects=(*others, gain), code=code)
        assert lacks in gap_steps(found)[0] and lacks in gap_text(found)
    assert "simulates as the nominal one" in gap_text(result("named", effects=(gain,)))


def test_an_effect_whose_every_parameter_is_zero_is_told() -> None:
    nothing = {"mass": 0.0, "x": 0.0}
    ends = dict.fromkeys(nothing, (0.0, 0.0))
    effect = NamedEffect(kind="payload", where="tool", parameters=nothing, interval_95=ends)
    assert "mass 0 (0 to 0)" in gap_text(result("named", effects=(effect,)))


def test_a_parameter_that_is_not_determined_has_no_value() -> None:
    effect = NamedEffect(
        kind="load_friction", where="elbow", parameters={"share": 0.5, "speed": 5.08},
        interval_95={"speed": (0.1, 9.0)}, undetermined=("speed",),
    )  # fmt: skip
    assert "speed not determined (0.1 to 9)" in gap_text(result("named", effects=(effect,)))


def test_the_probability_is_of_a_group_and_that_of_the_named_one_stands_beside_it() -> None:
    effect = NamedEffect(
        kind="coulomb_friction", where="elbow", parameters={"torque": 1.0}, probability=0.9996,
        probability_alone=0.68, ambiguous_with=(LAG,),
    )  # fmt: skip
    assert re.search(
        r"over 99.9 % \(alone 68 %\) +torque 1 +a lag \(motor2\):",
        gap_text(result("named", effects=(effect,))),
    )
    assert "a lag (motor2): time constant 0.02 s<" in gap_html(result("named", effects=(effect,)))


def test_where_simulation_decided_positions_are_drawn(solution: GapSolution) -> None:
    decision = replace(solution.answer.decision, simulated=True)
    page = render_gap_page(replace(solution, answer=replace(solution.answer, decision=decision)))
    assert "Both models follow the recorded commands" in page and "[rad]" in page
    assert "Correlation of the residual" not in checked(page).headings


def test_samples_that_are_not_compared_are_not_drawn(solution: GapSolution) -> None:
    (elbow,) = (o for o in solution.overlays if o.channel == "elbow")
    assert 0.2 < np.mean(np.isfinite(elbow.corrected)) < 1.0


def test_the_check_lists_what_is_seen_and_what_is_not() -> None:
    text = check_text(SHOWN)
    assert "elbow  1.2 rad  2 rad/s  9 rad/s²" in text and "80 %" in text
    seen, wanted = text.split("to record next, what tells most first:")
    assert re.search(r"drag that grows with the square of the speed +all of them\n", seen)
    assert re.search(r"a lag +time constant 0.01 s\n", seen)
    assert max(map(len, text.splitlines())) <= 120
    assert "(elbow): move at the highest speed" in wanted
    assert "To tell a lag from late commands: command a sweep" in wanted


def test_the_check_says_sizes_of_one_kind_by_their_units() -> None:
    effects = [
        VisibleEffect(kind="sensor_bias", where=f"s{k}", smallest={"bias": size, "ratio": 9.0},
                      units={"bias": unit}, visible=k < 3)
        for k, (size, unit) in enumerate([(0.1, "rad"), (0.3, "rad"), (2.0, "rad/s"), (7.0, "m")])
    ]  # fmt: skip
    text = check_text(replace(SHOWN, effects=tuple(effects)))
    assert re.search(r"a sensor with a bias +bias 0.1 to 0.3 rad; bias 2 rad/s +s3\n", text)


def test_names_with_dollar_signs_are_drawn_as_they_are() -> None:
    names, values = ["q$1$", r"$\no{such$", "two $ and $"], np.linspace(-1, 1, 50)
    gains = {name: values.astype(complex) + 2j for name in ("measured", "nominal", "corrected")}
    assert to_svg(response_figure(np.linspace(1, 20, 50), gains))
    for name in names:
        given = Correlation(
            channel=name, joint=name, interval=0.01, own=values, other=values, band=0.1
        )
        for figure in (
            correlation_figure(given),
            overlay_figure(values, values, values, values, unit=name),
        ):
            drawn = re.sub("<!--.*?-->", "", to_svg(figure).decode(), flags=re.DOTALL)
            assert name in html.unescape(drawn)


def test_a_page_that_fails_takes_neither_model_nor_result_along(
    solution: GapSolution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error: Exception = MissingExtra("figures need matplotlib")

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(gap_report, "render_gap_page", fail)
    (tmp_path / "report.html").write_text("of an earlier run")
    lines: list[str] = []
    report = partial(write_gap_report, say=lines.append)
    written = write_gap(tmp_path, solution, report=report, say=lines.append)
    assert [path.name for path in written] == ["model.xml", "result.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.xml", "result.json"]
    assert "no report.html: figures need matplotlib" in lines
    error = ValueError("no such glyph")
    assert report(tmp_path, solution) is None
    assert lines[-1] == "no report.html: ValueError: no such glyph"


def result(verdict: str, **given: object) -> GapResult:
    gap = given.pop("gap", Gap(before=4.0, after=1.1))
    return GapResult(verdict=verdict, gap=gap, **given)  # type: ignore[arg-type]
