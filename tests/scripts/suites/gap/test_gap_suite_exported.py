"""The model that is written does in plain MuJoCo what the tool says it does."""

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
from loose_env.gap.preparation.prepare import GapProblem
from scripts.suites.gap.grading.exported import exported_gap
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
