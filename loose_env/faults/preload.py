"""Preload of a loose seat against its stop, relative to the weight it carries."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from loose_env.arms import GRAVITY, Arm
from loose_env.errors import InvalidSetting
from loose_env.faults.faults import (
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    Preload,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
)
from loose_env.faults.seat import SinglePart, twist_of

__all__ = ["preloaded", "seat_weight"]


def seat_weight(arm: Arm, part: SinglePart) -> float:
    """Maximum load of 1 g, in any direction, on a seat of the nominal arm at zero pose.

    A slide carries the weight m g of all that lies beyond it; a hinge that weight times the
    distance of its centre of mass from the axis.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    part : StructuralLooseness, RotationalLooseness or Backlash
        One degree of freedom of a seat.

    Returns
    -------
    float
        Force of a slide [N], torque of a hinge [N·m].

    Raises
    ------
    InvalidSetting
        If the fault is no single degree of freedom.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> slide = StructuralLooseness(link=1, direction=(1, 0, 0), gap=1e-4, stiffness=(1e5, 1e5))
    >>> arm = planar(2)
    >>> mass = arm.model.body(arm.seat_bodies[0]).subtreemass[0]
    >>> bool(np.isclose(seat_weight(arm, slide), 9.81 * mass))
    True
    """
    twist = twist_of(arm, part)
    if len(twist) == 3:  # in the plane: x, y and the turn about z
        twist = np.array([twist[0], twist[1], 0.0, 0.0, 0.0, twist[2]])
    link = part.joint if isinstance(part, Backlash) else part.link  # type: ignore[union-attr]
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = 0.0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    body = model.body(arm.seat_bodies[arm.link_number(link) - 1]).id
    frame = data.xmat[body].reshape(3, 3)
    centre = frame.T @ (data.subtree_com[body] - data.xpos[body])
    per_travel = twist[:3] + np.cross(twist[3:], centre)
    return float(GRAVITY * model.body_subtreemass[body] * np.linalg.norm(per_travel))


def preloaded(arm: Arm, fault: Fault, share: float) -> Fault:
    """Preload every loose seat of a fault on its upper stop by a share of its weight.

    At 1 it takes a shake of 1 g along the seat to open it.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    fault : Fault
        The fault. Where nothing is loose, nothing changes.
    share : float
        Load over `seat_weight` [1]; below zero it presses on the lower stop.

    Raises
    ------
    InvalidSetting
        If the share is no finite number.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> play = Backlash(joint=2, gap=1e-3, stiffness=(1e3, 1e3))
    >>> pressed = preloaded(planar(2), play, 0.5)
    >>> pressed.preload == 0.5 * seat_weight(planar(2), play)
    True
    """
    if isinstance(fault, (StructuralLooseness, Backlash, RotationalLooseness)):
        if not np.isfinite(share):
            raise InvalidSetting(f"a share of the weight is a finite number, got {share!r}")
        return replace(fault, preload=float(share) * seat_weight(arm, fault))
    if isinstance(fault, CompoundLooseness):
        parts = tuple(preloaded(arm, part, share) for part in fault.parts)
        return replace(fault, parts=parts)  # type: ignore[arg-type]
    if isinstance(fault, SeveralFaults):
        faults = tuple(preloaded(arm, one, share) for one in fault.faults)
        return replace(fault, faults=faults)  # type: ignore[arg-type]
    assert isinstance(fault, (Healthy, Preload))
    return fault
