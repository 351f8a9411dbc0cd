"""Restarts from the measured state: exact where the model is right, growing where it is not."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.diagnostics.prediction_horizon import HorizonError, horizon_errors
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.simulation.simulator import Simulator
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR

RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
STEP, COUNT = 0.001, 2800
CHANNELS = (
    *(Channel(f"sensor.encoder{k}") for k in (1, 2, 3)),
    Channel("sensor.rate3"),
    *(Channel("sensor.shake", axis) for axis in range(3)),
)
FLOORS = np.array([1e-5, 1e-5, 1e-5, 1e-3, 0.02, 0.02, 0.02])


def machine() -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(PLANAR), step=STEP, integrator=RK4)


def commanded(own: NominalModel) -> Trial:
    """A forward run from rest, without readings."""
    time = np.arange(COUNT) * STEP
    swing = np.sin(np.outer(time, [2.1, 3.4, 5.2])) * np.minimum(time, 1.0)[:, None]
    return Trial(
        name="run-01.csv", form="forward", time=time, measured=np.zeros((COUNT, len(CHANNELS))),
        step=STEP, steps=COUNT, controls=0.4 * swing, position=np.zeros(3), speed=np.zeros(3),
        resting=True,
    )  # fmt: skip


def hypothesis_of(effect: Effect | None, values: Array | None = None) -> Hypothesis:
    if effect is None:
        return Hypothesis()
    own = np.array(effect.starts[0]) if values is None else values
    return Hypothesis(effects=(effect,), values=(own,))


def measured(own: NominalModel, truth: Hypothesis, *, noise: float = 0.0) -> Trial:
    from dataclasses import replace

    trial = commanded(own)
    shown = Simulator(own, [trial], CHANNELS, threads=1).predict([truth])[0][0]
    rng = np.random.default_rng(4)
    shown = shown + noise * FLOORS * rng.normal(0, 1, shown.shape)
    joints = {f"joint{k}": shown[:, k - 1] for k in (1, 2, 3)}
    return replace(trial, measured=shown, motion=joints)


def errors(own: NominalModel, trial: Trial, hypothesis: Hypothesis) -> tuple[HorizonError, ...]:
    return horizon_errors(
        own, [trial], CHANNELS, FLOORS, hypothesis, every=0.5, horizons=(0.1, 0.5, 2.0), threads=1
    )


@pytest.mark.parametrize(
    "kind",
    [
        "joint_compliance",
        "command_delay",
        "encoder_offset",
        "sensor_bias",
        "sensor_delay",
    ],
)
def test_the_truth_restarted_from_exact_readings_stays_on_them(kind: str) -> None:
    own = machine()
    truth = hypothesis_of(candidates(own, [kind])[0])
    trial = measured(own, truth)
    right = errors(own, trial, truth)
    assert [e.horizon for e in right] == [0.1, 0.5, 2.0]
    assert [e.starts for e in right] == [6, 5, 2]
    assert all(e.rms < 0.05 for e in right)
    wrong = errors(own, trial, hypothesis_of(None))
    assert wrong[-1].rms > 3 * max(right[-1].rms, 0.1)


def test_with_noise_the_truth_is_at_the_floor_and_a_wrong_model_is_not() -> None:
    own = machine()
    effect = candidates(own, ["viscous_friction"])[0]
    truth = hypothesis_of(effect)
    trial = measured(own, truth, noise=1.0)
    right, wrong = errors(own, trial, truth), errors(own, trial, hypothesis_of(None))
    assert all(0.97 < e.rms < 1.1 for e in right)
    assert wrong[0].rms > 1.2 and wrong[-1].rms > wrong[0].rms
    assert set(right[0].by_channel) == {channel.name for channel in CHANNELS}
    assert max(wrong[-1].by_channel, key=lambda c: wrong[-1].by_channel[c]) == "sensor.encoder1"


def test_missing_samples_are_skipped_and_count_for_nothing() -> None:
    own = machine()
    truth = hypothesis_of(None)
    trial = measured(own, truth, noise=1.0)
    trial.measured[::3, 1] = np.nan
    trial.measured[:, 3] = np.nan
    found = errors(own, trial, truth)
    assert all(0.95 < e.rms < 1.1 for e in found)
    assert "sensor.rate3" not in found[0].by_channel


def test_inverse_runs_have_no_open_loop() -> None:
    from dataclasses import replace

    own = machine()
    trial = replace(measured(own, hypothesis_of(None)), form="inverse")
    assert errors(own, trial, hypothesis_of(None)) == ()


def test_a_simulation_that_goes_wild_counts_as_far_off_and_is_no_error() -> None:
    own = machine()
    trial = measured(own, hypothesis_of(None))

    class Exploding(type(candidates(own, ["viscous_friction"])[0])):  # type: ignore[misc]
        def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
            spec.joint("joint1").damping = [-1e7, 0, 0]

    found = errors(own, trial, hypothesis_of(Exploding(own, "joint1"), np.array([1.0])))
    assert all(np.isfinite(e.rms) and e.rms > 1e3 for e in found)
