"""A level planar arm in fine steps: what a loose link of it does, no gravity holds back."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from loose_env.recording import Run
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR

# The plane is level, so that nothing but the motion throws a slide to and fro.
LEVEL = PLANAR.replace('gravity="0 -9.81 0"', 'gravity="0 0 -9.81"')
FINE, EVERY = 2e-4, 5
"""Step [s], and steps from one sample to the next."""
NOISE = np.array([2e-5, 2e-5, 2e-5, 2e-3, 0.03, 0.03, 0.03])


def recorded(
    data: mujoco.MjData,
    controls: Array,
    rng: np.random.Generator,
    *,
    name: str,
    excited: tuple[str, ...] = (),
) -> Run:
    """A run of commands (T, 3) from the state in ``data`` on, its readings with noise."""
    model = data.model
    shown = np.zeros((len(controls), model.nsensordata))
    for row, command in zip(shown, controls, strict=True):
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        row[:] = data.sensordata
        mujoco.mj_step(model, data, EVERY)
    shown += rng.normal(0, NOISE, shown.shape)
    names = ("encoder1", "encoder2", "encoder3", "rate3")
    return Run(
        name=name,
        time=np.arange(len(controls)) * FINE * EVERY,
        controls={f"servo{j + 1}": controls[:, j] for j in range(3)},
        sensors={n: shown[:, c] for c, n in enumerate(names)} | {"shake": shown[:, 4:]},
        excited=excited,
    )


def moving(model: mujoco.MjModel, speeds: Sequence[Array], *, size: float, count: int) -> list[Run]:
    """Runs of so many samples in which every joint swings at speeds of its own [rad/s]."""
    time, rng, runs = np.arange(count) * FINE * EVERY, np.random.default_rng(4), []
    for k, own in enumerate(speeds):
        controls = size * np.sin(np.outer(time, own))
        controls *= np.minimum(2 * time, 1.0)[:, None]
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 2000)
        runs.append(recorded(data, controls, rng, name=f"run-{k + 1:02d}.parquet"))
    return runs
