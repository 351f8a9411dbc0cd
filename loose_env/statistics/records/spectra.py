"""Signals and their spectra. Frequencies and rates are in Hz."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData
from loose_env.statistics._checks import (
    MIN_SAMPLES,
    as_finite_samples,
    as_record,
    band_bins,
    require_finite,
    require_rate,
)
from loose_env.typing import Array

# Power of the excitation, relative to its peak, below which a bin holds rounding alone.
EMPTY = 1e-24


class TransferFunction(NamedTuple):
    """Estimate of a transfer function from one input to several outputs."""

    frequencies: Array
    """Hz, shape (K,)."""
    response: NDArray[np.complex128]
    """Output over input, shape (dy, K)."""
    coherence: Array
    """Share of each output's power that the input explains, 0 to 1, shape (dy, K)."""


def bandpass(signal: ArrayLike, rate: float, band: tuple[float, float]) -> Array:
    """Keep the frequencies of a band and drop the rest, without shifting any in time.

    Parameters
    ----------
    signal : array, shape (..., N)
        Signal of any unit.
    rate : float
        Sampling rate, Hz.
    band : tuple of float
        Lowest and highest frequency kept, Hz.

    Returns
    -------
    array, shape (..., N)
        Signal within the band.

    Raises
    ------
    InvalidData
        If the signal, the rate or the band cannot be used.

    Examples
    --------
    >>> t = np.arange(100) / 100
    >>> slow, fast = np.sin(2 * np.pi * 3 * t), np.sin(2 * np.pi * 20 * t)
    >>> bool(np.allclose(bandpass(slow + fast, 100.0, (10.0, 30.0)), fast))
    True
    """
    samples = as_finite_samples(signal, "signal")
    count = samples.shape[-1]
    kept = band_bins(count, rate, band)
    spectrum = np.fft.rfft(samples)
    spectrum[..., : kept.start] = 0.0
    spectrum[..., kept.stop :] = 0.0
    return np.fft.irfft(spectrum, count)


def acceleration_from_angle(angle: ArrayLike, rate: float, band: tuple[float, float]) -> Array:
    """Differentiate a joint angle twice within a band.

    The second central difference is taken in time, so that slow drift, which does not repeat over
    the record, does not leak into the band. Its gain (2 - 2 cos w dt) / (w dt)^2 is then undone
    at every frequency.

    Parameters
    ----------
    angle : array, shape (..., N + 2)
        Joint angle, rad.
    rate : float
        Sampling rate, Hz.
    band : tuple of float
        Lowest and highest frequency kept, Hz.

    Returns
    -------
    array, shape (..., N)
        Acceleration, rad/s^2, at samples 1 to N of `angle` counted from zero.

    Raises
    ------
    InvalidData
        If the angle, the rate or the band cannot be used.

    Examples
    --------
    >>> t = np.arange(102) / 100
    >>> wave = np.sin(2 * np.pi * 20 * t)
    >>> x = acceleration_from_angle(wave + 5 * t, 100.0, (10.0, 30.0))
    >>> bool(np.allclose(x, -((2 * np.pi * 20) ** 2) * wave[1:-1]))
    True
    """
    samples = as_finite_samples(angle, "angle")
    count = samples.shape[-1] - 2
    if count < MIN_SAMPLES:
        raise InvalidData(
            f"angle has {count + 2} samples; two are lost at the ends and {MIN_SAMPLES} must remain"
        )
    kept = band_bins(count, rate, band)
    difference = samples[..., 2:] - 2.0 * samples[..., 1:-1] + samples[..., :-2]
    spectrum = np.fft.rfft(difference)
    # w dt from 0 to pi; sin(w dt / 2) / (w dt / 2) is the root of the gain, exact at w = 0.
    half = np.pi * np.arange(kept.start, kept.stop) / count
    spectrum[..., kept] *= (rate / np.sinc(half / np.pi)) ** 2
    spectrum[..., : kept.start] = 0.0
    spectrum[..., kept.stop :] = 0.0
    return np.fft.irfft(spectrum, count)


def transfer_function(
    x: ArrayLike, y: ArrayLike, rate: float, segments: int = 8
) -> TransferFunction:
    """Estimate the transfer function from x to y, and the coherence (H1, Welch's averages).

    The record is cut into segments that overlap by half; their means are removed, a Hann window is
    laid on them and their spectra are averaged: H = S_xy / S_xx.

    Parameters
    ----------
    x : array, shape (N,)
        Input, such as the acceleration of the excited joint, rad/s^2.
    y : array, shape (N,) or (dy, N)
        Outputs, such as the tool acceleration, m/s^2.
    rate : float
        Sampling rate, Hz.
    segments : int
        Number of segments. More of them scatter less and resolve less. With one, the coherence
        is one whatever the record.

    Returns
    -------
    TransferFunction
        Frequencies, response and coherence. The last two are zero where x has no power.

    Raises
    ------
    InvalidData
        If the record cannot be used or is too short for the segments.

    References
    ----------
    Bendat and Piersol, Random Data, chapters 9 and 11.

    Examples
    --------
    >>> x = np.random.default_rng(0).standard_normal(1200)
    >>> found = transfer_function(x, [2 * x, -x], 1000.0)
    >>> bool(np.allclose(found.response, [[2.0], [-1.0]])), bool(np.allclose(found.coherence, 1))
    (True, True)
    """
    source, outputs = as_record(x, "x"), as_record(y, "y")
    if len(source) != 1 or source.shape[1] != outputs.shape[1]:
        raise InvalidData(
            f"x has shape {source.shape} and y {outputs.shape}; they must be (1, N) and (dy, N)"
        )
    require_rate(rate)
    spectra, length = _segment_spectra(np.concatenate((source, outputs)), segments)
    from_x, from_y = spectra[0], spectra[1:]
    power_x = np.sum(np.abs(from_x) ** 2, axis=0)
    power_y = np.sum(np.abs(from_y) ** 2, axis=1)
    if power_x.max() == 0.0:
        raise InvalidData("x is constant; it must vary")
    cross = np.sum(np.conj(from_x) * from_y, axis=1)
    present = power_x > EMPTY * power_x.max()
    response = np.where(present, cross / np.where(present, power_x, 1.0), 0.0)
    both = np.where(present, power_x * power_y, 0.0)
    coherence = np.where(both > 0.0, np.abs(cross) ** 2, 0.0) / np.where(both > 0.0, both, 1.0)
    frequencies = np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64)
    return TransferFunction(frequencies, response, np.minimum(coherence, 1.0))


def _segment_spectra(record: Array, segments: int) -> tuple[NDArray[np.complex128], int]:
    """Return the spectra of the segments of each row, (k, segments, K), and their length."""
    require_finite(record, "the record")
    count = record.shape[1]
    length = 2 * (count // (segments + 1)) if segments > 0 else 0
    if length < MIN_SAMPLES:
        raise InvalidData(
            f"segments is {segments} for {count} samples; it must be at least 1 and leave "
            f"{MIN_SAMPLES} samples to a segment"
        )
    windows = np.lib.stride_tricks.sliding_window_view(record, length, axis=1)
    pieces = windows[:, :: length // 2][:, :segments]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    return np.fft.rfft((pieces - pieces.mean(axis=-1, keepdims=True)) * window), length
