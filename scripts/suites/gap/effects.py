"""Effects that blind recordings hide: kinds, places and sizes, and a true arm changed by them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap import dynamics as of
from scripts.suites.gap.arms import Figures, Link
from scripts.suites.gap.dynamics import (
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

FORWARD, INVERSE, FREE, RANDOM = FORMS = ("forward", "inverse", "free", "random")
"""Commands to sensors, motion to torque, free response, random excitation of a held arm."""
MIXED = "mixed"
"""Runs of the first two forms in turn."""
ACCELEROMETER = "tool_acc"
"""Name of the accelerometer at the tool."""


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
class Effect:
    """A kind at a place with its parameters."""

    kind: str
    place: Place
    parameters: Mapping[str, Any]


Bounds = Callable[[Figures, Place], tuple[float, float]]
Draw = Callable[[np.random.Generator, Figures, Place], Parameters]
Size = Callable[[float, Parameters, Figures, Place], Parameters]
Apply = Callable[["At", Parameters], None]


def nothing(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """No further parameters."""
    return {}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of effect: where it can be, how large, and what it does to the true arm."""

    name: str
    """Identifier of the catalogue, or of an effect outside it."""
    places: Callable[[Figures], list[Place]]
    """Where it can sit on an arm."""
    bounds: Bounds
    """Least and largest size in the sense of physics."""
    size: Size
    """All its parameters, from a size and what was drawn; larger is easier to see."""
    apply: Apply
    """Change the arm or its sensors, in place."""
    draw: Draw = nothing
    """Everything about it but its size."""
    forms: tuple[str, ...] = FORMS
    """Forms of recording that can show it."""
    rivals: tuple[str, ...] = ()
    """Kinds at the same joints that may explain most of it: it is sized by what they leave."""


# --------------------------------------------------------------------------------- places


def joints(figures: Figures) -> list[Place]:
    """All joints."""
    return [Place(name=f"joint{i + 1}", index=i) for i in range(figures.joints)]


def hinges(figures: Figures) -> list[Place]:
    """All joints that turn."""
    return [p for p in joints(figures) if figures.links[p.index].kind == "hinge"]


def _named(words: str) -> Callable[[Figures], list[Place]]:
    """A place for each joint, by a name with its number."""
    return lambda figures: [Place(name=words.format(i + 1), index=i) for i in range(figures.joints)]


_links, _actuators = _named("link{}"), _named("motor{}")
_encoders, _speeds = _named("joint{}_pos"), _named("joint{}_vel")


def _one(name: str, index: int) -> Callable[[Figures], list[Place]]:
    return lambda figures: [Place(name=name, index=index % figures.joints if index else 0)]


_base, _accelerometer, _tool = _one("base", 0), _one(ACCELEROMETER, 0), _one("tool", -1)
_ALL = Place(name="all", index=-1)


def _bars(figures: Figures) -> list[Place]:
    """Links that are bars along their x axis."""
    return [p for p in _links(figures) if figures.links[p.index].end[0] > 0.15]


def _foot(figures: Figures) -> list[Place]:
    # a base that rocks about the axis of its first joint is that joint on a spring
    return _base(figures) if len(moved_axes(figures)) == 3 else []


def _offset_places(figures: Figures) -> list[Place]:
    # the zero of a first joint about the vertical, or of a slide, changes nothing that is measured
    upright = abs(figures.links[0].axis[2]) > 0.99
    return [place for place in hinges(figures) if place.index or not upright]


def _pairs(figures: Figures) -> list[Place]:
    return hinges(figures)[:-1]


# ---------------------------------------------------------------------------------- draws


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two bounds, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def either_sign(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """Nothing but a sign."""
    return {"sign": float(rng.choice([-1.0, 1.0]))}


SLIDE_SPEED = 0.2
"""Speed of a slide [m/s] that counts like 1 rad/s of a hinge."""


def _speed(figures: Figures, place: Place) -> float:
    return SLIDE_SPEED if figures.links[place.index].kind == "slide" else 1.0


def _rubbing(static: tuple[float, float], speeds: tuple[float, float] | None = None) -> Draw:
    def draw(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
        unit = _speed(figures, place)
        return {
            "smooth_speed": log_uniform(rng, 1e-3, 4e-3) * unit,
            "static": rng.uniform(*static),
            "speed": (log_uniform(rng, *speeds) if speeds else 0.05) * unit,
        }

    return draw


_draw_coulomb = _rubbing((1.0, 1.1))


def _draw_asymmetric(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    drawn = _draw_coulomb(rng, figures, place)
    return {**drawn, "side": float(rng.uniform(0.3, 0.8) * rng.choice([-1.0, 1.0]))}


def _draw_loaded(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    unit = _speed(figures, place)
    return {
        "static_ratio": rng.uniform(1.0, 1.6),
        "speed": log_uniform(rng, 0.03, 0.25) * unit,
        "smooth_speed": log_uniform(rng, 1e-3, 4e-3) * unit,
        "load_ratio": float(rng.choice([0.0, rng.uniform(0.2, 0.8)])),
    }


def _damped(ratio: tuple[float, float], stiffening: tuple[float, float]) -> Draw:
    return lambda rng, figures, place: {
        "damping_ratio": log_uniform(rng, *ratio), "stiffening": rng.uniform(*stiffening),
    }  # fmt: skip


def _draw_stops(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """Mode of a part pressed to a stop by its usual load [Hz], and how it is damped there."""
    return {"stop_mode": rng.uniform(90.0, 130.0), "stop_damping_ratio": rng.uniform(0.2, 0.5)}


def moved_axes(figures: Figures) -> Array:
    """Directions in which gravity or forces matter to an arm: rows, of shape (k, 3)."""
    axes = np.array([link.axis for link in figures.links])
    same = np.allclose(np.abs(axes @ axes[0]), 1.0)
    if same and all(link.kind == "hinge" for link in figures.links):
        return np.linalg.svd(axes[:1])[2][1:]
    return np.eye(3)


def _draw_direction(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    basis = moved_axes(figures)
    mix = rng.normal(size=len(basis)) @ basis
    return {"direction": (mix / np.linalg.norm(mix)).tolist()}


def _draw_turn(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    axis = rng.normal(size=3)
    return {"direction": (axis / np.linalg.norm(axis)).tolist()}


def _draw_looseness(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    direction = _draw_direction(rng, figures, place)
    friction = log_uniform(rng, 0.3, 3.0)
    return {**direction, "friction": friction, **_draw_stops(rng, figures, place)}


def _draw_flexibility(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    # mostly in the plane in which the joint drives it
    own = np.abs(figures.links[place.index].axis)
    axes = [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    axis = axes[int(np.argmax(own[1:]))]
    if len(moved_axes(figures)) == 3 and rng.random() < 0.3:
        axis = axes[1 - axes.index(axis)]
    place_on_link = rng.uniform(0.35, 0.6)
    damped = _damped((0.01, 0.05), (0.02, 0.08))(rng, figures, place)
    return {"axis": list(axis), "position": place_on_link, **damped}


PAYLOAD_OFF = 0.08
"""Furthest centre of a load from the tool [m]."""


def _draw_payload(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    """Centre of a load: at the tool, or as far off as a gripper is long."""
    off = rng.normal(size=3)
    off *= rng.choice([0.0, rng.uniform(0.01, PAYLOAD_OFF)]) / np.linalg.norm(off)
    return dict(zip("xyz", off.tolist(), strict=True))


def _draw_tilt(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    # only a tilt that turns gravity inside a planar arm's plane moves the arm
    if len(moved_axes(figures)) < 3:
        axis = np.abs(figures.links[0].axis) * rng.choice([-1.0, 1.0])
    else:
        angle = rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    return {"direction": axis.tolist()}


def _draw_base(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    axis = str(rng.choice(list("xy")))
    return {"axis": axis, **_damped((0.02, 0.1), (0.0, 0.05))(rng, figures, place)}


def _draw_ripple(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {
        "order": float(rng.integers(6, 25)),
        "phase": rng.uniform(-np.pi, np.pi),
        "second_harmonic": rng.uniform(0.0, 0.2),
    }


def _draw_spring(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    link = figures.links[place.index]
    return {
        "reference": link.home + rng.uniform(-1.5, 1.5) * link.reach,
        "stiffening": rng.uniform(0.0, 0.1),
    }


def _draw_voltage(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    # of the velocity gain this much is back-EMF
    return {"back_emf": rng.uniform(0.3, 1.0) * figures.links[place.index].kv}


def _draw_bias(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    draw = _draw_turn if place.name == ACCELEROMETER else either_sign
    return draw(rng, figures, place)


def _draw_cable(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    others = [p.index for p in hinges(figures) if p.index > place.index]
    return {
        "other": int(rng.choice(others)),
        "ratio": float(rng.uniform(0.6, 1.5) * rng.choice([-1.0, 1.0])),
        "slack": float(rng.uniform(-0.3, 0.3)),
    }


def _draw_fan(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    direction = _draw_direction(rng, figures, place)
    frequency = log_uniform(rng, 6.0, 40.0)
    return {**direction, "frequency": frequency, "phase": rng.uniform(-np.pi, np.pi)}


# --------------------------------------------------------------------------------- bounds

HIGHEST_MODE, LOWEST_MODE = 130.0, 12.0
"""Free modes that a compliance may have [Hz]: faster ones cannot be followed at 1 kHz, and
holding modes of real arms lie at 10 to 80 Hz."""
LEAST_TIME = 3e-4
"""Shortest lag or delay [s]: shorter ones only say on which side of a command's step a sample
was taken."""


def _within(low: float, high: float) -> Bounds:
    return lambda figures, place: (low, high)


def _share_of_limit(low: float, high: float, power: int = 0) -> Bounds:
    """Bounds as shares of the drive's limit over the joint's unit of speed to a power."""

    def bounds(figures: Figures, place: Place) -> tuple[float, float]:
        unit = figures.links[place.index].limit / _speed(figures, place) ** power
        return low * unit, high * unit

    return bounds


def _spring_bounds(system: System, dof: int, figures: Figures) -> tuple[float, float]:
    """Compliances whose free mode lies between `HIGHEST_MODE` and `LOWEST_MODE` [rad/(N m)]."""
    felt = felt_inertia(system, dof, figures.home)
    return tuple(1 / (felt * (2 * np.pi * mode) ** 2) for mode in (HIGHEST_MODE, LOWEST_MODE))  # type: ignore[return-value]


def _compliance_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    system = build(figures, Factors.ones(figures.joints))
    dof = free_link(system, place.index, "hinge", np.array(figures.links[place.index].axis))
    return _spring_bounds(system, dof, figures)


def _flexibility_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    system = build(figures, Factors.ones(figures.joints))
    link = figures.links[place.index]
    dof = split_link(system, place.index, 0.5 * np.array(link.end), np.array(link.axis), 0.52)
    return _spring_bounds(system, dof, figures)


def _base_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    system = build(figures, Factors.ones(figures.joints))
    return _spring_bounds(system, free_base(system, np.eye(3)[1]), figures)


def _of_link(bounds: Callable[[Any], tuple[float, float]]) -> Bounds:
    """Bounds by the numbers of the link and its drive."""
    return lambda figures, place: bounds(figures.links[place.index])


def _com_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    length = max(float(np.linalg.norm(figures.links[place.index].end)), 0.1)
    return 1e-4 * length, 0.35 * length


# ---------------------------------------------------------------------------------- sizes


def _scalar(name: str) -> Size:
    """A size that is the parameter `name`, with the sign drawn as `sign` if there is one."""

    def parameters(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
        rest = {key: value for key, value in drawn.items() if key != "sign"}
        return {name: size * drawn.get("sign", 1.0), **rest}

    return parameters


def _ratio(name: str) -> Size:
    """A size that is the distance of the parameter `name` from one."""
    return lambda size, drawn, figures, place: {name: 1.0 + drawn["sign"] * size}


def _vector(name: str, axes: str = "xyz") -> Size:
    """A size along a direction that was drawn."""

    def parameters(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
        whole = size * np.array(drawn["direction"])
        return {name: size, **dict(zip(axes, whole.tolist(), strict=False))}

    return parameters


def _softness(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"stiffness": 1.0 / size, **drawn}


def _size_friction(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {
        "torque": size,
        "static_torque": size * drawn["static"],
        "speed": drawn["speed"],
        "smooth_speed": drawn["smooth_speed"],
    }


def _size_asymmetric(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    sides = {"forward": size * (1 + drawn["side"]), "backward": size * (1 - drawn["side"])}
    return {**_size_friction(size, drawn, figures, place), **sides}


def _size_mass(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    mass = figures.links[place.index].mass
    return {"mass": drawn["sign"] * size * mass, "ratio": 1.0 + drawn["sign"] * size}


def _size_limit(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"limit": figures.links[place.index].limit / size}


def _size_voltage(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    stall = figures.links[place.index].limit / size
    return {"stall_torque": stall, "no_load_speed": stall / drawn["back_emf"], **drawn}


def _size_eccentric(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    phase = drawn["phase"]
    return {
        "amplitude": size,
        "sine": float(size * np.cos(phase)),
        "cosine": float(size * np.sin(phase)),
    }


def _size_bias(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    if "sign" in drawn:
        return {"bias": drawn["sign"] * size}
    return _vector("size")(size, drawn, figures, place)


# ------------------------------------------------------------------- changes of the true arm


@dataclasses.dataclass(frozen=True)
class At:
    """The true arm and its sensors, to be changed at a place."""

    system: System
    readings: Readings
    figures: Figures
    place: Place

    @property
    def link(self) -> Link:
        """Nominal link."""
        return self.figures.links[self.place.index]

    @property
    def law(self) -> Array:
        """Laws of a joint's motor side, to be written to."""
        return self.system.laws[int(self.system.drives[self.place.index, 0])]  # type: ignore[no-any-return]

    @property
    def body(self) -> Array:
        """Numbers of the body at a link's proximal end, to be written to."""
        return self.system.bodies[int(self.system.proximal[self.place.index])]  # type: ignore[no-any-return]

    @property
    def drive(self) -> Array:
        """Columns of a drive, or of all drives, to be written to."""
        return self.system.drives[slice(None) if self.place.index < 0 else self.place.index].T


def _writes(row: str, constants: Mapping[int, float] | None = None, **columns: int) -> Apply:
    """Write parameters into columns of a row, and constants."""

    def apply(at: At, p: Parameters) -> None:
        for column, value in (constants or {}).items():
            getattr(at, row)[column] = value
        for name, column in columns.items():
            getattr(at, row)[column] = p[name]

    return apply


def _adds(row: str, **columns: int) -> Apply:
    def apply(at: At, p: Parameters) -> None:
        for name, column in columns.items():
            getattr(at, row)[column] += p[name]

    return apply


def _reads(part: str, name: str, *, by_index: bool = False) -> Apply:
    """Write a parameter into a part of the readings."""

    def apply(at: At, p: Parameters) -> None:
        getattr(at.readings, part)[at.place.index if by_index else at.place.name] = p[name]

    return apply


def _viscous(at: At, p: Parameters) -> None:
    # oil thins a little with speed
    law = at.law
    law[of.EXTRA] += p["damping"]
    law[of.THINNING] = 6.0 * _speed(at.figures, at.place)


def _friction(at: At, p: Parameters) -> None:
    law = at.law
    law[of.FRICTION], law[of.BUMP] = p["torque"], p["static_torque"] / p["torque"] - 1.0
    law[of.STRIBECK_SPEED], law[of.SMOOTH_SPEED] = p["speed"], p["smooth_speed"]
    if "forward" in p:
        law[of.ASYMMETRY] = p["forward"] / p["torque"] - 1.0


def _set_spring(system: System, dof: int, figures: Figures, load: float, p: Parameters) -> None:
    """Give a degree of freedom a slightly progressive spring and a damper, in place."""
    law = system.laws[dof]
    law[of.STIFFNESS] = p["stiffness"]
    law[of.PROGRESS] = p["stiffening"] / (load / p["stiffness"]) ** 2
    felt = felt_inertia(system, dof, figures.home)
    law[of.DAMPING] = 2 * p["damping_ratio"] * np.sqrt(p["stiffness"] * felt)


def _compliance(at: At, p: Parameters) -> None:
    link = at.link
    dof = free_link(at.system, at.place.index, "hinge", np.array(link.axis))
    _set_spring(at.system, dof, at.figures, 0.5 * link.limit, p)


def _set_stops(system: System, dof: int, figures: Figures, load: float, p: Parameters) -> None:
    """Give a degree of freedom a free travel `gap` between Hertzian stops, in place."""
    law = system.laws[dof]
    law[of.GAP_LOW], law[of.GAP_HIGH] = -p["gap"] / 2, p["gap"] / 2
    felt = felt_inertia(system, dof, figures.home)
    stiffness = felt * (2 * np.pi * p["stop_mode"]) ** 2
    # tangent of h d^1.5 at h d^1.5 = load: 1.5 h^(2/3) load^(1/3)
    law[of.HERTZ] = (stiffness / (1.5 * load ** (1 / 3))) ** 1.5
    law[of.CROSSLEY] = 2 * p["stop_damping_ratio"] * np.sqrt(stiffness * felt) / load


def _backlash(at: At, p: Parameters) -> None:
    link = at.link
    dof = free_link(at.system, at.place.index, "hinge", np.array(link.axis))
    _set_stops(at.system, dof, at.figures, 0.1 * link.limit, p)
    # grease between the flanks
    at.system.laws[dof, of.DAMPING] = 0.05 * link.damping


STOP_LOAD = 30.0
"""Force that usually presses a loose seat to its stops [N]."""
SEAT_DAMPING = 5.0
"""Damping of a loose seat's guide [N s/m]."""


def _looseness(at: At, p: Parameters) -> None:
    dof = free_link(at.system, at.place.index, "slide", np.array(p["direction"]))
    _set_stops(at.system, dof, at.figures, STOP_LOAD, p)
    law = at.system.laws[dof]
    law[of.DAMPING], law[of.FRICTION] = SEAT_DAMPING, p["friction"]
    law[of.SMOOTH_SPEED], law[of.STRIBECK_SPEED] = 2e-3, 0.01


def _flexibility(at: At, p: Parameters) -> None:
    link = at.link
    point = p["position"] * np.array(link.end)
    # a bar that is a little heavier near its joint has its middle of mass at 0.48 of its length
    share = p["position"] * (1 + 0.08 * (1 - p["position"]))
    dof = split_link(at.system, at.place.index, point, np.array(p["axis"]), share)
    _set_spring(at.system, dof, at.figures, 0.5 * link.limit, p)


def _on_a_spring(at: At, p: Parameters) -> None:
    dof = free_base(at.system, np.eye(3)["xy".index(p["axis"])])
    _set_spring(at.system, dof, at.figures, 0.5 * at.figures.links[0].limit, p)


def _rotor(at: At, p: Parameters) -> None:
    at.system.bodies[int(at.system.drives[at.place.index, 0]), of.ARMATURE] += p["inertia"]


def _spring(at: At, p: Parameters) -> None:
    law = at.law
    law[of.STIFFNESS], law[of.REST] = p["stiffness"], p["reference"]
    law[of.PROGRESS] = p["stiffening"] / at.link.reach**2


def _mass(at: At, p: Parameters) -> None:
    row = at.body
    row[of.MASS] *= p["ratio"]
    row[of.INERTIA : of.INERTIA + 9] *= p["ratio"]


def _com(at: At, p: Parameters) -> None:
    at.system.bodies[int(at.system.proximal[at.place.index]), 8:11] += (p["x"], p["y"], p["z"])


def _payload(at: At, p: Parameters) -> None:
    centre = np.array([p["x"], p["y"], p["z"]])
    add_mass(at.system, len(at.system.bodies) - 1, p["mass"], at.system.tool + centre)


def rotation(vector: Array) -> Array:
    """Rotation matrix of a rotation vector, of shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross  # type: ignore[no-any-return]


def _tilt(at: At, p: Parameters) -> None:
    # the base is turned by (x, y, 0) in the world, so gravity turns backwards in its frame
    at.system.gravity = rotation(-np.array([p["x"], p["y"], 0.0])) @ at.system.gravity


def _gain(at: At, p: Parameters) -> None:
    at.system.drives[at.place.index, of.GAIN] *= p["gain"]


def _loaded(at: At, p: Parameters) -> None:
    row = at.drive
    row[of.LOADED], row[of.LOADED_BUMP] = p["share"], p["static_ratio"] - 1.0
    row[of.LOADED_SPEED], row[of.LOADED_SMOOTH] = p["speed"], p["smooth_speed"]
    row[of.LOADED_EXTERNAL] = p["load_ratio"] * p["share"]


def _turn(at: At, p: Parameters) -> None:
    # the sensor is turned by (x, y, z) in the tool's frame
    at.readings.rotation = rotation(np.array([p["x"], p["y"], p["z"]])).T @ at.readings.rotation


def _bias(at: At, p: Parameters) -> None:
    value = [p["bias"]] if "bias" in p else [p["x"], p["y"], p["z"]]
    at.readings.bias[at.place.name] = np.array(value)


def _cable(at: At, p: Parameters) -> None:
    other, ratio, home = p["other"], p["ratio"], at.figures.home
    rest = home[at.place.index] + ratio * home[other] + p["slack"]
    dofs = at.system.joint_dofs
    at.system.cable = np.array([dofs[at.place.index], dofs[other], ratio, p["stiffness"], rest])


def _fan(at: At, p: Parameters) -> None:
    push = p["force"] * np.array(p["direction"])
    at.system.fan = np.array([*push, p["frequency"], p["phase"]])


# ---------------------------------------------------------------------------------- kinds

_THIN = {of.SMOOTH_SPEED: 3e-3, of.STRIBECK_SPEED: 0.1}

_CATALOGUE = (
    Kind(name="viscous_friction", places=joints, bounds=_share_of_limit(1e-5, 0.15, 1),
         size=_scalar("damping"), apply=_viscous),
    Kind(name="coulomb_friction", places=joints, draw=_draw_coulomb,
         bounds=_share_of_limit(2e-5, 0.12), size=_size_friction, apply=_friction),
    Kind(name="stribeck_friction", places=joints, draw=_rubbing((1.4, 2.2), (0.03, 0.25)),
         bounds=_share_of_limit(2e-5, 0.12), size=_size_friction, apply=_friction,
         rivals=("coulomb_friction",), forms=(FORWARD, INVERSE, FREE)),
    Kind(name="quadratic_drag", places=joints, bounds=_share_of_limit(1e-5, 0.15, 2),
         size=_scalar("drag"), apply=_adds("law", drag=of.DRAG),
         rivals=("viscous_friction",), forms=(FORWARD, INVERSE, FREE)),
    Kind(name="joint_compliance", places=hinges, draw=_damped((0.02, 0.08), (0.03, 0.12)),
         bounds=_compliance_bounds, size=_softness, apply=_compliance),
    Kind(name="backlash", places=hinges, draw=_draw_stops, bounds=_within(3e-4, 0.02),
         size=_scalar("gap"), apply=_backlash, forms=(FORWARD, INVERSE, RANDOM)),
    Kind(name="structural_looseness", places=_links, draw=_draw_looseness,
         bounds=_within(2e-5, 5e-4), size=_scalar("gap"), apply=_looseness,
         forms=(FORWARD, RANDOM)),
    Kind(name="link_flexibility", places=_bars, draw=_draw_flexibility,
         bounds=_flexibility_bounds, size=_softness, apply=_flexibility, forms=(FORWARD, RANDOM)),
    Kind(name="link_mass", places=_links, draw=either_sign, bounds=_within(0.01, 0.6),
         size=_size_mass, apply=_mass),
    Kind(name="link_com", places=_links, draw=_draw_direction, bounds=_com_bounds,
         size=_vector("shift"), apply=_com),
    Kind(name="payload", places=_tool, draw=_draw_payload,
         bounds=_of_link(lambda link: (1e-3 * link.mass, 1.0 * link.mass)),
         size=_scalar("mass"), apply=_payload),
    Kind(name="rotor_inertia", places=joints,
         bounds=_of_link(lambda link: (0.01 * link.armature, 4.0 * link.armature)),
         size=_scalar("inertia"), apply=_rotor),
    Kind(name="actuator_gain", places=_actuators, draw=either_sign, bounds=_within(0.01, 0.6),
         size=_ratio("gain"), apply=_gain, forms=(FORWARD, INVERSE)),
    Kind(name="actuator_lag", places=_actuators, bounds=_within(LEAST_TIME, 0.1),
         size=_scalar("time"), apply=_writes("drive", time=of.LAG), forms=(FORWARD, RANDOM)),
    # a bus delays all drives alike: as likely as one of them
    Kind(name="command_delay", places=lambda f: _actuators(f) + [_ALL] * f.joints,
         bounds=_within(LEAST_TIME, 0.06), size=_scalar("delay"),
         apply=_adds("drive", delay=of.DELAY), forms=(FORWARD, RANDOM)),
    # the servo closes on the shifted reading too
    Kind(name="encoder_offset", places=_offset_places, draw=either_sign,
         bounds=_of_link(lambda link: (1e-5, 0.25 * link.reach)), size=_scalar("offset"),
         apply=_adds("drive", offset=of.OFFSET), forms=(FORWARD, INVERSE, FREE)),
    Kind(name="sensor_misalignment", places=_accelerometer, draw=_draw_turn,
         bounds=_within(1e-5, 0.35), size=_vector("angle"), apply=_turn, forms=(FORWARD, RANDOM)),
    Kind(name="sensor_gain", places=lambda f: _accelerometer(f) * 2 + _speeds(f),
         draw=either_sign, bounds=_within(1e-4, 0.4), size=_ratio("gain"),
         apply=_reads("gain", "gain"), forms=(FORWARD, RANDOM)),
    Kind(name="sensor_bias", places=lambda f: _accelerometer(f) * 2 + _speeds(f), draw=_draw_bias,
         bounds=lambda f, place: (1e-4, 1.5) if place.name == ACCELEROMETER else (1e-6, 0.05),
         size=_size_bias, apply=_bias, forms=(FORWARD, FREE)),
    Kind(name="sensor_delay", places=lambda f: _accelerometer(f) * 3 + _speeds(f) + _encoders(f),
         bounds=_within(LEAST_TIME, 0.04), size=_scalar("delay"), apply=_reads("delay", "delay"),
         forms=(FORWARD, RANDOM)),
    Kind(name="base_tilt", places=_base, draw=_draw_tilt, bounds=_within(1e-5, 0.15),
         size=_vector("angle", "xy"), apply=_tilt, forms=(FORWARD, INVERSE, FREE)),
    Kind(name="torque_ripple", places=hinges, draw=_draw_ripple, bounds=_share_of_limit(2e-5, 0.1),
         size=_scalar("amplitude"),
         apply=_writes("law", amplitude=of.RIPPLE, order=of.ORDER, phase=of.PHASE,
                       second_harmonic=of.SECOND), forms=(FORWARD, INVERSE)),
    Kind(name="joint_spring", places=joints, draw=_draw_spring,
         bounds=_of_link(lambda link: (1e-4 * link.limit / link.reach,
                                       0.25 * link.limit / link.reach)),
         size=_scalar("stiffness"), apply=_spring, forms=(FORWARD, INVERSE, FREE)),
    Kind(name="load_friction", places=joints, draw=_draw_loaded, bounds=_within(0.005, 0.7),
         size=_scalar("share"), apply=_loaded, forms=(FORWARD, INVERSE),
         rivals=("coulomb_friction",)),
    Kind(name="asymmetric_friction", places=joints, draw=_draw_asymmetric,
         bounds=_share_of_limit(2e-5, 0.12), size=_size_asymmetric, apply=_friction,
         rivals=("coulomb_friction",), forms=(FORWARD, INVERSE, FREE)),
    Kind(name="torque_limit", places=_actuators, bounds=_within(1.05, 20.0), size=_size_limit,
         apply=_writes("drive", limit=of.LIMIT), forms=(FORWARD,)),
    Kind(name="voltage_limit", places=_actuators, draw=_draw_voltage, bounds=_within(1.05, 20.0),
         size=_size_voltage, apply=_writes("drive", stall_torque=of.LIMIT, back_emf=of.BACK_EMF),
         forms=(FORWARD,), rivals=("torque_limit",)),
    Kind(name="dead_zone", places=_actuators,
         bounds=_of_link(lambda link: (1e-6 * link.limit / link.kp, 0.3 * link.limit / link.kp)),
         size=_scalar("width"), apply=_writes("drive", width=of.DEAD), forms=(FORWARD,)),
    Kind(name="gravity_compensation", places=_links, draw=either_sign, bounds=_within(1e-4, 0.9),
         size=_scalar("share"),
         apply=_adds("body", share=of.CARRIED),
         forms=(FORWARD, INVERSE, FREE)),
    Kind(name="torque_constant", places=joints, draw=either_sign, bounds=_within(0.005, 0.5),
         size=_ratio("factor"), apply=_reads("torque", "factor", by_index=True),
         forms=(INVERSE,)),
    Kind(name="base_compliance", places=_foot, draw=_draw_base, bounds=_base_bounds,
         size=_softness, apply=_on_a_spring, forms=(FORWARD, RANDOM)),
    Kind(name="gear_eccentricity", places=hinges,
         draw=lambda rng, f, place: {"phase": rng.uniform(-np.pi, np.pi)},
         bounds=_within(1e-5, 0.03), size=_size_eccentric,
         apply=_writes("drive", sine=of.ECCENTRIC_SINE, cosine=of.ECCENTRIC_COSINE),
         forms=(FORWARD,), rivals=("encoder_offset",)),
    Kind(name="sensor_quantisation", places=_encoders, bounds=_within(1e-4, 0.05),
         size=_scalar("step"), apply=_reads("step", "step"), forms=(FORWARD,)),
)  # fmt: skip

_OUTSIDE = (
    Kind(name="warming_friction", places=hinges,
         draw=lambda rng, f, place: {"warm_time": log_uniform(rng, 1.5, 4.0)},
         bounds=_share_of_limit(1e-4, 0.2), size=_scalar("torque"),
         apply=_writes("law", _THIN, torque=of.FRICTION, warm_time=of.WARM_TIME),
         forms=(FORWARD,), rivals=("coulomb_friction", "viscous_friction")),
    Kind(name="cable_coupling", places=_pairs, draw=_draw_cable, bounds=_share_of_limit(1e-4, 0.3),
         size=_scalar("stiffness"), apply=_cable, forms=(FORWARD,), rivals=("joint_spring",)),
    Kind(name="shaking_force", places=_tool, draw=_draw_fan, bounds=_share_of_limit(1e-5, 1.0),
         size=_scalar("force"), apply=_fan, forms=(FORWARD,)),
    Kind(name="voltage_sag", places=lambda f: [_ALL], bounds=_within(1e-3, 2.0),
         size=_scalar("sag"), apply=_writes("drive", sag=of.SAG), forms=(FORWARD,),
         rivals=("actuator_gain",)),
    # a bent shaft rubs in some angles and runs free in others
    Kind(name="tight_spots", places=hinges,
         draw=lambda rng, f, place: {
             "waves": float(rng.integers(3, 9)), "phase": rng.uniform(-np.pi, np.pi)},
         bounds=_share_of_limit(1e-4, 0.3), size=_scalar("torque"),
         apply=_writes("law", _THIN, torque=of.FRICTION, waves=of.GRAIN, phase=of.GRAIN + 1),
         forms=(FORWARD,), rivals=("coulomb_friction", "asymmetric_friction")),
    Kind(name="drive_hysteresis", places=joints,
         draw=lambda rng, f, place: {
             "stroke": rng.uniform(0.25, 0.6) * f.links[place.index].reach},
         bounds=_share_of_limit(1e-5, 0.15), size=_scalar("torque"),
         apply=_writes("law", torque=of.HYSTERESIS, stroke=of.STROKE), forms=(FORWARD,),
         rivals=("coulomb_friction", "joint_spring")),
)  # fmt: skip

KINDS = {kind.name: kind for kind in (*_CATALOGUE, *_OUTSIDE)}
"""All kinds by name: the catalogue in the order of its table, then those outside it."""
CATALOGUE = tuple(kind.name for kind in _CATALOGUE)
"""Identifiers of the catalogue."""
OUTSIDE = tuple(kind.name for kind in _OUTSIDE)
"""Effects that the catalogue does not have."""


def apply_effect(effect: Effect, system: System, readings: Readings, figures: Figures) -> None:
    """Change an arm and its sensors by an effect, in place."""
    KINDS[effect.kind].apply(At(system, readings, figures, effect.place), dict(effect.parameters))
