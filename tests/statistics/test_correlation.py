"""Correlation, coherence, transmission and the comparative index of a record."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import linalg, stats

from loose_env.errors import InvalidData
from loose_env.statistics import (
    apparent_inertia_from,
    axial_angle,
    axial_difference,
    axial_vector,
    comparative_index,
    correlation_loop,
    covariances,
    lowest_coherence_direction_from,
    lowest_correlation_direction,
    maximum_correlation,
    transmission,
    transmission_by_instrument_from,
)


def unit(angle):
    return np.array([math.cos(angle), math.sin(angle)])


def pearson(x, a, direction):
    return stats.pearsonr(x, direction @ a).statistic


def record(rng, dimension=2, count=300):
    """Joint acceleration and a tool acceleration partly driven by it."""
    x = rng.standard_normal(count)
    mixing = rng.standard_normal((dimension, dimension))
    return x, rng.standard_normal((dimension, 1)) * x + mixing @ rng.standard_normal(
        (dimension, count)
    )


def test_the_loop_is_the_correlation_along_every_angle(rng):
    x, a = record(rng)
    angles = np.linspace(-1, 4, 23)
    expected = [pearson(x, a, unit(angle)) for angle in angles]
    np.testing.assert_allclose(correlation_loop(x, a, angles), expected)


def test_the_loop_changes_sign_from_an_angle_to_its_opposite(rng):
    x, a = record(rng)
    angles = np.linspace(0, np.pi, 19)
    np.testing.assert_allclose(
        correlation_loop(x, a, angles + np.pi), -correlation_loop(x, a, angles), atol=1e-14
    )


def test_nothing_is_correlated_along_the_lowest_direction(rng):
    x, a = record(rng)
    phi0 = lowest_correlation_direction(x, a)
    assert 0 <= phi0 < math.pi
    assert pearson(x, a, unit(phi0)) == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize("angle", np.radians([0.0, 15.0, 90.0, 134.0, 179.9]))
def test_a_slide_the_joint_does_not_drive_is_found_where_transmission_is_across_it(rng, angle):
    # Only when the arm moves the tool across the slide is there no bias.
    x, slide = rng.standard_normal((2, 400))
    x -= x.mean()
    slide -= slide.mean()
    slide -= x * (slide @ x) / (x @ x)
    a = np.outer(unit(angle + math.pi / 2), x) + 0.4 * np.outer(unit(angle), slide)
    turn = axial_difference(lowest_correlation_direction(x, a), float(angle))
    assert turn == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("scale", [0.5, 2.0, 8.0])
def test_scaling_the_driven_motion_leaves_the_lowest_direction(rng, scale):
    # Section 5.3.2 of the thesis: normal against uniform motion, 6000 points each.
    x, slide = rng.standard_normal(6000), rng.uniform(-1, 1, 6000)
    phi0 = lowest_correlation_direction(x, np.stack((scale * x, slide)))
    scatter = slide.std() / (scale * math.sqrt(6000))
    assert abs(axial_difference(phi0, math.pi / 2)) < 3 * scatter


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_maximum_is_the_multiple_correlation_of_x_on_a(rng, dimension):
    x, a = record(rng, dimension)
    design = np.vstack((a, np.ones(x.size))).T
    residual = x - design @ np.linalg.lstsq(design, x, rcond=None)[0]
    value, direction = maximum_correlation(x, a)
    assert value**2 == pytest.approx(1 - residual.var() / x.var())
    assert np.linalg.norm(direction) == pytest.approx(1)
    assert pearson(x, a, direction) == pytest.approx(value)


def test_no_direction_exceeds_the_maximum(rng):
    x, a = record(rng)
    loop = correlation_loop(x, a, np.linspace(0, 2 * np.pi, 3601))
    assert loop.max() <= maximum_correlation(x, a).value * (1 + 1e-12)
    assert loop.max() == pytest.approx(maximum_correlation(x, a).value, rel=1e-5)


def test_a_rigid_noise_free_tool_has_both_directions_well_defined(rng):
    x = rng.standard_normal(100)
    a = np.outer(unit(0.3), x)
    value, direction = maximum_correlation(x, a)
    assert value == pytest.approx(1)
    np.testing.assert_allclose(direction, unit(0.3))
    assert lowest_correlation_direction(x, a) == pytest.approx(0.3 + math.pi / 2)
    across = 0.3 + math.pi / 2
    assert correlation_loop(x, a, [across])[0] == 0.0


@pytest.mark.parametrize("function", [lowest_correlation_direction, maximum_correlation])
def test_no_direction_stands_out_of_uncorrelated_motion(function):
    with pytest.raises(InvalidData, match="uncorrelated"):
        function([1.0, -1.0, 1.0, -1.0], [[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])


def test_several_excited_joints_are_refused(rng):
    x, a = rng.standard_normal((2, 2, 20))
    with pytest.raises(InvalidData, match="2 rows"):
        lowest_correlation_direction(x, a)


def test_an_angle_needs_a_planar_record(rng):
    x, a = record(rng, 3)
    with pytest.raises(InvalidData, match="3 rows"):
        lowest_correlation_direction(x, a)


def test_angles_must_be_finite(rng):
    with pytest.raises(InvalidData, match="angles"):
        correlation_loop(*record(rng), [0.0, math.inf])


def lowest_coherence_direction(x, a):
    return lowest_coherence_direction_from(covariances(x, a))


def several(rng, m, d, count=400):
    x = rng.standard_normal((m, m)) @ rng.standard_normal((m, count))
    return x, rng.standard_normal((d, m)) @ x + rng.standard_normal((d, count))


@pytest.mark.parametrize(("m", "d"), [(1, 2), (2, 2), (4, 2), (3, 3), (4, 3)])
def test_it_is_the_smallest_generalised_eigenvector(rng, m, d):
    x, a = several(rng, m, d)
    cov = covariances(x, a)
    explained = cov.xa.T @ np.linalg.inv(cov.xx) @ cov.xa
    values, vectors = linalg.eigh(explained, cov.aa)
    lowest = lowest_coherence_direction(x, a)
    np.testing.assert_allclose(lowest.coherences, values, atol=1e-12)
    assert lowest.coherence == lowest.coherences[0]
    np.testing.assert_allclose(lowest.direction, axial_vector(vectors[:, 0]), atol=1e-9)


def test_with_one_joint_in_the_plane_it_is_the_lowest_correlation(rng):
    x, a = several(rng, 1, 2)
    lowest = lowest_coherence_direction(x, a)
    assert lowest.coherence == 0.0
    turn = axial_difference(axial_angle(lowest.direction), lowest_correlation_direction(x, a))
    assert turn == pytest.approx(0, abs=1e-12)


def test_a_slide_the_joints_do_not_drive_bends_it_by_their_own_motion(rng):
    # With a = B x + z w the coherence is lowest along (B Sx B.T)^-1 z, by hand.
    x, w = rng.standard_normal((2, 500)), rng.standard_normal(500)
    basis = np.vstack((x, np.ones(500))).T
    w = w - basis @ np.linalg.lstsq(basis, w, rcond=None)[0]
    b, z = rng.standard_normal((2, 2)), np.array([0.6, 0.8])
    lowest = lowest_coherence_direction(x, b @ x + np.outer(z, w))
    expected = np.linalg.solve(b @ np.cov(x, bias=True) @ b.T, z)
    np.testing.assert_allclose(lowest.direction, axial_vector(expected), atol=1e-9)
    assert lowest.coherences[1] == pytest.approx(1)


def test_coherence_does_not_depend_on_units(rng):
    x, a = several(rng, 2, 2)
    plain = lowest_coherence_direction(x, a).coherences
    scaled = lowest_coherence_direction(x * [[1e4], [1e-4]], 1e-3 * a).coherences
    np.testing.assert_allclose(scaled, plain)


def test_a_direction_in_which_the_tool_does_not_move_has_no_coherence(rng):
    x = rng.standard_normal(100)
    lowest = lowest_coherence_direction(x, [x, 2 * x])
    np.testing.assert_allclose(lowest.coherences, [0, 1], atol=1e-9)
    np.testing.assert_allclose(lowest.direction, axial_vector([-2, 1]))


def test_joints_excited_alike_are_refused(rng):
    x = rng.standard_normal((2, 100))
    with pytest.raises(InvalidData, match="depend on each other"):
        lowest_coherence_direction([x[0], 3 * x[0]], x)


def by_instrument(command, x, a):
    return transmission_by_instrument_from(covariances(command, x), covariances(command, a))


def inertia_of(command, x):
    return apparent_inertia_from(covariances(command, x))


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
    np.testing.assert_allclose(by_instrument(command, x, a), jacobian, atol=1e-12)
    np.testing.assert_allclose(inertia_of(command, x), inertia, atol=1e-12)


def test_encoder_noise_shrinks_the_regression_and_not_the_instrument(rng):
    count = 200_000
    command = rng.standard_normal(count)
    true = 2.0 * command
    measured = true + 2.0 * rng.standard_normal(count)
    a = np.stack((0.7 * true, -0.2 * true))
    # As much noise as motion: half the variance of the measured x is motion.
    np.testing.assert_allclose(transmission(measured, a), [[0.35], [-0.1]], rtol=0.02)
    np.testing.assert_allclose(by_instrument(command, measured, a), [[0.7], [-0.2]], rtol=0.02)
    np.testing.assert_allclose(inertia_of(command, measured), [[0.5]], rtol=0.02)


def test_the_inertia_of_one_joint_is_var_u_over_cov_u_x(rng):
    command = rng.standard_normal(300)
    x = 0.4 * command + rng.standard_normal(300)
    expected = command.var() / np.cov(command, x, bias=True)[0, 1]
    assert inertia_of(command, x).item() == pytest.approx(expected)


def test_coupled_joints_give_the_inertia_matrix_in_order(rng):
    # Not symmetric on purpose: rows are torques, columns accelerations.
    inertia = np.array([[2.0, 0.5], [0.1, 1.0]])
    x = rng.standard_normal((2, 50))
    np.testing.assert_allclose(inertia_of(inertia @ x, x), inertia)


def test_a_command_the_joint_does_not_follow_is_refused():
    command, x = [1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]
    with pytest.raises(InvalidData, match="does not follow"):
        by_instrument(command, x, x)
    with pytest.raises(InvalidData, match="does not follow"):
        inertia_of(command, x)


def test_each_joint_needs_a_command(rng):
    with pytest.raises(InvalidData, match="1 rows and x has 2"):
        inertia_of(rng.standard_normal(50), rng.standard_normal((2, 50)))


# Case (degrees), maximum correlations of table 6.4 in the nominal and in the fault state, printed
# difference of angles (degrees) and printed mag(D) of tables 6.5 (looseness) and 6.7 (backlash).
PRINTED = [
    (122, 0.40, 0.25, 100, 0.37),
    (98, 0.40, 0.60, 80, 0.49),
    (28, 0.75, 0.50, 20, 0.11),
    (302, 0.50, 0.20, 120, 0.52),
    (122, 0.40, 0.13, 50, 0.52),
    (98, 0.40, 0.55, 5, 0.03),
    (56, 0.60, 0.65, 20, 0.03),
    (28, 0.75, 0.20, -60, 0.63),
    (302, 0.50, 0.55, 0, 0.00),
]


@pytest.mark.parametrize(("case", "c_n", "c_f", "turn", "printed"), PRINTED)
def test_the_printed_index_follows_from_the_printed_correlations(case, c_n, c_f, turn, printed):
    found = comparative_index(c_n, math.radians(turn), c_f, 0.0).mag_d
    # Two decimals are printed, of factors that were themselves rounded.
    assert found == pytest.approx(printed, abs=0.0075)


def test_the_looseness_case_at_56_degrees_was_misprinted():
    # Printed 0.80 and 0.75; table 6.4 gives 1 - 0.30/0.60 = 0.50.
    found = comparative_index(0.60, math.radians(70), 0.30, 0.0).mag_d
    assert found == pytest.approx(0.47, abs=0.005)


def test_the_backlash_case_at_302_degrees_was_misprinted():
    # Printed 0.18; table 6.4 gives |1 - 0.55/0.50| = 0.10, seen in full at a right angle.
    assert comparative_index(0.50, math.pi / 2, 0.55, 0.0).mag_d == pytest.approx(0.10)


def test_e_and_d_are_cross_products_of_correlation_vectors():
    c_n, phi_n, c_f, phi_f = 0.6, 1.1, 0.3, 0.2
    relative = c_f / c_n
    # (6.16) with C_n* = 1, and the same with the difference of magnitudes.
    cross = math.cos(phi_f) * math.sin(phi_n) - math.sin(phi_f) * math.cos(phi_n)
    found = comparative_index(c_n, phi_n, c_f, phi_f)
    assert found.mag_e == pytest.approx(abs(relative * cross))
    assert found.mag_d == pytest.approx(abs((1 - relative) * cross))


def test_the_index_is_blind_where_the_direction_does_not_change():
    assert comparative_index(0.5, 0.7, 0.1, 0.7) == (0.0, 0.0)


def test_opposite_ends_of_an_axis_count_as_one():
    assert comparative_index(0.5, 0.7, 0.1, 0.2) == pytest.approx(
        comparative_index(0.5, 0.7 + math.pi, 0.1, 0.2)
    )


@pytest.mark.parametrize(
    "arguments",
    [
        (0.0, 0.0, 0.5, 0.0),
        (1.1, 0.0, 0.5, 0.0),
        (0.5, 0.0, -0.1, 0.0),
        (math.nan, 0.0, 0.5, 0.0),
        (0.5, math.inf, 0.5, 0.0),
    ],
)
def test_impossible_correlation_vectors_are_refused(arguments):
    with pytest.raises(InvalidData):
        comparative_index(*arguments)
