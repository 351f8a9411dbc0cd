"""The torque that a model lacks is that of the truth, whatever the noise of the readings.

A pendulum with a bob of 0.1 kg swings against bearing friction and air drag of known size.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.diagnostics.joint_torque_residual import joint_motion
from loose_env.gap.diagnostics.localisation import _joint_gaps
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Run
from loose_env.statistics import channel_floor

MODEL = """<mujoco><option timestep="0.001"/><worldbody><body><joint name="pivot" axis="0 1 0"/>
<inertial pos="0 0 -.3" mass=".1" diaginertia="1e-5 1e-5 1e-5"/></body></worldbody>
<sensor><jointpos name="q" joint="pivot"/></sensor></mujoco>"""
INERTIA, WEIGHT = 0.1 * 0.3**2 + 1e-5, 0.1 * 9.81 * 0.3
BEARING, DRAG = 0.004, 0.002
"""Dry friction [N·m] and drag [N·m·s²/rad²]."""
SECONDS = 15.0


def swing(rate: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Times, angles and the root mean square of the missing torque, by an own integrator."""
    parts = max(1, int(2000 / rate))
    step = 1 / rate / parts
    angle, speed, angles, torques = 1.2, 0.0, [], []
    for _ in range(int(SECONDS * rate)):
        angles.append(angle)
        torques.append(BEARING * np.tanh(speed / 0.01) + DRAG * speed * abs(speed))
        for _ in range(parts):
            friction = BEARING * np.tanh(speed / 0.01) + DRAG * speed * abs(speed)
            speed -= step * (WEIGHT * np.sin(angle) + friction) / INERTIA
            angle += step * speed
    rms = float(np.sqrt(np.mean(np.square(torques))))
    return np.arange(len(angles)) / rate, np.array(angles), rms


def told(time: np.ndarray, angle: np.ndarray) -> float:
    """Missing torque that the diagnostics state [N·m]."""
    run = Run(name="a.csv", time=time, sensors={"q": angle})
    machine, channels = NominalModel(mujoco.MjSpec.from_string(MODEL)), channels_of([run])
    trial = align_run(run, machine, channels, step=0.001)
    motion = joint_motion(machine, trial, channels, np.array([channel_floor(angle)]))
    (gap,) = _joint_gaps("a.csv", motion)
    assert gap.unit == "N·m"
    return gap.residual


ERRORS = {
    "noise": lambda q, rng: q + rng.normal(0, 1e-3, len(q)),
    "loud noise": lambda q, rng: q + rng.normal(0, 5e-3, len(q)),
    "heavy tails": lambda q, rng: q + 2e-3 * rng.standard_t(2, len(q)),
    "quantised": lambda q, rng: np.round(q / (2 * np.pi / 4096)) * (2 * np.pi / 4096),
    "glitches": lambda q, rng: q + np.where(rng.random(len(q)) < 0.01, 0.3, 0.0),
    "one glitch": lambda q, rng: q + 0.5 * (np.arange(len(q)) == len(q) // 2),
    "held": lambda q, rng: np.repeat(q[::2], 2)[: len(q)] + rng.normal(0, 1e-4, len(q)),
    "slow to read": lambda q, rng: np.interp(np.arange(len(q)), np.arange(len(q))[::4], q[::4]),
}


@pytest.mark.parametrize("rate", [60.0, 100.0, 500.0])
@pytest.mark.parametrize("error", ERRORS)
def test_residual_torque_is_that_of_the_truth(rate: float, error: str) -> None:
    if error in ("held", "slow to read") and rate < 100:
        pytest.skip("the swing itself is not resolved")
    time, angle, true = swing(rate)
    found = told(time, ERRORS[error](angle, np.random.default_rng(2)))
    assert abs(found / true - 1) < 0.3
    assert found < 0.1 * WEIGHT


def test_a_model_that_lacks_nothing_lacks_no_torque() -> None:
    time = np.arange(3000) / 200
    model = mujoco.MjModel.from_xml_string(MODEL)
    data, angles = mujoco.MjData(model), []
    data.qpos[0] = 1.0
    for _ in time:
        angles.append(data.qpos[0])
        for _ in range(5):
            mujoco.mj_step(model, data)
    noisy = np.array(angles) + np.random.default_rng(0).normal(0, 2e-3, len(time))
    assert told(time, noisy) < 0.02 * WEIGHT
