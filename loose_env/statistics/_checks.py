"""Input validation of the statistics: arrays of samples, records, directions, bands."""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.typing import Array

MIN_SAMPLES = 4


def as_floats(values: ArrayLike, name: str) -> Array:
    """Return `values` as an array of 64-bit floats."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidData(f"{name} must be an array of real numbers: {error}") from error


def as_samples(values: ArrayLike, name: str) -> Array:
    """Return `values` as floats, with at least four samples along the last axis."""
    samples = as_floats(values, name)
    if samples.ndim == 0 or samples.size == 0 or samples.shape[-1] < MIN_SAMPLES:
        raise InvalidData(
            f"{name} has shape {samples.shape}; the last axis is time and needs at least "
            f"{MIN_SAMPLES} samples"
        )
    return samples


def as_finite_samples(values: ArrayLike, name: str) -> Array:
    """Return `values` as samples, none of them NaN or infinite."""
    samples = as_samples(values, name)
    require_finite(samples, name)
    return samples


def as_record(values: ArrayLike, name: str) -> Array:
    """Return `values`, of shape (N,) or (k, N), as samples of shape (k, N)."""
    samples = as_samples(values, name)
    if samples.ndim > 2:
        raise InvalidData(f"{name} has shape {samples.shape}; it must be (N,) or (k, N)")
    return samples.reshape(-1, samples.shape[-1])


def as_directions(directions: ArrayLike, name: str = "direction") -> Array:
    """Return `directions`, of shape (..., d), as unit vectors."""
    vectors = np.atleast_1d(as_floats(directions, name))
    length = np.sqrt(np.vecdot(vectors, vectors))[..., None]
    if not ((length > 0.0) & (length < np.inf)).all():
        raise InvalidData(f"{name} is {vectors}; it needs a length above zero")
    return np.asarray(vectors / length)


def require_finite(values: Array, name: str) -> None:
    """Raise unless every value is finite."""
    if not np.isfinite(values).all():
        raise InvalidData(f"{name} holds NaN or infinite values; every value must be finite")


def require_rate(rate: float) -> None:
    """Raise unless `rate` is a sampling rate in Hz."""
    if not (math.isfinite(rate) and rate > 0.0):
        raise InvalidData(f"rate is {rate} Hz; it must be finite and above zero")


def band_bins(count: int, rate: float, band: tuple[float, float]) -> slice:
    """Return which bins of the real FFT of `count` samples lie in `band` (Hz), ends included."""
    require_rate(rate)
    low, high = band
    if not 0.0 <= low < high <= rate / 2:
        raise InvalidData(
            f"band is ({low}, {high}) Hz; it must be rising and lie within 0 and half the "
            f"sampling rate, {rate / 2} Hz"
        )
    # A bin exactly on an end of the band stays in, whatever the rounding of its frequency.
    first = math.ceil(low * count / rate - 1e-9)
    last = math.floor(high * count / rate + 1e-9)
    if first > last:
        raise InvalidData(
            f"band ({low}, {high}) Hz holds no frequency of {count} samples at {rate} Hz, "
            f"which lie {rate / count} Hz apart"
        )
    return slice(first, last + 1)
