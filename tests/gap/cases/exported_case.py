"""A recording whose held-out run a written model can be held against."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from pathlib import Path

import mujoco
import numpy as np

from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer
from loose_env.gap.model.effect import Effect
from loose_env.gap.residuals.preparation.prepare import GapProblem, prepare
from loose_env.gap.settings import GapSettings
from loose_env.recording import Run, write_recording
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.gap_case import stated


def prepared_arm(folder: Path, *, rate: float = 1000.0, first: float = 0.0) -> GapProblem:
    """Runs of an arm with friction of 3 N·m·s/rad that begin at rest under the first command [rad].

    They have ``rate`` samples per second [Hz].
    """
    spec, inside = mujoco.MjSpec.from_string(PLANAR), ceil(1000.0 / rate)
    spec.option.timestep = 1 / (rate * inside)
    spec.joint("joint2").damping = np.array([3.5, 0, 0])
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    time, rng, runs = np.arange(round(2 * rate)) / rate, np.random.default_rng(3), []
    for k in range(2):
        moved = np.sin(np.outer(np.maximum(time - 0.4, 0), [5.0 + k, 7.0, 9.0 - k]))
        commands = first + 0.3 * moved
        data, shown = mujoco.MjData(model), np.zeros((len(time), 3))
        data.qpos[:] = data.ctrl[:] = first
        mujoco.mj_step(model, data, 1500)
        for row, command in zip(shown, commands, strict=True):
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            row[:] = data.sensordata[:3]
            mujoco.mj_step(model, data, inside - 1)
        shown += rng.normal(0, 2e-5, shown.shape)
        runs.append(
            Run(
                name=f"r{k}.csv", time=time,
                controls={f"servo{j + 1}": commands[:, j] for j in range(3)},
                sensors={f"encoder{j + 1}": shown[:, j] for j in range(3)},
            )
        )  # fmt: skip
    recording = write_recording(folder, model_xml=PLANAR, runs=runs, file_format="csv")
    return prepare(recording, GapSettings(threads=1, kinds=("viscous_friction",)))


def judged_with(problem: GapProblem, effect: Effect, values: Sequence[float]) -> ScoredFit:
    """The nominal model with an effect, as if that had been fitted."""
    scorer = Scorer(problem.fit, problem.held_out_whole)
    return scorer.score(stated(problem.fit, [effect], [np.array(values)]))
