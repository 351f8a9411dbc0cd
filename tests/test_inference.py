"""Steps, evidence and expected information, against closed forms and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from loose_env.inference import (
    block_counts,
    bounded_step,
    expected_log_score,
    information_bound,
    log_determinant,
    overlap,
    squared_distances,
    whitener,
)


def curved(rng: np.random.Generator, size: int) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


def test_whitened_errors_are_independent_and_the_determinant_is_that_of_numpy() -> None:
    rng = np.random.default_rng(0)
    stack = np.array([curved(rng, 4) for _ in range(3)])
    w = whitener(stack)
    np.testing.assert_allclose(w @ stack @ w.mT, np.broadcast_to(np.eye(4), w.shape), atol=1e-9)
    assert log_determinant(stack[0]) == pytest.approx(np.linalg.slogdet(stack[0])[1])


@pytest.mark.parametrize("seed", range(4))
def test_a_bounded_step_is_the_minimum_of_the_quadratic_within_its_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curvature, slope = curved(rng, 5), rng.normal(size=5)
    low, high = -rng.uniform(0.0, 0.5, 5), rng.uniform(0.0, 0.5, 5)
    found = bounded_step(curvature, slope, low, high)
    cost = lambda x: 0.5 * x @ curvature @ x + slope @ x  # noqa: E731
    other = minimize(cost, np.zeros(5), bounds=list(zip(low, high, strict=True)), tol=1e-12)
    assert cost(found) <= other.fun + 1e-6
    assert (found >= low - 1e-6).all() and (found <= high + 1e-6).all()
    damped = bounded_step(curvature, slope, low, high, damping=10.0)
    assert np.linalg.norm(damped) < np.linalg.norm(found)


def test_the_overlap_is_the_integral_of_the_root_of_both_densities() -> None:
    x = np.linspace(-40, 40, 200_001)
    one, other = (multivariate_normal(m, 2.0).pdf(x) for m in (0.0, 3.0))
    integral = np.trapezoid(np.sqrt(one * other), x)
    assert overlap(np.array(9.0), 2.0) == pytest.approx(integral)


def test_the_information_bound_lies_between_nothing_and_the_mutual_information() -> None:
    rng = np.random.default_rng(2)
    means, weights = np.array([0.0, 1.5, 4.0]), np.array([0.5, 0.3, 0.2])
    truth = rng.choice(3, size=60_000, p=weights)
    seen = means[truth] + rng.normal(size=len(truth))
    joint = weights * np.exp(-0.5 * (seen[:, None] - means) ** 2)
    posterior = joint / joint.sum(axis=1, keepdims=True)
    mutual = np.mean(np.log(posterior[np.arange(len(truth)), truth] / weights[truth]))
    bound = information_bound(weights, squared_distances(np.outer(means, means)))
    assert 0.5 * mutual < bound < mutual


def test_the_expected_score_is_that_of_each_case_judged_by_its_own_posterior() -> None:
    weights, hypothesis = np.array([0.5, 0.25, 0.25]), np.array([0, 1, 1])
    blind, _ = expected_log_score(weights, hypothesis, weights[None])
    assert blind == pytest.approx(np.log(0.5))
    near = np.array([[0.5, 0.1, 0.0], [0.1, 0.2, 0.2], [0.0, 0.2, 0.3]])
    score, sure = expected_log_score(weights, hypothesis, near)
    assert score == pytest.approx(0.5 * np.log(0.5 / 0.6) + 0.25 * np.log(0.4 / 0.5))
    assert sure == pytest.approx(0.5 * 0.5 / 0.6 + 0.25 * 0.4 / 0.5 + 0.25)


def test_blocks_are_drawn_with_replacement_and_equal_chance() -> None:
    drawn = block_counts(6, 20_000, np.random.default_rng(3))
    assert (drawn.sum(axis=1) == 6).all()
    assert drawn.mean(axis=0) == pytest.approx(np.ones(6), abs=0.03)
    assert drawn.var(axis=0) == pytest.approx(np.full(6, 5 / 6), rel=0.05)
