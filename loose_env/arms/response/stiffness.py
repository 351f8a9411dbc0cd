"""Dynamic stiffness of an arm's joints and bending modes, in many poses at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.typing import Array, ComplexArray

__all__ = ["dynamic_stiffness", "inertance_rate", "solved"]


def inertance_rate(timestep: float) -> float:
    """Corner [rad/s] of the holding constraint: its inertance is stiffness / corner².

    A brake is a constraint of MuJoCo's solver. The solver adds an inertance to the spring
    and the damper, which keeps a stiff brake stable; half a radian per step is well inside
    the stable range of the integrator.
    """
    return 0.5 / timestep


def dynamic_stiffness(
    arm: Arm,
    mass: Array,
    excited: NDArray[np.bool_],
    frequency: Array,
    springs: Array,
    dampers: Array,
) -> ComplexArray:
    """Force per motion of joints, then bending modes, over the band.

    Parameters
    ----------
    arm : Arm
        The arm; it says what holds and what centres its joints.
    mass : ndarray (B, v, v)
        Inertia in each of B poses.
    excited : ndarray of bool (B, n)
        Joints that are excited; all others are held.
    frequency : ndarray (K,)
        Frequencies [Hz].
    springs, dampers : ndarray (v,)
        Of the arm itself.

    Returns
    -------
    ndarray (v, v, B, K)
    """
    omega = 2 * np.pi * frequency
    s = 1j * omega
    loose = s * dampers[:, None] + springs[:, None]
    for j in range(arm.n):
        loose[j] += arm.centring.stiffness[j] + s * arm.centring.damping[j]
    held = loose.copy()
    for j in range(arm.n):
        k, c = arm.holding.stiffness[j], arm.holding.damping[j]
        inertance = k / inertance_rate(arm.timestep) ** 2
        held[j] += k + s * c - omega**2 * inertance
    stiffness = mass.transpose(1, 2, 0)[..., None] * (-(omega**2) + 0j)
    for v in range(len(springs)):
        free = excited[:, v, None] if v < arm.n else True  # bending modes are never held
        stiffness[v, v] += np.where(free, loose[v], held[v])
    return np.asarray(stiffness)


def solved(stiffness: ComplexArray, force: ComplexArray) -> ComplexArray:
    """Solve systems of equations that lie along the last axes, (v, v, ...) and (v, m, ...).

    Gauss-Jordan elimination of all of them at once, by operations on single elements: a system's
    solution does not depend on the others. Dampers keep the pivots of a dynamic stiffness off
    zero. Both arrays are overwritten.
    """
    for p in range(len(stiffness)):
        scale = 1.0 / stiffness[p, p]
        ahead = stiffness[p, p + 1 :] * scale
        known = force[p] * scale
        for v in range(len(stiffness)):
            if v != p:
                factor = stiffness[v, p]
                stiffness[v, p + 1 :] -= factor * ahead
                force[v] -= factor * known
        stiffness[p, p + 1 :] = ahead
        force[p] = known
    return force
