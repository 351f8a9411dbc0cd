"""Elastic coordinates of an arm: gears, links and base, with prior medians of their stiffness.

Every real arm is elastic. Each gear turns; each link bends about the two axes across its length, as
a hinge at a third of it (a beam that is clamped at its root and loaded at its end, by Euler and
Bernoulli); the base slides, and rocks about the axes across the first joint's. A stiffness is known
by its order of magnitude alone: its logarithm is distributed about that of a given mode, and the
runs say more. A spring answers every force alike, in all runs: that tells it from a seat with play,
whose motion is free at every line.

Where the softest direction of a link or of the base lies, nobody knows: their stiffness is a
matrix, with a logarithm that is symmetric and normal in every direction alike (log-Euclidean;
Arsigny et al., SIAM J. Matrix Anal. Appl. 29, 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.instrument.settings.thresholds import BENDING_HZ, GEAR_HZ
from loose_env.statistics import tangents
from loose_env.typing import Array

_ALIKE = 1e-4
"""Half the difference of logarithms below which two stiffnesses count as one [1]."""
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
    """Of the parameters: one for every coordinate, then one for every pair in a group (Q,)."""
    directions: Array
    """Change of the logarithm of the stiffness over its median by each parameter (Q, E, E) [1]."""
    hertz: Array
    """Modes by the median stiffness (E,) [Hz]."""
    kinds: tuple[slice, ...]
    """Coordinates of the gears, of the base and of the links."""

    @property
    def count(self) -> int:
        """Number of coordinates."""
        return len(self.stiffness)

    def matrix(self, parameters: Array) -> Array:
        """Stiffness for given parameters (E, E) [N/m or N·m/rad]."""
        values, vectors = np.linalg.eigh(np.tensordot(parameters, self.directions, 1))
        root = np.sqrt(self.stiffness)
        found = (vectors * np.exp(values)) @ vectors.T
        return np.asarray(root[:, None] * found * root)

    def of_kind(self, kind: slice) -> NDArray[np.bool_]:
        """Mask of the parameters of the coordinates of a kind (Q,)."""
        return np.asarray(np.any(self.directions[:, :, kind], axis=(1, 2)))

    def with_modes(self, hertz: float) -> Array:
        """Parameters (Q,) by which every coordinate has its mode at a frequency [Hz]."""
        found = np.zeros(len(self.names))
        found[: self.count] = 2 * np.log(hertz / self.hertz)
        return found

    def slopes(self, parameters: Array) -> Array:
        """Change of the stiffness by each parameter (Q, E, E).

        The derivative of a matrix exponential (Daleckii and Krein).
        """
        values, vectors = np.linalg.eigh(np.tensordot(parameters, self.directions, 1))
        mean, half = (values[:, None] + values) / 2, (values[:, None] - values) / 2
        far = np.abs(half) > _ALIKE
        ratio = np.sinh(half) / np.where(far, half, 1.0)
        change = np.exp(mean) * np.where(far, ratio, 1.0)
        turned = vectors.T @ self.directions @ vectors
        root = np.sqrt(self.stiffness)
        found = vectors @ (change * turned) @ vectors.T
        return np.asarray(root[:, None] * found * root)


def elastic_coordinates(
    linear: LinearArm, seats: Array, *, joints: tuple[str, ...], links: tuple[str, ...]
) -> ElasticCoordinates:
    """Return the elastic coordinates of an arm."""
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
    kinds = (slice(0, n), slice(n, len(names)), slice(len(names), None))
    groups = [1] * n + [3, len(rocking)]
    for link in range(n):
        own, slides = turns[:, 3 * link : 3 * link + 3], seats[:, 3 * link : 3 * link + 3]
        long = np.linalg.norm(lengths[link]) > _SHORT
        across = _across(lengths[link] if long else axes[link])
        # A turn about a point away from the origin moves the origin.
        columns += [own @ turn - slides @ np.cross(turn, lengths[link] / 3) for turn in across]
        names += [f"bending_stiffness_{k + 1}@{links[link]}" for k in range(len(across))]
        hertz += [BENDING_HZ] * len(across)
        groups.append(len(across))
    found = np.array(columns).T
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    carried = np.einsum("ie,ij,je->e", found, full, found)
    pairs = _pairs(groups)
    directions = np.zeros((len(names) + len(pairs), len(names), len(names)))
    directions[np.arange(len(names)), np.arange(len(names)), np.arange(len(names))] = 1.0
    for k, (one, other) in enumerate(pairs, start=len(names)):
        # As large a change as that of a stiffness: no direction is preferred.
        directions[k, one, other] = directions[k, other, one] = np.sqrt(0.5)
    return ElasticCoordinates(
        columns=found,
        stiffness=np.asarray((2 * np.pi * np.array(hertz)) ** 2 * carried),
        names=(*names, *(f"{names[one]}_{other}" for one, other in pairs)),
        directions=directions,
        hertz=np.array(hertz),
        kinds=kinds,
    )


def _pairs(groups: list[int]) -> list[tuple[int, int]]:
    """Pairs of coordinates within groups that stand one behind the other."""
    first, found = 0, []
    for size in groups:
        found += list(combinations(range(first, first + size), 2))
        first += size
    return found


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
