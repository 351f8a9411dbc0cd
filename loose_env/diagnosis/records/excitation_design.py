"""Excitation design in a pose: band and level from modes, gravity and clearance.

Below its holding modes an arm transmits as its kinematics say; inside them it does not. A seat
stays shut until the force across it overcomes its static load, and once it moves farther than its
gap it only hits its stops. For a joint excited alone at level L, a seat direction that feels
the rms force f L over a static load W, and would move by x L rms if it floated, loses about

    min(1, (f L / 0.6 W)²) · min(1, gap / (4 x L))

of its transmission. The level that is proposed makes the mean of that over all links and
directions largest, because nothing is known yet about the fault.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, LinearPose
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation, at_levels
from loose_env.statistics import axes_grid
from loose_env.typing import Array

__all__ = ["Proposal", "holding_modes", "propose_band", "propose_excitation"]


_CLEAR = 2.0
"""A band ends at this share below the lowest holding mode."""
_LEAST_WIDTH = 20.0
"""Narrowest band worth proposing [Hz]: 1.2 s of it hold 48 independent samples."""
_LOWEST = 8.0
"""Lowest end of a band: twice the modes of the soft springs that centre excited joints [Hz]."""
_AXES = {2: 12, 3: 40}
_LEVELS = np.geomspace(0.05, 50.0, 121)
"""Levels that are tried, rms acceleration of the nominal tool [m/s²]."""
_AS_GOOD = 0.9
"""Share of the best score at which a level counts as about as good."""
_WORTH = 0.5
"""Share of the opening in the arm's own band that a band below its modes must keep."""
_OVERCOME = 0.6
"""Rms force over static load at which a seat begins to move: peaks are what opens it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """Excitation of each joint in turn in one pose."""

    band: tuple[float, float]
    """Band [Hz]."""
    levels: Array
    """Rms acceleration of the nominal tool to ask of each joint alone (n,) [m/s²]; 0 where the
    joint cannot move the tool."""
    shares: Array
    """Share of each joint's torque-free optimum that its torque limit allows (n,) [1]."""
    excitations: tuple[Excitation | None, ...]
    """Excitation of each joint; None where it cannot move the tool."""
    modes: Array
    """Modes of the arm with one joint free and the others held, lowest over the joints, rising
    [Hz]."""
    seat_gravity: Array
    """Static load of each link's seat in its worst direction over the mass behind it (n,) [g]."""
    openings: Array
    """Expected share of transmission lost by an open seat of each link under the best joint, mean
    over directions (n,) [1]."""
    warnings: tuple[str, ...]
    """Warnings about disturbances of a diagnosis in this pose."""


def holding_modes(pose: LinearPose, excited: NDArray[np.bool_]) -> Array:
    """Undamped natural frequencies with some joints free and all others held, rising [Hz].

    Parameters
    ----------
    pose : LinearPose
        The nominal arm in its pose.
    excited : ndarray (n,)
        True for free joints, on their soft centring springs.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> at = LinearArm(planar(2, hold="servo")).at([0.0, 0.0])
    >>> bool(5 < holding_modes(at, np.array([False, False]))[0] < 30)
    True
    """
    lin = pose.linear
    arm, model = lin.arm, lin.model
    moving = np.concatenate([lin.joint_dofs, lin.flexible_dofs])
    stiffness = np.array(model.jnt_stiffness[model.dof_jntid[moving]], dtype=float)
    stiffness[: arm.n] += arm.centring.stiffness
    held = ~np.asarray(excited, dtype=bool)
    stiffness[: arm.n] += np.where(held, arm.holding.stiffness, 0.0)
    inertia = pose.inertia[np.ix_(moving, moving)]
    values = np.linalg.eigvals(np.linalg.solve(inertia, np.diag(stiffness))).real
    return np.sort(np.sqrt(np.maximum(values, 0.0))) / (2 * np.pi)


def propose_band(
    linear: LinearArm, pose: Array
) -> tuple[tuple[float, float], Array, tuple[str, ...]]:
    """Propose a band below the arm's holding modes.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    pose : ndarray (n,)
        Pose [rad or m].

    Returns
    -------
    tuple of float
        Band [Hz]: the arm's own where no mode reaches into twice its top, else one that ends at
        half the lowest mode, if there is room for it.
    ndarray
        The modes [Hz], lowest over the joints that may be excited, rising.
    tuple of str
        Warning about the band, if any.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> propose_band(LinearArm(planar(3)), np.array([0.0, 0.5, 0.5]))[0]
    (30.0, 150.0)
    """
    arm = linear.arm
    at = linear.at(pose)
    # The free joint's own mode on its centring spring is not one that disturbs.
    modes = np.array([holding_modes(at, np.arange(arm.n) == j)[1:] for j in range(arm.n)]).min(
        axis=0
    )
    if not len(modes):
        return arm.band, modes, ()
    low, high = arm.band
    lowest = float(modes[0])
    if lowest >= _CLEAR * high:
        return arm.band, modes, ()
    top = lowest / _CLEAR
    bottom = max(_LOWEST, min(low, top - (high - low)))
    if top - bottom >= _LEAST_WIDTH:
        return (round(bottom, 1), round(top, 1)), modes, ()
    inside = modes[(modes > 0.8 * low) & (modes < 1.25 * high)]
    if not len(inside):
        note = f"the lowest holding mode, {lowest:.0f} Hz, is below twice the band's top"
        return arm.band, modes, (note,)
    return arm.band, modes, (_warning(arm.band, inside, "there is no room below"),)


def _warning(band: tuple[float, float], inside: Array, why: str) -> str:
    what = ", ".join(f"{m:.0f}" for m in inside[:4])
    return (
        f"the band {band[0]:g} to {band[1]:g} Hz lies about holding modes ({what} Hz) and {why}: "
        "compare with healthy records or the whole dynamic model, expect errors of ten degrees "
        "and more otherwise, or hold the joints stiffer"
    )


def propose_excitation(
    arm: Arm,
    pose: Array,
    *,
    gap: float = 0.1e-3,
    friction: float = 0.0,
    duration: float = 1.2,
) -> Proposal:
    """Propose band and level for every joint of an arm in a pose.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    pose : ndarray (n,)
        Pose [rad or m].
    gap : float
        Travel of interest [m]: seats should move about as far as this.
    friction : float
        Friction of the seats' guides, if known [N].
    duration : float
        Length of a record [s].

    Returns
    -------
    Proposal
        To be played joint by joint.

    Raises
    ------
    InvalidSetting
        If gap, friction, duration or pose cannot be used.

    Examples
    --------
    >>> from loose_env.arms import six_axis
    >>> found = propose_excitation(six_axis(), np.array([0.0, -1.5, 1.5, 0.0, 0.5, 0.0]))
    >>> found.band, found.levels.shape, bool(found.seat_gravity[1] > 0.9)
    ((30.0, 150.0), (6,), True)
    """
    for name, value, least in (("gap", gap, 1e-9), ("friction", friction, 0.0)):
        if not isinstance(value, Real) or not np.isfinite(value) or value < least:
            raise InvalidSetting(f"{name} is {value!r}; it must be finite and {least:g} or more")
    nominal = LinearArm(arm)
    band, modes, warnings = propose_band(nominal, pose)
    wanted = (pose, gap, friction, duration)
    found = _play(nominal, *wanted)
    if band != arm.band:
        lower = _play(nominal.variant(replace(arm, band=band)), *wanted)
        if lower.openings.mean() >= _WORTH * found.openings.mean():
            found = lower
        else:  # the gap allows little acceleration at low frequencies, gravity asks for more
            inside = modes[modes < _CLEAR * arm.band[1]]
            band, warnings = arm.band, (_warning(arm.band, inside, "below them seats stay shut"),)
    notes = [*warnings, *found.notes]
    at, best_by_link = found.at, found.openings
    mass = _seat_mass(at)
    gravity = np.linalg.norm(at.seat_load, axis=1) / (9.81 * np.maximum(mass, 1e-9))
    shut = [i + 1 for i in range(arm.n) if best_by_link[i] < 0.1]
    if shut:
        notes.append(
            f"gravity and torque limits keep seats of links {shut} mostly shut in this pose: add "
            "poses that lay other directions across gravity"
        )
    return Proposal(
        band=band,
        levels=found.levels,
        shares=found.shares,
        excitations=found.excitations,
        modes=modes,
        seat_gravity=gravity,
        openings=best_by_link,
        warnings=tuple(notes),
    )


class _Play(NamedTuple):
    """The part of a proposal that depends on the band."""

    at: LinearPose
    levels: Array
    shares: Array
    excitations: tuple[Excitation | None, ...]
    openings: Array
    """Of each link under its best joint (n,)."""
    notes: list[str]


def _play(nominal: LinearArm, pose: Array, gap: float, friction: float, duration: float) -> _Play:
    """Find the level of every joint in the arm's band."""
    arm, at = nominal.arm, nominal.at(pose)
    axes = axes_grid(_AXES[len(arm.axes)], len(arm.axes))
    load = np.abs(at.seat_load @ axes.T) + friction  # (n links, A)
    levels, shares = np.zeros(arm.n), np.ones(arm.n)
    excitations: list[Excitation | None] = [None] * arm.n
    openings = np.zeros((arm.n, arm.n))
    notes = []
    for j in range(arm.n):
        if np.linalg.norm(at.kinematic[:, j]) < 1e-6:
            notes.append(f"joint {j + 1} does not move the tool in this pose: leave it out")
            continue
        force, travel = _per_level(at, j, axes)
        lost = _lost(_LEVELS[:, None, None], force, load, travel, gap)  # (L, links, A)
        score = lost.mean(axis=(1, 2))
        # Of levels that are about as good the highest: sensors and friction count least there.
        best = int(np.flatnonzero(score >= _AS_GOOD * score.max())[-1])
        wanted = np.zeros(arm.n)
        wanted[j] = _LEVELS[best]
        excitation, share = at_levels(at, wanted, duration=duration)
        if excitation.torque_rms[j] <= 0:
            notes.append(f"joint {j + 1} needs all its torque to hold the arm in this pose")
            continue
        excitations[j], shares[j] = excitation, share[j]
        levels[j] = wanted[j] * share[j]
        openings[j] = _lost(levels[j], force, load, travel, gap).mean(axis=1)
    return _Play(at, levels, shares, tuple(excitations), openings.max(axis=0), notes)


def _per_level(at: LinearPose, joint: int, axes: Array) -> tuple[Array, Array]:
    """Rms force across shut seats and rms travel of floating ones, per unit level (n, A)."""
    excited = np.arange(at.linear.arm.n) == joint
    answer, opened = at.response(excited), at.open_response(excited)
    tool = np.sqrt(np.mean(np.sum(np.abs(answer.tool[..., 0]) ** 2, axis=1)))
    force = np.einsum("kis,as->kia", answer.slide[..., 0], axes)
    mass = np.einsum("kisr,as,ar->kia", opened.mass_slide, axes, axes)
    omega = 2 * np.pi * answer.frequency[:, None, None]
    travel = np.abs(force / mass) / omega**2
    return (
        np.sqrt(np.mean(np.abs(force) ** 2, axis=0)) / tool,
        np.sqrt(np.mean(travel**2, axis=0)) / tool,
    )


def _lost(level: Array | float, force: Array, load: Array, travel: Array, gap: float) -> Array:
    """Expected share of transmission that open seats lose at a level."""
    opens = np.minimum(1.0, (force * level / np.maximum(_OVERCOME * load, 1e-9)) ** 2)
    floats = np.minimum(1.0, gap / np.maximum(4 * travel * level, 1e-12))
    return np.asarray(opens * floats)


def _seat_mass(at: LinearPose) -> Array:
    """Mass behind each seat (n,) [kg]."""
    slides = at.linear.slide_dofs
    return np.array([float(at.inertia[s[0], s[0]]) for s in slides])
