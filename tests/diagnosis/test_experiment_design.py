"""Band and level of the excitation in a pose."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import LinearArm, planar, scara, six_axis, vera
from loose_env.diagnosis import holding_modes, propose_excitation
from loose_env.diagnosis.experiment_design import (
    propose_band,
)
from loose_env.errors import InvalidSetting
from loose_env.excitation import CREST_FACTOR

READY = np.array([0.0, -1.5, 1.5, 0.3, 0.5, 0.2])


def test_modes_of_two_held_bodies() -> None:
    """Two joints on springs: the frequencies of the 2 x 2 problem solved by hand."""
    arm = planar(2, hold="servo")
    at = LinearArm(arm).at([0.2, 1.1])
    dofs = at.linear.joint_dofs
    inertia = at.inertia[np.ix_(dofs, dofs)]
    k = np.array(arm.servo.stiffness) + arm.centring.stiffness
    trace = np.trace(np.linalg.inv(inertia) @ np.diag(k))
    det = np.prod(k) / np.linalg.det(inertia)
    by_hand = np.sqrt(
        [trace / 2 - np.sqrt(trace**2 / 4 - det), trace / 2 + np.sqrt(trace**2 / 4 - det)]
    )
    found = holding_modes(at, np.array([False, False]))
    np.testing.assert_allclose(found, by_hand / (2 * np.pi), rtol=1e-9)


def test_a_stiff_arm_keeps_its_band_and_a_soft_one_is_warned_of() -> None:
    band, modes, warnings = propose_band(LinearArm(six_axis()), READY)
    assert band == (30.0, 150.0)
    assert modes[0] > 300
    assert not warnings
    soft = six_axis(hold="servo")
    band, modes, warnings = propose_band(LinearArm(soft), READY)
    assert modes[0] < 150
    assert any("holding mode" in w for w in warnings)
    band, modes, warnings = propose_band(LinearArm(vera()), np.array([0.3, 1.0]))
    assert band[1] <= 0.51 * modes[0] or any("mode" in w for w in warnings)


@pytest.mark.parametrize(
    "arm", [six_axis(), scara(), planar(4, vertical=True)], ids=lambda a: a.name
)
def test_levels_are_within_the_drives(arm) -> None:  # type: ignore[no-untyped-def]
    pose = arm.random_pose(np.random.default_rng(0))
    found = propose_excitation(arm, pose)
    gravity = np.abs(LinearArm(arm).at(pose).gravity_torque)
    played = 0
    for j, shake in enumerate(found.excitations):
        if shake is None:
            assert found.levels[j] == 0
            continue
        played += 1
        assert np.flatnonzero(shake.torque_rms).tolist() == [j]
        assert gravity[j] + CREST_FACTOR * shake.torque_rms[j] <= arm.torque_limits[j] * (1 + 1e-9)
        assert 0 < found.levels[j] <= 50
    assert played >= 2
    assert (found.openings >= 0).all() and (found.openings <= 1).all()
    assert (found.seat_gravity <= 1.0 + 1e-6).all()


def test_a_band_below_the_modes_is_not_taken_where_gravity_shuts_the_seats_in_it() -> None:
    arm, low_enough, rng = planar(4, vertical=True, hold="compliant"), 0, np.random.default_rng(0)
    linear = LinearArm(arm)
    for _ in range(12):
        pose = arm.random_pose(rng)
        band, _, _ = propose_band(linear, pose)
        found = propose_excitation(arm, pose)
        low_enough += band != arm.band
        if band != found.band:
            assert found.band == arm.band
            assert any("stay shut" in w for w in found.warnings)
            assert found.openings.mean() > 0.1
    assert low_enough > 0
    # Without gravity nothing is lost below the modes.
    flat = vera()
    pose = np.array([0.3, 1.0])
    assert propose_excitation(flat, pose).band == propose_band(LinearArm(flat), pose)[0]


def test_heavier_seats_and_larger_gaps_ask_for_more() -> None:
    pose = np.array([0.3, 0.7, -0.4, 0.2])
    light = propose_excitation(planar(4), pose, gap=0.05e-3)
    wide = propose_excitation(planar(4), pose, gap=0.4e-3)
    assert (wide.levels > light.levels).all()
    vertical = propose_excitation(planar(4, vertical=True), pose, gap=0.05e-3)
    assert vertical.levels.mean() > light.levels.mean()
    assert vertical.openings.mean() < light.openings.mean()
    assert vertical.seat_gravity.min() > 0.9  # in its plane, the worst direction is down
    assert light.seat_gravity.max() < 1e-6  # gravity is across the plane


@pytest.mark.parametrize("bad", [{"gap": 0.0}, {"gap": np.nan}, {"friction": -1.0}, {"gap": "a"}])
def test_bad_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InvalidSetting):
        propose_excitation(planar(2), np.zeros(2), **bad)
