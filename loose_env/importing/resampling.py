"""One time base for channels of different rates; gaps are not interpolated."""

from __future__ import annotations

import numpy as np

from loose_env.typing import Array

EVEN = 0.01
"""Stamps within this share of a step of a straight line are evenly spaced."""
_GAP_EVEN, _GAP_UNEVEN = 1.5, 3.0
"""A pause of more median steps than this is a gap."""
_SAME = 1e-3
"""Rows within this share of a step of a sample take it as it is."""
_DEGREE = 7
"""Degree of the spline through even samples, whose error is 0.2 % at three tenths of their rate and
less below; uneven ones are joined by cubics, which do not swing between stamps that are close."""


def median_step(time: Array) -> float:
    """Median time between samples [s]."""
    return float(np.median(np.diff(time)))


def filled(time: Array, values: Array) -> Array:
    """Column with missing samples interpolated; zeros where none is there."""
    there = np.isfinite(values)
    if there.all():
        return values
    return np.interp(time, time[there], values[there]) if there.any() else np.zeros_like(values)


def smoothed(values: Array, width: int) -> Array:
    """Mean of each sample and its neighbours along the first axis; the ends are mirrored."""
    ends = [(width // 2, (width - 1) // 2), *[(0, 0)] * (values.ndim - 1)]
    base = values[:1]  # sums of what is left lose no digits
    total = np.cumsum(np.pad(values - base, ends, mode="symmetric"), axis=0)
    total[width:] -= total[:-width].copy()
    return np.asarray(base + total[width - 1 :] / width)


def bridged(time: Array) -> float:
    """Longest pause between two samples that is no gap [s].

    One and a half steps where samples are evenly spaced, missing ones aside, so that one missing
    sample is seen, and three where they are not.
    """
    step = median_step(time)
    steps = np.diff(time) / step
    even = np.all(np.abs(steps - np.round(steps)) <= 2 * EVEN) and np.all(steps > 0.5)
    return (_GAP_EVEN if even else _GAP_UNEVEN) * step


def rows_of(time: Array, start: float, stop: float, gap: float, most: int) -> Array | None:
    """Times of the rows, from a channel's own samples: gaps are filled with rows at its step."""
    step = median_step(time)
    # The ends are other channels' samples, and may be a rounding away from this one's.
    kept = time[(time >= start - _SAME * step) & (time <= stop + _SAME * step)]
    if len(kept) < 2:
        return kept
    pauses = np.diff(kept)
    extra = np.where(pauses > gap, np.maximum(np.round(pauses / step) - 1, 0), 0)
    if len(kept) + extra.sum() > most:
        return None
    parts, last = [], 0
    for i in np.flatnonzero(extra):
        parts += [kept[last : i + 1], kept[i] + step * np.arange(1, int(extra[i]) + 1)]
        last = int(i) + 1
    rows = np.concatenate([*parts, kept[last:]])
    return rows[np.concatenate([[True], np.diff(rows) > 0.25 * step])] if parts else rows


def held(time: Array, values: Array, rows: Array, longest: float) -> Array:
    """Last value at or before each row; NaN before the first and after a pause."""
    if np.array_equal(time, rows):
        return values
    # A row that a rounding puts before its own sample still means that sample.
    at = np.searchsorted(time, rows + _SAME * median_step(time), side="right") - 1
    found = values[np.maximum(at, 0)].copy()
    found[(at < 0) | (rows - time[np.maximum(at, 0)] > longest)] = np.nan
    return found


def resampled(time: Array, values: Array, rows: Array, longest: float) -> tuple[Array, str]:
    """Bring a channel to the times of the rows, and NaN across gaps; and say how.

    Where the channel has a sample at every row, samples are taken as they are; else a spline goes
    through them.

    Examples
    --------
    >>> slow = np.arange(400) / 100
    >>> rows = np.arange(1000, 3000) / 1000
    >>> values, how = resampled(slow, np.sin(2 * np.pi * 20 * slow), rows, 0.015)
    >>> how, bool(np.abs(values - np.sin(2 * np.pi * 20 * rows)).max() < 1e-3)
    ('spline of degree 7 from 100 Hz', True)
    """
    if np.array_equal(time, rows):
        return values, "taken as it is"
    step = median_step(time)
    after = np.clip(np.searchsorted(time, rows), 1, len(time) - 1)
    near = after - ((rows - time[after - 1]) < (time[after] - rows))
    same = np.abs(time[near] - rows) <= _SAME * step
    found = np.full(len(rows), np.nan)
    found[same] = values[near[same]]
    inside = (rows >= time[0]) & (rows <= time[-1]) & (np.diff(time)[after - 1] <= longest)
    if not np.any(inside & ~same):
        return found, "taken as it is"
    found[:] = np.nan
    even = True
    edges = np.flatnonzero(np.diff(time) > longest) + 1
    for first, last in zip([0, *edges], [*edges, len(time)], strict=True):
        part = slice(int(first), int(last))
        lo, hi = np.searchsorted(rows, [time[first] - _SAME * step, time[last - 1] + _SAME * step])
        if last - first < 2:
            found[lo:hi] = values[first]  # a lone sample speaks for its own moment
        elif lo < hi:
            found[lo:hi], own = _segment(time[part], values[part], rows[lo:hi])
            even &= own
    how = f"spline of degree {_DEGREE}" if even else "cubic spline, uneven samples,"
    return found, f"{how} from {1 / step:.6g} Hz"


def _segment(time: Array, values: Array, rows: Array) -> tuple[Array, bool]:
    from scipy.interpolate import make_interp_spline  # half a second, and most logs need none

    count = len(time)
    line = np.linspace(time[0], time[-1], count)
    even = bool(np.max(np.abs(time - line)) <= EVEN * (line[1] - line[0]))
    degree = min(_DEGREE if even else 3, (count - 1) // 2 * 2 - 1 if count > 2 else 1)
    spline = make_interp_spline(line if even else time, values, k=degree)
    return np.asarray(spline(np.clip(rows, time[0], time[-1]))), even
