"""Effects that blind recordings hide: places, plausible sizes, and a true arm changed by them.

Parameters have the names that results of `loose gap` give them; the others are laws of this
generator alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap import dynamics as of
from scripts.suites.gap.arms import BAR_CENTRE, Figures, Link
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
SERVO, TORQUE, FREE = FORMS = ("servo", "torque", "free")
"""Commands to sensors, motion to torque, free response."""
MOVED = (SERVO,)
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
    offset: dict[int, float] = dataclasses.field(default_factory=dict)
    """Constant of the measured torque by number of the drive [N m or N]."""
    straight: bool = False
    """Whether the drives go in straight lines from command to command."""


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
    runs: tuple[int, ...] = ()
    """Runs in which it is there, from 0; all of them if none is given."""


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


SLIDE_SPEED = 0.2
"""Speed of a slide [m/s] that counts like 1 rad/s of a hinge."""


@dataclasses.dataclass(frozen=True)
class Spot:
    """A place on a machine where an effect is drawn, and the generator that draws it."""

    figures: Figures
    place: Place
    rng: np.random.Generator = dataclasses.field(default_factory=np.random.default_rng)

    @property
    def link(self) -> Link:
        """Nominal link."""
        return self.figures.links[self.place.index]

    @property
    def speed(self) -> float:
        """Speed that counts like 1 rad/s [rad/s or m/s]."""
        return SLIDE_SPEED if self.link.kind == "slide" else 1.0

    def sign(self) -> float:
        """Either sign."""
        return float(self.rng.choice([-1.0, 1.0]))

    def uniform(self, low: float, high: float) -> float:
        """A number between two bounds."""
        return float(self.rng.uniform(low, high))

    def direction(self, basis: Array | None = None) -> Array:
        """A unit vector, by default one in which gravity or forces matter."""
        basis = moved_axes(self.figures) if basis is None else basis
        mix = self.rng.normal(size=len(basis)) @ basis
        return np.asarray(mix / np.linalg.norm(mix))


Span = Callable[[Spot], tuple[float, float]]
Make = Callable[[float, Spot], Parameters]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of effect: where it can be, how large, and what it does to the true arm."""

    name: str
    """Identifier of the catalogue, or of an effect outside it."""
    places: Callable[[Figures], list[Place]]
    """Where it can sit on an arm."""
    span: Span
    """Least and largest size that machines have and that is outside tolerances."""
    make: Make
    """All its parameters, from a size; larger is easier to see."""
    apply: Callable[[At, Parameters], None]
    """Change the arm or its sensors, in place."""
    forms: tuple[str, ...] = FORMS
    """Forms of recording that can show it."""
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Parameters that a result has too, and their units: T a torque or force, A an angle or way."""


# --------------------------------------------------------------------------------- places


def joints(figures: Figures) -> list[Place]:
    """All joints."""
    return _named("joint{}")(figures)


def hinges(figures: Figures) -> list[Place]:
    """All joints that turn."""
    return [p for p in joints(figures) if figures.links[p.index].kind == "hinge"]


def _named(words: str) -> Callable[[Figures], list[Place]]:
    """A place for each joint, by a name with its number."""
    return lambda figures: [Place(name=words.format(i + 1), index=i) for i in range(figures.joints)]


_links, _motors = _named("link{}"), _named("motor{}")
_encoders, _speeds = _named("joint{}_pos"), _named("joint{}_vel")
ALL, _BASE = Place(name="all", index=-1), Place(name="base", index=0)
_TOOL_ACC = Place(name=ACCELEROMETER, index=0)


def _tool(figures: Figures) -> list[Place]:
    return [Place(name="tool", index=figures.joints - 1)]


def _inertial(figures: Figures) -> list[Place]:
    return [_TOOL_ACC] * 2 + _speeds(figures)


def _bars(figures: Figures) -> list[Place]:
    """Links that are bars along their x axis, with their mass around the middle."""
    return [
        place
        for place, link in zip(_links(figures), figures.links, strict=True)
        if link.end[0] > 0.12 and np.isclose(link.com[0], BAR_CENTRE * link.end[0])
    ]


def _foot(figures: Figures) -> list[Place]:
    # a base that rocks about the axis of its first joint is that joint on a spring
    return [_BASE] if len(moved_axes(figures)) == 3 else []


def _tilting(figures: Figures) -> list[Place]:
    return [_BASE] if hinges(figures) else []


def _offset_places(figures: Figures) -> list[Place]:
    # the zero of a first joint about the vertical, or of a slide, changes nothing that is measured
    upright = abs(figures.links[0].axis[2]) > 0.99
    return [place for place in hinges(figures) if place.index or not upright]


def _weighed(figures: Figures) -> list[Place]:
    """Links whose weight some joint carries."""
    system, found = build(figures, Factors.ones(figures.joints)), []
    for place in _links(figures):
        bare = system.copy()
        bare.bodies[place.index, of.MASS] *= 0.5
        loads = [of.at_rest(each, figures.home + 0.3)[1] for each in (system, bare)]
        found += [place] * bool(np.abs(loads[0] - loads[1]).max() > 0.02 * figures.links[0].limit)
    return found


def moved_axes(figures: Figures) -> Array:
    """Directions in which gravity or forces matter to an arm: rows, of shape (k, 3)."""
    axes = np.array([link.axis for link in figures.links])
    if np.allclose(np.abs(axes @ axes[0]), 1.0) and figures.links[0].kind == "hinge":
        return np.linalg.svd(axes[:1])[2][1:]
    return np.eye(3)


# ----------------------------------------------------------------------- sizes and parameters

HIGHEST_MODE, LOWEST_MODE = 60.0, 12.0
"""Free modes that a compliance may have [Hz]: holding modes of real arms lie at 10 to 80 Hz."""


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two bounds, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _within(low: float, high: float) -> Span:
    return lambda at: (low, high)


def _of_link(low: float, high: float, unit: Callable[[Link], float], power: int = 0) -> Span:
    """Bounds as shares of a number of the link, over the joint's unit of speed to a power."""
    return lambda at: (
        low * unit(at.link) / at.speed**power, high * unit(at.link) / at.speed**power,
    )  # fmt: skip


def _of_limit(low: float, high: float, power: int = 0) -> Span:
    return _of_link(low, high, lambda link: link.limit, power)


def _springs(free: Callable[[System, Spot], int]) -> Span:
    """Compliances whose free mode lies between `HIGHEST_MODE` and `LOWEST_MODE` [rad/(N m)]."""

    def span(at: Spot) -> tuple[float, float]:
        system = build(at.figures, Factors.ones(at.figures.joints))
        felt = felt_inertia(system, free(system, at), at.figures.home)
        low, high = (1 / (felt * (2 * np.pi * f) ** 2) for f in (HIGHEST_MODE, LOWEST_MODE))
        return low, high

    return span


def _free_joint(system: System, at: Spot | At) -> int:
    return free_link(system, at.place.index, "hinge", np.array(at.link.axis))


def _free_half(system: System, at: Spot) -> int:
    end, axis = np.array(at.link.end), np.array(at.link.axis)
    return split_link(system, at.place.index, 0.5 * end, axis, 0.52)


def _just(name: str) -> Make:
    return lambda size, at: {name: size}


def _signed(name: str, neutral: float = 0.0) -> Make:
    return lambda size, at: {name: neutral + at.sign() * size}


def _along(*names: str, every: bool = False) -> Make:
    """A vector of the size in a random direction, of those that matter or of all."""
    return lambda size, at: dict(
        zip(names, (size * at.direction(np.eye(3) if every else None)).tolist(), strict=True)
    )


def _rubbing(ratio: tuple[float, float], speeds: tuple[float, float] = (0.05, 0.05)) -> Make:
    return lambda size, at: {
        "torque": size, "static_ratio": at.uniform(*ratio),
        "speed": log_uniform(at.rng, *speeds) * at.speed,
        "smooth_speed": log_uniform(at.rng, 1e-3, 4e-3) * at.speed,
    }  # fmt: skip


def _make_asymmetric(size: float, at: Spot) -> Parameters:
    side = at.uniform(0.35, 0.8) * at.sign()
    sides = {"forward": size * (1 + side), "backward": size * (1 - side)}
    return {**_rubbing((1.0, 1.1))(size, at), **sides}


def _make_loaded(size: float, at: Spot) -> Parameters:
    return {**_rubbing((1.0, 1.2), (0.03, 0.25))(size, at), "share": size, "load_ratio": 0.0}


def _softness(ratio: tuple[float, float], stiffening: tuple[float, float]) -> Make:
    return lambda size, at: {
        "stiffness": 1.0 / size, "damping_ratio": log_uniform(at.rng, *ratio),
        "stiffening": at.uniform(*stiffening),
    }  # fmt: skip


def _make_stops(size: float, at: Spot) -> Parameters:
    """Free travel, mode of a part pressed to a stop by its usual load [Hz], its damping there."""
    mode, ratio = at.uniform(90.0, 130.0), at.uniform(0.2, 0.5)
    return {"gap": size, "stop_mode": mode, "stop_damping_ratio": ratio}


def _make_looseness(size: float, at: Spot) -> Parameters:
    seat = {"direction": at.direction().tolist(), "friction": log_uniform(at.rng, 0.3, 3.0)}
    return {**seat, **_make_stops(size, at)}


def _make_flexibility(size: float, at: Spot) -> Parameters:
    # in the plane in which the joint drives it
    own = np.abs(at.link.axis)
    axis = [0.0, 1.0, 0.0] if own[1] >= own[2] else [0.0, 0.0, 1.0]
    soft = _softness((0.01, 0.05), (0.02, 0.08))(size, at)
    return {"axis": axis, "position": at.uniform(0.35, 0.6), **soft}


def _make_payload(size: float, at: Spot) -> Parameters:
    # its centre at the tool, or as far off as a gripper is long
    off = at.rng.choice([0.0, at.uniform(0.01, 0.08)]) * at.direction(np.eye(3))
    return {"mass": size, **dict(zip("xyz", off.tolist(), strict=True))}


def _make_tilt(size: float, at: Spot) -> Parameters:
    # only a tilt that turns gravity inside a planar arm's plane moves the arm
    angle = at.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    own = np.abs(at.figures.links[0].axis)
    if len(moved_axes(at.figures)) < 3 and own[2] < 0.5:
        axis = own * at.sign()
    return {"tilt_x": float(size * axis[0]), "tilt_y": float(size * axis[1])}


def _make_ripple(size: float, at: Spot) -> Parameters:
    return {
        "amplitude": size, "periods": float(at.rng.integers(6, 25)),
        "phase": at.uniform(-np.pi, np.pi), "second_harmonic": at.uniform(0.0, 0.2),
    }  # fmt: skip


def _make_spring(size: float, at: Spot) -> Parameters:
    reference = at.link.home + at.uniform(-1.5, 1.5) * at.link.reach
    return {"stiffness": size, "reference": reference, "stiffening": at.uniform(0.0, 0.1)}


def _make_voltage(size: float, at: Spot) -> Parameters:
    stall = at.link.limit / size  # of the velocity gain a part is back-EMF
    return {"stall_torque": stall, "no_load_speed": stall / (at.uniform(0.3, 1.0) * at.link.kv)}


def _make_eccentric(size: float, at: Spot) -> Parameters:
    phase = at.uniform(-np.pi, np.pi)
    return {"sine": float(size * np.cos(phase)), "cosine": float(size * np.sin(phase))}


def _make_bias(size: float, at: Spot) -> Parameters:
    if at.place.name != ACCELEROMETER:
        return {"bias": 0.05 * at.sign() * size * at.speed}
    return _along("bias_x", "bias_y", "bias_z", every=True)(size, at)


def _make_slack(size: float, at: Spot) -> Parameters:
    slack = at.uniform(0.05, 0.25) * at.link.reach
    return {"torque": size, "slack": slack, "elastic": at.uniform(0.1, 0.4) * slack}


def _make_cable(size: float, at: Spot) -> Parameters:
    others = [p.index for p in hinges(at.figures) if p.index > at.place.index]
    return {
        "stiffness": size, "other": int(at.rng.choice(others)),
        "ratio": at.uniform(0.6, 1.5) * at.sign(), "slack": at.uniform(-0.3, 0.3),
    }  # fmt: skip


def _make_fan(size: float, at: Spot) -> Parameters:
    return {
        "force": size, "direction": at.direction().tolist(),
        "frequency": log_uniform(at.rng, 3.0, 12.0), "phase": at.uniform(-np.pi, np.pi),
    }  # fmt: skip


# ------------------------------------------------------------------- changes of the true arm


def _writes(row: str, constants: Mapping[int, float] | None = None, **columns: int) -> Any:
    """Write parameters into columns of a row, and constants."""

    def apply(at: At, p: Parameters) -> None:
        for column, value in (constants or {}).items():
            getattr(at, row)[column] = value
        for name, column in columns.items():
            getattr(at, row)[column] = p[name]

    return apply


def _adds(row: str, **columns: int) -> Any:
    def apply(at: At, p: Parameters) -> None:
        for name, column in columns.items():
            getattr(at, row)[column] += p[name]

    return apply


def _reads(part: str, name: str) -> Any:
    """Write a parameter into a part of the readings."""

    def apply(at: At, p: Parameters) -> None:
        getattr(at.readings, part)[at.place.name] = p[name]

    return apply


def _constant(at: At, p: Parameters) -> None:
    torque = at.readings.torque
    torque[at.place.index] = torque.get(at.place.index, 1.0) * p["factor"]


def _zero_torque(at: At, p: Parameters) -> None:
    offset = at.readings.offset
    offset[at.place.index] = offset.get(at.place.index, 0.0) + p["torque"]


def _viscous(at: At, p: Parameters) -> None:
    # oil thins a little with speed
    law = at.law
    law[of.EXTRA] += p["damping"]
    law[of.THINNING] = 6.0 * Spot(at.figures, at.place).speed


def _friction(at: At, p: Parameters) -> None:
    law = at.law
    law[of.FRICTION], law[of.BUMP] = p["torque"], p["static_ratio"] - 1.0
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
    dof = _free_joint(at.system, at)
    _set_spring(at.system, dof, at.figures, 0.5 * at.link.limit, p)


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
    dof = _free_joint(at.system, at)
    _set_stops(at.system, dof, at.figures, 0.1 * at.link.limit, p)
    # grease between the flanks
    at.system.laws[dof, of.DAMPING] = 0.05 * at.link.damping


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
    point = p["position"] * np.array(at.link.end)
    # a bar that is a little heavier near its joint has its middle of mass at 0.48 of its length
    share = p["position"] * (1 + 0.08 * (1 - p["position"]))
    dof = split_link(at.system, at.place.index, point, np.array(p["axis"]), share)
    _set_spring(at.system, dof, at.figures, 0.5 * at.link.limit, p)


def _on_a_spring(at: At, p: Parameters) -> None:
    dof = free_base(at.system, np.eye(3)["xy".index(p["axis"])])
    _set_spring(at.system, dof, at.figures, 0.5 * at.figures.links[0].limit, p)


def _rotor(at: At, p: Parameters) -> None:
    at.system.bodies[int(at.system.drives[at.place.index, 0]), of.ARMATURE] += p["inertia"]


def _spring(at: At, p: Parameters) -> None:
    law = at.law
    law[of.STIFFNESS], law[of.REST] = p["stiffness"], p["reference"]
    farthest = abs(at.link.home - p["reference"]) + at.link.reach
    law[of.PROGRESS] = p["stiffening"] / farthest**2


def _mass(at: At, p: Parameters) -> None:
    ratio = 1 + p["mass"] / at.link.mass
    at.body[of.MASS] *= ratio
    at.body[of.INERTIA : of.INERTIA + 9] *= ratio


def _com(at: At, p: Parameters) -> None:
    at.body[of.COM : of.COM + 3] += (p["x"], p["y"], p["z"])


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
    at.system.gravity = rotation(-np.array([p["tilt_x"], p["tilt_y"], 0.0])) @ at.system.gravity


def _gain(at: At, p: Parameters) -> None:
    at.system.drives[at.place.index, of.GAIN] *= p["gain"]


def _loaded(at: At, p: Parameters) -> None:
    row = at.drive
    row[of.LOADED], row[of.LOADED_BUMP] = p["share"], p["static_ratio"] - 1.0
    row[of.LOADED_SPEED], row[of.LOADED_SMOOTH] = p["speed"], p["smooth_speed"]
    row[of.LOADED_EXTERNAL] = p.get("load_ratio", 0.0) * p["share"]


def _turn(at: At, p: Parameters) -> None:
    # the sensor is turned in the tool's frame
    vector = np.array([p[f"turn_{axis}"] for axis in "xyz"])
    at.readings.rotation = rotation(vector).T @ at.readings.rotation


def _bias(at: At, p: Parameters) -> None:
    at.readings.bias[at.place.name] = np.array(list(p.values()))


def _ripple(at: At, p: Parameters) -> None:
    law, slide = at.law, at.link.kind == "slide"
    law[of.RIPPLE], law[of.SECOND] = p["amplitude"], p["second_harmonic"]
    law[of.ORDER], law[of.PHASE] = p["periods"] * (2 * np.pi if slide else 1.0), p["phase"]


def _voltage(at: At, p: Parameters) -> None:
    at.drive[of.LIMIT] = p["stall_torque"]
    at.drive[of.BACK_EMF] = p["stall_torque"] / p["no_load_speed"]


def _straight(at: At, p: Parameters) -> None:
    at.readings.straight = True


def _cable(at: At, p: Parameters) -> None:
    other, ratio, home = p["other"], p["ratio"], at.figures.home
    rest = home[at.place.index] + ratio * home[other] + p["slack"]
    dofs = at.system.joint_dofs
    at.system.cable[:5] = [dofs[at.place.index], dofs[other], ratio, p["stiffness"], rest]


def _fan(at: At, p: Parameters) -> None:
    push = p["force"] * np.array(p["direction"])
    at.system.fan = np.array([*push, p["frequency"], p["phase"]])


# ---------------------------------------------------------------------------------- kinds

_THIN = {of.SMOOTH_SPEED: 3e-3, of.STRIBECK_SPEED: 0.1}
_PER = "T/A"


def _limit_over_reach(link: Link) -> float:
    return link.limit / link.reach


_CATALOGUE = (
    Kind(name="viscous_friction", places=joints, span=_of_link(0.6, 6.0, lambda x: x.damping),
         make=_just("damping"), apply=_viscous, units={"damping": "T·s/A"}),
    Kind(name="coulomb_friction", places=joints, span=_of_limit(0.008, 0.08),
         make=_rubbing((1.0, 1.1)), apply=_friction, units={"torque": "T"}),
    Kind(name="stribeck_friction", places=joints, span=_of_limit(0.015, 0.08),
         make=_rubbing((1.5, 2.2), (0.05, 0.25)), apply=_friction,
         units={"torque": "T", "static_ratio": "", "speed": "A/s"}),
    Kind(name="asymmetric_friction", places=joints, span=_of_limit(0.015, 0.08),
         make=_make_asymmetric, apply=_friction, units={"forward": "T", "backward": "T"}),
    Kind(name="load_friction", places=joints, span=_within(0.06, 0.4), make=_make_loaded,
         apply=_loaded, forms=(SERVO, TORQUE), units={"share": ""}),
    Kind(name="friction_behind_slack", places=joints, span=_of_limit(0.03, 0.12),
         make=_make_slack, apply=_writes("law", torque=of.SLACK_FORCE, slack=of.SLACK,
                                         elastic=of.ELASTIC),
         units={"torque": "T", "slack": "A", "elastic": "A"}),
    Kind(name="quadratic_drag", places=joints, span=_of_limit(0.003, 0.04, 2), make=_just("drag"),
         apply=_adds("law", drag=of.DRAG), units={"drag": "T·s²/A²"}),
    Kind(name="joint_compliance", places=hinges, span=_springs(_free_joint),
         make=_softness((0.02, 0.08), (0.03, 0.12)), apply=_compliance,
         units={"stiffness": _PER}),
    Kind(name="backlash", places=hinges, span=_within(2e-3, 0.02), make=_make_stops,
         apply=_backlash, forms=(SERVO, TORQUE), units={"gap": "A"}),
    Kind(name="structural_looseness", places=_links, span=_within(5e-5, 4e-4),
         make=_make_looseness, apply=_looseness, forms=MOVED, units={"gap": "m"}),
    Kind(name="link_flexibility", places=_bars, span=_springs(_free_half),
         make=_make_flexibility, apply=_flexibility, forms=MOVED, units={"stiffness": "N·m/rad"}),
    Kind(name="link_mass", places=_links, span=_of_link(0.12, 0.6, lambda x: x.mass),
         make=_signed("mass"), apply=_mass, units={"mass": "kg"}),
    Kind(name="link_com", places=_links, span=_of_link(0.10, 0.35, lambda x: x.length),
         make=_along("x", "y", "z"), apply=_com, units={"x": "m", "y": "m", "z": "m"}),
    Kind(name="payload", places=_tool, span=_of_link(0.25, 1.2, lambda x: x.mass),
         make=_make_payload, apply=_payload,
         units={"mass": "kg", "x": "m", "y": "m", "z": "m"}),
    Kind(name="rotor_inertia", places=joints, span=_of_link(0.4, 2.0, lambda x: x.armature),
         make=_just("inertia"), apply=_rotor, units={"inertia": "kg·m²"}),
    Kind(name="actuator_gain", places=_motors, span=_within(0.12, 0.5),
         make=_signed("gain", 1.0), apply=_gain, forms=MOVED, units={"gain": ""}),
    Kind(name="torque_constant", places=joints, span=_within(0.12, 0.4),
         make=_signed("factor", 1.0), apply=_constant,
         forms=(TORQUE,), units={"factor": ""}),
    Kind(name="torque_offset", places=joints, span=_of_limit(0.02, 0.1), make=_signed("torque"),
         apply=_zero_torque, forms=(TORQUE,), units={"torque": "T"}),
    Kind(name="actuator_lag", places=_motors, span=_within(3e-3, 0.06),
         make=_just("time_constant"), apply=_writes("drive", time_constant=of.LAG), forms=MOVED,
         units={"time_constant": "s"}),
    # a bus delays all drives alike: as likely as one of them
    Kind(name="command_delay", places=lambda f: _motors(f) + [ALL] * f.joints,
         span=_within(2e-3, 0.04), make=_just("delay"), apply=_adds("drive", delay=of.DELAY),
         forms=MOVED, units={"delay": "s"}),
    Kind(name="command_interpolation", places=lambda f: [ALL], span=_within(1.0, 1.01),
         make=lambda size, at: {}, apply=_straight, forms=MOVED),
    # the servo closes on the shifted reading too
    Kind(name="encoder_offset", places=_offset_places, span=_within(8e-3, 0.12),
         make=_signed("offset"), apply=_adds("drive", offset=of.OFFSET), units={"offset": "A"}),
    Kind(name="gear_eccentricity", places=hinges, span=_within(3e-3, 0.02), make=_make_eccentric,
         apply=_writes("drive", sine=of.ECCENTRIC_SINE, cosine=of.ECCENTRIC_COSINE), forms=MOVED,
         units={"sine": "A", "cosine": "A"}),
    Kind(name="sensor_misalignment", places=lambda f: [_TOOL_ACC], span=_within(0.03, 0.3),
         make=_along("turn_x", "turn_y", "turn_z", every=True), apply=_turn, forms=MOVED,
         units={"turn_x": "rad", "turn_y": "rad", "turn_z": "rad"}),
    Kind(name="sensor_gain", places=_inertial, span=_within(0.03, 0.3), make=_signed("gain", 1.0),
         apply=_reads("gain", "gain"), forms=MOVED, units={"gain": ""}),
    Kind(name="sensor_bias", places=_inertial, span=_within(0.15, 1.5), make=_make_bias,
         apply=_bias, forms=MOVED,
         units={"bias": "A/s", "bias_x": "m/s²", "bias_y": "m/s²", "bias_z": "m/s²"}),
    Kind(name="sensor_delay", places=lambda f: [_TOOL_ACC] * 2 + _speeds(f) + _encoders(f),
         span=_within(3e-3, 0.04), make=_just("delay"), apply=_reads("delay", "delay"),
         forms=MOVED, units={"delay": "s"}),
    Kind(name="sensor_quantisation", places=_encoders, span=_within(2e-3, 0.02),
         make=lambda size, at: {"step": size * at.speed},
         apply=_reads("step", "step"), forms=MOVED, units={"step": "A"}),
    Kind(name="base_tilt", places=_tilting, span=_within(0.015, 0.12), make=_make_tilt,
         apply=_tilt, units={"tilt_x": "rad", "tilt_y": "rad"}),
    Kind(name="base_compliance", places=_foot,
         span=_springs(lambda system, at: free_base(system, np.eye(3)[1])),
         make=lambda size, at: {
             "axis": "y", **_softness((0.02, 0.1), (0.0, 0.05))(size, at)},
         apply=_on_a_spring, forms=MOVED, units={"stiffness": "N·m/rad"}),
    Kind(name="torque_ripple", places=joints, span=_of_limit(0.01, 0.08), make=_make_ripple,
         apply=_ripple, forms=(SERVO, TORQUE),
         units={"amplitude": "T", "periods": "", "phase": "rad"}),
    Kind(name="joint_spring", places=joints, span=_of_link(0.03, 0.2, _limit_over_reach),
         make=_make_spring, apply=_spring, units={"stiffness": _PER, "reference": "A"}),
    Kind(name="gravity_compensation", places=_weighed, span=_within(0.25, 1.0),
         make=_signed("share"), apply=_adds("body", share=of.CARRIED), units={"share": ""}),
    Kind(name="torque_limit", places=_motors, span=_within(1.3, 4.0),
         make=lambda size, at: {"limit": at.link.limit / size},
         apply=_writes("drive", limit=of.LIMIT), forms=MOVED, units={"limit": "T"}),
    Kind(name="voltage_limit", places=_motors, span=_within(1.3, 4.0), make=_make_voltage,
         apply=_voltage, forms=MOVED, units={"stall_torque": "T", "no_load_speed": "A/s"}),
    Kind(name="speed_limit", places=_motors, span=_within(0.3, 5.0),
         make=lambda size, at: {"speed": at.speed / size},
         apply=_writes("drive", speed=of.SPEED_LIMIT), forms=MOVED, units={"speed": "A/s"}),
    Kind(name="dead_zone", places=_motors,
         span=_of_link(0.02, 0.2, lambda x: x.limit / x.kp), make=_just("width"),
         apply=_writes("drive", width=of.DEAD), forms=MOVED, units={"width": "A"}),
)  # fmt: skip

_OUTSIDE = (
    Kind(name="warming_friction", places=hinges, span=_of_limit(0.02, 0.1),
         make=lambda size, at: {
             "torque": size, "warm_time": log_uniform(at.rng, 1.5, 4.0)},
         apply=_writes("law", _THIN, torque=of.FRICTION, warm_time=of.WARM_TIME)),
    Kind(name="cable_coupling", places=lambda f: hinges(f)[:-1], span=_of_limit(0.05, 0.3),
         make=_make_cable, apply=_cable),
    Kind(name="shaking_force", places=_tool, span=_of_limit(0.05, 0.5), make=_make_fan, apply=_fan),
    Kind(name="voltage_sag", places=lambda f: [ALL], span=_within(0.1, 1.5), make=_just("sag"),
         apply=_writes("drive", sag=of.SAG), forms=MOVED),
    # a bent shaft rubs in some angles and runs free in others
    Kind(name="tight_spots", places=hinges, span=_of_limit(0.02, 0.12),
         make=lambda size, at: {
             "torque": size, "waves": float(at.rng.integers(3, 9)),
             "phase": at.uniform(-np.pi, np.pi)},
         apply=_writes("law", _THIN, torque=of.FRICTION, waves=of.GRAIN, phase=of.GRAIN + 1)),
)  # fmt: skip

KINDS = {kind.name: kind for kind in (*_CATALOGUE, *_OUTSIDE)}
"""All kinds by name: the catalogue in the order of its table, then those outside it."""
CATALOGUE = tuple(kind.name for kind in _CATALOGUE)
"""Identifiers of the catalogue."""
OUTSIDE = tuple(kind.name for kind in _OUTSIDE)
"""Effects that the catalogue does not have."""


def drawn(name: str, spot: Spot, share: float | None = None) -> Effect:
    """An effect at a place, of a size in its span: at a share of it, or log-uniform."""
    kind = KINDS[name]
    low, high = kind.span(spot)
    size = low * (high / low) ** (spot.uniform(0, 1) if share is None else share)
    return Effect(kind=name, place=spot.place, parameters=kind.make(float(size), spot))


def apply_effect(effect: Effect, system: System, readings: Readings, figures: Figures) -> None:
    """Change an arm and its sensors by an effect, in place."""
    KINDS[effect.kind].apply(At(system, readings, figures, effect.place), dict(effect.parameters))
