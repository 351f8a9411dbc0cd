"""Effects in joints and links that recordings hide, what an effect is, and the list of all."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap.arms import Figures
from scripts.suites.gap.dynamics import (
    ASYMMETRY,
    BUMP,
    CARRIED,
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
from scripts.suites.gap.simulate import (
    Factors,
    System,
    add_mass,
    build,
    felt_inertia,
    free_base,
    free_link,
    split_link,
)

Parameters = dict[str, Any]


FORWARD, INVERSE, FREE, RANDOM = "forward", "inverse", "free", "random"


FORMS = (FORWARD, INVERSE, FREE, RANDOM)
"""Commands to sensors, motion to torque, free response, random excitation of a held arm."""
MIXED = "mixed"
"""Runs of the first two forms in turn."""


@dataclasses.dataclass(kw_only=True)
class Readings:
    """What sensors may do to the signals; changed in place by effects of sensors."""

    rotation: Array = dataclasses.field(default_factory=lambda: np.eye(3))
    """Reading of the accelerometer = rotation @ truth, of shape (3, 3)."""
    gain: dict[str, float] = dataclasses.field(default_factory=dict)
    """Factor by sensor."""
    bias: dict[str, Array] = dataclasses.field(default_factory=dict)
    """Constant by sensor, of shape (1,) or (3,)."""
    delay: dict[str, float] = dataclasses.field(default_factory=dict)
    """Delay by sensor [s]."""
    step: dict[str, float] = dataclasses.field(default_factory=dict)
    """Step by sensor, to which its readings are rounded, noise and all."""
    torque: dict[int, float] = dataclasses.field(default_factory=dict)
    """Measured over true torque by number of the drive."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Place:
    """Where an effect sits."""

    name: str
    """Name in the model: of a joint, body, actuator or sensor; or `tool`, `base`, `all`."""
    index: int
    """Number of the joint or link from 0; -1 for `all`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of effect: where it can be, how large, and what it does to the true arm."""

    name: str
    """Identifier of the catalogue, or of an effect outside it."""
    places: Callable[[Figures], list[Place]]
    """Where it can sit on an arm."""
    draw: Callable[[np.random.Generator, Figures, Place], Parameters]
    """Everything about it but its size."""
    bounds: Callable[[Figures, Place], tuple[float, float]]
    """Least and largest size in the sense of physics."""
    size: Callable[[float, Parameters, Figures, Place], Parameters]
    """All its parameters, from a size and what was drawn; larger is easier to see."""
    apply: Callable[[System, Readings, Figures, Place, Parameters], None]
    """Change the arm or its sensors, in place."""
    forms: tuple[str, ...] = FORMS
    """Forms of recording that can show it."""
    rivals: tuple[str, ...] = ()
    """Kinds at the same joints that may explain most of it: it is sized by what they leave."""
    group: str = "catalogue"
    """`catalogue` or `outside`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """A kind at a place with its parameters."""

    kind: str
    place: Place
    parameters: Mapping[str, Any]


def joints(figures: Figures) -> list[Place]:
    """All joints."""
    return [Place(name=f"joint{i + 1}", index=i) for i in range(figures.joints)]


def hinges(figures: Figures) -> list[Place]:
    """All joints that turn."""
    return [p for p in joints(figures) if figures.links[p.index].kind == "hinge"]


def links(figures: Figures) -> list[Place]:
    """All links."""
    return [Place(name=f"link{i + 1}", index=i) for i in range(figures.joints)]


def bars(figures: Figures) -> list[Place]:
    """Links that are bars along their x axis."""
    return [p for p in links(figures) if figures.links[p.index].end[0] > 0.15]


def actuators(figures: Figures) -> list[Place]:
    """All actuators."""
    return [Place(name=f"motor{i + 1}", index=i) for i in range(figures.joints)]


def scalar(name: str) -> Callable[[float, Parameters, Figures, Place], Parameters]:
    """A size that is the parameter `name`, with the sign drawn as `sign` if there is one."""

    def parameters(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
        rest = {key: value for key, value in drawn.items() if key != "sign"}
        return {name: size * drawn.get("sign", 1.0), **rest}

    return parameters


def either_sign(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """Nothing but a sign."""
    return {"sign": float(rng.choice([-1.0, 1.0]))}


def nothing(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """No further parameters."""
    return {}


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two bounds, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


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
    """Give a degree of freedom a slightly progressive spring and a damper, in place."""
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
    """Give a degree of freedom a free travel `gap` between Hertzian stops, in place."""
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

JOINT_KINDS = (
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
    """Directions in which gravity or forces matter to an arm: rows, of shape (k, 3)."""
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


LINK_KINDS = (
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
