"""Covariances, skewness and kurtosis of a record, and what records are refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from loose_env.errors import InvalidData
from loose_env.statistics import (
    acceleration_from_angle,
    bandpass,
    covariances,
    record_covariances,
    shape_of,
)

GOOD = np.array([1.0, 2.0, 4.0, 3.0, 0.0])


def test_covariances_are_those_of_numpy(rng):
    x, a = rng.standard_normal((3, 200)) + 5.0, rng.standard_normal((2, 200))
    cov = covariances(x, a)
    expected = np.cov(np.vstack((x, a)), bias=True)
    np.testing.assert_allclose(cov.xx, expected[:3, :3])
    np.testing.assert_allclose(cov.xa, expected[:3, 3:])
    np.testing.assert_allclose(cov.aa, expected[3:, 3:])
    assert cov.count == 200


def test_a_single_signal_needs_no_second_axis(rng):
    x, a = rng.standard_normal(50), rng.standard_normal((3, 50))
    np.testing.assert_array_equal(covariances(x, a).xa, covariances(x[None], a).xa)


def test_the_record_is_left_as_it_was(rng):
    x, a = rng.standard_normal((2, 50)), rng.standard_normal((2, 50))
    before = x.copy(), a.copy()
    covariances(x, a)
    np.testing.assert_array_equal(x, before[0])
    np.testing.assert_array_equal(a, before[1])


@pytest.mark.parametrize("count", [90, 91])
@pytest.mark.parametrize("band", [(0.0, 50.0), (10.0, 30.0)])
def test_one_pass_with_the_command_gives_the_covariances_of_each_filtered_pair(rng, count, band):
    played = {"rate": 100.0, "band": band}
    raw, angle = rng.standard_normal((2, 2, count)), rng.standard_normal((2, count + 2))
    joint = record_covariances(raw[0], angle, raw[1], **played)
    u, x, a = bandpass(raw[0], **played), acceleration_from_angle(angle, **played), raw[1]
    a = bandpass(a, **played)
    for found, pair in (
        (joint.x_a, (x, a)),
        (joint.command_x, (u, x)),
        (joint.command_a, (u, a)),
    ):
        expected = covariances(*pair)
        for name in ("xx", "xa", "aa", "count"):
            own = getattr(expected, name)
            np.testing.assert_allclose(getattr(found, name), own, atol=1e-13 * np.max(own))


@pytest.mark.parametrize(
    ("x", "a", "said"),
    [
        (GOOD[:3], GOOD[:3], "4 samples"),
        (GOOD, GOOD[:4], "'x': 5, 'a': 4"),
        (3.0, GOOD, r"shape \(\)"),
        (np.ones((2, 2, 5)), GOOD, r"\(2, 2, 5\)"),
        (np.where(GOOD > 3, np.nan, GOOD), GOOD, "NaN"),
        (GOOD, np.where(GOOD > 3, np.inf, GOOD), "infinite"),
        (1e200 * GOOD, GOOD, "too large"),
        ([GOOD, np.full(5, 0.1)], GOOD, "x is constant in row 1"),
        (GOOD, np.full((2, 5), 9.81), "a is constant"),
        (["a", "b", "c", "d"], GOOD, "real numbers"),
        (np.empty((0, 5)), GOOD, r"\(0, 5\)"),
    ],
)
def test_a_record_that_cannot_be_used_is_refused_with_the_reason(x, a, said):
    with pytest.raises(InvalidData, match=said):
        covariances(x, a)


def test_the_rounding_of_a_mean_is_no_motion(rng):
    constant = np.full(1201, 0.1)
    assert np.var(constant) > 0
    with pytest.raises(InvalidData, match="x is constant"):
        covariances(constant, rng.standard_normal(1201))


def test_one_still_row_of_the_tool_is_allowed():
    assert covariances(GOOD, [GOOD, np.full(5, 9.81)]).aa[1, 1] == pytest.approx(0, abs=1e-30)


def test_a_constant_command_is_refused(rng):
    x, played = rng.standard_normal((1, 22)), {"rate": 100.0, "band": (10.0, 30.0)}
    with pytest.raises(InvalidData, match="command is constant"):
        record_covariances(np.full((1, 20), 0.1), x, x[:, 1:-1], **played)
    with pytest.raises(InvalidData, match="'x': 19"):
        record_covariances(x[:, 1:-1], x[:, 1:], x[:, 1:-1], **played)
    with pytest.raises(InvalidData, match="NaN"):
        record_covariances(x[:, 1:-1], np.full((1, 22), np.nan), x[:, 1:-1], **played)


def test_moments_are_those_of_scipy(rng):
    a = rng.gamma(2.0, size=(2, 3, 300))
    skewness, kurtosis = shape_of(a)
    np.testing.assert_allclose(skewness, stats.skew(a, axis=-1))
    np.testing.assert_allclose(kurtosis, stats.kurtosis(a, axis=-1))
    assert float(shape_of(a[0, 0])[1]) == pytest.approx(kurtosis[0, 0])


@pytest.mark.parametrize(
    "a",
    [
        [1.0, 2.0, 3.0],
        [1.0, 2.0, np.nan, 3.0],
        [1.0, 2.0, np.inf, 3.0],
        [0.1] * 7,
        [[1.0, 2.0, 3.0, 5.0], [0.3] * 4],
    ],
)
def test_motion_without_moments_is_refused(a):
    with pytest.raises(InvalidData):
        shape_of(a)
