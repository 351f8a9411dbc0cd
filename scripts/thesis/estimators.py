"""Estimators on one record: correlation by direction, skewness, kurtosis, transfer function.

x is the acceleration of the excited joint (N,), a that of the tool (2, N) in the tool frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import csd, welch

from loose_env.statistics import covariances, shape_of, wrap_axial
from loose_env.typing import Array


def correlation_loop(x: ArrayLike, a: ArrayLike, angles: ArrayLike) -> Array:
    """Correlation vector: the Pearson correlation (4.10 to 4.13) at angles [rad] (K,) (4.14).

    It changes sign from an angle to its opposite (4.15).
    """
    cov = covariances(x, a)
    c, s = cov.xa[0], cov.aa
    cosine, sine = np.cos(angles), np.sin(angles)
    variance = s[0, 0] * cosine**2 + 2 * s[0, 1] * cosine * sine + s[1, 1] * sine**2
    # Along a direction in which the tool does not move rounding decides.
    still = variance <= 1e-12 * (s[0, 0] + s[1, 1])
    scale = np.sqrt(cov.xx[0, 0] * np.where(still, 1.0, variance))
    return np.where(still, 0.0, (c[0] * cosine + c[1] * sine) / scale)


def lowest_correlation_direction(x: ArrayLike, a: ArrayLike) -> float:
    """Planar direction uncorrelated with x: perpendicular to cov(x, a) [rad], 0 to pi."""
    c = covariances(x, a).xa[0]
    return wrap_axial(math.atan2(c[1], c[0]) + math.pi / 2)


def maximum_correlation(x: ArrayLike, a: ArrayLike) -> float:
    """Maximum correlation over all directions: C in the thesis's tables [1]."""
    cov = covariances(x, a)
    variances, axes = np.linalg.eigh(cov.aa)
    along = axes.T @ cov.xa[0]
    moving = variances > 1e-12 * variances[-1]
    weights = np.where(moving, along, 0.0) / np.where(moving, variances, 1.0)
    return min(math.sqrt(float(np.sum(weights * along)) / float(cov.xx[0, 0])), 1.0)


def skewness(a: ArrayLike, direction: ArrayLike) -> float:
    """Skewness along a unit direction (d,), of the mean and variance in 4.16 to 4.18 (4.19)."""
    return float(shape_of(np.asarray(direction) @ np.asarray(a))[0])


def kurtosis(a: ArrayLike, direction: ArrayLike) -> float:
    """Excess kurtosis along a unit direction (d,) (4.20)."""
    return float(shape_of(np.asarray(direction) @ np.asarray(a))[1])


class TransferFunction(NamedTuple):
    """Transfer function from one input to several outputs."""

    frequencies: Array
    """Hz (K,)."""
    response: NDArray[np.complex128]
    """Output over input (dy, K)."""
    coherence: Array
    """Share of each output's power that the input explains, 0 to 1 (dy, K)."""


def transfer_function(
    x: ArrayLike, y: ArrayLike, rate: float, segments: int = 8
) -> TransferFunction:
    """Transfer function from x (N,) to y (dy, N), and coherence: H1 by Welch's averages."""
    source, outputs = np.atleast_2d(x), np.atleast_2d(y)
    half = source.shape[1] // (segments + 1)
    source, outputs = (each[:, : half * (segments + 1)] for each in (source, outputs))
    frequencies, cross = csd(source, outputs, rate, nperseg=2 * half)
    power_x, power_y = (welch(each, rate, nperseg=2 * half)[1] for each in (source, outputs))
    with np.errstate(divide="ignore", invalid="ignore"):  # outside the band there may be nothing
        coherence = np.minimum(np.abs(cross) ** 2 / (power_x * power_y), 1.0)
        return TransferFunction(frequencies, cross / power_x, coherence)
