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
from scripts.suites.gap.arms import BAR_CENTRE, Machine
from scripts.suites.gap.dynamics import System, exactly

SERVO, TORQUE, FREE = ("servo", "torque", "free")
"""Commands to sensors, motion to torque, free response."""
ACCELEROMETER = "tool_acc"  # name of the accelerometer at the tool
STOP_LOAD = 30.0  # force that usually presses a loose seat to its stops [N]
SEAT_DAMPING = 5.0  # damping of a loose seat's guide [N s/m]
SLIDE_SPEED = 0.2  # speed of a slide [m/s] that counts like 1 rad/s of a hinge


@dataclasses.dataclass(frozen=True, kw_only=True)
class Place:
    """Where an effect sits."""

    name: str
    """Name in the model: of a joint, body, actuator or sensor; or `tool`, `base`, `all`."""
    index: int  # Number of the joint or link from 0; -1 for `all`


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """A kind at a place with its parameters."""

    kind: str
    place: Place
    parameters: Mapping[str, Any]
    runs: tuple[int, ...] = ()
    """Runs in which it is there, from 0; all of them if none is given."""


class Spot:
    """A place on a machine where an effect is drawn, and the generator that draws it."""

    def __init__(
        self, machine: Machine, place: Place, rng: np.random.Generator | None = None
    ) -> None:
        self.machine, self.place, self.j = machine, place, place.index
        self.link = machine.link(self.j)
        self.speed = SLIDE_SPEED if self.link.slide else 1.0
        """Speed that counts like 1 rad/s [rad/s or m/s]."""
        self.rng = np.random.default_rng() if rng is None else rng

    def sign(self) -> float:
        """Either sign."""
        return float(self.rng.choice([-1.0, 1.0]))

    def uniform(self, low: float, high: float) -> float:
        """A number between two bounds."""
        return float(self.rng.uniform(low, high))

    def log_uniform(self, low: float, high: float) -> float:
        """A number between two bounds, its logarithm uniform."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def phase(self) -> float:
        """An angle."""
        return self.uniform(-np.pi, np.pi)

    def direction(self, every: bool = False) -> Array:
        """A unit vector, one in which gravity or forces matter unless every direction does."""
        basis = np.eye(3) if every else moved_axes(self.machine)
        mix = self.rng.normal(size=len(basis)) @ basis
        return np.asarray(mix / np.linalg.norm(mix))


class At(Spot):
    """A place of a true arm with its sensors, which are to be changed."""

    def __init__(self, machine: Machine, place: Place, system: System) -> None:
        super().__init__(machine, place)
        self.system = system

    @property
    def body(self) -> int:
        """Body at the link's proximal end."""
        return int(self.system.proximal[self.j])

    @property
    def motor(self) -> int:
        """Degree of freedom on the motor's side of the joint."""
        return int(self.system.joint_dofs[self.j])

    def adds(self, body: int, columns: int | slice, value: Any) -> None:
        """Add to numbers of a body."""
        self.system.bodies[body, columns] += value

    def law(self, dof: int | None = None, **values: float) -> None:
        """Write laws of a degree of freedom, by default the motor's."""
        for name, value in values.items():
            self.system.laws[name][self.motor if dof is None else dof] = value

    def drive(self, **values: float) -> None:
        """Write numbers of the drive, or of all drives."""
        for name, value in values.items():
            self.system.drives[name][slice(None) if self.j < 0 else self.j] = value

    def more(self, **values: float) -> None:
        """Add to numbers of the drive, or of all drives."""
        for name, value in values.items():
            self.system.drives[name][slice(None) if self.j < 0 else self.j] += value

    def reads(self, **values: Any) -> None:
        """Let the sensor say something else, by names of `System.sensors`."""
        for name, value in values.items():
            self.system.sensors[name][self.place.name] = value

    def spring(
        self, dof: int, load: float, *, stiffness: float, damping_ratio: float, stiffening: float
    ) -> None:
        """Give a degree of freedom a slightly progressive spring and a damper."""
        felt = self.system.felt_inertia(dof, self.machine.home)
        damping = 2 * damping_ratio * np.sqrt(stiffness * felt)
        progress = stiffening / (load / stiffness) ** 2
        self.law(dof, stiffness=stiffness, progress=progress, damping=damping)

    def couple(self, other: int, ratio: float, stiffness: float, slack: float) -> None:
        """Put a spring over the joint and another one, slack by so much in the middle pose."""
        home, dofs = self.machine.home, self.system.joint_dofs
        rest = home[self.j] + ratio * home[other] + slack
        self.system.cable[:5] = [self.motor, dofs[other], ratio, stiffness, rest]

    def stops(
        self, dof: int, load: float, *, gap: float, stop_mode: float, stop_damping_ratio: float,
        **others: float,
    ) -> None:  # fmt: skip
        """Give a degree of freedom a free travel between Hertzian stops, and other laws."""
        felt = self.system.felt_inertia(dof, self.machine.home)
        stiffness = felt * (2 * np.pi * stop_mode) ** 2
        # tangent of h d^1.5 at h d^1.5 = load: 1.5 h^(2/3) load^(1/3)
        hertz = (stiffness / (1.5 * load ** (1 / 3))) ** 1.5
        crossley = 2 * stop_damping_ratio * np.sqrt(stiffness * felt) / load
        self.law(dof, travel=gap / 2, hertz=hertz, crossley=crossley, **others)


def moved_axes(machine: Machine) -> Array:
    """Directions in which gravity or forces matter to an arm: rows, of shape (k, 3)."""
    axes = machine.axis
    if np.allclose(np.abs(axes @ axes[0]), 1.0) and not machine.slide[0]:
        return np.linalg.svd(axes[:1])[2][1:]
    return np.eye(3)


# --------------------------------------------------------------------------------- places


def _named(words: str) -> Callable[[Machine], list[Place]]:
    """A place for each joint, by a name with its number."""
    return lambda machine: [Place(name=words.format(i + 1), index=i) for i in range(machine.joints)]


_joints, _links, _motors = _named("joint{}"), _named("link{}"), _named("motor{}")
_encoders, _speeds = _named("joint{}_pos"), _named("joint{}_vel")
ALL, _BASE = Place(name="all", index=-1), Place(name="base", index=0)
_TOOL_ACC = Place(name=ACCELEROMETER, index=0)


def hinges(machine: Machine) -> list[Place]:
    """All joints that turn."""
    return [p for p in _joints(machine) if not machine.slide[p.index]]


def _bars(machine: Machine) -> list[Place]:
    """Links that are bars along their x axis, with their mass around the middle."""
    return [
        place
        for place, end, com in zip(_links(machine), machine.end, machine.com, strict=True)
        if end[0] > 0.12 and np.isclose(com[0], BAR_CENTRE * end[0])
    ]


def _inertial(machine: Machine) -> list[Place]:
    return [_TOOL_ACC] * 2 + _speeds(machine)


def _weighed(machine: Machine) -> list[Place]:
    """Links whose weight some joint carries."""
    found = []
    for place in _links(machine):
        whole, half = (System.build(machine, exactly(machine.joints)) for _ in range(2))
        half.bodies[place.index, of.MASS] *= 0.5
        loads = [each.at_rest(machine.home + 0.3)[1] for each in (whole, half)]
        found += [place] * bool(np.abs(loads[0] - loads[1]).max() > 0.02 * machine.limit[0])
    return found


def _zeroed(machine: Machine) -> list[Place]:
    # the zero of a first joint about the vertical, or of a slide, changes nothing that is measured
    upright = abs(machine.axis[0, 2]) > 0.99
    return [place for place in hinges(machine) if place.index or not upright]


def _tool(machine: Machine) -> list[Place]:
    return [Place(name="tool", index=machine.joints - 1)]


# ------------------------------------------------------------------- sizes and parameters

Parameters = Mapping[str, Any]
Draw = Callable[[float, Spot], Parameters]
"""All parameters, from a size; larger is easier to see."""
MODES = (60.0, 12.0)
"""Free modes that a compliance may have [Hz]: holding modes of real arms lie at 10 to 80 Hz."""


def _mode(free: Callable[[System, Spot], int]) -> Callable[[float, Spot], float]:
    """Compliance whose free mode has a frequency [rad/(N m)]."""

    def compliance(frequency: float, at: Spot) -> float:
        system = System.build(at.machine, exactly(at.machine.joints))
        felt = system.felt_inertia(free(system, at), at.machine.home)
        return 1 / (felt * (2 * np.pi * frequency) ** 2)

    return compliance


def _free_joint(system: System, at: Spot) -> int:
    return system.free_link(at.j, "hinge", at.link.axis)


def _free_half(system: System, at: Spot) -> int:
    return system.split_link(at.j, 0.5 * at.link.end, at.link.axis, 0.52)


_UNITS: dict[str, Callable[[float, Spot], float]] = {
    "": lambda x, at: x,
    "limit/reach": lambda x, at: x * (at.link.limit / at.link.reach),
    "limit/kp": lambda x, at: x * (at.link.limit / at.link.kp),
    "limit/speed²": lambda x, at: x * at.link.limit / at.speed**2,
    "limit": lambda x, at: x * at.link.limit,
    "damping": lambda x, at: x * at.link.damping,
    "mass": lambda x, at: x * at.link.mass,
    "length": lambda x, at: x * at.link.length,
    "armature": lambda x, at: x * at.link.armature,
    "joint": _mode(_free_joint), "half": _mode(_free_half),
    "base": _mode(lambda system, at: system.free_base(np.eye(3)[1])),
}  # fmt: skip
"""Sizes by their unit: a number of the link, or [Hz] of the free mode of a compliance."""


def _signed(name: str, neutral: float = 0.0) -> Draw:
    return lambda size, at: {name: neutral + at.sign() * size}


def _along(*names: str, every: bool = False) -> Draw:
    """A vector of the size in a random direction, of those that matter or of all."""
    return lambda size, at: dict(zip(names, (size * at.direction(every)).tolist(), strict=True))


def _rubbing(ratio: tuple[float, float], speeds: tuple[float, float] = (0.05, 0.05)) -> Draw:
    return lambda size, at: {
        "torque": size, "static_ratio": at.uniform(*ratio),
        "speed": at.log_uniform(*speeds) * at.speed,
        "smooth_speed": at.log_uniform(1e-3, 4e-3) * at.speed,
    }  # fmt: skip


def _asymmetric(size: float, at: Spot) -> Parameters:
    side = at.uniform(0.35, 0.8) * at.sign()
    sides = {"forward": size * (1 + side), "backward": size * (1 - side)}
    return {**_rubbing((1.0, 1.1))(size, at), **sides}


def _soft(ratio: tuple[float, float], stiffening: tuple[float, float]) -> Draw:
    return lambda size, at: {
        "stiffness": 1.0 / size, "damping_ratio": at.log_uniform(*ratio),
        "stiffening": at.uniform(*stiffening),
    }  # fmt: skip


def _bending(size: float, at: Spot) -> Parameters:
    # in the plane in which the joint drives it
    own = np.abs(at.link.axis)
    axis = [0.0, 1.0, 0.0] if own[1] >= own[2] else [0.0, 0.0, 1.0]
    soft = _soft((0.01, 0.05), (0.02, 0.08))(size, at)
    return {"axis": axis, "position": at.uniform(0.35, 0.6), **soft}


def _stops(size: float, at: Spot) -> Parameters:
    """Free travel, mode of a part pressed to a stop by its usual load [Hz], its damping there."""
    mode, ratio = at.uniform(90.0, 130.0), at.uniform(0.2, 0.5)
    return {"gap": size, "stop_mode": mode, "stop_damping_ratio": ratio}


def _payload(size: float, at: Spot) -> Parameters:
    # its centre at the tool, or as far off as a gripper is long
    off = at.rng.choice([0.0, at.uniform(0.01, 0.08)]) * at.direction(every=True)
    return {"mass": size, **dict(zip("xyz", off.tolist(), strict=True))}


def _bias(size: float, at: Spot) -> Parameters:
    if at.place.name != ACCELEROMETER:
        return {"bias": 0.05 * at.sign() * size * at.speed}
    return _along("bias_x", "bias_y", "bias_z", every=True)(size, at)


def _tilt(size: float, at: Spot) -> Parameters:
    # only a tilt that turns gravity inside a planar arm's plane moves the arm
    angle = at.phase()
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    own = np.abs(at.machine.axis[0])
    if len(moved_axes(at.machine)) < 3 and own[2] < 0.5:
        axis = own * at.sign()
    return {"tilt_x": float(size * axis[0]), "tilt_y": float(size * axis[1])}


# ---------------------------------------------------------------- changes of the true arm


def _rubs(
    at: At, torque: float, static_ratio: float, speed: float, smooth_speed: float,
    forward: float | None = None, backward: float | None = None,
) -> None:  # fmt: skip
    asymmetry = 0.0 if forward is None else forward / torque - 1.0
    at.law(friction=torque, bump=static_ratio - 1.0, stribeck_speed=speed, asymmetry=asymmetry,
           smooth_speed=smooth_speed)  # fmt: skip


def _weighs(at: At, mass: float) -> None:
    ratio = 1 + mass / at.link.mass
    at.system.bodies[at.body, of.MASS] *= ratio
    at.system.bodies[at.body, of.INERTIA : of.ARMATURE] *= ratio


def rotation(vector: Array) -> Array:
    """Rotation matrix of a rotation vector, of shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross  # type: ignore[no-any-return]


def _tilts(at: At, tilt_x: float, tilt_y: float) -> None:
    # the base is turned by (x, y, 0) in the world, so gravity turns backwards in its frame
    at.system.gravity = rotation(-np.array([tilt_x, tilt_y, 0.0])) @ at.system.gravity


def _misaligned(at: At, **turns: float) -> None:
    # the sensor is turned in the tool's frame
    at.system.rotation = rotation(np.array(list(turns.values()))).T @ at.system.rotation


def _misread(at: At, factor: float = 1.0, torque: float = 0.0) -> None:
    at.system.torque_gain[at.j] *= factor
    at.system.torque_offset[at.j] += torque


# ---------------------------------------------------------------------------------- kinds


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of effect: where it can be, how large, and what it does to the true arm."""

    places: Callable[[Machine], list[Place]]  # Where it can sit on an arm
    bounds: tuple[float, float]
    """Least and largest size that machines have and that is outside tolerances."""
    unit: str  # Unit of the size, of `_UNITS`
    forms: str  # Initials of the forms of recording that can show it
    results: str
    """Parameters that a result has too, and units: T a torque or force, A an angle or way."""
    act: Callable[..., None]  # Change of the arm or its sensors by the parameters, in place
    draw: Draw | None = None
    """All its parameters, from a size; the size is the first result if not given."""

    def shown_by(self, form: str) -> bool:
        """Whether a form of recording can show it."""
        return form[0] in self.forms

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters that a result has too."""
        pairs = (result.partition(" ") for result in self.results.split(", ") if result)
        return {name: unit for name, _, unit in pairs}


_CATALOGUE = {
    "viscous_friction": Kind(  # oil thins a little with speed
        _joints, (0.6, 6.0), "damping", "stf", "damping T·s/A",
        lambda at, damping: at.law(extra=damping, thinning=6.0 * at.speed)),
    "coulomb_friction": Kind(
        _joints, (0.008, 0.08), "limit", "stf", "torque T", _rubs, _rubbing((1.0, 1.1))),
    "stribeck_friction": Kind(
        _joints, (0.015, 0.08), "limit", "stf", "torque T, static_ratio, speed A/s", _rubs,
        _rubbing((1.5, 2.2), (0.05, 0.25))),
    "asymmetric_friction": Kind(
        _joints, (0.015, 0.08), "limit", "stf", "forward T, backward T", _rubs, _asymmetric),
    "load_friction": Kind(
        _joints, (0.06, 0.4), "", "st", "share",
        lambda at, share, static_ratio, speed, smooth_speed, load_ratio, **_: at.drive(
            loaded=share, loaded_bump=static_ratio - 1.0, loaded_speed=speed,
            loaded_smooth=smooth_speed, loaded_external=load_ratio * share),
        lambda size, at: {
            **_rubbing((1.0, 1.2), (0.03, 0.25))(size, at), "share": size, "load_ratio": 0.0}),
    "friction_behind_slack": Kind(
        _joints, (0.03, 0.12), "limit", "stf", "torque T, slack A, elastic A",
        lambda at, torque, **p: at.law(slack_force=torque, **p),
        lambda size, at: {
            "torque": size, "slack": (slack := at.uniform(0.05, 0.25) * at.link.reach),
            "elastic": at.uniform(0.1, 0.4) * slack}),
    "quadratic_drag": Kind(
        _joints, (0.003, 0.04), "limit/speed²", "stf", "drag T·s²/A²", At.law),
    "joint_compliance": Kind(
        hinges, MODES, "joint", "stf", "stiffness T/A",
        lambda at, **p: at.spring(_free_joint(at.system, at), 0.5 * at.link.limit, **p),
        _soft((0.02, 0.08), (0.03, 0.12))),
    "backlash": Kind(  # with grease between the flanks
        hinges, (2e-3, 0.02), "", "st", "gap A", lambda at, **p: at.stops(
            _free_joint(at.system, at), 0.1 * at.link.limit, damping=0.05 * at.link.damping, **p),
        _stops),
    "structural_looseness": Kind(
        _links, (5e-5, 4e-4), "", "s", "gap m", lambda at, direction, friction, **p: at.stops(
            at.system.free_link(at.j, "slide", np.array(direction)), STOP_LOAD,
            damping=SEAT_DAMPING, friction=friction, smooth_speed=2e-3, **p),
        lambda size, at: {
            "direction": at.direction().tolist(), "friction": at.log_uniform(0.3, 3.0),
            **_stops(size, at)}),
    "link_flexibility": Kind(  # a bar with its middle of mass at 0.48 is heavier near its joint
        _bars, MODES, "half", "s", "stiffness N·m/rad", lambda at, axis, position, **p: at.spring(
            at.system.split_link(at.j, position * at.link.end, np.array(axis),
                                 position * (1 + 0.08 * (1 - position))),
            0.5 * at.link.limit, **p),
        _bending),
    "link_mass": Kind(_links, (0.12, 0.6), "mass", "stf", "mass kg", _weighs, _signed("mass")),
    "link_com": Kind(
        _links, (0.10, 0.35), "length", "stf", "x m, y m, z m",
        lambda at, **p: at.adds(at.body, slice(of.COM, of.INERTIA), list(p.values())),
        _along("x", "y", "z")),
    "payload": Kind(
        _tool, (0.25, 1.2), "mass", "stf", "mass kg, x m, y m, z m",
        lambda at, mass, x, y, z: at.system.add_mass(mass, at.system.tool + np.array([x, y, z])),
        _payload),
    "rotor_inertia": Kind(_joints, (0.4, 2.0), "armature", "stf", "inertia kg·m²",
        lambda at, inertia: at.adds(at.motor, of.ARMATURE, inertia)),
    "actuator_gain": Kind(
        _motors, (0.12, 0.5), "", "s", "gain", At.drive, _signed("gain", 1.0)),
    "torque_constant": Kind(
        _joints, (0.12, 0.4), "", "t", "factor", _misread, _signed("factor", 1.0)),
    "torque_offset": Kind(
        _joints, (0.02, 0.1), "limit", "t", "torque T", _misread, _signed("torque")),
    "actuator_lag": Kind(
        _motors, (3e-3, 0.06), "", "s", "time_constant s",
        lambda at, time_constant: at.drive(lag=time_constant)),
    "command_delay": Kind(  # a bus delays all drives alike: as likely as one of them
        lambda m: _motors(m) + [ALL] * m.joints, (2e-3, 0.04), "", "s", "delay s", At.more),
    "command_interpolation": Kind(
        lambda m: [ALL], (1.0, 1.01), "", "s", "",
        lambda at: setattr(at.system, "straight", True), lambda size, at: {}),
    "encoder_offset": Kind(  # the servo closes on the shifted reading too
        _zeroed, (8e-3, 0.12), "", "stf", "offset A", At.more, _signed("offset")),
    "gear_eccentricity": Kind(
        hinges, (3e-3, 0.02), "", "s", "sine A, cosine A", At.drive,
        lambda size, at: {
            "sine": float(size * np.cos(phase := at.phase())),
            "cosine": float(size * np.sin(phase))}),
    "sensor_misalignment": Kind(
        lambda m: [_TOOL_ACC], (0.03, 0.3), "", "s", "turn_x rad, turn_y rad, turn_z rad",
        _misaligned, _along("turn_x", "turn_y", "turn_z", every=True)),
    "sensor_gain": Kind(
        _inertial, (0.03, 0.3), "", "s", "gain", At.reads, _signed("gain", 1.0)),
    "sensor_bias": Kind(
        _inertial, (0.15, 1.5), "", "s", "bias A/s, bias_x m/s², bias_y m/s², bias_z m/s²",
        lambda at, **p: at.reads(bias=np.array(list(p.values()))), _bias),
    "sensor_delay": Kind(
        lambda m: _inertial(m) + _encoders(m), (3e-3, 0.04), "", "s", "delay s", At.reads),
    "sensor_quantisation": Kind(
        _encoders, (2e-3, 0.02), "", "s", "step A", At.reads,
        lambda size, at: {"step": size * at.speed}),
    "base_tilt": Kind(
        lambda m: [_BASE] if hinges(m) else [], (0.015, 0.12), "", "stf",
        "tilt_x rad, tilt_y rad", _tilts, _tilt),
    "base_compliance": Kind(  # one about the axis of its first joint is that joint on a spring
        lambda m: [_BASE] if len(moved_axes(m)) == 3 else [], MODES, "base", "s",
        "stiffness N·m/rad", lambda at, axis, **p: at.spring(
            at.system.free_base(np.eye(3)["xy".index(axis)]), 0.5 * at.machine.limit[0], **p),
        lambda size, at: {"axis": "y", **_soft((0.02, 0.1), (0.0, 0.05))(size, at)}),
    "torque_ripple": Kind(
        _joints, (0.01, 0.08), "limit", "st", "amplitude T, periods, phase rad",
        lambda at, amplitude, periods, phase, second_harmonic: at.law(
            ripple=amplitude, order=periods * (2 * np.pi if at.link.slide else 1.0), phase=phase,
            second=second_harmonic),
        lambda size, at: {
            "amplitude": size, "periods": float(at.rng.integers(6, 25)), "phase": at.phase(),
            "second_harmonic": at.uniform(0.0, 0.2)}),
    "joint_spring": Kind(
        _joints, (0.03, 0.2), "limit/reach", "stf", "stiffness T/A, reference A",
        lambda at, stiffness, reference, stiffening: at.law(
            stiffness=stiffness, rest=reference,
            progress=stiffening / (abs(at.link.home - reference) + at.link.reach) ** 2),
        lambda size, at: {
            "stiffness": size,
            "reference": at.link.home + at.uniform(-1.5, 1.5) * at.link.reach,
            "stiffening": at.uniform(0.0, 0.1)}),
    "gravity_compensation": Kind(
        _weighed, (0.25, 1.0), "", "stf", "share",
        lambda at, share: at.adds(at.body, of.CARRIED, share), _signed("share")),
    "torque_limit": Kind(
        _motors, (1.3, 4.0), "", "s", "limit T", At.drive,
        lambda size, at: {"limit": at.link.limit / size}),
    "voltage_limit": Kind(
        _motors, (1.3, 4.0), "", "s", "stall_torque T, no_load_speed A/s",
        lambda at, stall_torque, no_load_speed: at.drive(
            limit=stall_torque, back_emf=stall_torque / no_load_speed),
        lambda size, at: {  # of the velocity gain a part is back-EMF
            "stall_torque": (stall := at.link.limit / size),
            "no_load_speed": stall / (at.uniform(0.3, 1.0) * at.link.kv)}),
    "speed_limit": Kind(
        _motors, (0.3, 5.0), "", "s", "speed A/s", lambda at, speed: at.drive(speed_limit=speed),
        lambda size, at: {"speed": at.speed / size}),
    "dead_zone": Kind(
        _motors, (0.02, 0.2), "limit/kp", "s", "width A", lambda at, width: at.drive(dead=width)),
}  # fmt: skip

_OUTSIDE = {
    "warming_friction": Kind(
        hinges, (0.02, 0.1), "limit", "stf", "",
        lambda at, torque, warm_time: at.law(
            friction=torque, smooth_speed=3e-3, warm_time=warm_time),
        lambda size, at: {"torque": size, "warm_time": at.log_uniform(1.5, 4.0)}),
    "cable_coupling": Kind(
        lambda m: hinges(m)[:-1], (0.05, 0.3), "limit", "stf", "", At.couple,
        lambda size, at: {
            "stiffness": size,
            "other": int(at.rng.choice([p.index for p in hinges(at.machine) if p.index > at.j])),
            "ratio": at.uniform(0.6, 1.5) * at.sign(), "slack": at.uniform(-0.3, 0.3)}),
    "shaking_force": Kind(
        _tool, (0.05, 0.5), "limit", "stf", "",
        lambda at, force, direction, frequency, phase: np.copyto(
            at.system.fan, [*(force * np.array(direction)), frequency, phase]),
        lambda size, at: {
            "force": size, "direction": at.direction().tolist(),
            "frequency": at.log_uniform(3.0, 12.0), "phase": at.phase()}),
    "voltage_sag": Kind(
        lambda m: [ALL], (0.1, 1.5), "", "s", "", At.drive, lambda size, at: {"sag": size}),
    "tight_spots": Kind(  # a bent shaft rubs in some angles and runs free in others
        hinges, (0.02, 0.12), "limit", "stf", "",
        lambda at, torque, waves, phase: at.law(
            friction=torque, smooth_speed=3e-3, waves=waves, wave_phase=phase),
        lambda size, at: {
            "torque": size, "waves": float(at.rng.integers(3, 9)), "phase": at.phase()}),
}  # fmt: skip

KINDS = {**_CATALOGUE, **_OUTSIDE}
"""All kinds by name: the catalogue in the order of its table, then those outside it."""
CATALOGUE, OUTSIDE = tuple(_CATALOGUE), tuple(_OUTSIDE)
"""Names of what `loose gap` knows, and of what it lacks."""


def drawn(name: str, spot: Spot, share: float | None = None) -> Effect:
    """An effect at a place, of a size between its bounds: at a share, or log-uniform."""
    kind = KINDS[name]
    low, high = (_UNITS[kind.unit](bound, spot) for bound in kind.bounds)
    size = float(low * (high / low) ** (spot.uniform(0, 1) if share is None else share))
    parameters = kind.draw(size, spot) if kind.draw else {next(iter(kind.units)): size}
    return Effect(kind=name, place=spot.place, parameters=parameters)


def apply_effect(effect: Effect, system: System, machine: Machine) -> None:
    """Change an arm and its sensors by an effect, in place."""
    KINDS[effect.kind].act(At(machine, effect.place, system), **effect.parameters)
