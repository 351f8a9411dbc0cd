"""Bounded linear least squares on normal equations."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from loose_env.typing import Array

_ROOM = 1e-9
"""Least room between bounds that the solver needs."""
_RIDGE = 1e-9
"""Added to the curvature of each number, over its own: two may be one direction."""


def bounded_minimum(
    curvature: Array, slope: Array, low: Array, high: Array, *, damping: float = 0.0
) -> Array:
    """Change of free numbers within bounds that minimises a quadratic cost (P,).

    Examples
    --------
    >>> bounded_minimum(np.eye(2), np.array([-1.0, -3.0]), np.zeros(2), np.full(2, 2.0)).round(6)
    array([1., 2.])
    """
    scale = np.sqrt(np.diag(curvature) + 1e-12)
    scaled = curvature / np.outer(scale, scale) + (_RIDGE + damping) * np.eye(len(slope))
    root = np.linalg.cholesky(scaled)
    bounds = (low * scale - _ROOM, high * scale + _ROOM)
    target = -np.linalg.solve(root, slope / scale)
    # an active-set method: four times as fast as the default for some tens of numbers
    return np.asarray(lsq_linear(root.T, target, bounds=bounds, method="bvls").x) / scale
