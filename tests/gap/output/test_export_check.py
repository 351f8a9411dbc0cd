"""The corrected model's file does in plain MuJoCo what was fitted, or it says that it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.drives.actuators import ActuatorLag, CommandDelay
from loose_env.gap.model.effects.friction import ViscousFriction
from loose_env.gap.model.effects.sensors import SensorGain
from loose_env.gap.output.export_check import Exported, exported
from loose_env.gap.residuals.preparation.prepare import GapProblem
from tests.gap.cases.exported_case import judged_with, prepared_arm


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> GapProblem:
    return prepared_arm(tmp_path_factory.mktemp("exported") / "r")


def export_of(problem: GapProblem, effect: Effect, values: list[float]) -> Exported:
    best = judged_with(problem, effect, values)
    return exported(problem.held_out_whole, best.fitted.hypothesis.of_model, best.held_out_residual)


def test_what_acts_slowly_needs_no_finer_step(problem: GapProblem) -> None:
    found = export_of(problem, ViscousFriction(problem.machine, "joint2"), [3.0])
    assert found.parts == 1 and not found.matters and found.notes() == []
    assert found.left == pytest.approx(found.fitted, rel=1e-3) and found.fitted < 1.1


def export_as_fitted(problem: GapProblem, effect: Effect, value: float) -> Exported:
    """Held against a fit that is right: the readings are its own, and it leaves nothing."""
    best, held = judged_with(problem, effect, [value]), problem.held_out_whole
    hypothesis = best.fitted.hypothesis.of_model
    (shown,) = held.predict([hypothesis])
    measured = [trial.measured.copy() for trial in held.trials]
    try:
        for trial, values in zip(held.trials, shown, strict=True):
            trial.measured[:] = values
        return exported(held, hypothesis, np.zeros(len(held)))
    finally:
        for trial, values in zip(held.trials, measured, strict=True):
            trial.measured[:] = values


@pytest.mark.parametrize(
    ("kind", "where", "late"),
    [
        (ActuatorLag, "servo2", 0.0002),
        (ActuatorLag, "servo2", 0.0011),
        (CommandDelay, "all", 0.0004),
    ],
)
def test_what_is_shorter_than_a_step_is_written_with_a_finer_one(
    kind: type[Effect], where: str, late: float, problem: GapProblem
) -> None:
    found = export_as_fitted(problem, kind(problem.machine, where), late)
    assert not found.matters and found.apart < 0.3
    assert found.parts > 1 or late > problem.machine.step
    if found.parts > 1:
        assert found.step == pytest.approx(problem.machine.step / found.parts)
        assert "has a time step of" in found.notes()[0]


@pytest.mark.parametrize("rate", [60.0, 100.0, 300.0, 1000.0])
def test_samples_need_not_fall_on_steps_of_the_model(rate: float, tmp_path: Path) -> None:
    problem = prepared_arm(tmp_path / "r", rate=rate)
    found = export_of(problem, ViscousFriction(problem.machine, "joint2"), [3.0])
    assert found.parts == 1 and not found.notes()
    assert found.apart < 1e-3 and found.left == pytest.approx(found.fitted, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "where", "late"),
    [(CommandDelay, "all", 0.1), (ActuatorLag, "servo2", 0.15)],
)
def test_what_comes_late_begins_with_the_first_command(
    kind: type[Effect], where: str, late: float, tmp_path: Path
) -> None:
    problem = prepared_arm(tmp_path / "r", first=0.5)
    found = export_as_fitted(problem, kind(problem.machine, where), late)
    assert found.parts == 1 and found.apart < 0.1 and not found.notes()


def test_a_file_that_lacks_what_was_fitted_is_found_out(
    problem: GapProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ViscousFriction, "export", lambda *_: None)
    found = export_of(problem, ViscousFriction(problem.machine, "joint2"), [3.0])
    assert found.matters and found.parts == 1 and found.left > 3 * found.fitted
    (words,) = found.notes()
    assert found.channel in words and "deviates from the fit" in words


def test_what_a_file_cannot_carry_is_not_tried(problem: GapProblem) -> None:
    found = export_of(problem, SensorGain(problem.machine, "encoder1"), [1.1])
    assert found == Exported() and np.isnan(found.left) and found.notes() == []
