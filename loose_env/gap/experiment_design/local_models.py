"""Local linear models of every candidate: mean, slope, curvature and shape at each size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from loose_env.gap.experiment_design.bank import SignatureBank
from loose_env.typing import Array

__all__ = ["SIZE_SD", "LocalModels"]

SIZE_SD = 0.45
"""Standard deviation of a size about its linearisation point, over the point: neighbouring points
lie a factor of about three apart."""
_SHAPES = 2
"""Shape parameters of a ray at most."""


@dataclass(frozen=True, eq=False)
class LocalModels:
    """Local models as combinations of a bank's base vectors.

    A ray's signature about the size u_i is d_i + (u - u_i) d' + (1/2)(u - u_i)² d'', by the
    parabola through three points. Slope, curvature and shape derivatives are columns, each scaled
    by the standard deviation of its coefficient; that of the curvature stands for the error of the
    linearisation.
    """

    bank: SignatureBank

    @cached_property
    def count(self) -> int:
        """Number of local models: points of all rays (H)."""
        return int(self.bank.starts[-1])

    @cached_property
    def ray(self) -> NDArray[np.intp]:
        """Index of the ray of each local model (H,)."""
        return np.repeat(np.arange(len(self.bank.rays)), np.diff(self.bank.starts))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Candidates, kind and location."""
        return self.bank.names

    @cached_property
    def candidate(self) -> NDArray[np.intp]:
        """Index of the candidate of each local model (H,)."""
        index = {name: k for k, name in enumerate(self.names)}
        return np.array([index[self.bank.rays[r].name] for r in self.ray], dtype=np.intp)

    @cached_property
    def log_prior(self) -> Array:
        """Log probability of a local model given its candidate: all rays and points alike (H,)."""
        counts = np.bincount(self.candidate, minlength=len(self.names))
        return np.asarray(-np.log(counts[self.candidate]))

    @cached_property
    def size(self) -> Array:
        """Size of each local model (H,)."""
        return np.concatenate(self.bank.sizes)

    @cached_property
    def means(self) -> NDArray[np.intp]:
        """Column of the mean of each local model (H,)."""
        return np.arange(self.count)

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """Columns of slope, curvature and shapes (H, Q); where there is none, the zero column."""
        width = 2 + _SHAPES
        found = np.full((self.count, width), self.zero)
        found[:, 0] = self.count + 2 * np.arange(self.count)
        found[:, 1] = found[:, 0] + 1
        at = 3 * self.count
        for h in range(self.count):
            number = len(self.bank.shape_columns[self.ray[h]])
            found[h, 2 : 2 + number] = np.arange(at, at + number)
            at += number
        return found

    @cached_property
    def zero(self) -> int:
        """Index of a column of zeros."""
        return 3 * self.count + sum(len(self.bank.shape_columns[r]) for r in self.ray)

    @cached_property
    def combinations(self) -> sparse.csc_matrix:
        """Weights of the base vectors beyond the nominal parameters in each column (S, T)."""
        bank = self.bank
        first = bank.nuisances
        total = bank.signatures[0].vectors.shape[1] - first
        rows, cols, weights = [], [], []

        def put(column: int, entries: dict[int, float]) -> None:
            for row, weight in entries.items():
                rows.append(row)
                cols.append(column)
                weights.append(weight)

        for r in range(len(bank.rays)):
            u, base = bank.sizes[r], int(bank.starts[r])
            for i in range(len(u)):
                h = base + i
                put(h, {h: 1.0})
                slope, bend = _derivatives(u, i)
                sd = SIZE_SD * u[i]
                put(self.columns[h, 0], {base + k: sd * w for k, w in slope.items()})
                put(self.columns[h, 1], {base + k: 0.5 * sd**2 * w for k, w in bend.items()})
                ratio = float(u[i] / u[len(u) // 2])
                for which, vector in enumerate(bank.shape_columns[r]):
                    put(self.columns[h, 2 + which], {vector - first: ratio})
        shape = (total, self.zero + 1)
        return sparse.csc_matrix((weights, (rows, cols)), shape=shape)

    @cached_property
    def by_motion(self) -> tuple[NDArray[np.float32], ...]:
        """Columns in the directions of each motion (K, T)."""
        first = self.bank.nuisances
        return tuple(
            np.asarray((self.combinations.T @ found.vectors[:, first:].T).T, dtype=np.float32)
            for found in self.bank.signatures
        )


def _derivatives(u: Array, i: int) -> tuple[dict[int, float], dict[int, float]]:
    """Weights of the points in slope and second derivative at a point; no effect at size 0."""
    last = len(u) - 1
    j = min(i, last - 1) if last else 0
    below = u[j - 1] if j else 0.0
    if last == 0:
        return {0: 1 / u[0]}, {}
    h1, h2 = u[j] - below, u[j + 1] - u[j]
    bend = {j + 1: 2 / (h2 * (h1 + h2)), j: -2 / (h1 * h2), j - 1: 2 / (h1 * (h1 + h2))}
    if i == last:
        slope = {last: 1 / h2, last - 1: -1 / h2}
    else:
        slope = {
            j + 1: h1 / (h2 * (h1 + h2)),
            j: (h2 - h1) / (h1 * h2),
            j - 1: -h2 / (h1 * (h1 + h2)),
        }
    return {k: w for k, w in slope.items() if k >= 0}, {k: w for k, w in bend.items() if k >= 0}
