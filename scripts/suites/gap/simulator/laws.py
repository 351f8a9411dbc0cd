"""Torques that act in the joints, compiled: friction, springs, stops, drives.

The laws are smooth on purpose: friction is a hyperbolic tangent with a Stribeck bump, stops are
Hertzian with the dissipation of Hunt and Crossley, hysteresis is the model of Bouc and Wen.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Columns of a degree of freedom's row of laws.
DAMPING, THINNING, EXTRA = 0, 1, 21
"""Viscous coefficient; speed at which a further coefficient has thinned by a tenth, and it."""
FRICTION, BUMP, STRIBECK_SPEED, SMOOTH_SPEED, WARM_TIME = 2, 3, 4, 5, 6
"""Coulomb torque, static over Coulomb torque minus one, Stribeck speed, width of the tangent,
time in which the friction warms away (0: never)."""
DRAG = 7
"""Coefficient of speed squared."""
STIFFNESS, REST, PROGRESS = 8, 9, 10
"""Spring, its rest, and one over the square of the stretch that doubles its stiffness / 3."""
GAP_LOW, GAP_HIGH, HERTZ, CROSSLEY = 11, 12, 13, 14
"""Ends of the free travel, stiffness of the stops (force / travel^1.5), their dissipation."""
RIPPLE, ORDER, PHASE, SECOND = 15, 16, 17, 18
"""Amplitude, periods per unit of travel times 2 pi, phase, share of the second harmonic."""
HYSTERESIS, STROKE = 19, 20
"""Torque of the hysteresis and the travel over which it turns."""
ASYMMETRY = 22
"""Excess of the friction in the positive direction over the mean of both directions."""
GRAIN = 23
"""Waves per turn by which the friction varies from none to twice its mean (0: not); their phase."""
LAWS = 25

# Columns of an actuator's row.
DOF, KP, KV, LIMIT, GAIN, LAG, DELAY, OFFSET, DEAD, SAG = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
"""Driven degree of freedom, gains, largest torque, torque over commanded torque, time constant
and delay of the command, error of the encoder, dead zone of the position error, fall of the gain
with the load of all drives."""
LOADED, LOADED_BUMP, LOADED_SPEED, LOADED_SMOOTH = 10, 11, 12, 13
"""Friction of the gear over the torque of the drive; static over that, minus one; Stribeck speed;
width of the tangent."""
BACK_EMF = 14
"""Part of the velocity gain that is the motor's back-EMF: it acts beyond the limit of the torque,
which is that of the voltage."""
ECCENTRIC_SINE, ECCENTRIC_COSINE = 15, 16
"""Error of the encoder that is periodic in the turn of the joint."""
LOADED_EXTERNAL = 17
"""Friction of what is behind the gear over the torque of the load."""
ACTUATOR = 18


@njit(cache=True, fastmath=False)
def joint_force(law, q, v, z, time):  # type: ignore[no-untyped-def]
    """Passive force of one degree of freedom.

    Parameters
    ----------
    law : Array
        Of shape (LAWS,).
    q, v, z : float
        Position, velocity and state of the hysteresis.
    time : float
        Time since the start of the recording [s].
    """
    viscous = law[0] * v
    if law[21] != 0.0:
        viscous += law[21] * v / (1.0 + abs(v) / law[1]) ** 0.152
    force = -viscous - law[7] * v * abs(v)
    if law[2] != 0.0:
        bump = 0.0
        if law[3] != 0.0:
            x = v / law[4]
            bump = law[3] * np.exp(-x * x)
        fade = 1.0
        if law[6] > 0.0 and time > 0.0:
            fade = np.exp(-time / law[6])
        side = 1.0 + law[22] if v > 0.0 else 1.0 - law[22]
        if law[23] != 0.0:
            fade *= 1.0 + np.cos(law[23] * q + law[24])
        force -= law[2] * fade * side * (1.0 + bump) * np.tanh(v / law[5])
    if law[8] != 0.0:
        x = q - law[9]
        force -= law[8] * x * (1.0 + law[10] * x * x)
    if law[13] > 0.0:
        if q > law[12]:
            depth = q - law[12]
            push = law[13] * depth * np.sqrt(depth) * (1.0 + law[14] * v)
            if push > 0.0:
                force -= push
        elif q < law[11]:
            depth = law[11] - q
            push = law[13] * depth * np.sqrt(depth) * (1.0 - law[14] * v)
            if push > 0.0:
                force += push
    if law[15] != 0.0:
        x = law[16] * q + law[17]
        force += law[15] * (np.sin(x) + law[18] * np.sin(2.0 * x + 0.7))
    if law[19] != 0.0:
        force -= law[19] * z
    return force


@njit(cache=True, fastmath=False)
def encoder(row, q):  # type: ignore[no-untyped-def]
    """Error of an encoder and its derivative by the angle, of a wheel that turns off its centre."""
    error = row[7] + row[15] * np.sin(q) + row[16] * np.cos(q)
    return error, row[15] * np.cos(q) - row[16] * np.sin(q)


@njit(cache=True, fastmath=False)
def drive_torque(row, command, q, v):  # type: ignore[no-untyped-def]
    """Torque that a drive asks for: position servo with a dead zone, and the limit of its motor."""
    error, slope = encoder(row, q)
    error = command - q - error
    if row[8] > 0.0:
        if error > row[8]:
            error -= row[8]
        elif error < -row[8]:
            error += row[8]
        else:
            error = 0.0
    torque = row[1] * error - (row[2] - row[14]) * v * (1.0 + slope)
    if torque > row[3]:
        torque = row[3]
    elif torque < -row[3]:
        torque = -row[3]
    return torque - row[14] * v


@njit(cache=True, fastmath=False)
def gear_friction(row, torque, load, v):  # type: ignore[no-untyped-def]
    """Friction of teeth under the torques of a drive and of its load, against the motion."""
    x = v / row[12]
    size = row[10] * abs(torque) * (1.0 + row[11] * np.exp(-x * x)) + row[17] * abs(load)
    return -size * np.tanh(v / row[13])
