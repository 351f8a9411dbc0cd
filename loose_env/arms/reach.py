"""Reach of an arm: the largest distance between its first joint and its tool."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from loose_env.typing import Array

__all__ = ["largest_levers", "largest_reach"]

Range = tuple[float, float] | None

_STARTS = 12
"""Random poses from which the search starts, beside the model's own."""
_SWEEPS = 60
_POSES = 24
"""Random poses at which levers are looked at."""
_ENOUGH = 1e-9
"""Relative gain below which a sweep over the joints ends, and a pose counts as no farther."""


def largest_reach(
    model: mujoco.MjModel, joints: Sequence[str], ranges: Sequence[Range], tool: str
) -> float:
    """Find the largest distance from the first joint's anchor to the tool over all poses [m].

    One joint is moved at a time. With the others still, the squared distance is a cosine of a
    hinge's angle and a convex parabola in a slide's position, so each joint goes straight to
    its best place within its range, and no step makes the distance smaller. Several starts, the
    same ones in every call, guard against a bent arm in which no single joint gains.

    Parameters
    ----------
    model : mujoco.MjModel
        The bare arm; bending modes stay at rest.
    joints : sequence of str
        Its driven joints, base first.
    ranges : sequence of (float, float) or None
        Allowed positions of each joint [rad or m]; None for a hinge that turns without end.
    tool : str
        Site of the tool.

    Returns
    -------
    float
        Reach [m]. Where no pose reaches farther than the model's own zero and that lies within
        the ranges, exactly its distance.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> arm = planar(3)
    >>> round(largest_reach(arm.model, arm.joints, arm.joint_ranges, arm.tool), 9)
    0.9
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    anchor = data.joint(joints[0]).xanchor.copy()
    ids = [int(model.joint(name).id) for name in joints]
    at = np.array([int(model.jnt_qposadr[j]) for j in ids])
    own = model.qpos0[at].copy()
    site = int(model.site(tool).id)
    own_distance = float(np.linalg.norm(data.site_xpos[site] - anchor))

    low = np.array([-np.pi if r is None else r[0] for r in ranges])
    high = np.array([np.pi if r is None else r[1] for r in ranges])
    best = own_distance if bool(np.all((own >= low) & (own <= high))) else 0.0
    rng = np.random.default_rng(0)  # the same arm always has the same reach
    starts = [np.clip(own, low, high), *(low + (high - low) * rng.random((_STARTS, len(ids))))]
    for start in starts:
        data.qpos[at] = start
        reached = 0.0
        for _ in range(_SWEEPS):
            for k, j in enumerate(ids):
                mujoco.mj_kinematics(model, data)
                data.qpos[at[k]] = _best_place(
                    slides=bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE),
                    axis=data.xaxis[j],
                    tool=data.site_xpos[site] - data.xanchor[j],
                    base=anchor - data.xanchor[j],
                    now=float(data.qpos[at[k]]),
                    limits=ranges[k],
                )
            mujoco.mj_kinematics(model, data)
            before, reached = reached, float(np.linalg.norm(data.site_xpos[site] - anchor))
            if reached <= before * (1 + _ENOUGH):
                break
        if reached > best * (1 + _ENOUGH):
            best = reached
    return best


def _best_place(
    *, slides: bool, axis: Array, tool: Array, base: Array, now: float, limits: Range
) -> float:
    """Position of one joint at which the tool is farthest from the base."""
    if slides:
        if limits is None:
            return now
        along = float((tool - base) @ axis)
        return max(limits, key=lambda place: abs(along + place - now))
    across = tool - (tool @ axis) * axis
    # Turned by t, the distance falls with base . tool = constant + c cos t + s sin t.
    c, s = float(base @ across), float(base @ _cross(axis, across))
    if np.hypot(c, s) < 1e-12:
        return now
    place = now + float(np.arctan2(-s, -c))
    if limits is None:
        return place
    low, high = limits
    place += (
        2 * np.pi * float(np.ceil((low - place) / (2 * np.pi)))
    )  # the first such angle above low
    if place <= high:
        return place
    farthest: float = max(limits, key=lambda end: -c * np.cos(end - now) - s * np.sin(end - now))
    return farthest


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors (3,), without what `numpy.cross` asks of many."""
    (x, y, z), (u, v, w) = a, b
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def largest_levers(
    model: mujoco.MjModel, joints: Sequence[str], ranges: Sequence[Range], tool: str
) -> Array:
    """Largest distance of the tool from each joint's axis over random poses [m] (n,).

    Infinite where a joint slides: every motion of it moves the tool.

    Parameters
    ----------
    model : mujoco.MjModel
        The bare arm; bending modes stay at rest.
    joints : sequence of str
        Its driven joints, base first.
    ranges : sequence of (float, float) or None
        Allowed positions of each joint [rad or m]; None for a hinge that turns without end.
    tool : str
        Site of the tool.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> arm = planar(2)
    >>> largest_levers(arm.model, arm.joints, arm.joint_ranges, arm.tool).round(2).tolist()
    [0.6, 0.3]
    """
    data = mujoco.MjData(model)
    ids = [int(model.joint(name).id) for name in joints]
    slides = np.array([model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE for i in ids])
    low = np.array([-np.pi if r is None else r[0] for r in ranges])
    high = np.array([np.pi if r is None else r[1] for r in ranges])
    rng = np.random.default_rng(0)  # the same arm always has the same levers
    found = np.zeros(len(ids))
    for _ in range(_POSES):
        data.qpos[[model.jnt_qposadr[i] for i in ids]] = low + (high - low) * rng.random(len(ids))
        mujoco.mj_kinematics(model, data)
        away = data.site(tool).xpos - data.xanchor[ids]
        found = np.maximum(found, np.linalg.norm(np.cross(data.xaxis[ids], away), axis=1))
    return np.where(slides, np.inf, found)
