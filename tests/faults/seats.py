"""Arms, faults and records that the tests of seats share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from loose_env.arms import Arm, MismatchDraw, planar, scara, six_axis, vera
from loose_env.excitation import at_levels
from loose_env.faults import (
    Backlash,
    Fault,
    RotationalLooseness,
    StructuralLooseness,
)
from loose_env.rig import Plant, PlantShop, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

ARMS: dict[str, Callable[[], Arm]] = {
    "planar3": lambda: planar(3),
    "vera": vera,
    "six_axis": six_axis,
    "scara": scara,
}


def slide(link: int, **changes: Any) -> StructuralLooseness:
    figures = {"direction": (0.6, 0.8, 0.0), "gap": 2e-4, "stiffness": (2e4, 3e4)}
    return StructuralLooseness(**{"link": link, **figures, **changes})


def rock(link: int, **changes: Any) -> RotationalLooseness:
    figures = {"axis": (0, 0, 1), "gap": 1e-3, "stiffness": (2e2, 2e2), "pivot": (0.01, 0.03, 0)}
    return RotationalLooseness(**{"link": link, **figures, **changes})


def play(joint: int, **changes: Any) -> Backlash:
    return Backlash(**{"joint": joint, "gap": 1e-3, "stiffness": (2e2, 4e2), **changes})


def tilted(arm: Arm, link: int) -> RotationalLooseness:
    """A link that rocks about an axis through nothing in particular."""
    rng = np.random.default_rng(link)
    axis, pivot = rng.standard_normal(3), 0.1 * rng.standard_normal(3)
    if len(arm.axes) == 2:
        axis[:2] = 0.0
    return rock(link, axis=tuple(axis), pivot=tuple(pivot), stiffness=(1e3, 1e3))


def pose_of(arm: Arm) -> Array:
    return arm.random_pose(np.random.default_rng(7))


def plant_of(arm: Arm, fault: Fault) -> Plant:
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    return shop.build(fault, MismatchDraw.none(arm))


def at_pose(plant: Plant, pose: Array) -> mujoco.MjData:
    data = mujoco.MjData(plant.model)
    data.qpos[plant.indices.position] = plant.hold_at(pose)
    return data


def inertia_of(model: mujoco.MjModel, data: mujoco.MjData, names: tuple[str, ...]) -> Array:
    """Inertia matrix of named joints (k, k)."""
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    return full[np.ix_(dofs, dofs)]


def records(arm: Arm, faults: list[Fault], *, finer: int = 1, centred: bool = False) -> list[Array]:
    """Tool acceleration with ideal sensors of several arms (d, N), all joints shaken alike.

    A centred seat starts in the middle of its gap.
    """
    rig = SimulatedRig(
        arm,
        slots=len(faults),
        sensors=SensorSuite.ideal(),
        timestep=arm.timestep / finer,
        threads=1,
    )
    for slot, fault in enumerate(faults):
        rig.mount(slot, fault)
        if centred:
            rig.plants[slot].gaps[:] = 0.0
    pose = pose_of(arm)
    shake, _ = at_levels(rig.nominal.at(pose), np.full(arm.n, arm.levels[-1]), duration=0.2)
    rngs = [np.random.default_rng(5) for _ in faults]
    found = rig.measure_all(range(len(faults)), pose, shake, rngs)
    assert all(m.failure is None for m in found)
    return [m.tool for m in found]


def apart(one: Array, other: Array) -> float:
    """Relative difference of two records without their means."""
    one, other = (x - x.mean(axis=1, keepdims=True) for x in (one, other))
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))
