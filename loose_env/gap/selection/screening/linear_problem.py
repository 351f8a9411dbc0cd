"""Linearised bounded least squares of the current fit, with signatures of candidates added."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.model_structure import prior_of
from loose_env.inference import bounded_step
from loose_env.typing import Array


@dataclass(frozen=True, eq=False)
class CurrentFit:
    """The current fit in the linearised problem of every candidate."""

    jacobian: Array
    """Change of the residual with the free numbers (N, P)."""
    residual: Array
    """Measured less predicted (N,)."""
    curvature: Array
    """Hessian of half the cost (P, P)."""
    slope: Array
    """Gradient of half the cost (P,)."""
    room: tuple[Array, Array]
    """Allowed change of every free number, down and up (P,)."""

    @classmethod
    def of(cls, fitted: Fit, rows: NDArray[np.bool_] | slice = slice(None)) -> CurrentFit:
        """The problem of a fit, of some of its rows."""
        parameters = fitted.structure.parameters
        centres, weights = prior_of(parameters)
        low, high = np.array([p.bounds for p in parameters]).T.reshape(2, -1)
        jacobian, residual = fitted.jacobian[rows], fitted.residual[rows]
        return cls(
            jacobian,
            residual,
            jacobian.T @ jacobian + np.diag(weights**2),
            jacobian.T @ residual + weights**2 * (fitted.free - centres),
            (np.minimum(low - fitted.free, 0.0), np.maximum(high - fitted.free, 0.0)),
        )

    @property
    def to_gain(self) -> float:
        """Share of the sum of squares that a further step of the fit would gain; 0 at its end."""
        moved = bounded_step(self.curvature, self.slope, *self.room)
        gain = -float(moved @ (2 * self.slope + self.curvature @ moved))
        return max(gain, 0.0) / max(float(self.residual @ self.residual), 1e-12)

    def best_coefficients(
        self, signatures: Array, least: float, most: float
    ) -> tuple[Array, Array] | None:
        """Best coefficients of signatures (N, K) and their change of the residual.

        Returns (K,) and (N,). The current parameters are refitted within their bounds: a parameter
        known within a tolerance absorbs no more of a signature than that.
        """
        jacobian, residual, count = self.jacobian, self.residual, signatures.shape[1]
        across, sizes = jacobian.T @ signatures, signatures.T @ signatures
        if not np.all(np.isfinite(sizes)) or not sizes.any():
            return None
        curvature = np.block([[self.curvature, across], [across.T, sizes]])
        slope = np.append(self.slope, signatures.T @ residual)
        low = np.append(self.room[0], np.full(count, least))
        high = np.append(self.room[1], np.full(count, most))
        moved = bounded_step(curvature, slope, low, high)
        return moved[-count:], signatures @ moved[-count:] + jacobian @ moved[:-count]
