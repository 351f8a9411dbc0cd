"""Runs on simulation steps: what their time stamps say of the moments of commands."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Trial, align_run, channels_of
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Run
from loose_env.typing import Array

ARM = """<mujoco><worldbody><body><joint name="q" axis="0 1 0"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.01"/></body></worldbody>
<actuator><position name="servo" joint="q" kp="50" kv="5"/></actuator>
<sensor><jointpos name="encoder" joint="q"/></sensor></mujoco>"""
ROWS = 400


def _aligned(time: Array, step: float) -> Trial:
    """A run whose command counts its rows."""
    rows = np.arange(float(len(time)))
    run = Run(name="r", time=time, controls={"servo": rows}, sensors={"encoder": 1e-3 * rows})
    machine = NominalModel(mujoco.MjSpec.from_string(ARM))
    return align_run(run, machine, channels_of([run]), step=step)


@pytest.mark.parametrize(
    ("rate", "decimals", "begin"),
    [
        (100.0, 9, 0.0),
        (90.9, 6, 0.0),
        (90.9, 3, 0.0),
        (60.0, 6, 0.0),
        (30.0, 3, 0.0),
        (100.0, 9, 1727771234.12),
        (90.9, 9, 1727771234.12),
    ],
)
def test_rounded_stamps_make_no_command_late(rate: float, decimals: int, begin: float) -> None:
    time = np.round(begin + np.arange(ROWS) / rate, decimals)
    trial = _aligned(time, step=0.004)
    parts = round(1 / rate / trial.step)
    assert parts == np.ceil(1 / rate / 0.004)
    assert trial.step * parts == pytest.approx(1 / rate, rel=1e-4)
    held = np.arange(trial.steps) // parts
    assert np.array_equal(trial.controls[:, 0], np.minimum(held, ROWS - 1))
    assert np.allclose(np.diff(trial.time), trial.step * parts, rtol=1e-9)


def test_uneven_stamps_stay_and_hold_commands_from_the_nearest_step() -> None:
    rng = np.random.default_rng(1)
    time = 0.01 * np.arange(ROWS) + rng.uniform(-0.003, 0.003, ROWS)
    trial, step = _aligned(time, step=0.002), 0.002
    assert trial.step == step and np.allclose(trial.time, time - time[0])
    first = np.searchsorted(trial.controls[:, 0], np.arange(1.0, ROWS - 1.0)) * step
    late = first - (time - time[0])[1:-1]
    assert np.all(np.abs(late) <= 0.5 * step + 1e-12)
    assert abs(np.mean(late)) < 0.1 * step


def test_a_lost_row_keeps_the_stamps() -> None:
    time = np.delete(0.01 * np.arange(ROWS), 200)
    trial = _aligned(time, step=0.005)
    assert np.allclose(trial.time, time)
    assert trial.controls[401, 0] == 199  # held until the next row there is
    assert trial.controls[402, 0] == 200
