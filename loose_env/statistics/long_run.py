"""Covariance of the means of several dependent series."""

from typing import NamedTuple

import numpy as np

from loose_env.statistics._checks import FloatArray
from loose_env.statistics.memory import memory_window


class LongRun(NamedTuple):
    """What the autocovariances of several series say about the scatter of their means."""

    covariance: FloatArray
    """Covariance of the means times the number of samples, shape (k, k)."""
    degrees: float
    """Degrees of freedom of that covariance."""


def long_run_covariance(series: FloatArray) -> LongRun:
    """Estimate the long-run covariance of several series.

    As `memory_of` does for one series: autocovariances are summed with flat-top weights up to
    twice the last significant lag of any of the series, which hardly bends the result but may
    leave it indefinite, and with falling weights over the same lags (Newey and West), which
    cannot; in every direction the larger of the two counts.

    Parameters
    ----------
    series : array, shape (k, N)
        Series sampled together, of any units.

    Returns
    -------
    LongRun
        Covariance and its degrees of freedom.

    References
    ----------
    Newey and West, Econometrica 55 (1987); Politis and Romano, flat-top kernels (1995).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> white = rng.standard_normal((2, 4000))
    >>> bool(abs(long_run_covariance(white).covariance - np.eye(2)).max() < 0.15)
    True
    """
    count = series.shape[1]
    centred = series - series.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(centred, 2 * count)
    power = spectrum.real**2 + spectrum.imag**2
    auto = np.fft.irfft(power)[:, :count] / count
    # A series that stands still has no memory; its autocovariances are all zero.
    window = max((memory_window(row) for row in auto if row[0] > 0.0), default=1)
    flat = np.einsum("in,jn->ij", centred, centred) / count
    falling = flat.copy()
    for lag in range(1, window + 1):
        lagged = np.einsum("in,jn->ij", centred[:, lag:], centred[:, :-lag]) / count
        both = lagged + lagged.T
        flat += min(1.0, 2 * (1 - lag / window)) * both
        falling += (1 - lag / (window + 1)) * both
    scale = np.sqrt(np.maximum(np.diag(falling), 1e-300))
    values, vectors = np.linalg.eigh(falling / np.outer(scale, scale))
    root = (vectors * np.sqrt(np.maximum(values, 1e-12))).T  # falling = root.T root
    inverse = vectors / np.sqrt(np.maximum(values, 1e-12))
    among = inverse.T @ (flat / np.outer(scale, scale)) @ inverse
    values, vectors = np.linalg.eigh(among)
    larger = root.T @ (vectors * np.maximum(values, 1.0)) @ vectors.T @ root
    return LongRun(larger * np.outer(scale, scale), count / max(4 / 3 * window, 1.0))
