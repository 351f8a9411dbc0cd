"""What an arm's own compliance does to a change of transmission.

On a stiff arm a seat that opens moves the tool along its own direction and nothing else. Bending
modes, gears, servos and, a little, brakes give way to the seat's reaction, and move the tool
elsewhere: near a mode by as much as the seat itself. And where the healthy arm is taken from the
nominal model, modes in or near the band change its transmission with every error of stiffness.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.linear import LinearArm, LinearPose, Response
from loose_env.arms.mismatch import Mismatch

__all__ = ["bent_by_seats", "stiffness_errors"]

Array = NDArray[np.float64]
_IN_STEP = 0.3
"""Least share of a seat's motion that is taken to be in step with the command."""


def bent_by_seats(pose: LinearPose, excited: NDArray[np.bool_]) -> Array:
    """How far off its own direction a seat of each link would move the tool.

    Parameters
    ----------
    pose : LinearPose
        The nominal arm at the pose, in the band that was played.
    excited : ndarray of bool (n,)
        Joints that were excited together.

    Returns
    -------
    ndarray (m, n, d, d)
        For each excited joint and link: what is added to a change of transmission z, over it, for
        a seat that floats in that link and slides along z in the tool frame.

    Examples
    --------
    >>> from loose_env.arms import planar, vera
    >>> def most(arm):
    ...     at = LinearArm(arm).at([0.0, 1.2])
    ...     return float(np.abs(bent_by_seats(at, np.array([True, False]))).max())
    >>> most(planar(2)) < 0.03, most(vera()) > 0.1
    (True, True)
    """
    answer, opened = pose.response(excited), pose.open_response(excited)
    b = _transmission(answer, excited)
    stiff = pose.jacobian[:, pose.linear.slide_dofs].transpose(1, 0, 2)  # (n, d, s)
    column = opened.tool_open_slide - np.einsum("dm,kmis->kdis", b, opened.joint_open_slide)
    mass = np.einsum("kiss->kis", opened.mass_slide)
    free = -answer.slide / mass[..., None]  # (K, n, s, m)
    shown = np.einsum("kdis,kism->midsk", column, free).real.mean(axis=-1)
    step = free.real.mean(axis=0)
    size = np.sqrt(np.mean(np.abs(free) ** 2, axis=0))
    off = shown - np.einsum("ids,ism->mids", stiff, step)
    scale = np.maximum(np.abs(step), _IN_STEP * size).transpose(2, 0, 1)[:, :, None]
    signed = np.where(step < 0, -1.0, 1.0).transpose(2, 0, 1)[:, :, None]
    share = np.divide(signed * off, scale, out=np.zeros_like(off), where=scale > 0)
    # From axes of the link to axes of the tool.
    return np.asarray(np.einsum("mids,ies->mide", share, stiff))


def stiffness_errors(
    linear: LinearArm, pose: Array, excited: NDArray[np.bool_], mismatch: Mismatch
) -> Array:
    """Change of the healthy transmission by an error of each spring that may give way.

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
    >>> from loose_env.arms import planar, vera
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
    """The arm with one spring stiffer: of a bending mode or gear, then what holds a joint."""
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
