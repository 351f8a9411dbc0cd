"""The recursion on arms whose geometry is known."""

import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.errors import InvalidData
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.thesis.methods.looseness.parameter_recursion import (
    distended_angles,
    identify_planar,
    parameter_deviations,
    rotation_arms,
    slide_direction,
    velocity_components,
)

LENGTHS = np.array([0.5, 0.35, 0.4, 0.2, 0.15])
OFFSETS = np.array([0.0, 0.3, -1.0, 0.7, 2.5])
RATES = np.array([0.4, -0.7, 0.5, 1.1, -0.9])


def jacobian(angles: np.ndarray) -> np.ndarray:
    """Closed form: every joint moves the tool across the vector from it to the tool."""
    heading = np.cumsum(angles + OFFSETS)
    links = LENGTHS[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    arms = np.cumsum(links[::-1], axis=0)[::-1]
    return np.array([-arms[:, 1], arms[:, 0]])


def test_lengths_and_offsets_come_back_in_any_pose():
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = rng.uniform(-np.pi, np.pi, 5)
        found = identify_planar(velocity_components(jacobian(q), RATES), RATES, q)
        np.testing.assert_allclose(found.lengths, LENGTHS, rtol=1e-10)
        error = (found.offsets - OFFSETS[1:] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(error, 0, atol=1e-10)


def test_the_frame_does_not_matter():
    q = np.array([0.1, 0.4, -0.5, 0.9, 0.2])
    v = velocity_components(jacobian(q), RATES)
    c, s = np.cos(0.7), np.sin(0.7)
    turned = identify_planar(v @ np.array([[c, s], [-s, c]]), RATES, q)
    straight = identify_planar(v, RATES, q)
    np.testing.assert_allclose(turned.offsets, straight.offsets, atol=1e-12)
    np.testing.assert_allclose(turned.directions - straight.directions, 0.7, atol=1e-12)


def test_on_mujocos_arm():
    arm, q = planar(4), np.array([0.3, -0.6, 0.8, 0.5])
    j = geometric_jacobian(Chain.of(arm, q))[:2]
    found = identify_planar(velocity_components(j, np.ones(4)), np.ones(4), q)
    np.testing.assert_allclose(found.lengths, 0.30, rtol=1e-12)
    np.testing.assert_allclose(found.offsets, 0, atol=1e-12)


def test_components_add_up():
    q = np.zeros(5)
    parts = velocity_components(jacobian(q), RATES)
    np.testing.assert_allclose(parts.sum(axis=0), jacobian(q) @ RATES, atol=1e-15)


def test_the_printed_angle_is_a_joint_angle_for_the_last_joint_only():
    # Only joint 5 moves, so that the angles of joints 2 to 4 are the same in both poses.
    first, second = (
        distended_angles(velocity_components(jacobian(q), RATES), RATES)
        for q in (np.array([0.0, 0.2, 0.3, 0.4, 0.1]), np.array([0.0, 0.2, 0.3, 0.4, 0.9]))
    )
    assert first[-1] == pytest.approx(0.1 + OFFSETS[4])
    assert np.angle(np.exp(1j * (second[-1] - first[-1]))) == pytest.approx(0.8)
    assert np.abs(second[:3] - first[:3]).min() > 0.02


def test_noise_reaches_the_parameters_as_predicted():
    rng = np.random.default_rng(2)
    q = np.array([0.1, 0.4, -0.5, 0.9, 0.2])
    v, noise = velocity_components(jacobian(q), RATES), 1e-3
    draws = [
        identify_planar(v + noise * rng.standard_normal(v.shape), RATES, q) for _ in range(2000)
    ]
    lengths, offsets = parameter_deviations(v, RATES, noise)
    np.testing.assert_allclose(np.std([d.lengths for d in draws], axis=0), lengths, rtol=0.06)
    spread = np.std(np.unwrap([d.offsets - OFFSETS[1:] for d in draws], axis=0), axis=0)
    np.testing.assert_allclose(spread, offsets, rtol=0.06)
    assert lengths[-1] == pytest.approx(noise / abs(RATES[-1]))


def test_a_slide_has_a_direction_and_no_place():
    np.testing.assert_allclose(slide_direction([0.03, 0.04]), [0.6, 0.8])
    v = velocity_components(jacobian(np.zeros(5)), RATES)
    with pytest.raises(InvalidData, match=r"joint 3 is prismatic.*free vector"):
        identify_planar(
            v,
            RATES,
            np.zeros(5),
            kinds=["revolute", "revolute", "prismatic", "revolute", "revolute"],
        )


def test_seat_motion_shifts_the_joint_by_its_velocity_over_the_rate():
    q = np.array([0.1, 0.4, -0.5, 0.9, 0.2])
    v = velocity_components(jacobian(q), RATES)
    before = rotation_arms(v, RATES)
    v[1] += [0.02, -0.01]
    shift = rotation_arms(v, RATES) - before
    expected = np.zeros((5, 2))
    expected[1] = np.array([-0.01, -0.02]) / RATES[1]
    np.testing.assert_allclose(shift, expected, atol=1e-14)


def test_bad_input_is_refused():
    with pytest.raises(InvalidData, match="joint 2 has a rate of zero"):
        rotation_arms([[0, 1], [0, 1]], [1, 0])
    with pytest.raises(InvalidData, match="no length"):
        identify_planar([[0, 0.3], [0, 0.3]], [1, 1], [0, 0])
