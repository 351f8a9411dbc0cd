"""Errors of the nominal transmission, by source.

With one joint excited and the others held, the healthy transmission is kinematics: link lengths,
joint zeros and the accelerometer's gains, leakage and mounting decide, masses hardly matter.

What an arm's own compliance does to a change of transmission.

On a stiff arm a seat that opens moves the tool along its own direction and nothing else. Bending
modes, gears, servos and, a little, brakes yield to the seat's reaction, and move the tool
elsewhere: near a mode by as much as the seat itself. And where the healthy arm is taken from the
nominal model, modes in or near the band change its transmission with every error of stiffness.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm, Mismatch, Response
from loose_env.typing import Array

__all__ = [
    "joint_zero_errors",
    "sensor_errors",
    "sensor_matrices",
    "stiffness_errors",
]


def sensor_matrices(axes: int, mismatch: Mismatch) -> Array:
    """Change of the reading per true acceleration by each accelerometer error.

    Parameters
    ----------
    axes : int
        Number of measured axes d.
    mismatch : Mismatch
        Standard deviations of the errors.

    Returns
    -------
    ndarray (d * d + d * (d - 1) / 2, d, d)
        One standard deviation each: gain of every axis and leakage from every axis into every
        other one, then rotation about each axis.
    """
    errors = []
    for i in range(axes):
        for j in range(axes):
            leak = np.zeros((axes, axes))
            leak[i, j] = mismatch.gain if i == j else mismatch.cross_axis
            errors.append(leak)
    turn = np.radians(mismatch.misalignment)
    for i in range(axes):
        for j in range(i):
            skew = np.zeros((axes, axes))
            skew[i, j], skew[j, i] = turn, -turn
            errors.append(skew)
    return np.array(errors)


def sensor_errors(b: Array, mismatch: Mismatch) -> Array:
    """Change of a measured transmission by each error of the tool accelerometer.

    Parameters
    ----------
    b : ndarray (d, m)
        Transmission, or change of transmission, that the accelerometer reads [m].
    mismatch : Mismatch
        Standard deviations of the errors.

    Returns
    -------
    ndarray (K, d, m)
        Changes by each of the `sensor_matrices`.

    Examples
    --------
    >>> errors = sensor_errors(np.array([[1.0], [0.0]]), Mismatch(cross_axis=0.02))
    >>> errors.shape, errors[2].ravel().tolist()
    ((5, 2, 1), [0.0, 0.02])
    """
    return np.asarray(sensor_matrices(len(b), mismatch) @ b)


def joint_zero_errors(linear: LinearArm, pose: Array, mismatch: Mismatch) -> Array:
    """Change of the tool's Jacobian by an error of each joint's zero, tool frame [m] (n, d, n).

    The zero of a sliding joint is off by as many metres as that of a turning one by radians.
    """
    tiny = 1e-4
    kinematic = linear.at(pose).kinematic
    slopes = []
    for k in range(linear.arm.n):
        moved = np.array(pose, dtype=float)
        moved[k] += tiny
        slopes.append((linear.at(moved).kinematic - kinematic) / tiny)
    return np.asarray(np.radians(mismatch.joint_zero) * np.array(slopes))


def stiffness_errors(
    linear: LinearArm, pose: Array, excited: NDArray[np.bool_], mismatch: Mismatch
) -> Array:
    """Change of the healthy transmission by an error of each compliant spring.

    Differences over two standard deviations, because answers near a mode are far from linear.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm, in the band that was played.
    pose : ndarray (n,)
        Pose [rad or m].
    excited : ndarray of bool (n,)
        Joints that were excited together.
    mismatch : Mismatch
        Standard deviations of the errors. Errors of mass shift modes as those of stiffness do.

    Returns
    -------
    ndarray (K, d, m)
        Changes by one standard deviation each [m]: bending modes and gears, then what holds each
        joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import vera
    >>> one = np.array([True, False])
    >>> def most(arm):
    ...     errors = stiffness_errors(LinearArm(arm), np.array([0.0, 1.2]), one, Mismatch())
    ...     return float(np.abs(errors).max())
    >>> most(planar(2)) < 0.002, most(vera()) > 0.01
    (True, True)
    """
    relative = float(np.hypot(mismatch.stiffness, mismatch.mass))

    at = linear.at(pose)

    def transmission(sprung: LinearArm) -> Array:
        # Springs change no inertia: the arm stands as it did.
        return _transmission(replace(at, linear=sprung).response(excited), excited)

    arm, held = linear.arm, ~np.asarray(excited, dtype=bool)
    dofs = len(linear.flexible_dofs)
    soft, stiff = [], []
    for k in range(dofs + arm.n):
        if k < dofs or held[k - dofs]:
            stiff.append(transmission(_sprung(linear, k, 1 + relative)))
            soft.append(transmission(_sprung(linear, k, 1 / (1 + relative))))
    shape = (-1, len(arm.axes), int(np.sum(excited)))  # there may be no spring at all
    return (np.reshape(stiff, shape) - np.reshape(soft, shape)) / 2


def _transmission(answer: Response, excited: NDArray[np.bool_]) -> Array:
    """Healthy transmission with the command as instrument, all commands alike (d, m)."""
    joint = answer.joint[:, np.flatnonzero(excited)].real.mean(axis=0)
    return np.asarray(np.linalg.solve(joint.T, answer.tool.real.mean(axis=0).T).T)


@lru_cache(maxsize=64)
def _sprung(linear: LinearArm, spring: int, factor: float) -> LinearArm:
    """Arm with one stiffer spring: a bending mode, a gear or a holding."""
    arm, joint = linear.arm, spring - len(linear.flexible_dofs)
    if joint < 0:
        model = copy(linear.model)
        model.jnt_stiffness[model.dof_jntid[linear.flexible_dofs[spring]]] *= factor
        return linear.variant(arm, model)
    stiffness = list(arm.holding.stiffness)
    stiffness[joint] *= factor
    held = replace(arm.holding, stiffness=tuple(stiffness))
    return linear.variant(
        replace(arm, servo=held) if arm.hold == "servo" else replace(arm, brake=held)
    )
