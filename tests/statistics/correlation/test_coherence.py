"""Coherence with several excited joints."""

import math

import numpy as np
import pytest
from scipy import linalg, stats

from loose_env.errors import InvalidData
from loose_env.statistics import (
    axial_angle,
    axial_difference,
    axial_vector,
    covariances,
    lowest_coherence_direction,
    lowest_coherence_direction_from,
    lowest_correlation_direction,
    rank_test,
    rank_test_from,
)


def record(rng, m, d, count=400):
    x = rng.standard_normal((m, m)) @ rng.standard_normal((m, count))
    return x, rng.standard_normal((d, m)) @ x + rng.standard_normal((d, count))


@pytest.mark.parametrize(("m", "d"), [(1, 2), (2, 2), (4, 2), (3, 3), (4, 3)])
def test_it_is_the_smallest_generalised_eigenvector(rng, m, d):
    x, a = record(rng, m, d)
    cov = covariances(x, a)
    explained = cov.xa.T @ np.linalg.inv(cov.xx) @ cov.xa
    values, vectors = linalg.eigh(explained, cov.aa)
    lowest = lowest_coherence_direction(x, a)
    np.testing.assert_allclose(lowest.coherences, values, atol=1e-12)
    assert lowest.coherence == lowest.coherences[0]
    np.testing.assert_allclose(lowest.direction, axial_vector(vectors[:, 0]), atol=1e-9)


def test_with_one_joint_in_the_plane_it_is_the_lowest_correlation(rng):
    x, a = record(rng, 1, 2)
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
    x, a = record(rng, 2, 2)
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


@pytest.mark.parametrize(("m", "d"), [(2, 2), (4, 2), (4, 3)])
def test_the_statistic_is_chi_square_when_one_direction_follows_no_joint(rng, m, d):
    p_values = []
    for _ in range(400):
        x, noise = rng.standard_normal((m, 150)), rng.standard_normal((d, 150))
        b = rng.standard_normal((d, m))
        b[-1] = 0.0
        # The other directions follow closely: the test is exact when they do.
        mixing = rng.standard_normal((d, d))
        p_values.append(rank_test(x, mixing @ (3 * b @ x + 0.3 * noise)).p_value)
    assert stats.kstest(p_values, "uniform").pvalue > 0.01


def test_every_direction_following_is_seen(rng):
    x, a = record(rng, 3, 2)
    assert rank_test(x, a).p_value < 1e-6


def test_the_statistic_is_bartletts(rng):
    x, a = record(rng, 4, 2, count=60)
    lowest = lowest_coherence_direction(x, a).coherence
    found = rank_test(x, a, count=30)
    expected = -(30 - 1 - (2 + 4 + 1) / 2) * math.log(1 - lowest)
    assert found.statistic == pytest.approx(expected)
    assert found.degrees == 3
    assert found.p_value == pytest.approx(stats.chi2.sf(expected, 3))


def test_a_tool_that_follows_exactly_leaves_no_doubt(rng):
    x = rng.standard_normal((2, 100))
    assert rank_test(x, [[1, 2], [2, 1]] @ x).p_value == 0.0


def test_covariances_computed_once_give_the_same(rng):
    x, a = record(rng, 2, 2)
    cov = covariances(x, a)
    assert rank_test_from(cov, 50.0) == rank_test(x, a, 50.0)
    assert lowest_coherence_direction_from(cov).coherence == (
        lowest_coherence_direction(x, a).coherence
    )


def test_fewer_joints_than_directions_cannot_be_tested(rng):
    with pytest.raises(InvalidData, match="1 rows and a has 2"):
        rank_test(*record(rng, 1, 2))


@pytest.mark.parametrize("count", [3.5, -10, math.nan, math.inf])
def test_too_few_samples_cannot_be_tested(rng, count):
    with pytest.raises(InvalidData, match="count"):
        rank_test(*record(rng, 2, 2), count)
