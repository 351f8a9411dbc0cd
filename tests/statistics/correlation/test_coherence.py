"""Coherence with several excited joints."""

import numpy as np
import pytest
from scipy import linalg

from loose_env.errors import InvalidData
from loose_env.statistics import (
    axial_angle,
    axial_difference,
    axial_vector,
    covariances,
    lowest_coherence_direction,
    lowest_coherence_direction_from,
    lowest_correlation_direction,
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


def test_covariances_computed_once_give_the_same(rng):
    x, a = record(rng, 2, 2)
    cov = covariances(x, a)
    assert lowest_coherence_direction_from(cov).coherence == (
        lowest_coherence_direction(x, a).coherence
    )
