"""Goodness of fit of a transmission change along one axis, or across it.

For any axis u the change along it is u v.T with the v that fits best; what is left, weighed by the
errors' covariance, is the misfit of the axis.
"""

import math
from collections.abc import Callable

import numpy as np

from loose_env.errors import InvalidData
from loose_env.statistics.directions.angles import axial_vector
from loose_env.statistics.directions.sphere import axes_grid, tangents
from loose_env.statistics.tool_transmission.estimate import TransmissionEstimate
from loose_env.typing import Array

_GRID = {2: 90, 3: 400}
"""Axes at which the misfit is looked at first."""
_STARTS = 3
_STEPS, _SHRINK = 24, 0.5
_TURNS = 12


class Misfit:
    """Squared misfit of a change along any axis, errors weighed by their covariance.

    Parameters
    ----------
    change : TransmissionEstimate
        Change of transmission, shape (d, m), with its covariance.

    Raises
    ------
    InvalidData
        If d is neither 2 nor 3, a value is not finite, or the covariance is not positive.
    """

    def __init__(self, change: TransmissionEstimate) -> None:
        d, m = change.b.shape
        if d not in (2, 3):
            raise InvalidData(f"the change has {d} rows; a direction needs two or three")
        size = d * m
        covariance = change.covariance.reshape(size, size)
        if not (np.isfinite(change.b).all() and np.isfinite(covariance).all()):
            raise InvalidData("the change or its covariance holds NaN or infinite values")
        spread = np.diag(covariance)
        if not (spread >= 0).all() or not spread.any():
            raise InvalidData("the covariance of the change must be positive")
        # In units of each entry's scatter; one without any gets next to none.
        scale = np.sqrt(np.maximum(spread, 1e-12 * spread.max()))
        regular = covariance / np.outer(scale, scale) + 1e-10 * np.eye(size)
        precision = np.linalg.inv(regular)
        self._change = change.b
        self._covariance = (regular * np.outer(scale, scale)).reshape(d, m, d, m)
        self.precision = (precision / np.outer(scale, scale)).reshape(d, m, d, m)
        self._weighted = np.einsum("imjn,jn->im", self.precision, change.b)
        self.total = float(np.sum(self._weighted * change.b))
        """Misfit of no change at all."""

    def at(self, axes: Array) -> Array:
        """Misfit at unit vectors of shape (K, d); shape (K,)."""
        drive, gram = self._normal_equations(axes)
        fitted = np.linalg.solve(gram, drive[..., None])[..., 0]
        return np.asarray(self.total - np.sum(drive * fitted, axis=1))

    def likely(self) -> Array:
        """Axes near the minimum of the misfit, shape (K, d).

        Directions of the columns and of the change as a whole, plain and with each column in units
        of its scatter, and where `followed` leads from them.
        """
        change = self._change
        spread = np.sqrt(np.einsum("imim->m", self._covariance))
        axes = [np.linalg.svd(change)[0].T, np.linalg.svd(change / spread)[0].T]
        sizes = np.linalg.norm(change, axis=0)
        axes.append((change / np.where(sizes > 0, sizes, 1.0)).T[sizes > 0])
        starts = np.concatenate(axes)
        return np.concatenate((starts, [self.followed(axis) for axis in starts]))

    def followed(self, axis: Array) -> Array:
        """Alternating minimisation over v and u from a starting axis, shape (d,)."""
        for _ in range(_TURNS):
            v = self.drives(axis)
            gram = np.einsum("m,imjn,n->ij", v, self.precision, v)
            if not gram.any():
                break  # nothing of the change lies along this axis
            drive = self._weighted @ v
            vector = np.linalg.solve(gram + 1e-12 * np.trace(gram) * np.eye(len(gram)), drive)
            length = float(np.linalg.norm(vector))
            if not (math.isfinite(length) and length > 0.0):
                break
            axis = vector / length
        return axis

    def drives(self, axes: Array) -> Array:
        """Best v for unit vectors of shape (K, d) or (d,); shape (K, m) or (m,)."""
        drive, gram = self._normal_equations(np.atleast_2d(axes))
        fitted = np.linalg.solve(gram, drive[..., None])[..., 0]
        return np.asarray(fitted if axes.ndim == 2 else fitted[0])

    def without(self, axes: Array) -> Array:
        """Misfit with the components along these axes removed, shape (K,).

        Small where a change of fewer directions than d explains all: it has no part along u.
        """
        along = axes @ self._change
        among = np.einsum("ki,imjn,kj->kmn", axes, self._covariance, axes)
        return np.asarray(np.sum(along * np.linalg.solve(among, along[..., None])[..., 0], axis=1))

    def _normal_equations(self, axes: Array) -> tuple[Array, Array]:
        return axes @ self._weighted, np.einsum("ki,imjn,kj->kmn", axes, self.precision, axes)


def lowest_axis(at: Callable[[Array], Array], likely: Array) -> tuple[Array, float]:
    """Minimise a smooth function of axes.

    From the best of a grid and of some likely axes, ever finer about them. Valleys can be far
    narrower than the grid: the scatter of loose motion is nearly all along the seat.
    """
    dimension = likely.shape[1]
    grid = axes_grid(_GRID[dimension], dimension)
    best = np.concatenate((grid[np.argsort(at(grid))[:_STARTS]], likely))
    best = best[np.argsort(at(best))[: 2 * _STARTS]]
    step = 1.5 * math.sqrt(2 * math.pi / len(grid)) if dimension == 3 else math.pi / len(grid)
    offsets = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    around = np.stack(np.meshgrid(*[offsets] * (dimension - 1), indexing="ij"), axis=-1)
    around = around.reshape(-1, dimension - 1)
    for _ in range(_STEPS):
        across = np.stack([tangents(u) for u in best])
        near = best[:, None] + step * (around @ across)
        near /= np.linalg.norm(near, axis=2, keepdims=True)
        values = at(near.reshape(-1, dimension)).reshape(near.shape[:2])
        best = near[np.arange(len(best)), np.argmin(values, axis=1)]
        step *= _SHRINK
    values = at(best)
    return axial_vector(best[int(np.argmin(values))]), float(np.min(values))
