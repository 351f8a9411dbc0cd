"""The closed form of the Wishart density against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import wishart

from loose_env.diagnosis.likelihood.record_likelihood import wishart_fit
from loose_env.errors import InvalidData

AMOUNTS = np.array([0.0, 0.01, 0.5, 3.0, 200.0])


def scatter(rng: np.random.Generator, d: int, rows: int) -> np.ndarray:
    drawn = rng.standard_normal((d, rows))
    return drawn @ drawn.T / rows


@pytest.mark.parametrize("d", [2, 3])
def test_it_is_scipys_density_up_to_a_constant(d: int) -> None:
    rng = np.random.default_rng(d)
    found, degrees = scatter(rng, d, 9), 17.0
    fixed = np.stack([scatter(rng, d, 6) * scale for scale in (0.1, 1.0, 20.0)])
    added = np.stack([scatter(rng, d, rows) for rows in (1, 4)])  # the first has rank one
    here = wishart_fit(found, fixed[:, None], added, AMOUNTS, degrees)
    assert here.shape == (3, 2, len(AMOUNTS))
    there = np.array(
        [
            [[wishart.logpdf(degrees * found, degrees, a + q * b) for q in AMOUNTS] for b in added]
            for a in fixed
        ]
    )
    constant = here - there
    assert constant == pytest.approx(np.full(constant.shape, constant[0, 0, 0]), abs=1e-5)


@pytest.mark.parametrize("d", [2, 3])
def test_it_is_zero_where_the_expected_covariance_is_the_one_found(d: int) -> None:
    rng = np.random.default_rng(d)
    fixed, added = scatter(rng, d, 8), scatter(rng, d, 1)
    fit = wishart_fit(fixed + 0.7 * added, fixed, added, np.array([0.2, 0.7, 1.9]), 30.0)
    assert fit[1] == pytest.approx(0.0, abs=1e-9)
    assert max(fit[0], fit[2]) < -0.1


def test_a_strong_and_narrow_part_costs_no_digits() -> None:
    # Sensor noise beside loose motion a hundred thousand times as strong along one direction.
    u = np.array([0.48, -0.6, 0.64])
    fixed = np.diag([1e-5, 2e-5, 3e-5])
    fit = wishart_fit(fixed + np.outer(u, u), fixed, np.outer(u, u), np.array([1.0]), 10.0)
    assert fit[0] == pytest.approx(0.0, abs=1e-4)


def test_other_sizes_are_refused() -> None:
    with pytest.raises(InvalidData, match="4"):
        wishart_fit(np.eye(4), np.eye(4), np.eye(4), AMOUNTS, 3.0)
