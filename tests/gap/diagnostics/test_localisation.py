from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.diagnostics.joint_torque_residual import JointMotion, joint_motion
from loose_env.gap.diagnostics.localisation import locate, location_notes, main_band, strongest
from loose_env.gap.diagnostics.regressors import REGRESSORS
from loose_env.gap.diagnostics.residual_tests import residual_tests
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import Rows
from loose_env.typing import Array

CHANNELS = (Channel("sensor.q"), Channel("sensor.acc", 0))
RATE, COUNT = 500.0, 5000
TIME = np.arange(COUNT) / RATE
ANGLE = 0.5 * np.sin(2 * np.pi * 0.37 * TIME) + 0.2 * np.sin(2 * np.pi * 1.31 * TIME + 1)
SPEED = np.gradient(ANGLE, TIME)

# A pendulum with a position servo; what it lacks is added by the tests.
PENDULUM = """
<mujoco>
  <option timestep="0.001" integrator="RK4"/>
  <worldbody>
    <body>
      <joint name="turn" axis="0 1 0" damping="{damping}" frictionloss="{friction}"/>
      <inertial pos="0 0 -0.4" mass="2" diaginertia="0.02 0.02 0.01"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="turn" kp="300" kv="20"/></actuator>
  <sensor><jointpos name="q" joint="turn"/></sensor>
</mujoco>
"""


def trial_of(name: str = "run-01.csv", **given: object) -> Trial:
    empty = np.zeros((COUNT, 2))
    whole = dict(
        name=name, form="forward", time=TIME, measured=empty, step=1 / RATE, steps=COUNT,
        controls=np.zeros((COUNT, 1)), position=np.zeros(1), speed=np.zeros(1), resting=True,
    )  # fmt: skip
    return Trial(**(whole | given))  # type: ignore[arg-type]


def rows_of(runs: int = 1) -> Rows:
    trial, sample, channel = np.meshgrid(np.arange(runs), np.arange(COUNT), [0, 1], indexing="ij")
    sample = sample.ravel()
    block = (sample / RATE // 0.5).astype(int) + 100 * trial.ravel()
    return Rows(
        trial=trial.ravel(), channel=channel.ravel(), sample=sample, index=sample, block=block,
        random_excitation=np.zeros(sample.size, dtype=bool),
        is_feature=np.zeros(sample.size, dtype=bool),
        inverse=np.zeros(sample.size, dtype=bool),
    )  # fmt: skip


def motion() -> JointMotion:
    one = ANGLE[:, None]
    return JointMotion(
        joints=("turn",), units=("N·m",), time=TIME, position=one, speed=SPEED[:, None],
        acceleration=np.gradient(SPEED, TIME)[:, None], load=3 * np.sin(one),
        residual_torque=np.full_like(one, np.nan), residual_noise=np.array([np.nan]),
    )  # fmt: skip


def residual(on_q: Array, seed: int = 1) -> Array:
    noise = np.random.default_rng(seed).normal(0, 1, (COUNT, 2))
    noise[:, 0] += on_q
    return noise.ravel()


def goes_with(on_q: Array) -> str | None:
    gap = locate(residual(on_q), rows_of(), [trial_of()], CHANNELS, [motion()]).channels[0]
    found = strongest(gap.dependences)
    return None if found is None else found.regressor


def test_noise_is_at_its_floor_at_every_frequency_and_goes_with_nothing() -> None:
    location = locate(residual(np.zeros(COUNT)), rows_of(), [trial_of()], CHANNELS, [motion()])
    assert [gap.channel for gap in location.channels] == ["sensor.q", "sensor.acc.x"]
    for gap in location.channels:
        assert gap.rms == pytest.approx(1, abs=0.05)
        assert strongest(gap.dependences) is None and main_band(gap) is None
        wide = [band for band in gap.bands if band.high > 3]
        assert all(0.8 < band.rms < 1.2 for band in wide)
        assert sum(band.share for band in gap.bands) == pytest.approx(1)
    assert location_notes(location) == []


@pytest.mark.parametrize(
    ("on_q", "quantity"),
    [
        (3 * np.sign(SPEED), "direction"),
        (3 * SPEED, "velocity"),
        (8 * np.cos(9 * ANGLE), "position"),
        (0.3 * np.gradient(SPEED, TIME), "acceleration"),
    ],
)
def test_a_residual_is_told_by_what_it_goes_with(on_q: Array, quantity: str) -> None:
    assert goes_with(on_q) == quantity


def test_a_resonance_is_found_in_its_band_and_named_in_words() -> None:
    gap = locate(
        residual(6 * np.sin(2 * np.pi * 47 * TIME)), rows_of(), [trial_of()], CHANNELS, [motion()]
    )
    band = main_band(gap.channels[0])
    assert band is not None and (band.low, band.high) == (30.0, 100.0)
    words = location_notes(gap)
    assert len(words) == 1
    assert (
        words[0].startswith("sensor.q has a residual of up to 4.")
        and "between 30 and 100 Hz" in words[0]
    )


def test_a_constant_is_called_constant() -> None:
    said = location_notes(
        locate(residual(np.full(COUNT, 9.0)), rows_of(), [trial_of()], CHANNELS, [motion()])
    )
    assert "almost constant" in said[0]


def simulated(damping: float, friction: float, *, noise: float = 2e-5) -> Trial:
    """A measured run of a pendulum that is led along the test's motion."""
    model = mujoco.MjModel.from_xml_string(PENDULUM.format(damping=damping, friction=friction))
    data = mujoco.MjData(model)
    steps = 2 * COUNT
    controls = np.interp(np.arange(steps) / 1000, TIME, ANGLE)[:, None]
    controls *= np.minimum(np.arange(steps)[:, None] / 1000, 1.0)
    angle = np.zeros(steps)
    for k in range(steps):
        data.ctrl[:] = controls[k]
        mujoco.mj_step(model, data)
        angle[k] = data.sensordata[0]
    read = angle[::2] + np.random.default_rng(3).normal(0, noise, COUNT)
    return trial_of(
        measured=np.stack([read, np.full(COUNT, np.nan)], axis=1), step=0.001, steps=steps,
        controls=controls, motion={"turn": read},
    )  # fmt: skip


def missing(damping: float, friction: float) -> JointMotion:
    machine = NominalModel(
        mujoco.MjSpec.from_string(PENDULUM.format(damping=0.1, friction=0)), step=0.001
    )
    trial = simulated(damping, friction)
    return joint_motion(machine, trial, CHANNELS[:1], np.array([2e-5]))


def test_torque_that_the_model_does_not_explain_is_that_of_the_effect_in_its_unit() -> None:
    found = missing(damping=1.6, friction=0)
    torque, speed = found.residual_torque[:, 0], found.speed[:, 0]
    good = np.isfinite(torque)
    rate = float(np.polyfit(speed[good], torque[good], 1)[0])
    assert rate == pytest.approx(1.5, rel=0.02)
    left = torque[good] - rate * speed[good]
    assert np.std(left) < 3 * found.residual_noise[0]
    assert found.units == ("N·m",)


def test_of_a_machine_without_gap_only_noise_is_unexplained() -> None:
    found = missing(damping=0.1, friction=0)
    torque = found.residual_torque[:, 0]
    rms = float(np.sqrt(np.nanmean(torque**2)))
    assert 0.5 * found.residual_noise[0] < rms < 2 * found.residual_noise[0]


def test_dry_friction_shows_as_torque_that_goes_with_the_direction() -> None:
    location = locate(
        np.zeros(0), rows_of(0), [simulated(0.1, 0.8)],
        CHANNELS[:1], [missing(damping=0.1, friction=0.8)],
    )  # fmt: skip
    gap = location.joints[0]
    found = strongest(gap.dependences)
    assert found is not None and found.regressor == "direction"
    assert gap.residual == pytest.approx(0.8, rel=0.1)
    assert (
        "turn has a residual torque of 0.7" in location_notes(location)[0]
        and "N·m" in location_notes(location)[0]
    )


def test_noise_that_is_left_is_called_white_and_a_rest_is_not() -> None:
    tests = residual_tests(residual(np.zeros(COUNT)), rows_of(), [trial_of()], CHANNELS, [motion()])
    assert [t.channel for t in tests] == ["sensor.q", "sensor.acc.x"]
    assert all(t.white and not t.dependences and t.trend_z < 3.5 for t in tests)
    assert tests[0].correlation_time == pytest.approx(1 / RATE, rel=0.3)
    rest = residual_tests(residual(2 * SPEED), rows_of(), [trial_of()], CHANNELS, [motion()])[0]
    assert not rest.white and rest.correlation_time > 0.05
    assert "velocity" in {d.regressor for d in rest.dependences} <= set(REGRESSORS)


def test_a_drift_over_a_run_is_measured() -> None:
    tests = residual_tests(
        residual(2 * TIME / TIME[-1]), rows_of(), [trial_of()], CHANNELS, [motion()]
    )
    assert tests[0].trend == pytest.approx(2, abs=0.2) and tests[0].trend_z > 6
    assert tests[1].trend_z < 4
