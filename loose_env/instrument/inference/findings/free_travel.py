"""Free travel of the most likely loose seat, from its motion and the force across it over time.

The fit gives the seat's acceleration at every line of a run. Integrated twice that is the seat's
path, and the arm's equation of motion gives the force across it, with gravity's static load. Inside
the gap the force is friction's alone; at either stop it rises. Only where both stops are reached do
the data say how far apart they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.evidence import Evidence
from loose_env.instrument.inference.laplace_fit import fitted_pieces, seats_of
from loose_env.instrument.inference.posterior import ModelComparison
from loose_env.instrument.inference.seat_motion import Piece, Seat
from loose_env.instrument.settings.thresholds import (
    CLEARANCE_ERROR,
    CLEARANCE_RESIDUAL,
    TIME_AT_STOP,
)
from loose_env.typing import Array

_FOLDED = 0.04
"""Power that samples fold back over that which they follow [1]."""
_ENDS = 25
_BLOCKS = 6
_SAMPLES = 500
"""Most samples to which the law is fitted."""
_TAPER = 0.5
"""Least height of the taper at samples that are used."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Travel:
    """Estimated free travel of a seat."""

    gap: float | None
    """Free travel [m, rad for play of a revolute joint]; None where not identified."""
    interval: tuple[float, float] | None
    """Ends of its 95 % interval."""
    range: float
    """Range of the seat's motion, 1st to 99th percentile [m or rad]."""
    linear: bool
    """True if a spring without clearance explains the force as well: a compliant part."""


def travel_of(comparison: ModelComparison, hypothesis: str, lines: Sequence[Lines]) -> Travel:
    """Estimate the free travel of the most likely seat."""
    uncertain = comparison.evidence.uncertain
    evidence = Evidence(
        uncertain=uncertain,
        lines=[comparison.as_sampled(one) for one in lines],
        known_runs=comparison.evidence.runs,
    )
    seat = seats_of(uncertain.arm.hypotheses, uncertain.arm.n)[hypothesis]
    fit = comparison.fits[hypothesis]
    assert isinstance(seat, Seat)
    assert fit.axis is not None
    gaps: list[float] = []
    ranges, linear = [], []
    for piece in fitted_pieces(evidence, fit):
        path, force = seat_in_time(piece, seat, fit.axis)
        ranges.append(float(np.subtract(*np.percentile(path, [99, 1]))))
        size = len(path) // _BLOCKS
        whole = law_of(path, force)
        linear.append(whole is None)
        if whole is None:
            continue
        for block in range(_BLOCKS):
            part = slice(block * size, (block + 1) * size)
            found = law_of(path[part], force[part])
            if found is not None:
                gaps.append(found)
    widest = max(ranges, default=0.0)
    if len(gaps) < 4:
        return Travel(gap=None, interval=None, range=widest, linear=all(linear))
    middle = float(np.median(gaps))
    spread = 1.4826 * float(np.median(np.abs(np.array(gaps) - middle)))
    half = 2.0 * np.hypot(1.25 * spread / np.sqrt(len(gaps) / 2), CLEARANCE_ERROR * middle)
    return Travel(
        gap=middle,
        interval=(max(middle - half, 0.0), middle + half),
        range=widest,
        linear=False,
    )


def seat_in_time(piece: Piece, seat: Seat, axis: Array) -> tuple[Array, Array]:
    """Seat displacement and force, zero mean (N,) each [m, N or rad, N·m]."""
    lines, response = piece.lines, piece.response
    first = response.columns[:, :, seat.columns] @ axis
    second = np.broadcast_to(response.sudden[:, seat.columns] @ axis, first.shape)
    both = np.stack([first, second], axis=2)
    weighted = piece.weight @ both
    inside = both.conj().swapaxes(1, 2) @ weighted
    # A seat may move at any line by as much as one that floats does at any.
    most = max(float(response.floating(seat.columns, axis[None]).max()) ** 2, 1e-30)
    inside[:, [0, 1], [0, 1]] += 1 / np.array([most, _FOLDED * most])
    seen = weighted.conj().swapaxes(1, 2) @ response.residual[:, :, None]
    moved = np.linalg.solve(inside, seen)[:, 0, 0]
    load, mass = response.across_seat(seat.columns)
    pushed = -(load @ axis + np.einsum("s,kst,t->k", axis, mass, axis) * moved)
    omega2 = (2 * np.pi * lines.frequency) ** 2
    count = round(lines.seconds / lines.period)
    at = np.round(lines.frequency * lines.seconds).astype(int)
    spectra = np.zeros((2, count // 2 + 1), dtype=complex)
    spectra[0, at], spectra[1, at] = -moved / omega2, pushed
    path, force = np.fft.irfft(spectra, count, axis=1)
    taper = signal.windows.hann(count, sym=False)
    taper /= np.sqrt(np.mean(taper**2))
    used = taper > _TAPER * taper.max()
    return path[used] / taper[used], force[used] / taper[used]


def law_of(path: Array, force: Array) -> float | None:
    """Best-fitting free travel; None unless both stops are reached.

    The force is a constant, and beyond either end of the gap a stiffness and a damping of their
    own. Widths and positions of the clearance are tried one by one.

    Examples
    --------
    >>> path = 2e-4 * np.sin(np.arange(2000) * 0.11)
    >>> pushed = 1e5 * np.sign(path) * np.maximum(np.abs(path) - 5e-5, 0.0)
    >>> bool(abs(law_of(path, pushed) - 1e-4) < 2e-5)
    True
    """
    low, high = np.percentile(path, [0.5, 99.5])
    wide = float(high - low)
    if not wide > 0 or len(path) < 50:
        return None
    speed = np.gradient(path)
    every = max(1, len(path) // _SAMPLES)
    path, force, speed = path[::every], force[::every], speed[::every]
    ends = np.linspace(low, high, _ENDS)
    under, over = path[:, None] < ends, path[:, None] > ends
    gone = np.where(under, path[:, None] - ends, 0.0), np.where(over, path[:, None] - ends, 0.0)
    fast = speed[:, None] / max(float(np.std(speed)), 1e-30)
    columns = np.column_stack([*(g / wide for g in gone), under * fast, over * fast])
    columns -= columns.mean(axis=0)
    centred = force - force.mean()
    gram, onto = columns.T @ columns, columns.T @ centred
    total = float(centred @ centred)
    best = spring = total
    found = None
    for i in range(_ENDS - 1):
        for j in range(i, _ENDS - 1):
            four = np.array([i, _ENDS + j, 2 * _ENDS + i, 3 * _ENDS + j])
            part = gram[np.ix_(four, four)]
            scale = np.sqrt(np.maximum(np.diag(part), 1e-300))
            shape = part / np.outer(scale, scale) + 1e-6 * np.eye(4)
            values = np.linalg.solve(shape, onto[four] / scale)
            if values[:2].min() <= 0:
                continue
            left = total - float(values @ (onto[four] / scale))
            if i == j:
                spring = min(spring, left)
            elif left < best:
                best, found = left, (ends[i], ends[j])
    if found is None or best > CLEARANCE_RESIDUAL * spring:
        return None
    at_stop = min(float(np.mean(path < found[0])), float(np.mean(path > found[1])))
    return None if at_stop < TIME_AT_STOP else float(found[1] - found[0])
