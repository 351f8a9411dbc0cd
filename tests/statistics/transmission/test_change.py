"""Transmission from joints to tool, the inertia felt, and their change."""

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.statistics import (
    apparent_inertia,
    apparent_inertia_from,
    axial_vector,
    covariances,
    record_covariances,
    transmission,
    transmission_by_instrument,
    transmission_by_instrument_from,
    transmission_change,
    transmission_from,
)


@pytest.mark.parametrize(("m", "d"), [(1, 2), (2, 2), (4, 3)])
def test_transmission_is_the_least_squares_fit(rng, m, d):
    x = rng.standard_normal((m, m)) @ rng.standard_normal((m, 200)) + 4.0
    a = rng.standard_normal((d, m)) @ x + rng.standard_normal((d, 200))
    design = np.vstack((x, np.ones(200))).T
    expected = np.linalg.lstsq(design, a.T, rcond=None)[0][:m].T
    np.testing.assert_allclose(transmission(x, a), expected, atol=1e-12)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_a_rigid_arm_gives_its_jacobian_either_way(rng, m):
    jacobian, inertia = rng.standard_normal((2, m)), np.eye(m) + 0.2
    x = rng.standard_normal((m, 100))
    a, command = jacobian @ x, inertia @ x
    np.testing.assert_allclose(transmission(x, a), jacobian, atol=1e-12)
    np.testing.assert_allclose(transmission_by_instrument(command, x, a), jacobian, atol=1e-12)
    np.testing.assert_allclose(apparent_inertia(command, x), inertia, atol=1e-12)


def test_encoder_noise_shrinks_the_regression_and_not_the_instrument(rng):
    count = 200_000
    command = rng.standard_normal(count)
    true = 2.0 * command
    measured = true + 2.0 * rng.standard_normal(count)
    a = np.stack((0.7 * true, -0.2 * true))
    # As much noise as motion: half the variance of the measured x is motion.
    np.testing.assert_allclose(transmission(measured, a), [[0.35], [-0.1]], rtol=0.02)
    np.testing.assert_allclose(
        transmission_by_instrument(command, measured, a), [[0.7], [-0.2]], rtol=0.02
    )
    np.testing.assert_allclose(apparent_inertia(command, measured), [[0.5]], rtol=0.02)


def test_the_inertia_of_one_joint_is_var_u_over_cov_u_x(rng):
    command = rng.standard_normal(300)
    x = 0.4 * command + rng.standard_normal(300)
    expected = command.var() / np.cov(command, x, bias=True)[0, 1]
    assert apparent_inertia(command, x).item() == pytest.approx(expected)


def test_coupled_joints_give_the_inertia_matrix_in_order(rng):
    # Not symmetric on purpose: rows are torques, columns accelerations.
    inertia = np.array([[2.0, 0.5], [0.1, 1.0]])
    x = rng.standard_normal((2, 50))
    np.testing.assert_allclose(apparent_inertia(inertia @ x, x), inertia)


def test_a_slide_changes_transmission_along_itself_alone(rng):
    # a = J x + z w, the slide's w partly driven by the joints.
    x = rng.standard_normal((3, 400))
    z, jacobian = np.array([0.6, -0.8]), rng.standard_normal((2, 3))
    w = rng.standard_normal((1, 3)) @ x + rng.standard_normal((1, 400))
    change = transmission_change(transmission(x, jacobian @ x + z[:, None] * w), jacobian)
    np.testing.assert_allclose(change.direction, axial_vector(z), atol=1e-9)
    assert change.first_share == pytest.approx(1)
    assert change.singular_values[1] == pytest.approx(0, abs=1e-12)


def test_the_size_of_a_change_is_its_singular_values(rng):
    b, reference = rng.standard_normal((3, 4)), rng.standard_normal((3, 4))
    change = transmission_change(b, reference)
    values = np.sqrt(np.linalg.eigvalsh((b - reference) @ (b - reference).T))[::-1]
    np.testing.assert_allclose(change.singular_values, values)
    assert change.magnitude == pytest.approx(values[0])
    assert change.ratio == pytest.approx(np.linalg.norm(b - reference) / np.linalg.norm(reference))
    assert change.first_share == pytest.approx(values[0] ** 2 / np.sum(values**2))


def test_a_change_and_its_opposite_have_one_direction(rng):
    b, reference = rng.standard_normal((2, 2, 3))
    there = transmission_change(b, reference).direction
    back = transmission_change(reference, b).direction
    np.testing.assert_allclose(there, back)
    assert there[-1] > 0


def test_no_change_has_no_size():
    change = transmission_change([[1.0], [2.0]], [[1.0], [2.0]])
    assert (change.magnitude, change.ratio, change.first_share) == (0.0, 0.0, 0.0)


def test_covariances_computed_once_give_the_same(rng):
    u, x, a = rng.standard_normal((2, 80)), rng.standard_normal((2, 80)), rng.standard_normal(80)
    cov = record_covariances(u, x, a)
    np.testing.assert_allclose(transmission_from(cov.x_a), transmission(x, a))
    np.testing.assert_allclose(
        transmission_by_instrument_from(cov.command_x, cov.command_a),
        transmission_by_instrument(u, x, a),
    )
    np.testing.assert_allclose(apparent_inertia_from(cov.command_x), apparent_inertia(u, x))
    np.testing.assert_array_equal(transmission_from(covariances(x, a)), transmission(x, a))


def test_joints_excited_alike_are_refused(rng):
    x = rng.standard_normal((2, 100))
    x[1] = 2 * x[0]
    with pytest.raises(InvalidData, match="depend on each other"):
        transmission(x, rng.standard_normal((2, 100)))


def test_a_command_the_joint_does_not_follow_is_refused():
    command, x = [1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]
    with pytest.raises(InvalidData, match="does not follow"):
        transmission_by_instrument(command, x, x)
    with pytest.raises(InvalidData, match="does not follow"):
        apparent_inertia(command, x)


def test_each_joint_needs_a_command(rng):
    with pytest.raises(InvalidData, match="1 rows and x has 2"):
        apparent_inertia(rng.standard_normal(50), rng.standard_normal((2, 50)))


@pytest.mark.parametrize(
    ("b", "reference"),
    [
        ([[1.0], [2.0]], [[1.0, 2.0]]),
        ([1.0, 2.0], [1.0, 2.0]),
        ([[np.nan], [1.0]], [[1.0], [1.0]]),
        ([[1.0], [1.0]], [[0.0], [0.0]]),
    ],
)
def test_transmissions_that_cannot_be_compared_are_refused(b, reference):
    with pytest.raises(InvalidData, match="b"):
        transmission_change(b, reference)
