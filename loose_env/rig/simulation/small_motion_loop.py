"""Compiled loop that integrates small motion like MuJoCo's Euler integrator, eight arms at once.

It goes from drive torque to what the sensors' converters see: the accelerometers' low-pass and
the encoders' sampling are part of the loop, so that no motion is kept that nobody reads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from loose_env.rig.simulation.lanes import LANES, load, pick, splat, store

__all__ = ["integrate"]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _seat_force(free: Any, mobility: Any, x: Any, v: Any, law: Any, stiff: Any) -> Any:
    """Force of friction and stops on the seats of eight arms.

    Parameters
    ----------
    free : lanes
        Acceleration of the seat without that force.
    mobility : lanes
        Acceleration per force.
    x, v : lanes
        Position and velocity of the seat.
    law : ndarray (11, 8)
        `SmallMotion.law`.
    stiff : ndarray (5, 8)
        Shares of an acceleration that remain: sticking and free of the stops, sticking at the
        lower and the upper stop, and slipping at each, as `_shares` works them out.
    """
    zero, one = splat(0.0), splat(1.0)
    low, high = load(law, 0), load(law, 1)
    # Force of the touched stop at no acceleration, and against it; 0 where none is touched.
    side = pick(x, low, one, pick(high, x, splat(-1.0), zero))
    base = pick(
        x,
        low,
        load(law, 2) * (low - x) - load(law, 4) * v,
        pick(high, x, zero - load(law, 3) * (x - high) - load(law, 5) * v, zero),
    )
    slope = pick(x, low, load(law, 6), pick(high, x, load(law, 7), zero))
    stuck = pick(x, low, load(stiff, 1), load(stiff, 2))
    slipping = pick(x, low, load(stiff, 3), load(stiff, 4))
    most, grip = load(law, 8), load(law, 9)
    least, aim = zero - most, load(law, 10) * v
    # The law is piecewise linear and falls with the acceleration: one combination holds.
    # Off the stops; sticking, friction = -grip (a + rate v).
    a = (free - mobility * (grip * aim)) * load(stiff, 0)
    friction = zero - grip * (a + aim)
    off = pick(most, friction, most, pick(friction, least, least, friction))
    a = pick(
        most, friction, free + mobility * most, pick(friction, least, free + mobility * least, a)
    )
    pressed = (base - slope * a) * side  # what the stop would give at this acceleration
    # At a stop.
    b = (free + mobility * (base - grip * aim)) * stuck
    friction = zero - grip * (b + aim)
    on = pick(most, friction, most, pick(friction, least, least, friction))
    slid = (free + mobility * (base + on)) * slipping
    b = pick(most, friction, slid, pick(friction, least, slid, b))
    stop = base - slope * b
    return pick(zero, pressed, pick(stop * side, zero, on, on + stop), off)


@njit(cache=True, nogil=True, error_model="numpy")
def _shares(mobility: Any, law: Any) -> Any:
    """Shares that `_seat_force` takes (5, 8)."""
    found = np.empty((5, LANES))
    one, grip = splat(1.0), load(law, 9)
    low, high = load(law, 6), load(law, 7)
    store(found, 0, one / (one + mobility * grip))
    store(found, 1, one / (one + mobility * (low + grip)))
    store(found, 2, one / (one + mobility * (high + grip)))
    store(found, 3, one / (one + mobility * low))
    store(found, 4, one / (one + mobility * high))
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
    """Integrate eight arms and write what their sensors see.

    Parameters
    ----------
    mobility, stiffness, damping, force, start, readings, tilting, still, zero, law
        As in `loose_env.rig.simulation.small_motion.SmallMotion`, the arms last: (..., 8).
    torque : ndarray (m, period, 8)
        Torque that drives deliver beyond what is constant, one period, which repeats.
    driven : ndarray of int (m,)
        Joint of each of these drives.
    timestep : float
        Step [s].
    before : int
        Steps before the first reading; whole readings.
    factor : int
        Steps per reading.
    taps : ndarray (8 factor + 1,)
        Low-pass of the accelerometers.
    smooth : ndarray (S, N, 8)
        Written: accelerometers behind their low-pass.
    encoder : ndarray (n, N + 2, 8)
        Written: joint positions, one reading more at either end.
    """
    count, sensors, joints = len(start), len(still), len(zero)
    period, samples = torque.shape[1], smooth.shape[1]
    length = len(taps)
    half = length // 2
    x = start.copy()
    v = np.zeros((count, LANES))
    f = np.empty((count, LANES))
    a = np.empty((count, LANES))
    window = np.zeros((length, sensors, LANES))  # the latest true accelerations, a ring
    seat = count - 1
    stiff = _shares(load(mobility, seat * count + seat), law)
    step = splat(timestep)
    position = (period - before % period) % period
    newest = 0
    reading, phase = -(before // factor), 0
    for t in range(before + factor * samples + max(half - factor, 0) + 1):
        for i in range(count):
            total = load(force, i) - load(damping, i) * load(v, i)
            for j in range(count):
                total = total - load(stiffness, i * count + j) * load(x, j)
            store(f, i, total)
        for e in range(len(driven)):
            i = driven[e]
            store(f, i, load(f, i) + load(torque, e * period + position))
        position += 1
        if position == period:
            position = 0
        for i in range(count):
            total = load(mobility, i * count) * load(f, 0)
            for j in range(1, count):
                total = total + load(mobility, i * count + j) * load(f, j)
            store(a, i, total)
        push = _seat_force(
            load(a, seat),
            load(mobility, seat * count + seat),
            load(x, seat),
            load(v, seat),
            law,
            stiff,
        )
        for i in range(count):
            store(a, i, load(a, i) + load(mobility, i * count + seat) * push)
        if t >= before - half:
            for s in range(sensors):
                total = load(still, s)
                for i in range(count):
                    row = s * count + i
                    total = total + (
                        load(readings, row) * load(a, i) + load(tilting, row) * load(x, i)
                    )
                store(window, newest * sensors + s, total)
            newest += 1
            if newest == length:
                newest = 0
            k = reading - half // factor
            if phase == 0 and k >= 0 and k < samples:
                for s in range(sensors):
                    total = splat(0.0)
                    for i in range(newest, length):
                        total = total + splat(taps[i - newest]) * load(window, i * sensors + s)
                    for i in range(newest):
                        total = total + splat(taps[length - newest + i]) * load(
                            window, i * sensors + s
                        )
                    store(smooth, s * samples + k, total)
        if phase == 0 and reading >= -1 and reading <= samples:
            for s in range(joints):
                store(encoder, s * (samples + 2) + reading + 1, load(zero, s) + load(x, s))
        for i in range(count):
            speed = load(v, i) + step * load(a, i)
            store(v, i, speed)
            store(x, i, load(x, i) + step * speed)
        phase += 1
        if phase == factor:
            phase = 0
            reading += 1
