"""Newton steps within a trust region."""

from __future__ import annotations

import numpy as np

from loose_env.typing import Array

FIRST_RADIUS = 2.0
"""Length of the first step [standard deviations of the priors]. The readings of a rigid arm change
with a spring's compliance, which there is next to nothing: a Newton step in its logarithm would
pass over all modes in the band, and there is no way back from beyond them."""
_LEAST_RADIUS, _MOST_RADIUS = 0.05, 16.0
"""Shortest and longest radius [standard deviations of the priors]."""
_DAMPINGS = (-6.0, 14.0)
"""Common logarithms of the least and the largest damping."""
_BISECTIONS = 30


def step_within(normal: Array, drive: Array, count: int, radius: float) -> Array:
    """Newton step, damped so far that its first parameters stay within a radius.

    Levenberg and Marquardt's step: the best one of a quadratic model within a sphere (Nocedal and
    Wright, Numerical Optimization, 2nd ed., theorem 4.1).

    Examples
    --------
    >>> step_within(np.diag([1.0, 4.0]), np.array([1.0, 4.0]), 2, 10.0)
    array([1., 1.])
    >>> float(np.linalg.norm(step_within(np.eye(2), np.array([3.0, 4.0]), 2, 1.0)).round(6))
    1.0
    """
    values, vectors = np.linalg.eigh(normal)
    along = vectors.T @ drive

    def step(damping: float) -> Array:
        return np.asarray(vectors @ (along / (values + damping)))

    found = step(0.0)
    if np.linalg.norm(found[:count]) <= radius:
        return found
    low, high = _DAMPINGS
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if np.linalg.norm(step(10.0**middle)[:count]) > radius:
            low = middle
        else:
            high = middle
    return step(10.0**high)


def next_radius(radius: float, gain: float, foreseen: float) -> float:
    """Radius after a step that was taken, by its gain over that of the quadratic model.

    Examples
    --------
    >>> next_radius(1.0, 0.9, 1.0), next_radius(1.0, 0.3, 1.0), next_radius(1.0, 0.1, 1.0)
    (2.0, 1.0, 0.5)
    """
    if gain > 0.5 * foreseen:
        return min(2 * radius, _MOST_RADIUS)
    return radius if gain > 0.25 * foreseen else radius / 2


def shorter(step: Array) -> float:
    """Radius after a step that gained nothing."""
    return max(float(np.linalg.norm(step)) / 3, _LEAST_RADIUS)
