"""Most likely direction: grid over half the circle or sphere, then Newton steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from loose_env.statistics import axes_grid, tangents
from loose_env.typing import Array

__all__ = ["UNKNOWN", "climb", "half_grid"]


def half_grid(axes: int) -> Array:
    """Directions over half the circle or half the sphere, evenly spread (U, A)."""
    return axes_grid({2: 36, 3: 120}[axes], axes)


UNKNOWN = {2: np.pi / np.sqrt(12), 3: np.sqrt(np.pi - 2)}
"""Root mean square angle to a direction of which nothing is known, in the plane and in space [rad].
"""
_FLAT = UNKNOWN[2]
"""Standard deviation of a direction along a way in which nothing is known of it [rad]."""
_STENCILS = {
    2: np.array([[0.0], [1.0], [-1.0]]),
    3: np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1]]),
}


def climb(
    likelihood: Callable[[Array], Array], u: Array, spacing: float, rounds: int = 5
) -> tuple[Array, Array, Array]:
    """Climb from each direction to its peak by Newton steps on finite differences.

    Parameters
    ----------
    likelihood : callable
        Log-likelihood of directions (n, U, A), as (n, U).
    u : ndarray (n, A)
        Start directions, unit vectors in the plane or in space.
    spacing : float
        Largest distance of the peak [rad].
    rounds : int
        Newton steps.

    Returns
    -------
    best : ndarray (n, A)
        Highest direction seen.
    peak : ndarray (n,)
        Its log-likelihood.
    variance : ndarray (n, A-1)
        Variances along the principal axes of the last fit [rad²].

    Examples
    --------
    >>> best, peak, variance = climb(lambda u: 50 * u[..., 1] ** 2, np.array([[0.1, 0.995]]), 0.1)
    >>> best.round(4).tolist(), variance.round(4).tolist()
    ([[0.0, 1.0]], [[0.01]])
    """
    n, axes = u.shape
    stencil, flat = _STENCILS[axes], axes - 1
    step = np.full(n, 0.3 * spacing)
    best, peak = u.copy(), np.full(n, -np.inf)
    bend = np.full((n, flat), 1 / _FLAT**2)
    for _ in range(rounds):
        ways = np.stack([tangents(one) for one in best])
        around = best[:, None] + step[:, None, None] * (stencil @ ways)
        around /= np.linalg.norm(around, axis=2, keepdims=True)
        f = likelihood(around)
        slope = np.stack([f[:, 1 + 2 * i] - f[:, 2 + 2 * i] for i in range(flat)], axis=1)
        slope /= 2 * step[:, None]
        hessian = np.zeros((n, flat, flat))
        for i in range(flat):
            hessian[:, i, i] = f[:, 1 + 2 * i] + f[:, 2 + 2 * i] - 2 * f[:, 0]
        if axes == 3:
            both = f[:, 5] + f[:, 6] - 2 * f[:, 0]
            cross = 0.5 * (both - hessian[:, 0, 0] - hessian[:, 1, 1])
            hessian[:, 0, 1] = hessian[:, 1, 0] = cross
        values, vectors = np.linalg.eigh(-hessian / step[:, None, None] ** 2)
        bend = np.maximum(values, 1 / _FLAT**2)
        along = np.einsum("nij,ni->nj", vectors, slope) / bend
        # Where the fit is poor, the step is limited to the last stencil.
        along *= np.minimum(1.0, 3 * step / np.maximum(np.linalg.norm(along, axis=1), 1e-12))[
            :, None
        ]
        moved = best + np.einsum("nij,nj,nia->na", vectors, along, ways)
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        top = np.argmax(f, axis=1)
        rows = np.arange(n)
        after = likelihood(moved[:, None])[:, 0]
        candidate = np.where((after > f[rows, top])[:, None], moved, around[rows, top])
        peak, best = np.maximum(after, f[rows, top]), candidate
        step = np.clip(0.5 / np.sqrt(bend.max(axis=1)), 1e-5, 0.3 * spacing)
    return best, peak, 1 / bend
