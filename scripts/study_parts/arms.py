"""Arms of the studies by name, and the direction in which a seat slides."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.arms import Arm, planar, scara, six_axis, vera
from loose_env.errors import UnknownName
from loose_env.faults import StructuralLooseness
from loose_env.typing import Array
from scripts.thesis.rigs import cylindrical

__all__ = ["arm_named", "seat_in_tool"]


def arm_named(name: str) -> Arm:
    """Build an arm: by its function's name, or planar with its number of links and v if vertical.

    Raises
    ------
    UnknownName
        If there is no such arm.

    Examples
    --------
    >>> arm_named("planar3v").n
    3
    """
    known = {"vera": vera, "six_axis": six_axis, "scara": scara, "cylindrical": cylindrical}
    if name in known:
        return known[name]()
    links = name.replace("-vertical", "v").removeprefix("planar")
    count = links.removesuffix("v") or "4"
    if not (name.startswith("planar") and count.isdecimal()):
        raise UnknownName(f"there is no arm {name!r}; there are {', '.join(known)} and planar4[v]")
    return planar(int(count), vertical=links.endswith("v"))


def seat_in_tool(arm: Arm, pose: Array, fault: StructuralLooseness) -> tuple[Array, float]:
    """Direction of a slide in the measured axes of the nominal tool, and gravity along it.

    Returns
    -------
    ndarray (d,), float
        Unit vector, and share of standard gravity [1].
    """
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(model, data)
    link = data.body(arm.seat_bodies[fault.link - 1]).xmat.reshape(3, 3)
    tool = data.site(arm.tool).xmat.reshape(3, 3)
    world = link @ (np.array(fault.direction) / np.linalg.norm(fault.direction))
    seen = (tool.T @ world)[list(arm.axes)]
    return seen / np.linalg.norm(seen), abs(float(world @ model.opt.gravity)) / 9.81
