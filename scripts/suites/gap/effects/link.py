"""Effects of the links, the tool and the base."""

from __future__ import annotations

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap.effects.joint import draw_stops, set_spring, set_stops, spring_bounds
from scripts.suites.gap.effects.types import (
    FORWARD,
    FREE,
    INVERSE,
    RANDOM,
    Kind,
    Parameters,
    Place,
    Readings,
    bars,
    either_sign,
    links,
    log_uniform,
    scalar,
)
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.build import Factors, build
from scripts.suites.gap.simulator.chain import add_mass, free_base, free_link, split_link
from scripts.suites.gap.simulator.dynamics import CARRIED
from scripts.suites.gap.simulator.laws import DAMPING, FRICTION, SMOOTH_SPEED, STRIBECK_SPEED
from scripts.suites.gap.simulator.simulate import System

PAYLOAD_OFF = 0.08
"""Furthest centre of a load from the tool [m]."""
STOP_LOAD = 30.0
"""Force that usually presses a loose seat to its stops [N]."""
SEAT_DAMPING = 5.0
"""Damping of a loose seat's guide [N s/m]."""


def rotation(vector: Array) -> Array:
    """Rotation matrix of a rotation vector, of shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross  # type: ignore[no-any-return]


def moved_axes(figures: Figures) -> Array:
    """Directions in which gravity or forces matter to an arm: rows, of shape (k, 3).

    A planar arm only moves across its axes, so an effect along them would hardly show.
    """
    axes = np.array([link.axis for link in figures.links])
    same = np.allclose(np.abs(axes @ axes[0]), 1.0)
    if same and all(link.kind == "hinge" for link in figures.links):
        return np.linalg.svd(axes[:1])[2][1:]
    return np.eye(3)


def _direction(rng: np.random.Generator, figures: Figures) -> Array:
    basis = moved_axes(figures)
    mix = rng.normal(size=len(basis)) @ basis
    return mix / np.linalg.norm(mix)


def _draw_looseness(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {
        "direction": _direction(rng, figures).tolist(),
        "friction": log_uniform(rng, 0.3, 3.0),
        **draw_stops(rng),
    }


def _looseness(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    dof = free_link(system, place.index, "slide", np.array(p["direction"]))
    set_stops(system, dof, figures, STOP_LOAD, p)
    law = system.laws[dof]
    law[DAMPING], law[FRICTION] = SEAT_DAMPING, p["friction"]
    law[SMOOTH_SPEED], law[STRIBECK_SPEED] = 2e-3, 0.01


def _draw_flexibility(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    # mostly in the plane in which the joint drives it
    link = figures.links[place.index]
    own = np.abs(link.axis)
    axes = [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    planar = len(moved_axes(figures)) < 3
    axis = axes[int(np.argmax(own[1:]))]
    if not planar and rng.random() < 0.3:
        axis = axes[1 - axes.index(axis)]
    return {
        "axis": list(axis),
        "position": rng.uniform(0.35, 0.6),
        "damping_ratio": log_uniform(rng, 0.01, 0.05),
        "stiffening": rng.uniform(0.02, 0.08),
    }


def _size_flexibility(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"stiffness": 1.0 / size, **drawn}


def _flexibility(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    link = figures.links[place.index]
    point = p["position"] * np.array(link.end)
    # a bar that is a little heavier near its joint has its middle of mass at 0.48 of its length
    share = p["position"] * (1 + 0.08 * (1 - p["position"]))
    dof = split_link(system, place.index, point, np.array(p["axis"]), share)
    set_spring(system, dof, figures, 0.5 * link.limit, p)


def _flexibility_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    system = build(figures, Factors.ones(figures.joints))
    link = figures.links[place.index]
    dof = split_link(system, place.index, 0.5 * np.array(link.end), np.array(link.axis), 0.52)
    return spring_bounds(system, dof, figures)


def _size_mass(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    mass = figures.links[place.index].mass
    return {"mass": drawn["sign"] * size * mass, "ratio": 1.0 + drawn["sign"] * size}


def _mass(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    row = system.bodies[int(system.proximal[place.index])]
    row[7] *= p["ratio"]
    row[11:20] *= p["ratio"]


def _draw_com(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"direction": _direction(rng, figures).tolist()}


def _size_com(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    shift = size * np.array(drawn["direction"])
    return {"shift": size, **dict(zip("xyz", shift.tolist(), strict=True))}


def _com(system: System, readings: Readings, figures: Figures, place: Place, p: Parameters) -> None:
    system.bodies[int(system.proximal[place.index]), 8:11] += (p["x"], p["y"], p["z"])


def _com_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    length = max(float(np.linalg.norm(figures.links[place.index].end)), 0.1)
    return 1e-4 * length, 0.35 * length


def _tool(figures: Figures) -> list[Place]:
    return [Place(name="tool", index=figures.joints - 1)]


def _payload(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    centre = np.array([p["x"], p["y"], p["z"]])
    add_mass(system, len(system.bodies) - 1, p["mass"], system.tool + centre)


def _draw_payload(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """Centre of a load: at the tool, or as far off as a gripper is long."""
    off = rng.normal(size=3)
    off *= rng.choice([0.0, rng.uniform(0.01, PAYLOAD_OFF)]) / np.linalg.norm(off)
    return dict(zip("xyz", off.tolist(), strict=True))


def _payload_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    mass = figures.links[-1].mass
    return 1e-3 * mass, 1.0 * mass


def _base(figures: Figures) -> list[Place]:
    return [Place(name="base", index=0)]


def _draw_tilt(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    # only a tilt that turns gravity inside a planar arm's plane moves the arm
    basis = moved_axes(figures)
    if len(basis) < 3:
        axis = np.abs(figures.links[0].axis) * rng.choice([-1.0, 1.0])
    else:
        angle = rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    return {"direction": axis.tolist()}


def _size_tilt(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    turn = size * np.array(drawn["direction"])
    return {"angle": size, "x": float(turn[0]), "y": float(turn[1])}


def _tilt(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # the base is turned by (x, y, 0) in the world, so gravity turns backwards in its frame
    system.gravity = rotation(-np.array([p["x"], p["y"], 0.0])) @ system.gravity


def _carried(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.bodies[int(system.proximal[place.index]), CARRIED] += p["share"]


_BASE_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}


def _draw_base(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {
        "axis": str(rng.choice(list("xy"))),
        "damping_ratio": log_uniform(rng, 0.02, 0.1),
        "stiffening": rng.uniform(0.0, 0.05),
    }


def _on_a_spring(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    dof = free_base(system, np.array(_BASE_AXES[p["axis"]]))
    set_spring(system, dof, figures, 0.5 * figures.links[0].limit, p)


def _base_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    system = build(figures, Factors.ones(figures.joints))
    return spring_bounds(system, free_base(system, np.array(_BASE_AXES["y"])), figures)


def _foot(figures: Figures) -> list[Place]:
    # a base that rocks about the axis of its first joint is that joint on a spring
    return _base(figures) if len(moved_axes(figures)) == 3 else []


KINDS = (
    Kind(name="structural_looseness", places=links, draw=_draw_looseness,
         bounds=lambda figures, place: (2e-5, 5e-4), size=scalar("gap"), apply=_looseness,
         forms=(FORWARD, RANDOM)),
    Kind(name="link_flexibility", places=bars, draw=_draw_flexibility,
         bounds=_flexibility_bounds, size=_size_flexibility, apply=_flexibility,
         forms=(FORWARD, RANDOM)),
    Kind(name="link_mass", places=links, draw=either_sign,
         bounds=lambda figures, place: (0.01, 0.6), size=_size_mass, apply=_mass),
    Kind(name="link_com", places=links, draw=_draw_com, bounds=_com_bounds, size=_size_com,
         apply=_com),
    Kind(name="payload", places=_tool, draw=_draw_payload, bounds=_payload_bounds,
         size=scalar("mass"), apply=_payload),
    Kind(name="base_tilt", places=_base, draw=_draw_tilt,
         bounds=lambda figures, place: (1e-5, 0.15), size=_size_tilt, apply=_tilt,
         forms=(FORWARD, INVERSE, FREE)),
    Kind(name="gravity_compensation", places=links, draw=either_sign,
         bounds=lambda figures, place: (1e-4, 0.9), size=scalar("share"), apply=_carried,
         forms=(FORWARD, INVERSE, FREE)),
    Kind(name="base_compliance", places=_foot, draw=_draw_base, bounds=_base_bounds,
         size=_size_flexibility, apply=_on_a_spring, forms=(FORWARD, RANDOM)),
)  # fmt: skip
"""Kinds of this file."""
