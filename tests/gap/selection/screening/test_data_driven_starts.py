"""What torque the drives gave beyond the model's, and what looks for itself in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Channel, Trial, align_run, channels_of
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.data_driven_starts import proposals, residual_torque
from loose_env.gap.simulation.simulator import Simulator
from loose_env.recording import Recording
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.gap_case import DAMPING, MODEL, STEP, record

NOTHING = Hypothesis()


def compared(recording: Recording) -> ResidualModel:
    machine = NominalModel(recording.spec(), step=STEP)
    channels = channels_of(list(recording.runs))
    trials = [align_run(run, machine, channels, step=STEP) for run in recording.runs]
    return ResidualModel(machine, trials, channels, np.ones(len(channels)), threads=1)


def test_the_missing_torque_is_what_the_model_lacks(tmp_path: Path) -> None:
    found = residual_torque(compared(record(tmp_path / "r")), NOTHING)
    assert found is not None
    _, speed, _, torque, _ = found
    moving = np.abs(speed[:, 1]) > 0.2
    rate = np.sum(torque[moving, 1] * speed[moving, 1]) / np.sum(speed[moving, 1] ** 2)
    assert rate == pytest.approx(DAMPING, rel=0.1)
    # Nothing is missing at the first joint, but for what the noise makes of it.
    assert np.std(torque[:, 0]) < 0.2 * np.std(torque[:, 1])


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
    comparison = ResidualModel(machine, trials, comparison.channels, comparison.floors, threads=1)
    starts = proposals(comparison, NOTHING, [ripple])[ripple.key]
    nearest = min(starts, key=lambda start: abs(start[1] - periods))
    assert nearest[1] == pytest.approx(periods, abs=1.0)
    assert nearest[0] == pytest.approx(4.0, rel=0.35)


@pytest.mark.parametrize(("where", "angle"), [("link1", 0.4), ("link2", 1.9), ("link3", -0.8)])
def test_a_loose_link_shakes_the_tool_along_its_own_direction(where: str, angle: float) -> None:
    runge_kutta = int(mujoco.mjtIntegrator.mjINT_RK4)
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=0.001, integrator=runge_kutta)
    channels = (
        *(Channel(f"sensor.encoder{k}") for k in (1, 2, 3)),
        *(Channel("sensor.shake", axis) for axis in range(3)),
    )
    count = 3000
    time = np.arange(count) * 0.001
    waves = np.sin(np.outer(time, [6.0, 9.0, 13.0]))
    bare = Trial(
        name="run-01.csv", form="forward", time=time, measured=np.zeros((count, 6)), step=0.001,
        steps=count, controls=waves * np.minimum(time, 1)[:, None],
        position=np.zeros(3), speed=np.zeros(3), resting=True, joints=machine.joints,
    )  # fmt: skip
    effect = CATALOGUE["structural_looseness"](machine, where)
    values = np.array([angle, 2e-4, *effect.starts[0][2:]])
    loose = Hypothesis(effects=(effect,), values=(values,))
    shown = Simulator(machine, [bare], channels, threads=1).predict([loose])[0][0]
    trial = replace(bare, measured=shown, motion={f"joint{k + 1}": shown[:, k] for k in range(3)})
    floors = np.array([1e-5] * 3 + [0.02] * 3)
    comparison = ResidualModel(machine, [trial], channels, floors, threads=1)
    starts = proposals(comparison, NOTHING, [effect])[effect.key]
    off = min(abs((start[0] - angle + np.pi / 2) % np.pi - np.pi / 2) for start in starts)
    assert off < 0.3  # a fit gets on from there
    gaps = {start[1] for start in starts}
    assert min(gaps) < 2e-4 < max(gaps)


@pytest.mark.parametrize(
    ("kind", "values"), [("torque_limit", (21.0,)), ("voltage_limit", (40.0, 9.0))]
)
def test_a_limit_starts_where_it_explains_what_was_not_given(
    kind: str, values: tuple[float, ...]
) -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=0.001)
    rng, time = np.random.default_rng(5), np.linspace(0.0, 10.0, 3000)
    speed = 3.0 * np.cos(4.0 * time) + np.cos(9.0 * time)
    asked = 50.0 * np.sin(2.3 * time + 0.4) * np.cos(0.7 * time)
    stall = values[0]
    back = stall / values[1] * speed if len(values) > 1 else 0.0
    given = np.clip(asked + back, -stall, stall) - back + rng.normal(0.0, 0.5, len(time))
    given[::40] += rng.normal(0.0, 30.0, len(given[::40]))  # where smoothing went wrong
    limit = CATALOGUE[kind](machine, "servo1")
    (start,) = limit.propose_limit(speed, asked, given)
    assert start == pytest.approx(values, rel=0.25 if len(values) > 1 else 0.03)
