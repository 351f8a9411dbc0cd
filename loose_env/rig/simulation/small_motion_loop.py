"""Compiled loop that integrates small motion like MuJoCo's Euler integrator."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

__all__ = ["integrate"]


@njit(cache=True, nogil=True, error_model="numpy")
def _seat_force(free: float, mobility: float, x: float, v: float, law: Any) -> float:
    """Force of friction and stops on the seat.

    Parameters
    ----------
    free : float
        Acceleration of the seat without that force.
    mobility : float
        Acceleration per force.
    x, v : float
        Position and velocity of the seat.
    law : ndarray (11,)
        `SeatLaw.numbers`.
    """
    low, high = law[0], law[1]
    side = 0
    base = slope = 0.0  # force of the stop at no acceleration, and against it
    if x < low:
        side = 1
        base = law[2] * (low - x) - law[4] * v
        slope = law[6]
    elif x > high:
        side = -1
        base = -law[3] * (x - high) - law[5] * v
        slope = law[7]
    most, grip, rate = law[8], law[9], law[10]
    # The law is piecewise linear and falls with the acceleration: one combination holds.
    force = 0.0
    for pushing in range(2 if side != 0 else 1):
        on = pushing if side != 0 else 0
        b, s = (base, slope) if on == 1 else (0.0, 0.0)
        # Sticking: friction = -grip (a + rate v).
        a = (free + mobility * (b - grip * rate * v)) / (1 + mobility * (s + grip))
        friction = -grip * (a + rate * v)
        if friction > most or friction < -most:
            friction = most if friction > most else -most
            a = (free + mobility * (b + friction)) / (1 + mobility * s)
        force = friction + b - s * a
        if side == 0:
            break
        stop = base - slope * a  # what the stop would give at this acceleration
        if on == 0 and stop * side <= 0:
            break
        if on == 1 and stop * side < 0:
            force = friction
    return force


@njit(cache=True, nogil=True, error_model="numpy")
def integrate(
    mobility: Any,
    stiffness: Any,
    damping: Any,
    force: Any,
    start: Any,
    drives: Any,
    excited: Any,
    readings: Any,
    tilting: Any,
    still: Any,
    encoders: Any,
    zero: Any,
    seat: int,
    law: Any,
    torque: Any,
    timestep: float,
    recorded: Any,
) -> None:
    """Integrate one arm and write its sensor channels.

    Parameters
    ----------
    mobility, stiffness, damping, force, start, drives, readings, tilting, still, encoders, zero
        As in `loose_env.rig.simulation.small_motion.SmallMotion`.
    excited : ndarray of int
        Drives whose torque changes or is not zero.
    seat : int
        Index of the seat, -1 without one.
    law : ndarray (11,)
        `SeatLaw.numbers`; not read without a seat.
    torque : ndarray (steps, n)
        Torque that each drive delivers.
    timestep : float
        Step [s].
    recorded : ndarray (steps, S + n)
        Written: accelerometers, then joint positions, each at the start of the step.
    """
    count, sensors, joints = len(start), len(still), len(zero)
    x = start.copy()
    v = np.zeros(count)
    f = np.empty(count)
    a = np.empty(count)
    for t in range(len(torque)):
        for i in range(count):
            total = force[i] - damping[i] * v[i]
            for j in range(count):
                total -= stiffness[i, j] * x[j]
            f[i] = total
        for j in excited:
            u = torque[t, j]
            for i in range(count):
                f[i] += drives[i, j] * u
        for i in range(count):
            total = 0.0
            for j in range(count):
                total += mobility[i, j] * f[j]
            a[i] = total
        if seat >= 0:
            push = _seat_force(a[seat], mobility[seat, seat], x[seat], v[seat], law)
            for i in range(count):
                a[i] += mobility[i, seat] * push
        for s in range(sensors):
            total = still[s]
            for i in range(count):
                total += readings[s, i] * a[i] + tilting[s, i] * x[i]
            recorded[t, s] = total
        for s in range(joints):
            total = zero[s]
            for i in range(count):
                total += encoders[s, i] * x[i]
            recorded[t, sensors + s] = total
        for i in range(count):
            v[i] += timestep * a[i]
            x[i] += timestep * v[i]
