"""Elastic coordinates of an arm: gears, links and the base, with uncertain stiffness.

Every real arm is elastic. Each gear turns, each link bends at its seat about the two axes across
its joint's, and the base slides and rocks (rocking is the first link's bending and its gear's
turn). A stiffness is known by its order of magnitude alone: its logarithm is normal about that of a
given mode, and the runs say more. A spring answers every force alike, in all runs: that tells it
from a seat with play, whose motion is free at every line.
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
    columns = [*plays.T, *seats[:, :3].T]
    names = [f"gear_stiffness@{joint}" for joint in joints]
    names += [f"base_stiffness_{axis}" for axis in "xyz"]
    hertz = [GEAR_HZ] * n + [BENDING_HZ] * 3
    for link in range(n):
        own = turns[:, 3 * link : 3 * link + 3]
        axis = np.linalg.lstsq(own, plays[:, link], rcond=None)[0]
        across = tangents(axis / np.linalg.norm(axis)) if np.linalg.norm(axis) > 0.5 else np.eye(3)
        columns += list(across @ own.T)
        names += [f"bending_stiffness_{k + 1}@{links[link]}" for k in range(len(across))]
        hertz += [BENDING_HZ] * len(across)
    found = np.array(columns).T
    model, data = linear.model, mujoco.MjData(linear.model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    carried = np.einsum("ie,ij,je->e", found, full, found)
    return ElasticCoordinates(
        columns=found,
        stiffness=np.asarray((2 * np.pi * np.array(hertz)) ** 2 * carried),
        names=tuple(names),
    )
