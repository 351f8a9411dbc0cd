"""Effects in the joints: friction, elasticity, play, rotors, ripple and springs."""

from __future__ import annotations

import dataclasses

import numpy as np

from scripts.suites.gap.effects.types import (
    FORWARD,
    FREE,
    INVERSE,
    RANDOM,
    Kind,
    Parameters,
    Place,
    Readings,
    hinges,
    joints,
    log_uniform,
    nothing,
    scalar,
)
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.build import Factors, build
from scripts.suites.gap.simulator.chain import felt_inertia, free_link
from scripts.suites.gap.simulator.laws import (
    ASYMMETRY,
    BUMP,
    CROSSLEY,
    DAMPING,
    DRAG,
    EXTRA,
    FRICTION,
    GAP_HIGH,
    GAP_LOW,
    HERTZ,
    ORDER,
    PHASE,
    PROGRESS,
    REST,
    RIPPLE,
    SECOND,
    SMOOTH_SPEED,
    STIFFNESS,
    STRIBECK_SPEED,
    THINNING,
)
from scripts.suites.gap.simulator.simulate import System

HIGHEST_MODE, LOWEST_MODE = 130.0, 12.0
"""Free modes that a compliance may have [Hz]: faster ones cannot be followed at 1 kHz, and
holding modes of real arms lie at 10 to 80 Hz."""
SLIDE_SPEED = 0.2
"""Speed of a slide [m/s] that counts like 1 rad/s of a hinge."""


def _law(system: System, place: Place) -> np.ndarray:
    """Row of laws of a joint's motor side; writing to it changes the system."""
    return system.laws[int(system.drives[place.index, 0])]  # type: ignore[no-any-return]


def _speed(figures: Figures, place: Place) -> float:
    return SLIDE_SPEED if figures.links[place.index].kind == "slide" else 1.0


def _share_of_limit(low: float, high: float, power: int = 0):  # type: ignore[no-untyped-def]
    """Bounds as shares of the drive's limit over the joint's unit of speed to a power."""

    def bounds(figures: Figures, place: Place) -> tuple[float, float]:
        unit = figures.links[place.index].limit / _speed(figures, place) ** power
        return low * unit, high * unit

    return bounds


def _viscous(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # oil thins a little with speed
    law = _law(system, place)
    law[EXTRA] += p["damping"]
    law[THINNING] = 6.0 * _speed(figures, place)


def _draw_coulomb(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    unit = _speed(figures, place)
    return {
        "smooth_speed": log_uniform(rng, 1e-3, 4e-3) * unit,
        "static": rng.uniform(1.0, 1.1),
        "speed": 0.05 * unit,
    }


def _draw_stribeck(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    unit = _speed(figures, place)
    return {
        "smooth_speed": log_uniform(rng, 1e-3, 4e-3) * unit,
        "static": rng.uniform(1.4, 2.2),
        "speed": log_uniform(rng, 0.03, 0.25) * unit,
    }


def _size_friction(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {
        "torque": size,
        "static_torque": size * drawn["static"],
        "speed": drawn["speed"],
        "smooth_speed": drawn["smooth_speed"],
    }


def _friction(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    law = _law(system, place)
    law[FRICTION], law[BUMP] = p["torque"], p["static_torque"] / p["torque"] - 1.0
    law[STRIBECK_SPEED], law[SMOOTH_SPEED] = p["speed"], p["smooth_speed"]


def _draw_asymmetric(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    drawn = _draw_coulomb(rng, figures, place)
    return {**drawn, "side": float(rng.uniform(0.3, 0.8) * rng.choice([-1.0, 1.0]))}


def _size_asymmetric(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    sides = {"forward": size * (1 + drawn["side"]), "backward": size * (1 - drawn["side"])}
    return {**_size_friction(size, drawn, figures, place), **sides}


def _asymmetric(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    _friction(system, readings, figures, place, p)
    _law(system, place)[ASYMMETRY] = p["forward"] / p["torque"] - 1.0


def _drag(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    _law(system, place)[DRAG] += p["drag"]


def _draw_compliance(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"damping_ratio": log_uniform(rng, 0.02, 0.08), "stiffening": rng.uniform(0.03, 0.12)}


def _size_compliance(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"stiffness": 1.0 / size, **drawn}


def set_spring(system: System, dof: int, figures: Figures, load: float, p: Parameters) -> None:
    """Give a degree of freedom a slightly progressive spring and a damper, in place.

    `stiffening` is the share by which the force is above the linear one at the deflection
    under `load`.
    """
    law = system.laws[dof]
    law[STIFFNESS] = p["stiffness"]
    law[PROGRESS] = p["stiffening"] / (load / p["stiffness"]) ** 2
    felt = felt_inertia(system, dof, figures.home)
    law[DAMPING] = 2 * p["damping_ratio"] * np.sqrt(p["stiffness"] * felt)
    p["damping"] = float(law[DAMPING])


def _compliance(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    dof = free_link(system, place.index, "hinge", np.array(figures.links[place.index].axis))
    set_spring(system, dof, figures, 0.5 * figures.links[place.index].limit, p)


def _draw_backlash(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return draw_stops(rng)


def draw_stops(rng: np.random.Generator) -> Parameters:
    """Mode of a part pressed to a stop by its usual load [Hz], and how it is damped there."""
    return {"stop_mode": rng.uniform(90.0, 130.0), "stop_damping_ratio": rng.uniform(0.2, 0.5)}


def set_stops(system: System, dof: int, figures: Figures, load: float, p: Parameters) -> None:
    """Give a degree of freedom a free travel `gap` between Hertzian stops, in place.

    Under `load` the stops are as stiff as `stop_mode` says; the dissipation of Hunt and Crossley
    grows with the load, so a light touch rings longer.
    """
    law = system.laws[dof]
    law[GAP_LOW], law[GAP_HIGH] = -p["gap"] / 2, p["gap"] / 2
    felt = felt_inertia(system, dof, figures.home)
    stiffness = felt * (2 * np.pi * p["stop_mode"]) ** 2
    # tangent of h d^1.5 at h d^1.5 = load: 1.5 h^(2/3) load^(1/3)
    law[HERTZ] = (stiffness / (1.5 * load ** (1 / 3))) ** 1.5
    law[CROSSLEY] = 2 * p["stop_damping_ratio"] * np.sqrt(stiffness * felt) / load


def _backlash(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    dof = free_link(system, place.index, "hinge", np.array(figures.links[place.index].axis))
    set_stops(system, dof, figures, 0.1 * figures.links[place.index].limit, p)
    # grease between the flanks
    system.laws[dof, DAMPING] = 0.05 * figures.links[place.index].damping


def _rotor(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.bodies[int(system.drives[place.index, 0]), 20] += p["inertia"]


def _rotor_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    armature = figures.links[place.index].armature
    return 0.01 * armature, 4.0 * armature


def _draw_ripple(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {
        "order": float(rng.integers(6, 25)),
        "phase": rng.uniform(-np.pi, np.pi),
        "second_harmonic": rng.uniform(0.0, 0.2),
    }


def _ripple(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    law = _law(system, place)
    law[RIPPLE], law[ORDER], law[PHASE] = p["amplitude"], p["order"], p["phase"]
    law[SECOND] = p["second_harmonic"]


def _draw_spring(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    link = figures.links[place.index]
    return {
        "reference": link.home + rng.uniform(-1.5, 1.5) * link.reach,
        "stiffening": rng.uniform(0.0, 0.1),
    }


def _spring(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    law = _law(system, place)
    law[STIFFNESS], law[REST] = p["stiffness"], p["reference"]
    law[PROGRESS] = p["stiffening"] / figures.links[place.index].reach ** 2


def _spring_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    link = figures.links[place.index]
    return 1e-4 * link.limit / link.reach, 0.25 * link.limit / link.reach


def _compliance_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    system = build(figures, Factors.ones(figures.joints))
    dof = free_link(system, place.index, "hinge", np.array(figures.links[place.index].axis))
    return spring_bounds(system, dof, figures)


def spring_bounds(system: System, dof: int, figures: Figures) -> tuple[float, float]:
    """Compliances whose free mode lies between `HIGHEST_MODE` and `LOWEST_MODE` [rad/(N m)]."""
    felt = felt_inertia(system, dof, figures.home)
    return tuple(1 / (felt * (2 * np.pi * mode) ** 2) for mode in (HIGHEST_MODE, LOWEST_MODE))  # type: ignore[return-value]


_compliance_kind = Kind(
    name="joint_compliance",
    places=hinges,
    draw=_draw_compliance,
    bounds=_compliance_bounds,
    size=_size_compliance,
    apply=_compliance,
)

KINDS = (
    Kind(name="viscous_friction", places=joints, draw=nothing,
         bounds=_share_of_limit(1e-5, 0.15, 1), size=scalar("damping"), apply=_viscous),
    Kind(name="coulomb_friction", places=joints, draw=_draw_coulomb,
         bounds=_share_of_limit(2e-5, 0.12), size=_size_friction, apply=_friction),
    Kind(name="stribeck_friction", places=joints, draw=_draw_stribeck,
         bounds=_share_of_limit(2e-5, 0.12), size=_size_friction, apply=_friction,
         rivals=("coulomb_friction",), forms=(FORWARD, INVERSE, FREE)),
    Kind(name="quadratic_drag", places=joints, draw=nothing,
         bounds=_share_of_limit(1e-5, 0.15, 2), size=scalar("drag"), apply=_drag,
         rivals=("viscous_friction",), forms=(FORWARD, INVERSE, FREE)),
    _compliance_kind,
    dataclasses.replace(_compliance_kind, name="backlash", draw=_draw_backlash,
                        bounds=lambda figures, place: (3e-4, 0.02), size=scalar("gap"),
                        apply=_backlash, forms=(FORWARD, INVERSE, RANDOM)),
    Kind(name="rotor_inertia", places=joints, draw=nothing, bounds=_rotor_bounds,
         size=scalar("inertia"), apply=_rotor),
    Kind(name="torque_ripple", places=hinges, draw=_draw_ripple,
         bounds=_share_of_limit(2e-5, 0.1), size=scalar("amplitude"), apply=_ripple,
         forms=(FORWARD, INVERSE)),
    Kind(name="asymmetric_friction", places=joints, draw=_draw_asymmetric,
         bounds=_share_of_limit(2e-5, 0.12), size=_size_asymmetric, apply=_asymmetric,
         rivals=("coulomb_friction",), forms=(FORWARD, INVERSE, FREE)),
    Kind(name="joint_spring", places=joints, draw=_draw_spring, bounds=_spring_bounds,
         size=scalar("stiffness"), apply=_spring, forms=(FORWARD, INVERSE, FREE)),
)  # fmt: skip
"""Kinds of this file."""
