"""Missing samples, coarse encoders, channels on one value: as real recordings have them."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Trial, align_run, channels_of
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.residuals.windows import _window
from loose_env.gap.selection.screening.data_driven_starts import residual_accelerations
from loose_env.recording import Run
from loose_env.statistics import noise_floor
from loose_env.typing import Array
from tests.gap.diagnostics.test_prediction_horizon import CHANNELS, FLOORS, machine, measured

SLIDER = """<mujoco><worldbody><body><joint name="hip"/><geom size=".1"/></body></worldbody>
<sensor><jointpos name="at" joint="hip"/><jointvel name="rate" joint="hip"/></sensor></mujoco>"""


@pytest.mark.parametrize("missing", [0.0, 0.05, 0.1, 0.2])
def test_missing_samples_do_not_lower_the_noise_floor(missing: float) -> None:
    rng = np.random.default_rng(5)
    time = np.arange(6000) / 1000
    values = 0.3 * np.sin(2 * np.pi * 3 * time) + rng.normal(0, 0.01, len(time))
    values[rng.random(len(time)) < missing] = np.nan
    assert noise_floor(values) == pytest.approx(0.01, rel=0.1)


def test_a_window_lies_on_motion_and_not_on_dropouts() -> None:
    time = np.arange(4000) / 1000
    values = np.where(time < 2.5, 1.5, 1.5 + 0.3 * np.sin(2 * np.pi * 2 * (time - 2.5)))
    values[:2000][np.random.default_rng(1).random(2000) < 0.2] = np.nan
    trial = Trial(
        name="a.csv", form="forward", time=time, measured=values[:, None], step=1e-3, steps=4000,
        controls=np.zeros((4000, 0)), position=np.zeros(1), speed=np.zeros(1), resting=True,
        joints=("hip",), motion={"hip": values},
    )  # fmt: skip
    window = _window(trial, 1.0)
    assert np.nanmax(window.motion["hip"]) - np.nanmin(window.motion["hip"]) > 0.5
    assert len(_window(replace(trial, motion={"hip": np.full(4000, np.nan)}), 1.0).time) < 2000


def aligned(position: Array, speed: Array | None, pose: dict[str, float] | None = None) -> Trial:
    machine = NominalModel(mujoco.MjSpec.from_string(SLIDER))
    sensors = {"at": position} | ({} if speed is None else {"rate": speed})
    run = Run(name="a.csv", time=np.arange(len(position)) / 1000, sensors=sensors, pose=pose)
    return align_run(run, machine, channels_of([run]), step=1e-3)


def test_a_coarse_encoder_does_not_contradict_a_measured_speed() -> None:
    rng = np.random.default_rng(2)
    angle = 0.5 * np.arange(2000) / 1000
    speed = 0.5 + rng.normal(0, 1e-3, 2000)
    coarse = aligned(np.round(angle / 0.02) * 0.02, speed)
    assert coarse.speed[0] == pytest.approx(0.5, abs=0.01)
    # where a fine encoder stands still, the speed sensor has a bias
    assert aligned(np.full(2000, 0.3) + 1e-5 * (np.arange(2000) % 2), speed).speed[0] == 0.0


def test_an_encoder_that_was_never_read_leaves_the_noted_pose() -> None:
    trial = aligned(np.full(200, np.nan), np.zeros(200), pose={"hip": 0.7})
    assert trial.position[0] == 0.7 and "hip" not in trial.motion


def test_a_missing_encoder_sample_is_left_out_of_residual_accelerations() -> None:
    own = machine()
    trial = measured(own, Hypothesis(), noise=1.0)
    trial = replace(trial, joints=own.joints)
    trial.motion["joint2"] = trial.motion["joint2"].copy()
    trial.motion["joint2"][::2] = np.nan
    comparison = ResidualModel(own, [trial], CHANNELS, FLOORS, threads=1)
    found = residual_accelerations(comparison, Hypothesis())
    assert found is not None and len(found.poses) > 100
    assert np.isfinite(found.poses).all() and np.isfinite(found.accelerations).all()
