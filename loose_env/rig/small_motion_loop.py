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
    a: Any, mobility: Any, x: Any, v: Any, law: Any, shares: Any, push: Any, arms: int
) -> None:
    """Add the accelerations (D, J) by friction and stops of the seat, the last coordinate."""
    seat = len(a) - 1
    own, free, at, speed = mobility[seat, seat], a[seat], x[seat], v[seat]
    for k in range(arms):
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
        for k in range(arms):
            total[k] += row[k] * push[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _cross(a: Any, b: Any) -> Any:
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return x, y, z


@njit(cache=True, nogil=True, error_model="numpy")
def _motion(hinge: Any, axis: Any, anchor: Any, at: Any) -> Any:
    """Velocity of a point per velocity of a degree of freedom."""
    arm = at[0] - anchor[0], at[1] - anchor[1], at[2] - anchor[2]
    return _cross(axis, arm) if hinge else (axis[0], axis[1], axis[2])


@njit(cache=True, nogil=True, error_model="numpy")
def linearise(
    fixed: Any, slots: Any, seen: Any, position: Any, excited: Any, torque: Any, sensors: Any
) -> Any:
    """Linearise J true arms of D degrees of freedom and S accelerometer axes about their positions.

    Gravity's linear part is taken about the start, springs about where they rest. Returns the
    inertia matrix with the holdings' inertances (J, D, D), in which a seat that is shut is apart
    from all else; and with the arms last the stiffness of springs, holdings and gravity (D, D, J),
    damping, constant force, start less where springs rest (D, J) each; sensor acceleration per
    acceleration and sensor reading per displacement (S, D, J) each, readings at rest (S, J); where
    springs of driven joints rest (n, J), and the forces of the seat (11, J).
    """
    (arms, count), n, (sites, owners) = position.shape, excited.shape[1], sensors
    axes = len(sites)
    inertia, stiffness = np.empty((arms, count, count)), np.empty((count, count, arms))
    damping, force, start = (
        np.empty((count, arms)),
        np.empty((count, arms)),
        np.empty((count, arms)),
    )
    readings, tilting = np.empty((axes, count, arms)), np.empty((axes, count, arms))
    still, zero, law = np.empty((axes, arms)), np.empty((n, arms)), np.empty((11, arms))
    turning, centres, falling = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    linear, along = np.empty((count, count)), np.empty(3)
    for k in range(arms):
        own = slots[k]
        gravity, hinges, carried = fixed.gravity[own], fixed.hinges[own], fixed.carried[own]
        joints, order, shut = fixed.joints[own], fixed.order[own], fixed.shut[own]
        for i in range(count):
            axis, anchor = seen.axes[k, joints[i]], seen.anchors[k, joints[i]]
            moved = _motion(hinges[i], axis, anchor, seen.centres[k, fixed.bodies[own, i]])
            for c in range(3):
                turning[i, c] = axis[c] if hinges[i] else 0.0
                centres[i, c] = moved[c] * fixed.mass[own, i]
            fallen = _cross(turning[i], gravity)
            for c in range(3):
                falling[i, c] = fallen[c]
            free = i >= n or excited[k, i]
            rest = fixed.rest[own, i] if i >= n else position[k, i]
            start[i, k] = position[k, i] - rest
            damping[i, k] = fixed.damping[own, i] + (0.0 if free else fixed.holding[own, 1, i])
            for j in range(count):
                inertia[k, i, j] = seen.inertia[k, order[i], order[j]]
            inertia[k, i, i] += 0.0 if free else fixed.held[own, i]
        if shut:
            start[count - 1, k] = 0.0
            for i in range(count):
                inertia[k, count - 1, i] = inertia[k, i, count - 1] = 1.0 if i == count - 1 else 0.0
        for i in range(count):
            for j in range(count):
                pull = -_dot(_cross(turning[j], centres[i]), gravity)
                linear[i, j] = pull if carried[i, j] else 0.0
        for i in range(count):
            total = 0.0
            for j in range(count):
                one_way = carried[j, i] and not carried[i, j]
                own_pull = linear[i, j] + (linear[j, i] if one_way else 0.0)
                stiffness[i, j, k] = own_pull
                part = own_pull * start[j, k]
                total = part if j == 0 else total + part
            force[i, k] = _dot(centres[i], gravity) + total
            springs = fixed.springs[own, i]
            if i < n:
                springs += 0.0 if excited[k, i] else fixed.holding[own, 0, i]
                force[i, k] += torque[k, i]
                zero[i, k] = position[k, i]
            stiffness[i, i, k] += springs
        for s in range(axes):
            frame, mixing = seen.frames[k, sites[s]], fixed.mixing[own, s]
            for r in range(3):
                along[r] = _dot(mixing, frame[3 * r : 3 * r + 3])
            total = 0.0
            for i in range(count):
                reached = fixed.reached[own, owners[s], i]
                axis, anchor = seen.axes[k, joints[i]], seen.anchors[k, joints[i]]
                moved = _motion(hinges[i], axis, anchor, seen.sites[k, sites[s]])
                readings[s, i, k] = _dot(along, moved) if reached else 0.0
                tilting[s, i, k] = _dot(along, falling[i]) if reached else 0.0
                part = tilting[s, i, k] * start[i, k]
                total = part if i == 0 else total + part
            still[s, k] = -_dot(along, gravity) - total
        for c in range(11):
            law[c, k] = fixed.law[own, c]
        last = fixed.rest[own, count - 1]
        law[0, k] -= last
        law[1, k] -= last
    return inertia, stiffness, damping, force, start, readings, tilting, still, zero, law


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
    several: Any,
) -> None:
    """Integrate J arms, the last axis of all arrays, and write what their sensors see.

    ``several`` is J, or None where it is 1: a single arm has a loop of its own compiled.
    """
    count, sensors, joints = len(start), len(still), len(zero)
    arms = 1 if several is None else several
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
            own, drive = driven[e], torque[e, position]
            for k in range(arms):
                f[own[k], k] += drive[k]
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
        _add_seat_force(a, mobility, x, v, law, shares, push, arms)
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
