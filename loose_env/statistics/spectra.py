"""Signals and their spectra: band filter, differentiation, phase delay, noise floor, resolution.

Frequencies and rates are in Hz.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import (
    MIN_SAMPLES,
    as_finite_samples,
    band_bins,
)
from loose_env.typing import Array, ComplexArray


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
    spectrum = np.fft.rfft(differenced(samples))
    spectrum[..., kept] *= line_scales(count, rate, kept.start, kept.stop)[0]
    spectrum[..., : kept.start] = 0.0
    spectrum[..., kept.stop :] = 0.0
    return np.fft.irfft(spectrum, count)


def differenced(samples: Array) -> Array:
    """Second central difference (..., N - 2)."""
    return samples[..., 2:] - 2.0 * samples[..., 1:-1] + samples[..., :-2]


@lru_cache(maxsize=64)
def line_scales(count: int, rate: float, first: int, last: int) -> tuple[Array, Array]:
    """Of lines of the FFT of so many samples: gain of `differenced`, weight for the variance.

    Acceleration per second difference; and what makes the squares of lines add up to the variance.
    """
    line = np.arange(first, last)
    # w dt from 0 to pi; sin(w dt / 2) / (w dt / 2) is the root of the gain, exact at w = 0.
    gain = (rate / np.sinc(line / count)) ** 2
    # All but the mean and the highest line stand for two of opposite frequency.
    return gain, np.sqrt((line > 0) * (2.0 - (2 * line == count))) / count


_PER_PERIOD = 24
"""Delays tried per period of the highest line."""
_REFINEMENTS = 3


class PhaseDelay(NamedTuple):
    """Delay of one signal behind another."""

    seconds: float
    """Positive where it is late [s]."""
    sd: float
    """Standard deviation by the scatter of the phases, as if lines were independent [s]."""
    sign: int
    """-1 where one is the negative of the other."""
    fit: float
    """Mean resultant length of the phases without the delay: 1 where they are the delay's alone."""
    rival: float
    """Fit of the best other delay over this one's; 0 where there is no other peak."""


def phase_delay(
    frequency: Array, cross: ComplexArray, weight: Array, *, largest: float, either_sign: bool
) -> PhaseDelay | None:
    """Delay by the phases of a cross-spectrum.

    Parameters
    ----------
    frequency : ndarray of shape (K,)
        Frequencies of the lines [Hz].
    cross : ndarray of shape (K,)
        Cross-spectrum conj(X) Y; only its phase counts.
    weight : ndarray of shape (K,)
        Weight of each line, not negative.
    largest : float
        Largest delay searched, either way [s].
    either_sign : bool
        True if one signal may be the negative of the other.

    Returns
    -------
    PhaseDelay or None
        None where no line has a weight, or the fit rises up to the largest delay.

    Examples
    --------
    >>> frequency = np.linspace(5.0, 100.0, 60)
    >>> late = -np.exp(-2j * np.pi * frequency * 0.0042)
    >>> found = phase_delay(frequency, late, np.ones(60), largest=0.05, either_sign=True)
    >>> round(found.seconds, 6), found.sign, round(found.fit, 6)
    (0.0042, -1, 1.0)
    """
    size = np.abs(cross)
    used = (size > 0) & (weight > 0)
    if not used.any():
        return None
    at, turn = frequency[used], cross[used] / size[used]
    share = weight[used] / weight[used].sum()
    step = 1 / (_PER_PERIOD * float(at.max()))
    tried = np.linspace(-largest, largest, 2 * int(np.ceil(largest / step)) + 1)
    fits = (np.exp(2j * np.pi * np.outer(tried, at)) @ (share * turn)).real
    heights = np.abs(fits) if either_sign else fits
    best = int(np.argmax(heights))
    if best in (0, len(tried) - 1) or not heights[best] > 0:
        return None
    sign = 1 if fits[best] > 0 else -1
    seconds = float(tried[best])
    for _ in range(_REFINEMENTS):  # Newton: outlying phases count by their sine alone
        left = np.angle(sign * turn * np.exp(2j * np.pi * at * seconds))
        bend = 2 * np.pi * float(share @ (at**2 * np.cos(left)))
        if not bend > 0:
            break
        move = -float(share @ (at * np.sin(left))) / bend
        seconds += float(np.clip(move, -step, step))
    left = np.angle(sign * turn * np.exp(2j * np.pi * at * seconds))
    normal = float(share @ at**2)
    lines = 1 / float(np.sum(share**2))
    sd = float(np.sqrt(share @ left**2)) / (2 * np.pi * np.sqrt(normal * lines))
    return PhaseDelay(
        seconds, sd, sign, float(share @ np.cos(left)), _rival(heights, best) / float(heights[best])
    )


def _rival(heights: Array, best: int) -> float:
    """Height of the highest point beyond the peak's own slopes."""
    left = right = best
    while left > 0 and heights[left - 1] < heights[left]:
        left -= 1
    while right < len(heights) - 1 and heights[right + 1] < heights[right]:
        right += 1
    return float(max(heights[:left].max(initial=0.0), heights[right + 1 :].max(initial=0.0)))


_NOISE_WINDOW = 64
"""Samples of a window."""
_NOISE_BAND = 0.6
"""Share of the band, up to half the rate, above which motion is taken to have died out."""
_NOISE_MEDIAN = 0.97
"""Median of a window's figure over the standard deviation, for white noise (20,000 windows)."""


def noise_floor(values: Array) -> float:
    """Estimate the standard deviation of a channel's noise.

    It is taken from the top of the spectrum: the noise of encoders and accelerometers is nearly
    white, the machine's motion is not. The level is the median over short windows, since a few
    contain steps and impacts. It is at least the rounding error of the channel's resolution (a step
    over the root of 12).

    Parameters
    ----------
    values : ndarray (T,)
        One channel of one run, evenly sampled; NaN where nothing was read.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> swing = np.sin(2 * np.pi * 2 * np.arange(4000) / 1000)
    >>> bool(abs(noise_floor(swing + rng.normal(0, 0.01, 4000)) - 0.01) < 0.001)
    True
    """
    good = np.isfinite(values)
    if good.sum() < 10:
        return float("nan")
    filled = np.interp(np.arange(len(values)), np.flatnonzero(good), values[good])
    white = float(np.median(_tops(filled))) / _noise_gain(good)
    return max(white, resolution_of(values) / float(np.sqrt(12)), 1e-12)


def _noise_gain(good: Array) -> float:
    """Median of a window's figure over the standard deviation, where some samples are read (T,).

    Interpolation across missing samples smooths the noise: white noise tells by how much.
    """
    if good.all():
        return _NOISE_MEDIAN
    unit = np.random.default_rng(0).standard_normal(len(good))
    return float(
        np.median(_tops(np.interp(np.arange(len(good)), np.flatnonzero(good), unit[good])))
    )


def channel_floor(values: Array) -> float:
    """Noise floor as of `noise_floor`; NaN where a channel is constant throughout.

    An encoder that stays on one of its steps does not reveal its resolution.

    Examples
    --------
    >>> channel_floor(np.full(100, 0.25))
    nan
    """
    good = values[np.isfinite(values)]
    return noise_floor(values) if len(good) and np.ptp(good) > 0 else float("nan")


def _tops(values: Array) -> Array:
    """Root mean square density at the top of the spectrum, window by window."""
    change = np.diff(values, 2)
    size = min(_NOISE_WINDOW, len(change))
    starts = np.arange(0, len(change) - size + 1, max(size // 2, 1))
    shape = np.hanning(size + 2)[1:-1]
    power = np.abs(np.fft.rfft(change[starts[:, None] + np.arange(size)] * shape, axis=1)) ** 2
    power = power / np.sum(shape**2)
    angle = np.linspace(0, np.pi, power.shape[1])
    top = (angle >= _NOISE_BAND * np.pi) & (angle < 0.98 * np.pi)
    # Second differences prevent leakage from low frequencies; their gain is divided out again.
    level = power[:, top] / (2 - 2 * np.cos(angle[top])) ** 2
    return np.asarray(np.sqrt(np.mean(level, axis=1)))


def resolution_of(values: Array) -> float:
    """Resolution of a rounded channel; 0 if it was not rounded.

    Examples
    --------
    >>> float(round(resolution_of(np.round(np.linspace(0, 1, 500) / 0.01) * 0.01), 6))
    0.01
    """
    good = values[np.isfinite(values)]
    levels = np.unique(good)
    if len(levels) < 2 or len(levels) > 0.5 * len(good):
        return 0.0
    gaps = np.diff(levels)
    step = float(np.min(gaps[gaps > 1e-6 * np.median(gaps)]))
    ratio = gaps / step
    return step if np.mean(np.abs(ratio - np.round(ratio)) < 0.05) > 0.9 else 0.0


def long_run_variance(series: Array) -> float:
    """Variance of the mean of an autocorrelated series times its number of samples.

    The autocovariance is summed with flat-top weights up to twice the last significant lag, which
    hardly bends the variance, or with falling weights over one block (Newey and West), which
    cannot fall below zero, whichever is larger. The length of the block is the rule of Politis and
    White for circular blocks.

    Parameters
    ----------
    series : array, shape (N,)
        Series of mean zero.

    References
    ----------
    Newey and West, Econometrica 55 (1987); Politis and White, Econometric Reviews 23 (2004);
    Patton, Politis and White, Econometric Reviews 28 (2009).

    Examples
    --------
    >>> white = np.random.default_rng(0).standard_normal(4000)
    >>> bool(0.8 < long_run_variance(white) < 1.2), bool(long_run_variance(np.cumsum(white)) > 50)
    (True, True)
    """
    count = len(series)
    transform = np.fft.rfft(series - series.mean(), 2 * count)
    covariance = np.fft.irfft(transform.real**2 + transform.imag**2)[:count] / count
    window = _memory_window(covariance)
    lag = np.arange(1, window + 1)
    weight = np.minimum(1.0, 2 * (1 - lag / window))
    level = float(covariance[0] + 2 * np.sum(weight * covariance[lag]))
    slope = float(2 * np.sum(weight * lag * covariance[lag]))
    longest = min(3 * math.sqrt(count), count / 3)
    best = (1.5 * (slope / level) ** 2 * count) ** (1 / 3) if level > 0.0 else longest
    block = min(max(best, 1.0), longest)
    lag = np.arange(1, min(math.ceil(block), count))
    within = float(covariance[0] + 2 * np.sum((1 - lag / block) * covariance[lag]))
    return max(within, level)


def _memory_window(covariance: Array) -> int:
    """Return twice the lag after which a run of autocovariances is insignificant."""
    count = len(covariance)
    # The published run of 5 lags is shorter than one period of a narrow-band record.
    run = max(5, math.ceil(0.5 * math.sqrt(count)))
    most = max(min(math.ceil(3 * math.sqrt(count)) + run, count // 2), 1)
    bound = 2 * math.sqrt(math.log10(count) / count) * covariance[0]
    last = 0
    for lag in np.flatnonzero(np.abs(covariance[1 : most + 1]) >= bound).tolist():
        if lag + 1 - last > run:
            break
        last = lag + 1
    return int(min(2 * max(last, 1), most))
