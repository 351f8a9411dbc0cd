"""Coherence, transmission and the comparative index of a record."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import linalg

from loose_env.errors import InvalidData
from loose_env.statistics import (
    apparent_inertia_from,
    axial_difference,
    axial_vector,
    comparative_index,
    covariances,
    lowest_coherence_direction_from,
    transmission_by_instrument_from,
    transmission_from,
)


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


def test_one_joint_is_uncorrelated_along_the_lowest_direction_in_the_plane(rng):
    x, a = several(rng, 1, 2)
    lowest = lowest_coherence_direction(x, a)
    assert lowest.coherence == 0.0
    assert np.corrcoef(x[0], lowest.direction @ a)[0, 1] == pytest.approx(0, abs=1e-14)
    design = np.vstack((a, np.ones(x.size))).T
    residual = x[0] - design @ np.linalg.lstsq(design, x[0], rcond=None)[0]
    assert lowest.coherences[1] == pytest.approx(1 - residual.var() / x.var())


@pytest.mark.parametrize("scale", [0.5, 2.0, 8.0])
def test_scaling_the_driven_motion_leaves_the_lowest_direction(rng, scale):
    # Section 5.3.2 of the thesis: normal against uniform motion, 6000 points each.
    x, slide = rng.standard_normal(6000), rng.uniform(-1, 1, 6000)
    found = lowest_coherence_direction(x, np.stack((scale * x, slide))).direction
    scatter = slide.std() / (scale * math.sqrt(6000))
    assert abs(axial_difference(math.atan2(found[1], found[0]), math.pi / 2)) < 3 * scatter


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
    np.testing.assert_allclose(transmission_from(covariances(x, a)), expected, atol=1e-12)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_a_rigid_arm_gives_its_jacobian_either_way(rng, m):
    jacobian, inertia = rng.standard_normal((2, m)), np.eye(m) + 0.2
    x = rng.standard_normal((m, 100))
    a, command = jacobian @ x, inertia @ x
    np.testing.assert_allclose(transmission_from(covariances(x, a)), jacobian, atol=1e-12)
    np.testing.assert_allclose(by_instrument(command, x, a), jacobian, atol=1e-12)
    np.testing.assert_allclose(inertia_of(command, x), inertia, atol=1e-12)


def test_encoder_noise_shrinks_the_regression_and_not_the_instrument(rng):
    count = 200_000
    command = rng.standard_normal(count)
    true = 2.0 * command
    measured = true + 2.0 * rng.standard_normal(count)
    a = np.stack((0.7 * true, -0.2 * true))
    # As much noise as motion: half the variance of the measured x is motion.
    shrunk = transmission_from(covariances(measured, a))
    np.testing.assert_allclose(shrunk, [[0.35], [-0.1]], rtol=0.02)
    np.testing.assert_allclose(by_instrument(command, measured, a), [[0.7], [-0.2]], rtol=0.02)
    np.testing.assert_allclose(inertia_of(command, measured), [[0.5]], rtol=0.02)


def test_coupled_joints_give_the_inertia_matrix_in_order(rng):
    # Not symmetric on purpose: rows are torques, columns accelerations.
    inertia = np.array([[2.0, 0.5], [0.1, 1.0]])
    x = rng.standard_normal((2, 50))
    np.testing.assert_allclose(inertia_of(inertia @ x, x), inertia)


@pytest.mark.parametrize(
    ("estimate", "said"),
    [
        (lambda u, x: lowest_coherence_direction([x, 3 * x], u), "depend on each other"),
        (lambda u, x: by_instrument(u, x, x), "does not follow"),
        (lambda u, x: inertia_of(u, x), "does not follow"),
        (lambda u, x: inertia_of(u, [u, x]), "1 rows and x has 2"),
    ],
)
def test_records_without_an_estimate_are_refused(estimate, said):
    with pytest.raises(InvalidData, match=said):
        estimate(np.array([1.0, -1.0, 1.0, -1.0]), np.array([1.0, 1.0, -1.0, -1.0]))


# Maximum correlations of table 6.4 in the nominal and in the fault state, printed difference of
# angles (degrees) and printed mag(D) of tables 6.5 (looseness) and 6.7 (backlash).
PRINTED = [
    (0.40, 0.25, 100, 0.37),
    (0.40, 0.60, 80, 0.49),
    (0.75, 0.50, 20, 0.11),
    (0.50, 0.20, 120, 0.52),
    (0.40, 0.13, 50, 0.52),
    (0.40, 0.55, 5, 0.03),
    (0.60, 0.65, 20, 0.03),
    (0.75, 0.20, -60, 0.63),
    (0.50, 0.55, 0, 0.00),
    (0.60, 0.30, 70, 0.47),  # misprinted 0.80 and 0.75; table 6.4 gives 1 - 0.30/0.60 = 0.50
    (0.50, 0.55, 90, 0.10),  # misprinted 0.18; table 6.4 gives |1 - 0.55/0.50|
]


@pytest.mark.parametrize(("c_n", "c_f", "turn", "printed"), PRINTED)
def test_the_printed_index_follows_from_the_printed_correlations(c_n, c_f, turn, printed):
    found = comparative_index(c_n, math.radians(turn), c_f, 0.0).mag_d
    # Two decimals are printed, of factors that were themselves rounded.
    assert found == pytest.approx(printed, abs=0.0075)


def test_e_and_d_are_cross_products_of_correlation_vectors():
    c_n, phi_n, c_f, phi_f = 0.6, 1.1, 0.3, 0.2
    relative = c_f / c_n
    # (6.16) with C_n* = 1, and the same with the difference of magnitudes.
    cross = math.cos(phi_f) * math.sin(phi_n) - math.sin(phi_f) * math.cos(phi_n)
    found = comparative_index(c_n, phi_n, c_f, phi_f)
    assert found.mag_e == pytest.approx(abs(relative * cross))
    assert found.mag_d == pytest.approx(abs((1 - relative) * cross))
    # Opposite ends of an axis are one, and a direction that stays hides the fault.
    assert comparative_index(c_n, phi_n + math.pi, c_f, phi_f) == pytest.approx(found)
    assert comparative_index(0.5, 0.7, 0.1, 0.7) == (0.0, 0.0)


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
