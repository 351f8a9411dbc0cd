"""The corrected model in plain MuJoCo, and on a machine without the effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("numba")

from loose_env.gap import Effect, GapSolution, NamedEffect
from loose_env.gap.model.effects.drives.actuators import ActuatorLag, CommandDelay
from loose_env.gap.model.effects.friction import ViscousFriction
from loose_env.gap.model.effects.joint_elasticity import JointCompliance
from loose_env.gap.model.effects.sensors import SensorGain
from loose_env.gap.residuals.preparation.prepare import GapProblem
from scripts.suites.gap.cases import draw_case
from scripts.suites.gap.grading.exported import exported_gap
from scripts.suites.gap.studies.edits import EditRow, edit_rows, table
from tests.gap.cases.exported_case import judged_with, prepared_arm


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> GapProblem:
    return prepared_arm(tmp_path_factory.mktemp("exported") / "r")


def found(problem: GapProblem, effect: Effect, values: list[float]) -> GapSolution:
    """As the tool would have found it."""
    best = judged_with(problem, effect, values)
    named = NamedEffect(kind=effect.kind, where=effect.where, parameters={})
    return GapSolution(problem=problem, base=best, best=best, verdict="named", effects=(named,))


@pytest.mark.parametrize(
    ("kind", "where", "values"),
    [
        (ViscousFriction, "joint2", [3.0]),
        (CommandDelay, "all", [0.0123]),
        (ActuatorLag, "servo2", [0.0123]),
        (ActuatorLag, "servo2", [0.0002]),
        (JointCompliance, "joint2", [3000.0, 0.05]),
    ],
)
def test_a_written_model_leaves_what_the_fit_leaves(
    kind: type, where: str, values: list[float], problem: GapProblem, tmp_path: Path
) -> None:
    case = found(problem, kind(problem.machine, where), values)
    gaps = exported_gap(case, tmp_path)
    assert gaps is not None
    assert gaps[0] == pytest.approx(gaps[1], rel=0.03)
    assert (gaps[1] < 1.1) == (kind is ViscousFriction)


def test_a_model_file_without_the_effect_is_found_out(
    problem: GapProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect = ViscousFriction(problem.machine, "joint2")
    case = found(problem, effect, [3.0])
    monkeypatch.setattr(ViscousFriction, "export", lambda *_: None)
    gaps = exported_gap(case, tmp_path)
    assert gaps is not None and gaps[0] > 3 * gaps[1]


def test_what_a_model_file_cannot_carry_is_not_checked(problem: GapProblem, tmp_path: Path) -> None:
    effect = SensorGain(problem.machine, "encoder1")
    assert exported_gap(found(problem, effect, [1.1]), tmp_path) is None
    nothing = replace(found(problem, effect, [1.1]), effects=())
    assert exported_gap(nothing, tmp_path) is None


# Edit test

NUMBER = 1264


def test_a_corrected_model_predicts_the_machine_without_the_effect() -> None:
    (effect,) = draw_case(NUMBER).arm.effects
    (row,) = edit_rows(NUMBER, kinds=(effect.kind, "rotor_inertia"))
    assert row.effect == f"{effect.kind} at {effect.place.name}" and row.left == 0
    assert row.edited < 1.2 < 2 * row.edited < row.unedited


def test_nothing_is_edited_where_nothing_was_named_rightly() -> None:
    assert edit_rows(NUMBER, kinds=("rotor_inertia",)) == []


def test_the_table_has_a_line_for_each_effect() -> None:
    row = EditRow(
        number=3, effect="payload at tool", left=1, nominal=4.0, unedited=3.0, edited=1.01
    )
    assert table([row]).splitlines()[-1] == "| 3 | payload at tool | 1 | 4.00 | 3.00 | 1.01 |"
