"""Compiled loop that integrates small motion like MuJoCo's Euler integrator, many arms at once.

It goes from drive torque to what the sensors' converters see: the accelerometers' low-pass and
the encoders' sampling are part of the loop, so that no motion is kept that nobody reads. Every
innermost loop runs over the arms, for the compiler to take several in one instruction; it holds no
branch, and an arm's numbers do not depend on its neighbours or on how many there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_seat_force(
    a: Any, mobility: Any, x: Any, v: Any, law: Any, shares: Any, push: Any
) -> None:
    """Add the accelerations (D, J) by friction and stops of the seat, the last coordinate."""
    seat = len(a) - 1
    own, free, at, speed = mobility[seat, seat], a[seat], x[seat], v[seat]
    for k in range(len(push)):
        # Everything is read first: a load behind a condition would keep arms from going together.
        m, free_k, at_k, speed_k = own[k], free[k], at[k], speed[k]
        low, high, most, grip = law[0, k], law[1, k], law[8, k], law[9, k]
        slope_low, slope_high, aim = law[6, k], law[7, k], law[10, k] * speed_k
        low_sticks, high_sticks = shares[1, k], shares[2, k]
        low_slips, high_slips = shares[3, k], shares[4, k]
        at_low = law[2, k] * (low - at_k) - law[4, k] * speed_k
        at_high = 0.0 - law[3, k] * (at_k - high) - law[5, k] * speed_k
        below, above = at_k < low, high < at_k
        # Force of the touched stop at no acceleration, and against it; 0 where none is touched.
        side = 1.0 if below else (-1.0 if above else 0.0)
        base = at_low if below else (at_high if above else 0.0)
        slope = slope_low if below else (slope_high if above else 0.0)
        stuck = low_sticks if below else high_sticks
        slipping = low_slips if below else high_slips
        least = 0.0 - most
        # The law is piecewise linear and falls with the acceleration: one combination holds.
        # Off the stops; sticking, friction = -grip (a + rate v).
        sticking = (free_k - m * (grip * aim)) * shares[0, k]
        friction = 0.0 - grip * (sticking + aim)
        off = most if most < friction else (least if friction < least else friction)
        after = free_k + m * off if off != friction else sticking
        # At a stop.
        held = (free_k + m * (base - grip * aim)) * stuck
        friction = 0.0 - grip * (held + aim)
        on = most if most < friction else (least if friction < least else friction)
        moving = (free_k + m * (base + on)) * slipping
        stop = base - slope * (moving if on != friction else held)
        total = on + stop if stop * side > 0.0 else on
        # Whether the stop would give anything at the acceleration off it.
        push[k] = total if (base - slope * after) * side > 0.0 else off
    for i in range(len(a)):
        total, row = a[i], mobility[i, seat]
        for k in range(len(push)):
            total[k] += row[k] * push[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _shares(mobility: Any, law: Any) -> Any:
    """Shares of an acceleration that remain (5, J).

    Sticking and free of the stops, sticking at the lower and the upper stop, slipping at each.
    """
    grip, low, high = law[9], law[6], law[7]
    found = np.empty((5, len(grip)))
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
    """Integrate J arms, the last axis of all arrays, and write what their sensors see."""
    (count, arms), sensors, joints = start.shape, len(still), len(zero)
    period, samples = torque.shape[1], smooth.shape[1]
    length = len(taps)
    half = length // 2
    x = start.copy()
    v, f, a = np.zeros((count, arms)), np.empty((count, arms)), np.empty((count, arms))
    push = np.empty(arms)
    window = np.zeros((length, sensors, arms))  # the latest true accelerations, a ring
    shares = _shares(mobility[count - 1, count - 1], law)
    position = (period - before % period) % period
    newest = 0
    reading, phase = -(before // factor), 0
    for t in range(before + factor * samples + max(half - factor, 0) + 1):
        for i in range(count):
            total, still_force, damper, speed = f[i], force[i], damping[i], v[i]
            for k in range(arms):
                total[k] = still_force[k] - damper[k] * speed[k]
            for j in range(count):
                spring, moved = stiffness[i, j], x[j]
                for k in range(arms):
                    total[k] -= spring[k] * moved[k]
        for e in range(len(driven)):
            total, drive = f[driven[e]], torque[e, position]
            for k in range(arms):
                total[k] += drive[k]
        position += 1
        if position == period:
            position = 0
        for i in range(count):
            total, row, load = a[i], mobility[i, 0], f[0]
            for k in range(arms):
                total[k] = row[k] * load[k]
            for j in range(1, count):
                row, load = mobility[i, j], f[j]
                for k in range(arms):
                    total[k] += row[k] * load[k]
        _add_seat_force(a, mobility, x, v, law, shares, push)
        if t >= before - half:
            for s in range(sensors):
                total, rest = window[newest, s], still[s]
                for k in range(arms):
                    total[k] = rest[k]
                for i in range(count):
                    row, tilt, moved, speed = readings[s, i], tilting[s, i], x[i], a[i]
                    for k in range(arms):
                        total[k] += row[k] * speed[k] + tilt[k] * moved[k]
            newest += 1
            if newest == length:
                newest = 0
            row_out = reading - half // factor
            if phase == 0 and row_out >= 0 and row_out < samples:
                for s in range(sensors):
                    total = smooth[s, row_out]
                    for k in range(arms):
                        total[k] = 0.0
                    for i in range(length):
                        at = newest + i if newest + i < length else newest + i - length
                        seen, tap = window[at, s], taps[i]
                        for k in range(arms):
                            total[k] += tap * seen[k]
        if phase == 0 and reading >= -1 and reading <= samples:
            for s in range(joints):
                total, rest, moved = encoder[s, reading + 1], zero[s], x[s]
                for k in range(arms):
                    total[k] = rest[k] + moved[k]
        for i in range(count):
            speed, moved, gained = v[i], x[i], a[i]
            for k in range(arms):
                speed[k] += timestep * gained[k]
                moved[k] += timestep * speed[k]
        phase += 1
        if phase == factor:
            phase = 0
            reading += 1
