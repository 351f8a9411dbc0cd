"""Load of each seat under the strongest excitation, to which friction is compared."""

from __future__ import annotations

from dataclasses import fields
from hashlib import sha256
from typing import Literal, get_args

import mujoco
import numpy as np

from loose_env.arms import LinearArm
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation.levels import at_levels
from loose_env.typing import Array

__all__ = ["SeatDrive", "SeatReference"]

SeatReference = Literal["median", "best"]
"""Pose whose seat load counts: the median one, or the best."""


class SeatDrive:
    """Rms load of each seat under the strongest excitation, to which friction is compared.

    For every joint excited alone at the top level (`Arm.top_level`), the nominal arm says which
    force a shut seat transmits. The best joint counts; the figure is the median over ``poses``
    random poses, the same for everybody, or that of the best of them.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm; with rotations if `twist` is to be asked.
    poses : int
        Number of poses.
    over : {"median", "best"}
        Pose that counts.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> drive = SeatDrive(LinearArm(planar(2)), poses=8)
    >>> drive.slide(1, (1.0, 0.0, 0.0)) > 0
    True
    """

    def __init__(
        self, linear: LinearArm, *, poses: int = 48, over: SeatReference = "median"
    ) -> None:
        if over not in get_args(SeatReference):
            raise UnknownName(f"over is one of {list(get_args(SeatReference))}, got {over!r}")
        self._of_poses = _median if over == "median" else _best
        key = (_digest(linear), poses)
        if key not in _DRIVES:
            while len(_DRIVES) >= _REMEMBERED:
                del _DRIVES[next(iter(_DRIVES))]  # the oldest
            _DRIVES[key] = _seat_powers(linear, poses)
        self._slide, self._hinge, self._twist = _DRIVES[key]

    def slide(self, link: int, direction: tuple[float, ...]) -> float:
        """Rms force across the slide of a link along a direction of its frame [N]."""
        u = np.asarray(direction, dtype=float)
        u = u / np.linalg.norm(u)
        m = self._slide[:, :, link - 1]
        u = u[: m.shape[-1]]
        power = np.einsum("a,pjab,b->pj", u, m, u)
        return self._of_poses(np.sqrt(power.max(axis=1)))

    def hinge(self, joint: int) -> float:
        """Rms torque across the play of a joint [N·m, N where it slides]."""
        return self._of_poses(np.sqrt(self._hinge[:, :, joint - 1].max(axis=1)))

    def twist(self, link: int, twist: Array) -> float:
        """Rms force or torque across a seat of a link that moves it by a twist [N or N·m].

        Parameters
        ----------
        link : int
            Link, from 1 at the base.
        twist : ndarray (t,)
            As `loose_env.faults.twist_of` has it.

        Raises
        ------
        InvalidSetting
            If the linear arm has no rotations.
        """
        if self._twist is None:
            raise InvalidSetting("for twists give a LinearArm(arm, rotations=True)")
        power = np.einsum("a,pjab,b->pj", twist, self._twist[:, :, link - 1], twist)
        return self._of_poses(np.sqrt(power.max(axis=1)))


def _best(values: Array) -> float:
    return float(values.max())


def _median(values: Array) -> float:
    """Median; numpy's own takes longer than all else of a draw."""
    ordered, half = np.sort(values), len(values) // 2
    return float(ordered[half]) if len(values) % 2 else float(ordered[half - 1 : half + 1].mean())


_Powers = tuple[Array, Array, Array | None]
_DRIVES: dict[tuple[bytes, int], _Powers] = {}
"""Powers by arm and number of poses: every environment and agent of an arm asks for them."""
_REMEMBERED = 32


def _digest(linear: LinearArm) -> bytes:
    """Digest of all that the answers of a linear arm depend on: equal for equal arms."""
    figures = {f.name: getattr(linear.arm, f.name) for f in fields(linear.arm)}
    del figures["spec"], figures["rigid"]  # compiled into the model; no part of the answers
    model = np.empty(mujoco.mj_sizeModel(linear.model), dtype=np.uint8)
    mujoco.mj_saveModel(linear.model, None, model)
    words = repr((figures, linear.rotations, len(linear.frequency)))
    return sha256(model.tobytes() + words.encode()).digest()


def _seat_powers(linear: LinearArm, poses: int) -> _Powers:
    """Mean square force across slides, torque across joints and both across twists, by pose.

    Of shapes (poses, n, n, s, s), (poses, n, n) and (poses, n, n, t, t), None without rotations;
    the second axis is the excited joint.
    """
    arm = linear.arm
    rng = np.random.default_rng(0)
    axes, motions = linear.slide_dofs.shape[1], linear.twist_dofs.shape[1]
    slides = np.zeros((poses, arm.n, arm.n, axes, axes))
    hinges = np.zeros((poses, arm.n, arm.n))
    twists = np.zeros((poses, arm.n, arm.n, motions, motions)) if linear.rotations else None
    for p in range(poses):
        at = linear.at(arm.random_pose(rng))
        for j in range(arm.n):
            levels = np.zeros(arm.n)
            levels[j] = arm.top_level
            excitation, _ = at_levels(at, levels, duration=1.0)
            # Not those it says are excited: a drive that hardly holds its load is none of them.
            answer = at.response(levels > 0)
            power = excitation.torque_rms[j] ** 2
            slide = answer.slide[..., 0]
            outer = np.einsum("kia,kib->iab", slide, slide.conj()).real
            slides[p, j] = power * outer / len(slide)
            hinges[p, j] = power * np.mean(np.abs(answer.hinge[..., 0]) ** 2, axis=0)
            if twists is not None and answer.twist is not None:
                twist = answer.twist[..., 0]
                outer = np.einsum("kia,kib->iab", twist, twist.conj()).real
                twists[p, j] = power * outer / len(twist)
    return slides, hinges, twists
