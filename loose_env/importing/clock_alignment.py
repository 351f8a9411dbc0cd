"""Offset between two clocks, from two channels of the same motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import fft, signal

from loose_env.errors import InvalidData
from loose_env.importing.resampling import bridged, median_step, resampled
from loose_env.typing import Array

_MOST_POINTS = 2**24
_LEAST_OVERLAP = 0.3
"""Share of the shorter channel that has to lie beside the other."""
_RIVAL = 0.95
"""A second peak this high leaves the shift open."""


class Shift(NamedTuple):
    """A shift [s] to add to the own channel's times, and the correlation that is left with it."""

    seconds: float
    correlation: float


def shift_between(
    place: str,
    own: tuple[Array, Array],
    other: tuple[Array, Array],
    *,
    most_s: float,
    band_hz: tuple[float, float] | None = None,
    sign: int = 1,
    least: float = 0.6,
) -> Shift:
    """Find the shift at which two channels agree best.

    Both are brought to one grid at the faster one's rate and to the band that both have; the
    correlation is taken at every shift over what overlaps, and its peak read off by a parabola.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(4000) / 1000
    >>> motion = signal.sosfilt(signal.butter(4, 50, fs=1000, output="sos"), rng.normal(size=4000))
    >>> found = shift_between("here", (t - 0.2, motion), (t, motion), most_s=1.0)
    >>> round(found.seconds, 6)
    0.2
    """
    step = min(median_step(own[0]), median_step(other[0]))
    top = 0.4 / max(median_step(own[0]), median_step(other[0]))
    low, high = band_hz if band_hz is not None else (0.0, top)
    high = min(high, top)
    if low >= high:
        raise InvalidData(f"{place}: the band starts at {low:g} Hz, and both reach {top:.3g} Hz")
    first = min(own[0][0], other[0][0] - most_s)
    last = max(own[0][-1], other[0][-1] + most_s)
    count = (last - first) / step
    if count > _MOST_POINTS:
        raise InvalidData(
            f"{place}: {count:.3g} samples would be compared; at most {_MOST_POINTS}. The sources "
            "may not count from the same date: give from_start = true or offset_s"
        )
    mine, mine_there = _on_grid(own, step, (low, high))
    theirs, theirs_there = _on_grid(other, step, (low, high))
    begin = (other[0][0] - own[0][0]) / step  # shift that puts both first samples together
    scores, lags, overlap = _correlations(mine, mine_there, theirs, theirs_there)
    seconds = (begin + lags) * step
    least_overlap = _LEAST_OVERLAP * min(mine_there.sum(), theirs_there.sum())
    allowed = (np.abs(seconds) <= most_s) & (overlap >= least_overlap)
    if not allowed.any():
        raise InvalidData(
            f"{place}: with shifts up to {most_s:g} s the two channels hardly overlap: one has "
            f"{own[0][0]:.3f} to {own[0][-1]:.3f} s, the other {other[0][0]:.3f} to "
            f"{other[0][-1]:.3f} s; raise most_s, or set offset_s or from_start first"
        )
    scores = np.where(allowed, sign * scores, -np.inf)
    best = int(np.argmax(scores))
    if scores[best] < least:
        raise InvalidData(
            f"{place}: the channels agree at no shift up to {most_s:g} s: the best correlation is "
            f"{scores[best]:.2f} (at {seconds[best]:+.4f} s), and {least:g} is asked for; is it "
            "the same motion, the right sign and band?"
        )
    _refuse_rival(place, scores, seconds, best)
    exact = float(seconds[best])
    if 0 < best < len(scores) - 1 and np.isfinite(scores[[best - 1, best + 1]]).all():
        left, here, right = scores[best - 1 : best + 2]
        bend = left - 2 * here + right
        if bend < 0:
            exact += float(0.5 * (left - right) / bend) * step
    return Shift(exact, float(scores[best]))


def _on_grid(
    channel: tuple[Array, Array], step: float, band: tuple[float, float]
) -> tuple[Array, Array]:
    """A channel on an even grid from its first sample, its band alone, and where it is there."""
    time, values = channel
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step) + 1)
    on_grid = resampled(time, values, grid, bridged(time, None)).values
    there = np.isfinite(on_grid)
    filled = np.where(there, on_grid, np.mean(values))
    filled = signal.detrend(filled)
    half = 0.5 / step
    low, high = band
    if low > 0 or high < 0.99 * half:
        kind = ("bandpass", (low, min(high, 0.99 * half))) if low > 0 else ("lowpass", high)
        sos = signal.butter(4, kind[1], btype=kind[0], fs=2 * half, output="sos")
        filled = signal.sosfiltfilt(sos, filled, padlen=min(len(filled) - 1, 1000))
    return np.where(there, filled, 0.0), there.astype(np.float64)


def _correlations(
    mine: Array, mine_there: Array, theirs: Array, theirs_there: Array
) -> tuple[Array, Array, Array]:
    """Correlation at each lag over the overlap, the lags, and the overlap in samples."""
    size = fft.next_fast_len(len(mine) + len(theirs) - 1, real=True)

    def products(a: Array, b: Array) -> Array:
        spectrum = fft.rfft(b, size) * np.conj(fft.rfft(a, size))
        full = fft.irfft(spectrum, size)
        return np.concatenate([full[size - len(a) + 1 :], full[: len(b)]])

    lags = np.arange(-(len(mine) - 1), len(theirs))
    own_power = products(mine**2, theirs_there)
    other_power = products(mine_there, theirs**2)
    overlap = products(mine_there, theirs_there)
    floor = 1e-9 * (np.sum(mine**2) * np.sum(theirs**2)) ** 0.5 + 1e-300
    power = np.sqrt(np.maximum(own_power, 0) * np.maximum(other_power, 0))
    return products(mine, theirs) / np.maximum(power, floor), lags.astype(np.float64), overlap


def _refuse_rival(place: str, scores: Array, seconds: Array, best: int) -> None:
    """Refuse a shift beside which another does as well, as in a motion that repeats itself."""
    peak = scores[best]
    left = right = best
    while left > 0 and scores[left - 1] > 0.5 * peak:
        left -= 1
    while right < len(scores) - 1 and scores[right + 1] > 0.5 * peak:
        right += 1
    others = np.concatenate([scores[:left], scores[right + 1 :]])
    if len(others) and others.max() > _RIVAL * peak:
        where = np.concatenate([seconds[:left], seconds[right + 1 :]])[int(np.argmax(others))]
        raise InvalidData(
            f"{place}: the shift is not clear: {seconds[best]:+.4f} s and {where:+.4f} s agree "
            f"about as well ({peak:.3f} and {others.max():.3f}); the motion repeats itself. Lower "
            "most_s, or use channels with random motion"
        )
