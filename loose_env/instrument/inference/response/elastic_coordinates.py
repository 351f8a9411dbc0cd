"""Elastic coordinates of an arm: gears, links and the base, with uncertain stiffness.

Every real arm is elastic. Each gear turns; each link bends about the two axes across its length, as
a hinge at a third of it (a beam that is clamped at its root and loaded at its end, by Euler and
Bernoulli); the base slides, and rocks about the axes across the first joint's. A stiffness is known
by its order of magnitude alone: its logarithm is distributed about that of a given mode, and the
runs say more. A spring answers every force alike, in all runs: that tells it from a seat with play,
whose motion is free at every line.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms import LinearArm
from loose_env.instrument.settings.thresholds import BENDING_HZ, GEAR_HZ
from loose_env.statistics import tangents
from loose_env.typing import Array

__all__ = ["ElasticCoordinates", "elastic_coordinates"]

_SHORT = 1e-3
"""Length below which a link has no direction of its own [m]: its joint's axis instead."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticCoordinates:
    """Directions of elastic motion and their stiffness by the prior's median."""

    columns: Array
    """In the linear arm's coordinates (nv, E)."""
    stiffness: Array
    """Median (E,) [N/m or N·m/rad]."""
    names: tuple[str, ...]
    """Of the stiffness parameters (E,)."""


def elastic_coordinates(
    linear: LinearArm, seats: Array, *, joints: tuple[str, ...], links: tuple[str, ...]
) -> ElasticCoordinates:
    """Return the elastic coordinates of an arm.

    Parameters
    ----------
    linear : LinearArm
        The arm with slides and rotations of its links.
    seats : ndarray (nv, 7 n)
        Its seats: 3 n slides, n plays of joints, 3 n rotations of links.
    joints, links : tuple of str
        Their names (n,).
    """
    n = len(joints)
    plays, turns = seats[:, 3 * n : 4 * n], seats[:, 4 * n :]
    model, data = linear.model, mujoco.MjData(linear.model)
    mujoco.mj_forward(model, data)
    lengths = _lengths(linear, data)
    axes = [
        np.asarray(np.linalg.lstsq(turns[:, 3 * k : 3 * k + 3], plays[:, k], rcond=None)[0], float)
        for k in range(n)
    ]
    rocking = _across(axes[0]) @ turns[:, :3].T
    columns = [*plays.T, *seats[:, :3].T, *rocking]
    names = [f"gear_stiffness@{joint}" for joint in joints]
    names += [f"base_stiffness_{axis}" for axis in "xyz"]
    names += [f"base_rocking_stiffness_{k + 1}" for k in range(len(rocking))]
    hertz = [GEAR_HZ] * n + [BENDING_HZ] * (3 + len(rocking))
    for link in range(n):
        own, slides = turns[:, 3 * link : 3 * link + 3], seats[:, 3 * link : 3 * link + 3]
        long = np.linalg.norm(lengths[link]) > _SHORT
        across = _across(lengths[link] if long else axes[link])
        # A turn about a point away from the origin moves the origin.
        columns += [own @ turn - slides @ np.cross(turn, lengths[link] / 3) for turn in across]
        names += [f"bending_stiffness_{k + 1}@{links[link]}" for k in range(len(across))]
        hertz += [BENDING_HZ] * len(across)
    found = np.array(columns).T
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    carried = np.einsum("ie,ij,je->e", found, full, found)
    return ElasticCoordinates(
        columns=found,
        stiffness=np.asarray((2 * np.pi * np.array(hertz)) ** 2 * carried),
        names=tuple(names),
    )


def _across(direction: Array) -> Array:
    """Axes across a direction (2, 3); all three where there is none, as of a prismatic joint."""
    return tangents(direction) if np.linalg.norm(direction) > _SHORT else np.eye(3)


def _lengths(linear: LinearArm, data: mujoco.MjData) -> list[Array]:
    """Vector from each link's origin to the next one's or the tool, in its own frame (3,) [m]."""
    arm = linear.arm
    bodies = [data.body(name) for name in arm.seat_bodies]
    ends = [*(body.xpos for body in bodies[1:]), data.site(arm.tool).xpos]
    return [
        np.asarray(body.xmat.reshape(3, 3).T @ (end - body.xpos))
        for body, end in zip(bodies, ends, strict=True)
    ]
