"""The report of a model-error analysis: words first, every section in its place."""

from __future__ import annotations

import html
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
    EffectLocation,
    Gap,
    GapResult,
    GapSolution,
    Identifiability,
    NamedEffect,
    RankedHypothesis,
    ResidualDiagnostics,
    diagnose_residuals,
    result_of,
    write_gap,
)
from loose_env.gap.diagnostics.experiment_advice import identifiability_notes
from loose_env.gap.output.evidence_schema import ConfusablePair, UnidentifiableEffect
from loose_env.report import gap as gap_report
from loose_env.report import gap_headline, gap_text, render_gap_page, to_svg, write_gap_report
from loose_env.report.gap import (
    gap_steps,
    parameters_section,
    summary_words,
)
from loose_env.report.gap_figures import channel_bars, residual_panels
from tests.gap.cases.gap_case import record, solution_for
from tests.report.page_checks import checked, words


@pytest.fixture(scope="module")
def solution(tmp_path_factory: pytest.TempPathFactory) -> GapSolution:
    return solution_for(record(tmp_path_factory.mktemp("page") / "arm <3>"))


@pytest.fixture(scope="module")
def evidence(solution: GapSolution) -> ResidualDiagnostics:
    return diagnose_residuals(solution)


def row(kind: str, where: str, *others: str, step: int = 1) -> RankedHypothesis:
    places = tuple(EffectLocation(kind=kind, where=other) for other in others)
    return RankedHypothesis(
        kind=kind, where=where, held_out=1.0, bic=-9.0, step=step, together_with=places
    )


FINDINGS = tuple(
    Finding(
        check="sign", severity=severity, channel=f"sensor.{severity}", run="a.csv",
        found="runs backwards", consequence="it is wrong", remedy="turn it round",
        fix=Correction(kind="gravity", columns=("gravity",), vector=(0.0, 6.9, -6.9)),
    )
    for severity in get_args(Severity)
)  # fmt: skip
UNSEEN = Identifiability(
    unidentifiable=(
        UnidentifiableEffect(kind="quadratic_drag", where="joint1", parameters={"drag": 0.2},
                             z=1.5, additional_s=52.0),
    ),
    confusable=(
        ConfusablePair(kind="actuator_lag", where="m1", other_kind="command_delay",
                       other_where="m1", z=0.2, additional_s=None),
    ),
)  # fmt: skip


@pytest.fixture(scope="module")
def page(solution: GapSolution, evidence: ResidualDiagnostics) -> str:
    family = row("joint_spring", "joint1", "joint2", "joint3", step=3)
    other = replace(solution, preflight=FINDINGS, ranking=(*solution.ranking, family))
    remaining = ("Much is left.", "It is in encoder1.")
    result = replace(result_of(other, evidence), identifiability=UNSEEN, remaining=remaining)
    assert GapResult.from_json(result.to_json()).preflight == FINDINGS
    assert "critical: In a.csv, sensor.error: runs backwards" in gap_text(result)
    return render_gap_page(other, evidence, result)


def test_the_page_is_whole_and_the_table_of_parameters_comes_first(page: str) -> None:
    assert checked(page).headings == [
        "What to do next",
        "Parameters",
        "Measured, nominal and corrected",
        "Warnings",
        "Residual before and after correction",
        "Spectra before and after",
        "Residual against motion and load",
        "Residual by channel",
        "Candidate fits",
        "Remaining residual",
        "Identifiability from these motions",
    ]
    assert "arm &lt;3&gt;" in page and "arm <3>" not in page
    assert "<h1>The model lacks 2 effects.</h1>" in page
    first = page.index("<svg")
    for said in (
        "Viscous friction (joint2) and a sensor whose scale is off (rate3).",
        "Viscous friction (joint2): damping",
        "2.9 to 3.1",
    ):
        assert 0 < page.index(said) < first
    assert "do not separate viscous friction (joint2) from another gain (servo2)" in page
    assert "The step is coarse." in page


def test_everything_that_a_result_holds_stands_on_the_page(page: str) -> None:
    order = ["Much is left.", "It is in encoder1.", "Invalidates the result", "sensor.error"]
    order += ["Limits the result", "sensor.warning", "Notes"]
    order += ["joint_spring at joint1, joint2, joint3", "Identifiability from these motions"]
    order += ["quadratic_drag at joint1", "52 s", "no help"]
    places = [words(page).index(each) for each in order]
    assert places == sorted(places)
    notes = identifiability_notes(UNSEEN)
    assert notes[0] == (
        "these motions would not show quadratic_drag at joint1 (such as drag 0.2); record about "
        "52 s more of them, or better: move at the highest speed"
    )
    assert notes[1].startswith(
        "these motions do not tell actuator_lag at m1 from command_delay at m1; more of the same "
        "will not help: command a sweep"
    )


def test_one_table_has_nominal_and_found_value_with_interval_and_unit() -> None:
    drive = NamedEffect(
        kind="joint_compliance", where="elbow", parameters={"stiffness": 4e3, "mass": -0.5},
        interval_95={"stiffness": (3e3, 5e3)}, units={"stiffness": "N·m/rad", "mass": "kg"},
    )  # fmt: skip
    found = result("named", effects=(drive,), nominal_parameters={"mass.a": 1.02, "mass.b": 1.0})
    (table,) = parameters_section(found).tables
    assert table.columns == ["Parameter", "Nominal", "Found", "95 % interval", "Unit"]
    assert [list(row.values())[1:] for row in table.rows] == [
        ["rigid", "4000", "3000 to 5000", "N·m/rad"],
        ["0", "-0.5", "–", "kg"],
        ["1", "1.02", "–", "factor"],
    ]
    assert "The other 1 are closer to 1" in table.note
    assert not parameters_section(result("no_gap")).filled


@pytest.mark.slow
def test_an_unexplained_inverse_run_has_its_page_too(
    solution: GapSolution, evidence: ResidualDiagnostics
) -> None:
    other = replace(solution, verdict="unexplained", effects=(), ranking=())
    bare = replace(evidence, before=(), after=())
    result = result_of(other, bare)
    text = words(render_gap_page(other, bare, result))
    assert gap_headline(result) in text and "Candidate fits" not in text
    assert "Prediction error by horizon" not in text and "Channel by channel" in text
    assert "effects that are not identified: viscous_friction at joint2: damping 3" in text


def test_names_with_dollar_signs_are_drawn_as_they_are() -> None:
    names, values = ["q$1$", r"$\no{such$", "two $ and $"], np.linspace(-1, 1, 50)
    panels = {f"position of {name} [rad]": values for name in names}
    for figure in (
        channel_bars({f"sensor.{name}": (3.0, 1.0) for name in names}),
        residual_panels(panels, values, values, floor=0.1, label=f"[{names[0]}]"),
    ):
        drawn = re.sub("<!--.*?-->", "", to_svg(figure).decode(), flags=re.DOTALL)
        assert all(name in html.unescape(drawn) for name in names)


@pytest.mark.slow
def test_a_page_that_fails_takes_neither_model_nor_result_along(
    solution: GapSolution,
    evidence: ResidualDiagnostics,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    error: Exception = MissingExtra("figures need matplotlib")

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(gap_report, "render_gap_page", fail)
    (tmp_path / "report.html").write_text("of an earlier run")
    lines: list[str] = []
    report = partial(write_gap_report, say=lines.append)
    result, written = write_gap(tmp_path, solution, report=report, say=lines.append)
    assert [path.name for path in written] == ["model.xml", "result.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.xml", "result.json"]
    assert "no report.html: figures need matplotlib" in lines and result.verdict == "named"
    error = ValueError("no such glyph")
    assert report(tmp_path, solution, evidence, result) is None
    assert lines[-1] == "no report.html: ValueError: no such glyph"


def result(verdict: str, **given: object) -> GapResult:
    gap = given.pop("gap", Gap(before=4.0, after=1.1))
    return GapResult(verdict=verdict, gap=gap, **given)  # type: ignore[arg-type]


def test_what_short_runs_leave_unsure_is_not_said_to_be_outside_the_catalogue() -> None:
    likely = RankedHypothesis(
        kind="coulomb_friction", where="joint2", held_out=1.01, bic=-9e3, improvement_z=1.7
    )
    short = result("unexplained", gap=Gap(before=4.8, after=4.8), ranking=(likely,))
    for said in (gap_headline(short), summary_words(short)[0], gap_text(short)):
        assert "not in the catalogue" not in said
        assert "joint2" in said
    assert "not significant" in summary_words(short)[0]
    assert gap_steps(short)[0].startswith("Record more")
    # A hypothesis that is sure and was not named, or leaves much, or of a gap that was none.
    for other, gap in (
        (replace(likely, improvement_z=5.0), short.gap),
        (replace(likely, held_out=2.0), short.gap),
        (replace(likely, step=2), short.gap),
        (likely, Gap(before=1.1, after=1.1)),
    ):
        outside = replace(short, ranking=(other,), gap=gap)
        assert "not in the catalogue" in gap_headline(outside)
        assert "not in the catalogue" in gap_text(outside)
        assert not gap_steps(outside)[0].startswith("Record more")


def test_every_ambiguous_effect_gets_a_motion_that_separates_it() -> None:
    effect = NamedEffect(
        kind="coulomb_friction", where="joint1", parameters={"torque": 1.0},
        ambiguous_with=(
            EffectLocation(kind="backlash", where="joint1"),
            EffectLocation(kind="coulomb_friction", where="joint2"),
        ),
    )  # fmt: skip
    steps = gap_steps(result("named", effects=(effect,)))
    assert "gravity pulling to one side" in steps[1]
    assert "move joint1 while joint2 is held" in steps[2]


def named(*where: str) -> tuple[NamedEffect, ...]:
    return tuple(
        NamedEffect(kind="actuator_gain", where=w, parameters={"gain": 2.0}) for w in where
    )
