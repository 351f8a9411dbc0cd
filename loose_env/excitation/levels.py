"""Excitation settings, and the torques that give the tool a wanted acceleration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import CREST_FACTOR, Arm, LinearPose, Response
from loose_env.errors import InvalidSetting
from loose_env.io import Checked, NonNegative, positive
from loose_env.typing import Array

__all__ = ["UNFELT_LEVER", "Excitation", "Shaping", "all_at_levels", "at_levels"]

Shaping = Callable[[Array], Array]
"""Relative amplitude of the excitation at given frequencies [Hz]."""


@dataclass(frozen=True, kw_only=True)
class Excitation(Checked):
    """Random torque for one record. Joints with zero rms are held."""

    torque_rms: tuple[NonNegative, ...]
    """Rms torque of each joint, base first [N·m]; 0 holds the joint."""
    duration: Annotated[float, positive("seconds")]
    """Length of the record [s]."""
    band: tuple[float, float]
    """Band of the excitation [Hz]."""
    shaping: tuple[Shaping | None, ...] | None = field(default=None, compare=False)
    """Spectrum of each joint's torque; None for a flat one."""
    shaker_rms: NonNegative = 0.0
    """Rms force of the shaker beside the arm [N]; 0 leaves it off."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.band[0] < self.band[1]:
            raise InvalidSetting(f"band must be 0 < low < high in Hz, got {self.band}")
        if self.duration * (self.band[1] - self.band[0]) < 4:
            raise InvalidSetting(
                f"a record of {self.duration} s holds fewer than 4 independent lines of the band "
                f"{self.band} Hz; lengthen it or widen the band"
            )
        if self.shaping is not None and len(self.shaping) != len(self.torque_rms):
            raise InvalidSetting(
                f"shaping needs one entry for each of {len(self.torque_rms)} joints, "
                f"got {len(self.shaping)}"
            )

    @property
    def excited(self) -> tuple[bool, ...]:
        """True for each joint that is excited."""
        return tuple(t > 0 for t in self.torque_rms)

    @property
    def levels(self) -> tuple[float, ...]:
        """Rms of every signal: torques of the joints, then the shaker's force where it is on."""
        return (*self.torque_rms, self.shaker_rms) if self.shaker_rms > 0 else self.torque_rms


UNFELT_LEVER = 0.1
"""Distance from the axis of a joint that the tool does not feel, over the reach, at which its level
counts [1]: about that of an accelerometer mounted beside the axis."""


def at_levels(pose: LinearPose, levels: Array, *, duration: float) -> tuple[Excitation, Array]:
    """Find the torques that give the nominal tool the wanted acceleration.

    Parameters
    ----------
    pose : LinearPose
        The nominal arm at the pose.
    levels : array_like (n,)
        Wanted rms acceleration of the tool from each joint alone, with the brakes as they
        are for the whole set of excited joints [m/s²]; 0 holds the joint.
    duration : float
        Length of the record [s].

    Returns
    -------
    Excitation
        Torques, clipped so that `CREST_FACTOR` times their rms plus the torque that holds
        the arm against gravity stays within the joint's limit.
    ndarray (n,)
        Share of each wanted level that the joint's torque limit allows, 0 to 1; 1 for
        joints that are held.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import LinearArm
    >>> at = LinearArm(planar(2)).at([0.0, 1.0])
    >>> shake, share = at_levels(at, np.array([0.0, 4.0]), duration=1.2)
    >>> shake.excited, share.tolist()
    ((False, True), [1.0, 1.0])
    """
    arm = pose.linear.arm
    wanted = np.asarray(levels, dtype=float)
    if wanted.shape != (arm.n,) or not np.isfinite(wanted).all() or (wanted < 0).any():
        raise InvalidSetting(
            f"levels of {arm.name!r} are {arm.n} numbers, zero or more m/s², got {levels!r}"
        )
    (excitation,), share = all_at_levels([pose], wanted[None], durations=[duration])
    return excitation, share[0]


def all_at_levels(
    poses: Sequence[LinearPose], levels: Array, *, durations: Sequence[float]
) -> tuple[list[Excitation], Array]:
    """Find the torques of several records, each as `at_levels`.

    Parameters
    ----------
    poses : sequence of B LinearPose
        One nominal arm at several poses.
    levels : ndarray (B, n)
        Wanted rms accelerations [m/s²].
    durations : sequence of B float
        Lengths of the records [s].

    Returns
    -------
    list of B Excitation
    ndarray (B, n)
        Share of each wanted level that is allowed.
    """
    arm = poses[0].linear.arm
    on = levels > 0
    torque, share = np.zeros(levels.shape), np.ones(levels.shape)
    limits = np.array(arm.torque_limits)
    counts = on.sum(axis=1)
    for m in np.unique(counts[counts > 0]):
        members = [int(k) for k in np.flatnonzero(counts == m)]
        chosen = on[members]
        found = poses[0].linear.responses([poses[k] for k in members], chosen)
        tool = np.array([answer.tool for answer in found])
        per_torque = np.sqrt(np.mean(np.sum(np.abs(tool) ** 2, axis=2), axis=1))
        if arm.unfelt_joints:
            least = [_least_felt(a, c, arm) for a, c in zip(found, chosen, strict=True)]
            per_torque = np.maximum(per_torque, least)
        gravity = np.array([poses[k].gravity_torque for k in members])
        spare = limits - np.abs(gravity)
        allowed = np.maximum(spare[chosen].reshape(-1, m), 0.0) / CREST_FACTOR
        needed = levels[members][chosen].reshape(-1, m) / per_torque
        given = np.minimum(needed, allowed)
        rows, columns = np.nonzero(chosen)
        rows = np.array(members)[rows]
        torque[rows, columns] = given.ravel()
        share[rows, columns] = (given / needed).ravel()
    excitations = [
        Excitation(torque_rms=tuple(own.tolist()), duration=duration, band=arm.band)
        for own, duration in zip(torque, durations, strict=True)
    ]
    return excitations, share


def _least_felt(response: Response, on: NDArray[np.bool_], arm: Arm) -> Array:
    """Acceleration that counts for an unfelt joint per torque, 0 for the others (m,).

    No torque would give the tool on the joint's axis its level; what is asked for then is the
    level at a distance of `UNFELT_LEVER` times the reach.
    """
    found = np.zeros(int(on.sum()))
    for k, joint in enumerate(np.flatnonzero(on)):
        if joint + 1 in arm.unfelt_joints:
            turning = np.sqrt(np.mean(np.abs(response.joint[:, joint, k]) ** 2))
            found[k] = UNFELT_LEVER * arm.reach * turning
    return found
