"""Ellipsoids against closed forms and the directions printed for VERA."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import planar, vera
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.thesis.methods.motion.manipulability import (
    axis_difference_deg,
    direction_deg,
    ellipsoid,
    joint_inertia,
    rotation_line,
    submanipulator,
    submanipulator_jacobian,
)


@pytest.mark.parametrize(
    ("theta", "printed"), [(122, 299), (98, 311), (56, 332), (28, 346), (302, 29)]
)
def test_the_line_of_joint_1_is_the_printed_one(theta: float, printed: float) -> None:
    found = direction_deg(rotation_line(vera(), np.radians([20.0, theta])))
    assert abs(axis_difference_deg(found, printed)) < 0.1
    assert abs(axis_difference_deg(found, -theta / 2)) < 1e-6


@pytest.mark.parametrize(
    ("theta", "printed", "agrees"),
    [(98, 328, True), (56, 338, True), (28, 349, True), (122, 260, False), (302, 215, False)],
)
def test_three_of_five_printed_major_axes_follow(
    theta: float, printed: float, agrees: bool
) -> None:
    j = geometric_jacobian(Chain.of(vera(), np.radians([0.0, theta])), "tool")[:2]
    found = direction_deg(ellipsoid(j).axes[:, 0])
    assert (abs(axis_difference_deg(found, printed)) < 1.5) is agrees


def test_the_plain_ellipsoid_of_two_links() -> None:
    """The measure is |det J| = l1 l2 |sin θ2|, the axes those of J Jᵀ."""
    theta = 0.7
    j = geometric_jacobian(Chain.of(vera(), [0.2, theta]), "tool")[:2]
    found = ellipsoid(j)
    assert np.prod(found.lengths) == pytest.approx(0.16 * np.sin(theta))
    np.testing.assert_allclose(
        found.axes @ np.diag(found.lengths**2) @ found.axes.T, j @ j.T, atol=1e-12
    )
    assert ellipsoid(geometric_jacobian(Chain.of(vera(), [0.2, 0.0]), "tool")[:2]).aspect > 1e9


def test_the_energy_ellipsoid_is_that_of_equal_energy() -> None:
    arm, pose = planar(4), np.array([0.1, 0.6, -0.8, 1.1])
    j = geometric_jacobian(Chain.of(arm, pose), "tool")[:2]
    m = joint_inertia(arm, pose)
    found = ellipsoid(j, m)
    shape = found.axes @ np.diag(found.lengths**2) @ found.axes.T
    np.testing.assert_allclose(shape, j @ np.linalg.inv(m) @ j.T, rtol=1e-10)
    # No rates of unit energy reach beyond it; the best along the major axis touch it.
    rates = np.random.default_rng(0).standard_normal((4, 500))
    rates /= np.sqrt(np.einsum("in,ij,jn->n", rates, m, rates))
    inside = np.einsum("in,ij,jn->n", j @ rates, np.linalg.inv(shape), j @ rates)
    assert inside.max() <= 1 + 1e-9
    best = np.linalg.inv(m) @ j.T @ found.axes[:, 0] / found.lengths[0]
    assert best @ m @ best == pytest.approx(1.0)
    np.testing.assert_allclose(j @ best, found.lengths[0] * found.axes[:, 0], atol=1e-12)


def test_a_point_mass_in_the_plane_has_a_round_energy_ellipsoid() -> None:
    """Whatever the joints, m |v|² = 1 is a circle if all the mass is at the point."""
    j = geometric_jacobian(Chain.of(vera(), [0.2, 0.9]), "tool")[:2]
    found = ellipsoid(j, 2.0 * j.T @ j)
    np.testing.assert_allclose(found.lengths, np.sqrt(0.5), rtol=1e-9)


def test_the_submanipulator_carries_the_distal_segment() -> None:
    arm, pose = planar(4), np.array([0.1, 0.6, -0.8, 1.1])
    step = 1e-6
    import mujoco

    def centre(q: np.ndarray) -> np.ndarray:
        data = mujoco.MjData(arm.model)
        data.qpos[:] = q
        mujoco.mj_forward(arm.model, data)
        return np.array(data.subtree_com[arm.model.body("link3").id])

    turn = pose[:3].sum()
    c, s = np.cos(turn), np.sin(turn)
    found = submanipulator_jacobian(arm, pose, 3)
    for k in range(3):
        moved = (centre(pose + step * np.eye(4)[k]) - centre(pose - step * np.eye(4)[k])) / 2 / step
        np.testing.assert_allclose(found[:, k], [[c, s], [-s, c]] @ moved[:2], atol=1e-8)
    assert submanipulator(arm, pose, 1).lengths[1] == pytest.approx(0.0, abs=1e-12)


def test_angles_count_from_the_y_axis() -> None:
    assert direction_deg([1.0, 0.0]) == 270.0
    assert axis_difference_deg(5.0, 355.0) == pytest.approx(10.0)
