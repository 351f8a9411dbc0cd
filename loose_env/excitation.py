"""Random torques: levels at the tool, drawn signals, and the force that drives a seat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache, partial
from hashlib import sha256
from typing import Annotated, Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import CREST_FACTOR, Arm, LinearArm, LinearPose
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.io import Checked, NonNegative, positive
from loose_env.typing import Array, ComplexArray, IndexArray

__all__ = [
    "CREST_FACTOR",
    "UNFELT_LEVER",
    "Excitation",
    "SeatDrive",
    "SeatReference",
    "Shaping",
    "at_levels",
    "torque_periods",
    "torques_at_levels",
]


def torque_periods(
    torque_rms: Array,
    shaker_rms: Array,
    *,
    duration: float,
    band: tuple[float, float],
    timestep: float,
    rngs: Sequence[np.random.Generator],
    shaping: Sequence[tuple[Shaping | None, ...] | None] | None = None,
) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """Draw one period of the torque of every excited joint of several records of one length.

    Parameters
    ----------
    torque_rms : ndarray (J, n)
        Rms torque of every joint [N·m].
    shaker_rms : ndarray (J,)
        Rms force of the shaker [N]; where it is off it takes nothing from the generator.
    duration : float
        Length of the records [s].
    band : tuple of float
        Their band [Hz].
    timestep : float
        Sampling step [s].
    rngs : sequence of J numpy.random.Generator
        Source of each record's draw. Joints draw in order, whether excited or not, so that the
        signal of a joint does not depend on which others are on; the shaker draws last.
    shaping : sequence, optional
        `Excitation.shaping` of each record; flat spectra by default.

    Returns
    -------
    ndarray (R, duration / timestep)
        Torques [N·m], or the force of the shaker [N].
    ndarray of int (R,)
        Record of each row.
    ndarray of int (R,)
        Joint of each row; n for the shaker.

    Examples
    --------
    >>> import numpy as np
    >>> rows, records, joints = torque_periods(
    ...     np.array([[0.0, 2.0]] * 2),
    ...     np.zeros(2),
    ...     duration=1.2,
    ...     band=(30.0, 150.0),
    ...     timestep=1e-3,
    ...     rngs=[np.random.default_rng(k) for k in range(2)],
    ... )
    >>> rows.shape, records.tolist(), joints.tolist()
    ((2, 1200), [0, 1], [1, 1])
    """
    count = round(duration / timestep)
    frequency, inside = _lines(count, timestep, band)
    levels = np.concatenate([torque_rms, shaker_rms[:, None]], axis=1)
    owners, joints = np.nonzero(levels)
    draws = np.empty((*levels.shape, len(inside), 2))
    for own, shaker, rng in zip(draws, shaker_rms, rngs, strict=True):
        rng.standard_normal(out=own if shaker else own[:-1])
    # E|line|² = 2; the expected rms of the sum of all lines is the one asked for.
    scale = levels[owners, joints] * count / (2 * np.sqrt(len(inside)))
    lines = draws[owners, joints].view(complex)[..., 0] * scale[:, None]
    for line, owner, joint in zip(lines, owners, joints, strict=True):
        own_shapes = shaping and shaping[int(owner)]
        shape = (*own_shapes, None)[joint] if own_shapes else None
        if shape is not None:
            weight = shape(frequency[inside])
            line *= weight / np.sqrt(np.mean(weight**2))
    spectra = np.zeros((len(lines), count // 2 + 1), dtype=complex)
    spectra[:, inside] = lines
    # numpy transforms row by row: no row depends on the others.
    return np.fft.irfft(spectra, n=count), owners, joints


@lru_cache
def _lines(
    count: int, timestep: float, band: tuple[float, float]
) -> tuple[Array, NDArray[np.intp]]:
    """Frequencies of a period of so many steps [Hz], and indices of those in a band."""
    low, high = band
    if high >= 0.5 / timestep:
        raise InvalidSetting(
            f"band {band} Hz reaches half the sampling rate, {0.5 / timestep:g} Hz"
        )
    frequency = np.arange(count // 2 + 1) / (count * timestep)
    return frequency, np.flatnonzero((frequency >= low - 1e-9) & (frequency <= high + 1e-9))


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
    on, torque, share = wanted > 0, np.zeros(arm.n), np.ones(arm.n)
    if on.any():
        answer = pose.response(on)
        gravity = pose.gravity_torque[None]
        given = answer.acceleration[None], answer.tool[None]
        (torque,), (share,) = torques_at_levels(arm, wanted[None], gravity, *given)
    rms = tuple(torque.tolist())
    return Excitation(torque_rms=rms, duration=duration, band=arm.band), share


def torques_at_levels(
    arm: Arm, levels: Array, gravity: Array, acceleration: ComplexArray, tool: ComplexArray
) -> tuple[Array, Array]:
    """Find the torques of several records, each as `at_levels`, equally many joints on in all.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    levels : ndarray (B, n)
        Wanted rms accelerations [m/s²].
    gravity : ndarray (B, n)
        Torque that holds each joint against gravity [N·m].
    acceleration, tool : ndarray (B, K, v, m), (B, K, d, m)
        The arm's responses, as `LinearPoses.responses` gives them.

    Returns
    -------
    ndarray (B, n)
        Rms torques [N·m].
    ndarray (B, n)
        Share of each wanted level that is allowed.
    """
    on = levels > 0
    torque, share = np.zeros(levels.shape), np.ones(levels.shape)
    m = tool.shape[-1]
    per_torque = np.sqrt((np.abs(tool) ** 2).sum(axis=2).mean(axis=1))
    for joint in arm.unfelt_joints:
        # No torque would give the tool on the joint's axis its level; what is asked for then is
        # the level at a distance from it.
        rows = np.flatnonzero(on[:, joint - 1])
        at = np.cumsum(on[rows], axis=1)[:, joint - 1] - 1
        turning = np.sqrt(np.mean(np.abs(acceleration[rows, :, joint - 1, at]) ** 2, axis=1))
        per_torque[rows, at] = np.maximum(per_torque[rows, at], UNFELT_LEVER * arm.reach * turning)
    spare = np.array(arm.torque_limits) - np.abs(gravity)
    allowed = np.maximum(spare[on].reshape(-1, m), 0.0) / CREST_FACTOR
    needed = levels[on].reshape(-1, m) / per_torque
    given = np.minimum(needed, allowed)
    torque[on], share[on] = given.ravel(), (given / needed).ravel()
    return torque, share


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
        The nominal arm.
    poses : int
        Number of poses.
    over : {"median", "best"}
        Pose that counts.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> drive = SeatDrive(LinearArm(planar(2)), poses=8)
    >>> bool(drive.slide(1, (1.0, 0.0, 0.0)) > 0)
    True
    """

    def __init__(
        self, linear: LinearArm, *, poses: int = 48, over: SeatReference = "median"
    ) -> None:
        if over not in get_args(SeatReference):
            raise UnknownName(f"over is one of {list(get_args(SeatReference))}, got {over!r}")
        self._of_poses = _median if over == "median" else partial(np.max, axis=0)
        key = (_digest(linear), poses)
        if key not in _DRIVES:
            while len(_DRIVES) >= _REMEMBERED:
                del _DRIVES[next(iter(_DRIVES))]  # the oldest
            _DRIVES[key] = _seat_powers(linear, poses)
        self._slide, hinge = _DRIVES[key]
        self.hinges: Array = self._of_poses(np.sqrt(hinge.max(axis=1)))
        """Rms torque across the play of each joint [N·m, N where it slides] (n,)."""

    def slide(self, link: int | IndexArray, direction: ArrayLike) -> Any:
        """Rms force across the slide of a link, or of B, along directions (..., 3) [N] (...)."""
        u = np.asarray(direction, dtype=float)
        u = u / np.sqrt(np.vecdot(u, u))[..., None]
        m = self._slide[:, :, link - 1]
        axes = range(m.shape[-1])
        # Written out, so that the order of a sum never depends on the number of seats.
        power: Any = sum(u[..., a] * m[..., a, b] * u[..., b] for a in axes for b in axes)
        return self._of_poses(np.sqrt(power.max(axis=1)))


def _median(values: Array) -> Array:
    """Median along the first axis; numpy's own takes longer than all else of a draw."""
    ordered, half = np.sort(values, axis=0), len(values) // 2
    return np.asarray(ordered[(len(values) - 1) // 2 : half + 1].mean(axis=0))


_Powers = tuple[Array, Array]
_DRIVES: dict[tuple[bytes, int], _Powers] = {}
"""Powers by arm and number of poses: every environment and agent of an arm asks for them."""
_REMEMBERED = 32


def _digest(linear: LinearArm) -> bytes:
    """Digest of all that the answers of a linear arm depend on: equal for equal arms."""
    figures = {f.name: getattr(linear.arm, f.name) for f in fields(linear.arm)}
    del figures["spec"], figures["rigid"]  # compiled into the model; no part of the answers
    model = np.empty(mujoco.mj_sizeModel(linear.model), dtype=np.uint8)
    mujoco.mj_saveModel(linear.model, None, model)
    words = repr((figures, len(linear.frequency)))
    return sha256(model.tobytes() + words.encode()).digest()


def _seat_powers(linear: LinearArm, poses: int) -> _Powers:
    """Mean square force across slides (poses, n, n, s, s), and torque across joints (poses, n, n).

    The second axis is the excited joint.
    """
    arm = linear.arm
    rng = np.random.default_rng(0)
    axes = linear.slide_dofs.shape[1]
    slides = np.zeros((poses, arm.n, arm.n, axes, axes))
    hinges = np.zeros((poses, arm.n, arm.n))
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
    return slides, hinges
