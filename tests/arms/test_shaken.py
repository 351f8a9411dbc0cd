"""The shaker beside the arm: its place, its force, and the closed form against simulation."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.arms import COIL, add_shaker, place_shaker, planar
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation, torque_periods
from loose_env.rig import SimulatedRig
from loose_env.sensors import Accelerometer, SensorSuite
from scripts.thesis.estimators import transfer_function
from scripts.thesis.rigs import PROXIMAL, SHAKEN_BAND, shaken_vera
from scripts.thesis.shaken_arm import ShakenArm

RATE = 2000.0
PERFECT = SensorSuite(
    rate=RATE, accelerometer=Accelerometer(bandwidth=900.0, noise_density=0.0, resolution=0.0)
)


def shake(force: float = 10.0, duration: float = 3.0) -> Excitation:
    return Excitation(torque_rms=(0.0, 0.0), duration=duration, band=SHAKEN_BAND, shaker_rms=force)


@pytest.mark.parametrize("pose", [(0.0, 0.0), (0.7, 1.9), (-2.5, 4.0)])
def test_the_stand_meets_the_link_wherever_it_is(pose: tuple[float, float]) -> None:
    arm = shaken_vera()
    assert arm.shaker is not None
    spec = arm.spec.copy()
    add_shaker(spec, arm.shaker)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:2] = 0.0
    for name, angle in zip(arm.joints, pose, strict=True):
        data.joint(name).qpos[0] = angle
    place_shaker(model, data, arm.shaker)
    mujoco.mj_forward(model, data)
    coil, end = data.site(COIL).xpos, data.site("stinger_end").xpos
    assert np.linalg.norm(end - coil) == pytest.approx(arm.shaker.stinger_length, abs=1e-12)
    tangential = [-np.sin(pose[0]), np.cos(pose[0]), 0.0]
    np.testing.assert_allclose((end - coil) / arm.shaker.stinger_length, tangential, atol=1e-12)
    # Nothing pulls: the stinger has its own length and the coil rests.
    np.testing.assert_allclose(data.qfrc_passive, 0.0, atol=1e-6)


def test_the_closed_form_is_what_the_simulation_does() -> None:
    arm, pose = shaken_vera(), np.array([0.0, np.radians(56.0)])
    rig = SimulatedRig(arm, sensors=PERFECT)
    record = rig.measure(pose, shake(), rng=np.random.default_rng(3))
    assert record.failure is None
    force = record.shaker_force
    assert force is not None
    motion = np.concatenate([record.tool, record.probes[PROXIMAL][1:2]])
    found = transfer_function(force, motion, RATE, segments=12)
    closed = ShakenArm(arm, points=2000).at(pose)
    predicted = np.concatenate([closed.tool.T, closed.probes[PROXIMAL].T[1:2]])
    # Away from the sharp modes, where a window of half a second resolves the answer.
    inside = (found.frequencies > 130.0) & (found.frequencies < 200.0)
    for row in range(3):
        at = np.interp(found.frequencies[inside], closed.frequency, np.abs(predicted[row]))
        np.testing.assert_allclose(np.abs(found.response[row, inside]), at, rtol=0.15)


def test_the_shaker_draws_last_and_leaves_the_joints_signals_alone() -> None:
    without = Excitation(torque_rms=(1.0, 2.0), duration=1.2, band=(30.0, 150.0))
    with_it = Excitation(torque_rms=(1.0, 2.0), duration=1.2, band=(30.0, 150.0), shaker_rms=5.0)

    def draw(excitation: Excitation) -> np.ndarray:
        torque, force = np.array([excitation.torque_rms]), np.array([excitation.shaker_rms])
        rngs = [np.random.default_rng(1)]
        return torque_periods(
            torque, force, duration=1.2, band=excitation.band, timestep=1e-3, rngs=rngs
        )[0]

    a, b = draw(without), draw(with_it)
    assert (a.shape, b.shape) == ((2, 1200), (3, 1200))
    np.testing.assert_array_equal(a, b[:2])
    assert b[2].std() == pytest.approx(5.0, rel=0.2)


def test_the_force_stays_within_its_limit() -> None:
    arm = shaken_vera()
    record = SimulatedRig(arm, sensors=PERFECT).measure(np.zeros(2), shake(force=400.0))
    assert record.shaker_force is not None and arm.shaker is not None
    assert np.abs(record.shaker_force).max() == arm.shaker.force_limit


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InvalidSetting, match="has no shaker"):
        SimulatedRig(planar(2)).measure(np.zeros(2), shake())
    with pytest.raises(InvalidSetting, match="shaker_rms"):
        shake(force=-1.0)
    shaker = shaken_vera().shaker
    assert shaker is not None
    for name, value, words in (
        ("coil_mass", 0.0, "coil_mass must be positive"),
        ("stinger_damping", -1.0, "stinger_damping must be a finite number, zero or more"),
        ("direction", (0.0, 0.0, 0.0), "direction must not be zero"),
        ("force_limit", np.nan, "force_limit must be positive"),
    ):
        with pytest.raises(InvalidSetting, match=words):
            replace(shaker, **{name: value})


def test_a_shaker_needs_bodies_that_exist() -> None:
    arm = shaken_vera()
    spec = planar(2).spec.copy()
    assert arm.shaker is not None
    with pytest.raises(InvalidSetting, match="needs a body 'link1_end'"):
        add_shaker(spec, arm.shaker)
