"""Putting degrees of freedom that nobody drives into a chain."""

from __future__ import annotations

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap.simulator.build import body_row
from scripts.suites.gap.simulator.dynamics import WORK, forward, mass_and_bias
from scripts.suites.gap.simulator.laws import LAWS
from scripts.suites.gap.simulator.simulate import System


def _insert(system: System, at: int, body: Array, law: Array) -> None:
    """Put a row in front of position `at`; every index to the rows behind moves on."""
    system.bodies = np.insert(system.bodies, at, body, axis=0)
    system.laws = np.insert(system.laws, at, law, axis=0)
    system.drives[system.drives[:, 0] >= at, 0] += 1
    system.cable[:2][system.cable[:2] >= at] += 1
    system.proximal[system.proximal >= at] += 1
    system.distal[system.distal >= at] += 1


def free_link(system: System, link: int, kind: str, axis: Array) -> int:
    """Set a link on an extra joint between it and the motor of its joint.

    Parameters
    ----------
    system : System
        Changed in place.
    link : int
        Number of the link from 0.
    kind : str
        `hinge` or `slide`.
    axis : Array
        Unit vector in the link's frame, of shape (3,).

    Returns
    -------
    int
        The extra degree of freedom, whose laws are empty.
    """
    at = int(system.proximal[link])
    carried = system.bodies[at].copy()
    carried[0] = float(kind == "slide")
    carried[1:4], carried[4:7], carried[20] = axis, 0.0, 0.0
    system.bodies[at, 7:20] = 0.0
    one_body = system.distal[link] == at
    _insert(system, at + 1, carried, np.zeros(LAWS))
    system.proximal[link] = at + 1
    if one_body:
        system.distal[link] = at + 1
    return at + 1


def free_base(system: System, axis: Array) -> int:
    """Set the whole arm on a hinge through the world's origin.

    Parameters
    ----------
    system : System
        Changed in place.
    axis : Array
        Unit vector in the world, of shape (3,).

    Returns
    -------
    int
        The extra degree of freedom, whose laws are empty.
    """
    base = body_row("hinge", axis, np.zeros(3), 0.0, np.zeros(3), np.zeros((3, 3)), 0.0)
    _insert(system, 0, base, np.zeros(LAWS))
    return 0


def split_link(system: System, link: int, point: Array, axis: Array, share: float) -> int:
    """Cut a link in two at a point and join the parts by a hinge; mass and inertia are kept.

    Parameters
    ----------
    system : System
        Changed in place.
    link : int
        Number of the link from 0.
    point : Array
        Where to cut, in the link's frame, of shape (3,) [m].
    axis : Array
        Axis of the hinge, of shape (3,).
    share : float
        Share of the mass in the proximal part, a straight bar from the origin to the point.

    Returns
    -------
    int
        The extra degree of freedom, whose laws are empty.

    Raises
    ------
    ValueError
        If the distal part would have no inertia: the link is no bar.
    """
    at = int(system.proximal[link])
    whole = system.bodies[at]
    mass, com, inertia = whole[7], whole[8:11].copy(), whole[11:20].reshape(3, 3).copy()
    near = share * mass
    length = float(np.linalg.norm(point))
    along = point / length
    bar = near * length**2 / 12 * (np.eye(3) - np.outer(along, along)) + share * inertia[
        0, 0
    ] * np.outer(along, along)
    near_com = point / 2
    far = mass - near
    far_com = (mass * com - near * near_com) / far
    rest = inertia - bar - _shifted(near, near_com - com) - _shifted(far, far_com - com)
    if np.linalg.eigvalsh(rest).min() <= 0:
        raise ValueError("the link is no bar: nothing is left for its distal part")
    whole[7], whole[8:11], whole[11:20] = near, near_com, bar.ravel()
    end = int(system.distal[link])
    assert end == at, "a link is cut once"
    if end + 1 < len(system.bodies):
        system.bodies[end + 1, 4:7] -= point
    else:
        system.tool = system.tool - point
    row = body_row("hinge", axis, point, far, far_com - point, rest, 0.0)
    _insert(system, end + 1, row, np.zeros(LAWS))
    system.distal[link] = end + 1
    return end + 1


def _shifted(mass: float, arm: Array) -> Array:
    """Inertia of a point mass at `arm`, of shape (3, 3)."""
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def add_mass(system: System, body: int, mass: float, at: Array) -> None:
    """Fix a point mass (it may be negative) to a body, in place."""
    row = system.bodies[body]
    total = row[7] + mass
    com = (row[7] * row[8:11] + mass * at) / total
    inertia = (
        row[11:20].reshape(3, 3) + _shifted(row[7], row[8:11] - com) + _shifted(mass, at - com)
    )
    row[7], row[8:11], row[11:20] = total, com, inertia.ravel()


def mass_matrix(system: System, joints: Array) -> Array:
    """Mass matrix with the joints at given positions and the extra ones at rest, (N, N)."""
    dofs = len(system.bodies)
    q = np.zeros(dofs)
    q[system.joint_dofs] = joints
    work = np.zeros((dofs, WORK))
    mass, bias = np.zeros((dofs, dofs)), np.zeros(dofs)
    forward(system.bodies, q, np.zeros(dofs), system.gravity, work)
    mass_and_bias(system.bodies, work, mass, bias)
    return mass


def felt_inertia(system: System, dof: int, joints: Array) -> float:
    """Inertia that a force in one degree of freedom feels, all others free."""
    return 1.0 / float(np.linalg.inv(mass_matrix(system, joints))[dof, dof])
