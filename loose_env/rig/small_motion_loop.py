"""Compiled loop that integrates small motion like MuJoCo's Euler integrator, eight arms at once.

It goes from drive torque to what the sensors' converters see: the accelerometers' low-pass and
the encoders' sampling are part of the loop, so that no motion is kept that nobody reads. Every
innermost loop runs over the arms, for the compiler to take them together; an arm's numbers do not
depend on its neighbours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

LANES = 8
"""Arms that are worked on at once."""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _seat_force(
    free: float, mobility: float, x: float, v: float, law: Any, stiff: Any, k: int
) -> Any:
    """Force of friction and stops on the seat of arm k."""
    low, high = law[0, k], law[1, k]
    below, above = x < low, high < x
    # Force of the touched stop at no acceleration, and against it; 0 where none is touched.
    side, base, slope = 0.0, 0.0, 0.0
    if below:
        side, slope = 1.0, law[6, k]
        base = law[2, k] * (low - x) - law[4, k] * v
    elif above:
        side, slope = -1.0, law[7, k]
        base = 0.0 - law[3, k] * (x - high) - law[5, k] * v
    stuck, slipping = (stiff[1, k], stiff[3, k]) if below else (stiff[2, k], stiff[4, k])
    most, grip = law[8, k], law[9, k]
    least, aim = 0.0 - most, law[10, k] * v
    # The law is piecewise linear and falls with the acceleration: one combination holds.
    # Off the stops; sticking, friction = -grip (a + rate v).
    a = (free - mobility * (grip * aim)) * stiff[0, k]
    friction = 0.0 - grip * (a + aim)
    off = friction
    if most < friction:
        off, a = most, free + mobility * most
    elif friction < least:
        off, a = least, free + mobility * least
    if not (base - slope * a) * side > 0.0:  # what the stop would give at this acceleration
        return off
    # At a stop.
    b = (free + mobility * (base - grip * aim)) * stuck
    friction = 0.0 - grip * (b + aim)
    on = most if most < friction else (least if friction < least else friction)
    if on != friction:
        b = (free + mobility * (base + on)) * slipping
    stop = base - slope * b
    return on + stop if stop * side > 0.0 else on


@njit(cache=True, nogil=True, error_model="numpy")
def _shares(mobility: Any, law: Any) -> Any:
    """Shares of an acceleration that remain (5, 8).

    Sticking and free of the stops, sticking at the lower and the upper stop, slipping at each.
    """
    grip, low, high = law[9], law[6], law[7]
    found = np.empty((5, LANES))
    found[0] = 1.0 / (1.0 + mobility * grip)
    found[1] = 1.0 / (1.0 + mobility * (low + grip))
    found[2] = 1.0 / (1.0 + mobility * (high + grip))
    found[3] = 1.0 / (1.0 + mobility * low)
    found[4] = 1.0 / (1.0 + mobility * high)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def integrate(
    mobility: Any,
    stiffness: Any,
    damping: Any,
    force: Any,
    start: Any,
    readings: Any,
    tilting: Any,
    still: Any,
    zero: Any,
    law: Any,
    torque: Any,
    driven: Any,
    timestep: float,
    before: int,
    factor: int,
    taps: Any,
    smooth: Any,
    encoder: Any,
) -> None:
    """Integrate eight arms and write what their sensors see."""
    count, sensors, joints = len(start), len(still), len(zero)
    period, samples = torque.shape[1], smooth.shape[1]
    length = len(taps)
    half = length // 2
    x = start.copy()
    v = np.zeros((count, LANES))
    f = np.empty((count, LANES))
    a = np.empty((count, LANES))
    total, push = np.empty(LANES), np.empty(LANES)
    window = np.zeros((length, sensors, LANES))  # the latest true accelerations, a ring
    seat = count - 1
    stiff = _shares(mobility[seat, seat], law)
    position = (period - before % period) % period
    newest = 0
    reading, phase = -(before // factor), 0
    for t in range(before + factor * samples + max(half - factor, 0) + 1):
        for i in range(count):
            for k in range(LANES):
                total[k] = force[i, k] - damping[i, k] * v[i, k]
            for j in range(count):
                for k in range(LANES):
                    total[k] -= stiffness[i, j, k] * x[j, k]
            for k in range(LANES):
                f[i, k] = total[k]
        for e in range(len(driven)):
            for k in range(LANES):
                f[driven[e], k] += torque[e, position, k]
        position += 1
        if position == period:
            position = 0
        for i in range(count):
            for k in range(LANES):
                total[k] = mobility[i, 0, k] * f[0, k]
            for j in range(1, count):
                for k in range(LANES):
                    total[k] += mobility[i, j, k] * f[j, k]
            for k in range(LANES):
                a[i, k] = total[k]
        for k in range(LANES):
            push[k] = _seat_force(
                a[seat, k], mobility[seat, seat, k], x[seat, k], v[seat, k], law, stiff, k
            )
        for i in range(count):
            for k in range(LANES):
                a[i, k] += mobility[i, seat, k] * push[k]
        if t >= before - half:
            for s in range(sensors):
                for k in range(LANES):
                    total[k] = still[s, k]
                for i in range(count):
                    for k in range(LANES):
                        total[k] += readings[s, i, k] * a[i, k] + tilting[s, i, k] * x[i, k]
                for k in range(LANES):
                    window[newest, s, k] = total[k]
            newest += 1
            if newest == length:
                newest = 0
            row = reading - half // factor
            if phase == 0 and row >= 0 and row < samples:
                for s in range(sensors):
                    for k in range(LANES):
                        total[k] = 0.0
                    for i in range(length):
                        at = newest + i if newest + i < length else newest + i - length
                        for k in range(LANES):
                            total[k] += taps[i] * window[at, s, k]
                    for k in range(LANES):
                        smooth[s, row, k] = total[k]
        if phase == 0 and reading >= -1 and reading <= samples:
            for s in range(joints):
                for k in range(LANES):
                    encoder[s, reading + 1, k] = zero[s, k] + x[s, k]
        for i in range(count):
            for k in range(LANES):
                v[i, k] += timestep * a[i, k]
                x[i, k] += timestep * v[i, k]
        phase += 1
        if phase == factor:
            phase = 0
            reading += 1
