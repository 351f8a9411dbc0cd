"""Geometry of a machine: normal of its plane, reach, ends of links, frame about an axis."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

_HINGE = mujoco.mjtJoint.mjJNT_HINGE


def _posed(machine: NominalModel) -> mujoco.MjData:
    data = mujoco.MjData(machine.model)
    mujoco.mj_kinematics(machine.model, data)
    return data


def normal_of(machine: NominalModel) -> Array | None:
    """Normal (3,) of the machine's plane of motion, world frame; None if not planar."""
    data = _posed(machine)
    turning = machine.model.jnt_type == _HINGE
    hinges, slides = data.xaxis[turning], data.xaxis[~turning]
    if not len(hinges):
        return None
    normal = hinges[0] * np.sign(hinges[0][np.argmax(np.abs(hinges[0]))])
    parallel = np.allclose(np.abs(hinges @ normal), 1.0, atol=1e-6)
    return np.array(normal) if parallel and np.allclose(slides @ normal, 0, atol=1e-6) else None


def reach_of(machine: NominalModel) -> float:
    """Length of the machine along its bodies, from its first joint on [m]."""
    model = machine.model
    along = np.zeros(model.nbody)
    first = int(model.jnt_bodyid[0])
    for body in range(first + 1, model.nbody):
        along[body] = along[model.body_parentid[body]] + np.linalg.norm(model.body_pos[body])
    beyond = np.zeros(model.nbody)
    if model.nsite:
        np.maximum.at(beyond, model.site_bodyid, np.linalg.norm(model.site_pos, axis=1))
    beyond = np.maximum(beyond, np.linalg.norm(model.body_ipos, axis=1))
    return max(float((along + beyond)[first:].max()), 1e-3)


def link_ends(machine: NominalModel, link: str) -> tuple[Array, Array]:
    """Ends of a link in its body's frame: at its joint, and at the next or the tool.

    The end is the farthest of the bodies and sites that it carries; without any, twice the distance
    to its centre of mass.
    """
    model = machine.model
    body = model.body(link).id
    start = np.array(model.jnt_pos[int(model.body_jntadr[body])])
    ends = [model.body_pos[b] for b in range(body + 1, model.nbody) if _carries(model, body, b)]
    if not ends:
        ends = [model.site_pos[s] for s in range(model.nsite) if model.site_bodyid[s] == body]
    if not ends:
        ends = [start + 2 * (model.body_ipos[body] - start)]
    far = max(ends, key=lambda end: float(np.linalg.norm(end - start)))
    return start, np.array(far)


def _carries(model: mujoco.MjModel, body: int, other: int) -> bool:
    """Return whether a body is a child of another and carries a joint somewhere."""
    if int(model.body_parentid[other]) != body:
        return False
    tree = {other}
    for b in range(other, model.nbody):
        if int(model.body_parentid[b]) in tree:
            tree.add(b)
    return any(int(model.body_jntnum[b]) > 0 for b in tree)


def frame_about(axis: Array) -> Array:
    """Right-handed unit vectors (3, 3), the first of them along ``axis``.

    Examples
    --------
    >>> frame_about(np.array([0.0, 0.0, 2.0]))
    array([[0., 0., 1.],
           [1., 0., 0.],
           [0., 1., 0.]])
    """
    first = axis / np.linalg.norm(axis)
    second = np.eye(3)[int(np.argmin(np.abs(first)))]
    second = second - first * (second @ first)
    second /= np.linalg.norm(second)
    return np.array([first, second, np.cross(first, second)])
