"""The thesis's estimators: correlation by direction and the transfer function."""

from __future__ import annotations

import math

import numpy as np
import pytest

from scripts.thesis.estimators import (
    correlation_loop,
    lowest_correlation_direction,
    maximum_correlation,
    transfer_function,
)


def test_the_loop_is_the_correlation_by_direction() -> None:
    rng = np.random.default_rng(1)
    x = rng.standard_normal(300)
    a = rng.standard_normal((2, 1)) * x + rng.standard_normal((2, 300))
    angles = np.linspace(0, np.pi, 361)
    loop = correlation_loop(x, a, angles)
    units = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    expected = [np.corrcoef(x, u @ a)[0, 1] for u in units]
    np.testing.assert_allclose(loop, expected, atol=1e-12)
    np.testing.assert_allclose(correlation_loop(x, a, angles + np.pi), -loop, atol=1e-14)
    assert np.abs(loop).max() == pytest.approx(maximum_correlation(x, a), rel=1e-4)
    low = lowest_correlation_direction(x, a)
    assert 0 <= low < math.pi
    assert correlation_loop(x, a, [low])[0] == pytest.approx(0, abs=1e-14)


def test_a_delay_turns_the_transfer_function_and_noise_lowers_the_coherence() -> None:
    rng = np.random.default_rng(2)
    x, noise = rng.standard_normal((2, 60_000))
    found = transfer_function(x[1:], x[:-1], 1000.0, 50)
    at_150 = np.argmin(np.abs(found.frequencies - 150.0))
    assert np.degrees(np.angle(found.response[0, at_150])) == pytest.approx(-54, abs=1.0)
    coherence = transfer_function(x, x + noise, 1000.0, 400).coherence
    assert coherence.mean() == pytest.approx(0.5, abs=0.02)
