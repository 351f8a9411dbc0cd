"""Effects that the catalogue does not have, sized like those that it has."""

from __future__ import annotations

import numpy as np

from scripts.suites.gap.effects.link import moved_axes
from scripts.suites.gap.effects.types import (
    FORWARD,
    Kind,
    Parameters,
    Place,
    Readings,
    hinges,
    joints,
    log_uniform,
    scalar,
)
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.laws import (
    FRICTION,
    GRAIN,
    HYSTERESIS,
    SAG,
    SMOOTH_SPEED,
    STRIBECK_SPEED,
    STROKE,
    WARM_TIME,
)
from scripts.suites.gap.simulator.simulate import System


def _torque(low: float, high: float):  # type: ignore[no-untyped-def]
    def bounds(figures: Figures, place: Place) -> tuple[float, float]:
        limit = figures.links[place.index].limit
        return low * limit, high * limit

    return bounds


def _draw_warming(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"warm_time": log_uniform(rng, 1.5, 4.0)}


def _warming(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    law = system.laws[int(system.drives[place.index, 0])]
    law[FRICTION], law[WARM_TIME] = p["torque"], p["warm_time"]
    law[SMOOTH_SPEED], law[STRIBECK_SPEED] = 3e-3, 0.1


def _pairs(figures: Figures) -> list[Place]:
    turning = [place.index for place in hinges(figures)]
    return [Place(name=f"joint{i + 1}", index=i) for i in turning if any(j > i for j in turning)]


def _draw_cable(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    others = [p.index for p in hinges(figures) if p.index > place.index]
    return {
        "other": int(rng.choice(others)),
        "ratio": float(rng.uniform(0.6, 1.5) * rng.choice([-1.0, 1.0])),
        "slack": float(rng.uniform(-0.3, 0.3)),
    }


def _cable(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    other, ratio = p["other"], p["ratio"]
    home = figures.home
    rest = home[place.index] + ratio * home[other] + p["slack"]
    dofs = system.joint_dofs
    system.cable = np.array([dofs[place.index], dofs[other], ratio, p["stiffness"], rest])


def _tool(figures: Figures) -> list[Place]:
    return [Place(name="tool", index=figures.joints - 1)]


def _draw_fan(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    basis = moved_axes(figures)
    mix = rng.normal(size=len(basis)) @ basis
    return {
        "direction": (mix / np.linalg.norm(mix)).tolist(),
        "frequency": log_uniform(rng, 6.0, 40.0),
        "phase": rng.uniform(-np.pi, np.pi),
    }


def _fan(system: System, readings: Readings, figures: Figures, place: Place, p: Parameters) -> None:
    push = p["force"] * np.array(p["direction"])
    system.fan = np.array([*push, p["frequency"], p["phase"]])


def _draw_none(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {}


def _sag(system: System, readings: Readings, figures: Figures, place: Place, p: Parameters) -> None:
    system.drives[:, SAG] = p["sag"]


def _draw_tight(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"waves": float(rng.integers(3, 9)), "phase": rng.uniform(-np.pi, np.pi)}


def _tight(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # a bent shaft rubs in some angles and runs free in others
    law = system.laws[int(system.drives[place.index, 0])]
    law[FRICTION], law[GRAIN], law[GRAIN + 1] = p["torque"], p["waves"], p["phase"]
    law[SMOOTH_SPEED], law[STRIBECK_SPEED] = 3e-3, 0.1


def _draw_hysteresis(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    reach = figures.links[place.index].reach
    return {"stroke": rng.uniform(0.25, 0.6) * reach}


def _hysteresis(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    law = system.laws[int(system.drives[place.index, 0])]
    law[HYSTERESIS], law[STROKE] = p["torque"], p["stroke"]


def _all(figures: Figures) -> list[Place]:
    return [Place(name="all", index=-1)]


KINDS = (
    Kind(name="warming_friction", places=hinges, draw=_draw_warming, bounds=_torque(1e-4, 0.2),
         size=scalar("torque"), apply=_warming, forms=(FORWARD,), group="outside",
         rivals=("coulomb_friction", "viscous_friction")),
    Kind(name="cable_coupling", places=_pairs, draw=_draw_cable, bounds=_torque(1e-4, 0.3),
         size=scalar("stiffness"), apply=_cable, forms=(FORWARD,), group="outside",
         rivals=("joint_spring",)),
    Kind(name="shaking_force", places=_tool, draw=_draw_fan, bounds=_torque(1e-5, 1.0),
         size=scalar("force"), apply=_fan, forms=(FORWARD,), group="outside"),
    Kind(name="voltage_sag", places=_all, draw=_draw_none,
         bounds=lambda figures, place: (1e-3, 2.0), size=scalar("sag"), apply=_sag,
         forms=(FORWARD,), group="outside", rivals=("actuator_gain",)),
    Kind(name="tight_spots", places=hinges, draw=_draw_tight, bounds=_torque(1e-4, 0.3),
         size=scalar("torque"), apply=_tight, forms=(FORWARD,), group="outside",
         rivals=("coulomb_friction", "asymmetric_friction")),
    Kind(name="drive_hysteresis", places=joints, draw=_draw_hysteresis,
         bounds=_torque(1e-5, 0.15), size=scalar("torque"), apply=_hysteresis, forms=(FORWARD,),
         group="outside", rivals=("coulomb_friction", "joint_spring")),
)  # fmt: skip
"""Kinds of this file."""
