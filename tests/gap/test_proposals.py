"""What torque the drives gave beyond the model's, and what looks for itself in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.gap.catalogue import CATALOGUE
from loose_env.gap.comparison import Comparison
from loose_env.gap.machine import Machine
from loose_env.gap.proposals import missing_torque, proposals
from loose_env.gap.simulator import Hypothesis
from loose_env.gap.trial import channels_of, lay_out
from loose_env.recording import Recording
from tests.gap.gap_case import DAMPING, MODEL, STEP, record

Array = NDArray[np.float64]
NOTHING = Hypothesis(effects=(), values=())


def compared(recording: Recording) -> Comparison:
    machine = Machine(recording.spec(), step=STEP)
    channels = channels_of(list(recording.runs))
    trials = [lay_out(run, machine, channels, step=STEP) for run in recording.runs]
    return Comparison(machine, trials, channels, np.ones(len(channels)), threads=1)


def test_the_missing_torque_is_what_the_model_lacks(tmp_path: Path) -> None:
    found = missing_torque(compared(record(tmp_path / "r")), NOTHING)
    assert found is not None
    _, speed, _, torque = found
    moving = np.abs(speed[:, 1]) > 0.2
    rate = np.sum(torque[moving, 1] * speed[moving, 1]) / np.sum(speed[moving, 1] ** 2)
    assert rate == pytest.approx(DAMPING, rel=0.1)
    # Nothing is missing at the first joint, but for what the noise makes of it.
    assert np.std(torque[:, 0]) < 0.2 * np.std(torque[:, 1])


def test_what_is_known_already_is_taken_off(tmp_path: Path) -> None:
    comparison = compared(record(tmp_path / "r"))
    friction = CATALOGUE["viscous_friction"](comparison.machine, "joint2")
    known = Hypothesis(effects=(friction,), values=(np.array([DAMPING]),))
    before, after = missing_torque(comparison, NOTHING), missing_torque(comparison, known)
    assert before is not None and after is not None
    assert np.std(after[3][:, 1]) < 0.3 * np.std(before[3][:, 1])


@pytest.mark.parametrize("periods", [7.0, 13.0])
def test_a_ripple_finds_its_own_period(tmp_path: Path, periods: float) -> None:
    comparison = compared(record(tmp_path / "r", runs=2))
    machine = comparison.machine
    ripple = CATALOGUE["torque_ripple"](machine, "joint1")
    spec = mujoco.MjSpec.from_string(MODEL)
    ripple.edit(spec, np.array([4.0, periods, 0.8]))
    model, trials = spec.compile(), []
    for trial in comparison.trials:
        data = mujoco.MjData(model)
        shown = np.zeros_like(trial.measured)
        for k, row in enumerate(shown):
            data.ctrl[:3] = trial.controls[k]
            mujoco.mj_step(model, data)
            row[:] = data.sensordata
        motion = {f"joint{j + 1}": shown[:, j] for j in range(3)}
        trials.append(replace(trial, measured=shown, motion=motion))
    comparison = Comparison(machine, trials, comparison.channels, comparison.floors, threads=1)
    starts = proposals(comparison, NOTHING, [ripple])[ripple.key]
    nearest = min(starts, key=lambda start: abs(start[1] - periods))
    assert nearest[1] == pytest.approx(periods, abs=1.0)
    assert nearest[0] == pytest.approx(4.0, rel=0.35)


def test_effects_that_do_not_search_are_left_to_their_own_starts(tmp_path: Path) -> None:
    comparison = compared(record(tmp_path / "r", runs=2))
    friction = CATALOGUE["viscous_friction"](comparison.machine, "joint2")
    assert proposals(comparison, NOTHING, [friction]) == {}
