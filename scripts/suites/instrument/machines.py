"""Machines of the instrument suite: kinematics, drives, controllers and sensors of five classes.

Each class is a table of links as its maker would give them. Lengths in m, masses in kg, angles in
rad; a slide's stiffness, friction and teeth are per metre.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

import mujoco
import numpy as np

from loose_env.typing import Array

STEP = 1e-4
"""Time step of all simulations [s]."""
MARGIN = {False: 0.35, True: 0.08}
"""Travel beyond the box of poses, of hinges [rad] and slides [m]."""

Vector = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Rod:
    """A capsule between two points of the link's frame."""

    start: Vector
    end: Vector
    radius: float
    mass: float


@dataclasses.dataclass(frozen=True)
class Box:
    """A box about a point of the link's frame, with half its edges."""

    centre: Vector
    half: Vector
    mass: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class Link:
    """A link, the joint that moves it, and that joint's drive."""

    body: str
    joint: str
    axis: Vector
    position: Vector
    """Origin in the frame of the link before."""
    parts: tuple[Rod | Box, ...]
    slide: bool = False
    low: float
    high: float
    """Box of poses."""
    torque: float
    """Largest drive torque [N m] or force [N]."""
    speed: float
    acceleration: float
    armature: float
    """Inertia of the rotor at the joint [kg m2] or [kg]."""
    coulomb: float
    """Friction of the drive without load [N m] or [N]."""
    viscous: float
    gear_hz: float
    """Frequency of the link on its gear with the rotor locked, all links beyond in the middle
    pose [Hz]."""
    teeth: float = 200.0
    """Meshing cycles a turn, or a metre."""
    mesh: float = 1e-5
    """Amplitude of the kinematic error at the meshing frequency [rad] or [m]."""
    bending_hz: float = 0.0
    """Frequency of the link's first bending mode; 0 for a rigid link [Hz]."""
    bending_axis: Vector = (0.0, 1.0, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sensor:
    """An accelerometer with its logger."""

    rate_hz: float
    corner_hz: float
    noise_ug: float
    """Noise density [µg/√Hz]."""
    range_g: float = 16.0
    bits: int = 16


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sheet:
    """What a user knows of a machine, and what its interfaces do."""

    name: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    slides: tuple[bool, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    torque: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    command: Literal["position", "velocity", "torque"]
    command_hz: float
    """Rate at which the controller takes commands."""
    latency: float
    """Time from command to its effect [s]."""
    interpolated: bool
    """Whether the controller goes in straight lines between commands."""
    bandwidth_hz: float
    encoders: Literal["motor", "link"]
    log_hz: float
    torques: Literal["none", "current", "joint"]
    """Torques in the log: none, from the motor's current, from a sensor behind the gear."""
    resolution: tuple[float, ...]
    sensor: Sensor
    strike: tuple[float, float]
    """Force of a cable that strikes [N]."""
    friction: tuple[float, float]
    """Guide friction of a loose seat [N]."""
    payload: tuple[float, float]
    """Payload that users forget [kg]."""
    base: str = "base"
    """Body that is bolted down."""
    least_play: float = 0.0
    """Play that healthy joints of this class have already [rad]."""
    judged_only: bool = False
    hobby: bool = False

    def session(self) -> dict[str, Any]:
        """What a tool is told, as ``session.json`` has it."""
        return {
            "controller": {
                "command": self.command, "rate_hz": self.command_hz,
                "max_speed": self.speed, "max_acceleration": self.acceleration,
                "max_torque": self.torque, "bandwidth_hz": self.bandwidth_hz,
                "low": self.low, "high": self.high,
            },
            "accelerometer": {
                "site": "tool", "rate_hz": self.sensor.rate_hz, "corner_hz": self.sensor.corner_hz
            },
            "encoders": self.encoders, "joints": self.joints, "bodies": self.bodies,
        }  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class Design:
    """A class of machines: its links and what the controller does."""

    sheet: Sheet
    base: tuple[Rod | Box, ...]
    links: tuple[Link, ...]
    tool: Vector
    """Accelerometer in the last link's frame."""
    tool_turn: Vector = (0.0, 0.0, 0.0)
    """Rotation vector of the accelerometer in the last link's frame."""
    control_hz: float
    control: Literal["cascade", "stiffness"]
    """Position, velocity and torque in a cascade, or stiffness and damping about the command."""
    servo_hz: float
    """Bandwidth of the velocity loop, or frequency of the stiffness [Hz]."""
    position_gain: float = 25.0
    """Of a cascade [1/s]."""
    forward: float = 0.9
    """Share of the command's velocity fed forward."""
    gravity: bool = False
    """Whether the drives carry the weight by a model of it."""
    load_friction: float = 0.03
    """Friction over gear torque."""
    hysteresis: float = 0.004
    """Half width of the gear's torque hysteresis over the largest torque."""
    roughness: tuple[float, float] = (0.02, 0.08)
    """Random torque of gears and bearings at a speed of 15 % of the largest, over what the largest
    acceleration takes."""
    gear_damping: tuple[float, float] = (0.02, 0.05)
    mass_error: tuple[float, float] = (0.1, 0.2)


def nominal_spec(
    design: Design, mass: Array | None = None, shift: Array | None = None
) -> mujoco.MjSpec:
    """Rigid model with joint sensors and accelerometer; factors of masses and shifts of centres."""
    spec = mujoco.MjSpec()
    spec.modelname = design.sheet.name
    spec.compiler.degree = False
    body = spec.worldbody.add_body(name=design.sheet.base)
    _add_parts(body, design.base, 1.0, np.zeros(3))
    for i, link in enumerate(design.links):
        body = body.add_body(name=link.body, pos=link.position)
        margin = MARGIN[link.slide]
        body.add_joint(
            name=link.joint, axis=link.axis, armature=link.armature, limited=1,
            type=mujoco.mjtJoint.mjJNT_SLIDE if link.slide else mujoco.mjtJoint.mjJNT_HINGE,
            range=[link.low - margin, link.high + margin], damping=[link.viscous, 0, 0],
        )  # fmt: skip
        factor = 1.0 if mass is None else float(mass[i])
        _add_parts(body, link.parts, factor, np.zeros(3) if shift is None else shift[i])
    turn = np.zeros(4)
    angle = float(np.linalg.norm(design.tool_turn))
    mujoco.mju_axisAngle2Quat(turn, np.array(design.tool_turn) / max(angle, 1e-12), angle)
    body.add_site(name="tool", pos=design.tool, quat=turn)
    add_interfaces(spec, design.sheet)
    return spec


def add_interfaces(spec: mujoco.MjSpec, sheet: Sheet) -> None:
    """Motors and sensors, named as recordings name them."""
    for joint, torque in zip(sheet.joints, sheet.torque, strict=True):
        spec.add_actuator(
            name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT,
            forcerange=[-torque, torque], forcelimited=1,
        )  # fmt: skip
        spec.add_sensor(
            name=f"{joint}_pos", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint,
        )  # fmt: skip
    spec.add_sensor(
        name="tool_acc", type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        objtype=mujoco.mjtObj.mjOBJ_SITE, objname="tool",
    )  # fmt: skip


def _add_parts(body: Any, parts: tuple[Rod | Box, ...], factor: float, shift: Array) -> None:
    for part in parts:
        common: dict[str, Any] = {"mass": part.mass * factor, "contype": 0, "conaffinity": 0}
        if isinstance(part, Rod):
            ends = [*(np.array(part.start) + shift), *(np.array(part.end) + shift)]
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[part.radius, 0, 0], **common
            )
        else:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, pos=np.array(part.centre) + shift,
                size=part.half, **common,
            )  # fmt: skip


def _sheet(links: tuple[Link, ...], **rest: Any) -> Sheet:
    names = ("joint", "body", "slide", "low", "high", "torque", "speed", "acceleration")
    fields = ("joints", "bodies", "slides", *names[3:])
    own: dict[str, Any] = {
        field: tuple(getattr(link, name) for link in links)
        for field, name in zip(fields, names, strict=True)
    }
    return Sheet(**own, **rest)


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
NONE = (0.0, 0.0, 0.0)

_PALLETISER = (
    Link(body="carousel", joint="a1", axis=Z, position=(0, 0, 0.4), low=-1.2, high=1.2,
         parts=(Box((0.1, 0, 0.15), (0.35, 0.3, 0.25), 260.0),),
         torque=6500.0, speed=1.9, acceleration=6.0, armature=190.0, coulomb=140.0, viscous=160.0,
         gear_hz=13.0, teeth=160.0, mesh=4e-6),
    Link(body="swing", joint="a2", axis=Y, position=(0.35, 0, 0.35), low=-0.5, high=0.6,
         parts=(Rod(NONE, (0, 0, 1.15), 0.13, 130.0),
                Rod((-0.2, 0.2, 0), (-0.2, 0.2, 1.1), 0.04, 28.0)),
         torque=8500.0, speed=1.8, acceleration=5.0, armature=210.0, coulomb=170.0, viscous=190.0,
         gear_hz=14.0, teeth=160.0, mesh=4e-6, bending_hz=75.0, bending_axis=X),
    Link(body="boom", joint="a3", axis=Y, position=(0, 0, 1.15), low=-0.3, high=0.7,
         parts=(Rod((-0.35, 0, 0), (1.25, 0, -0.05), 0.1, 95.0),
                Rod((0, 0.15, 0.2), (1.2, 0.15, 0.15), 0.03, 18.0)),
         torque=5200.0, speed=1.9, acceleration=7.0, armature=95.0, coulomb=90.0, viscous=85.0,
         gear_hz=17.0, teeth=140.0, mesh=5e-6, bending_hz=62.0, bending_axis=Y),
    Link(body="head", joint="a4", axis=Z, position=(1.3, 0, -0.1), low=-2.5, high=2.5,
         parts=(Box((0, 0, -0.1), (0.1, 0.12, 0.1), 24.0),
                Box((0.12, 0.05, -0.3), (0.3, 0.2, 0.06), 32.0)),
         torque=620.0, speed=4.5, acceleration=25.0, armature=7.5, coulomb=9.0, viscous=5.0,
         gear_hz=26.0, teeth=120.0, mesh=1.5e-5),
)  # fmt: skip

_GANTRY = (
    Link(body="bridge", joint="x", axis=X, position=(0, 0, 2.0), slide=True, low=-0.9, high=0.9,
         parts=(Box((0, 0, 0), (0.1, 1.1, 0.12), 62.0),),
         torque=3200.0, speed=2.0, acceleration=10.0, armature=55.0, coulomb=95.0, viscous=220.0,
         gear_hz=27.0, teeth=120.0, mesh=2e-6, bending_hz=88.0, bending_axis=X),
    Link(body="trolley", joint="y", axis=Y, position=(0.16, 0, 0), slide=True, low=-0.7, high=0.7,
         parts=(Box((0, 0, 0), (0.12, 0.15, 0.2), 24.0),),
         torque=1600.0, speed=2.0, acceleration=12.0, armature=14.0, coulomb=45.0, viscous=90.0,
         gear_hz=21.0, teeth=200.0, mesh=3e-6),
    Link(body="ram", joint="z", axis=Z, position=(0.14, 0, 0), slide=True, low=-0.55, high=0.0,
         parts=(Box((0, 0, -0.2), (0.045, 0.045, 0.6), 15.0),
                Box((0.03, 0.02, -0.9), (0.12, 0.08, 0.07), 5.5)),
         torque=1500.0, speed=1.3, acceleration=10.0, armature=22.0, coulomb=48.0, viscous=140.0,
         gear_hz=42.0, teeth=100.0, mesh=1e-6, bending_hz=130.0, bending_axis=Y),
)  # fmt: skip

_SEVEN = (
    Link(body="s1", joint="q1", axis=Z, position=(0, 0, 0.15), low=-1.5, high=1.5,
         parts=(Rod((0, 0, -0.02), (0, 0, 0.18), 0.065, 3.6),),
         torque=300.0, speed=1.7, acceleration=12.0, armature=1.7, coulomb=5.0, viscous=6.0,
         gear_hz=19.0, mesh=1.2e-5),
    Link(body="s2", joint="q2", axis=Y, position=(0, 0, 0.19), low=-0.3, high=1.2,
         parts=(Rod(NONE, (0, 0, 0.2), 0.062, 3.5),),
         torque=300.0, speed=1.7, acceleration=12.0, armature=1.7, coulomb=5.0, viscous=6.0,
         gear_hz=17.0, mesh=1.2e-5, bending_hz=95.0, bending_axis=X),
    Link(body="s3", joint="q3", axis=Z, position=(0, 0, 0.21), low=-1.5, high=1.5,
         parts=(Rod(NONE, (0.02, 0, 0.2), 0.055, 2.7),),
         torque=180.0, speed=1.9, acceleration=16.0, armature=0.8, coulomb=3.0, viscous=3.0,
         gear_hz=24.0, mesh=1.5e-5),
    Link(body="s4", joint="q4", axis=(0.0, -1.0, 0.0), position=(0.02, 0, 0.2), low=0.5, high=1.9,
         parts=(Rod(NONE, (-0.02, 0, 0.2), 0.055, 2.5),),
         torque=180.0, speed=1.9, acceleration=16.0, armature=0.8, coulomb=3.0, viscous=3.0,
         gear_hz=25.0, mesh=1.5e-5, bending_hz=140.0, bending_axis=X),
    Link(body="s5", joint="q5", axis=Z, position=(-0.02, 0, 0.2), low=-1.7, high=1.7,
         parts=(Rod(NONE, (0, 0, 0.19), 0.045, 1.7),),
         torque=110.0, speed=2.4, acceleration=22.0, armature=0.35, coulomb=1.8, viscous=1.5,
         gear_hz=34.0, mesh=1.8e-5),
    Link(body="s6", joint="q6", axis=Y, position=(0, 0, 0.2), low=-1.6, high=1.6,
         parts=(Rod(NONE, (0.05, 0, 0.02), 0.045, 1.5),),
         torque=45.0, speed=2.8, acceleration=30.0, armature=0.18, coulomb=0.9, viscous=0.7,
         gear_hz=38.0, mesh=2e-5),
    Link(body="s7", joint="q7", axis=Z, position=(0.08, 0, 0.03), low=-2.0, high=2.0,
         parts=(Rod(NONE, (0, 0, 0.05), 0.035, 0.5),
                Box((0.04, 0.02, 0.1), (0.05, 0.03, 0.04), 0.9)),
         torque=45.0, speed=2.8, acceleration=35.0, armature=0.12, coulomb=0.7, viscous=0.5,
         gear_hz=52.0, mesh=2e-5),
)  # fmt: skip

_COBOT = (
    Link(body="shoulder", joint="j1", axis=Z, position=(0, 0, 0.11), low=-1.4, high=1.4,
         parts=(Rod((0, 0, -0.03), (0, 0, 0.06), 0.055, 2.1),),
         torque=75.0, speed=2.0, acceleration=14.0, armature=0.42, coulomb=2.6, viscous=3.0,
         gear_hz=21.0, mesh=1.5e-5),
    Link(body="upper", joint="j2", axis=Y, position=(0, 0.06, 0.06), low=-0.9, high=0.9,
         parts=(Rod(NONE, (0, 0, 0.27), 0.045, 2.6), Rod((0, -0.05, 0), (0, 0.06, 0), 0.05, 0.8)),
         torque=75.0, speed=2.0, acceleration=12.0, armature=0.42, coulomb=2.6, viscous=3.0,
         gear_hz=19.0, mesh=1.5e-5, bending_hz=105.0, bending_axis=X),
    Link(body="lower", joint="j3", axis=Y, position=(0, -0.04, 0.27), low=0.5, high=1.9,
         parts=(Rod(NONE, (0, 0, 0.23), 0.038, 1.5),),
         torque=45.0, speed=2.4, acceleration=18.0, armature=0.2, coulomb=1.6, viscous=1.8,
         gear_hz=26.0, mesh=1.8e-5, bending_hz=150.0, bending_axis=X),
    Link(body="wrist1", joint="j4", axis=X, position=(0, 0, 0.25), low=-1.5, high=1.5,
         parts=(Rod((-0.03, 0, 0), (0.05, 0, 0.03), 0.033, 0.75),),
         torque=20.0, speed=3.0, acceleration=35.0, armature=0.055, coulomb=0.55, viscous=0.4,
         gear_hz=37.0, mesh=2e-5),
    Link(body="wrist2", joint="j5", axis=Y, position=(0.05, 0, 0.05), low=-1.4, high=1.4,
         parts=(Rod((0, -0.03, 0), (0, 0.04, 0.02), 0.033, 0.7),),
         torque=20.0, speed=3.0, acceleration=35.0, armature=0.055, coulomb=0.55, viscous=0.4,
         gear_hz=41.0, mesh=2e-5),
    Link(body="flange", joint="j6", axis=Z, position=(0, 0.05, 0.05), low=-2.2, high=2.2,
         parts=(Rod(NONE, (0, 0, 0.03), 0.03, 0.3),
                Box((0.03, 0.0, 0.07), (0.05, 0.03, 0.03), 0.7)),
         torque=20.0, speed=3.0, acceleration=40.0, armature=0.05, coulomb=0.5, viscous=0.35,
         gear_hz=55.0, mesh=2.5e-5),
)  # fmt: skip

_WELDER = (
    Link(body="column", joint="axis1", axis=Z, position=(0, 0, 0.2), low=-1.3, high=1.3,
         parts=(Box((0.05, 0, 0.1), (0.16, 0.14, 0.12), 48.0),),
         torque=1100.0, speed=2.4, acceleration=9.0, armature=16.0, coulomb=32.0, viscous=30.0,
         gear_hz=16.0, teeth=150.0, mesh=8e-6),
    Link(body="arm", joint="axis2", axis=Y, position=(0.15, 0.09, 0.22), low=-0.7, high=0.8,
         parts=(Box((0, 0, 0.3), (0.06, 0.05, 0.34), 26.0),
                Rod((0, -0.1, 0), (0, 0.02, 0), 0.08, 9.0)),
         torque=1300.0, speed=2.4, acceleration=8.0, armature=17.0, coulomb=36.0, viscous=34.0,
         gear_hz=15.0, teeth=150.0, mesh=8e-6, bending_hz=82.0, bending_axis=X),
    Link(body="elbow", joint="axis3", axis=Y, position=(0, -0.09, 0.6), low=-0.6, high=0.9,
         parts=(Box((0, 0, 0.05), (0.12, 0.09, 0.09), 21.0),),
         torque=620.0, speed=2.8, acceleration=12.0, armature=6.5, coulomb=15.0, viscous=13.0,
         gear_hz=20.0, teeth=150.0, mesh=1e-5),
    Link(body="tube", joint="axis4", axis=X, position=(0.12, 0, 0.1), low=-2.0, high=2.0,
         parts=(Rod((0.05, 0, 0), (0.62, 0, 0), 0.05, 13.0),
                Rod((0.05, 0.045, 0), (0.6, 0.045, 0), 0.015, 2.2)),
         torque=110.0, speed=4.0, acceleration=35.0, armature=0.5, coulomb=3.0, viscous=1.6,
         gear_hz=33.0, teeth=90.0, mesh=3e-5, bending_hz=115.0, bending_axis=Z),
    Link(body="torch", joint="axis5", axis=Y, position=(0.66, 0, 0), low=-1.5, high=1.5,
         parts=(Rod(NONE, (0.09, 0, 0), 0.03, 2.0), Rod((0.08, 0, 0), (0.22, 0, -0.1), 0.014, 1.1)),
         torque=75.0, speed=4.0, acceleration=40.0, armature=0.3, coulomb=2.1, viscous=1.1,
         gear_hz=36.0, teeth=90.0, mesh=3e-5),
)  # fmt: skip

DESIGNS: Mapping[str, Design] = {
    design.sheet.name: design
    for design in (
        Design(
            sheet=_sheet(
                _PALLETISER, name="palletiser", command="position", command_hz=250.0,
                latency=0.008, interpolated=True, bandwidth_hz=13.0, encoders="motor",
                log_hz=250.0, torques="none", resolution=(2e-6,) * 4, judged_only=True,
                sensor=Sensor(rate_hz=1000.0, corner_hz=380.0, noise_ug=70.0, range_g=8.0),
                strike=(60.0, 220.0), friction=(15.0, 90.0), payload=(6.0, 40.0),
            ),
            base=(Box((0, 0, 0.2), (0.5, 0.5, 0.2), 400.0),), links=_PALLETISER,
            tool=(0.34, 0.1, -0.34), tool_turn=(0.0, 1.2, 0.3),
            control_hz=2000.0, control="cascade", servo_hz=14.0, position_gain=18.0, forward=0.9,
            hysteresis=0.003,
        ),
        Design(
            sheet=_sheet(
                _GANTRY, name="gantry", command="position", command_hz=500.0, latency=0.004,
                interpolated=True, bandwidth_hz=22.0, encoders="motor", log_hz=1000.0,
                torques="current", resolution=(1e-6,) * 3,
                sensor=Sensor(rate_hz=3000.0, corner_hz=900.0, noise_ug=50.0),
                strike=(25.0, 90.0), friction=(4.0, 40.0), payload=(1.0, 6.0),
            ),
            base=(Box((0, 1.2, 1.0), (1.2, 0.08, 1.0), 300.0),
                  Box((0, -1.2, 1.0), (1.2, 0.08, 1.0), 300.0)),
            links=_GANTRY, tool=(0.1, 0.07, -0.95), tool_turn=(0.4, 0.0, 0.9),
            control_hz=2000.0, control="cascade", servo_hz=22.0, position_gain=32.0,
            hysteresis=0.004,
        ),
        Design(
            sheet=_sheet(
                _SEVEN, name="seven", command="torque", command_hz=1000.0, latency=0.002,
                interpolated=False, bandwidth_hz=25.0, encoders="link", log_hz=1000.0,
                torques="joint", resolution=(2 * np.pi / 2**18,) * 7, judged_only=True,
                sensor=Sensor(rate_hz=2000.0, corner_hz=650.0, noise_ug=110.0),
                strike=(12.0, 45.0), friction=(1.5, 14.0), payload=(0.4, 2.5),
            ),
            base=(Rod((0, 0, 0.02), (0, 0, 0.12), 0.08, 5.0),), links=_SEVEN,
            tool=(0.08, 0.05, 0.12), tool_turn=(0.0, 0.0, 0.7),
            control_hz=1000.0, control="stiffness", servo_hz=2.5, gravity=True, hysteresis=0.006,
        ),
        Design(
            sheet=_sheet(
                _COBOT, name="cobot", command="position", command_hz=250.0, latency=0.006,
                interpolated=True, bandwidth_hz=20.0, encoders="motor", log_hz=500.0,
                torques="current", resolution=(2 * np.pi / 2**16,) * 6,
                sensor=Sensor(rate_hz=1600.0, corner_hz=500.0, noise_ug=180.0),
                strike=(10.0, 35.0), friction=(1.0, 10.0), payload=(0.2, 1.5),
            ),
            base=(Rod((0, 0, 0.02), (0, 0, 0.08), 0.07, 2.0),), links=_COBOT,
            tool=(0.07, 0.025, 0.09), tool_turn=(1.57, 0.0, 0.0),
            control_hz=1000.0, control="stiffness", servo_hz=9.0, gravity=True, hysteresis=0.008,
            load_friction=0.05,
        ),
        Design(
            sheet=_sheet(
                _WELDER, name="welder", command="velocity", command_hz=500.0, latency=0.004,
                interpolated=False, bandwidth_hz=17.0, encoders="motor", log_hz=250.0,
                torques="none", resolution=(2 * np.pi / 2**19,) * 5,
                sensor=Sensor(rate_hz=800.0, corner_hz=320.0, noise_ug=120.0),
                strike=(25.0, 90.0), friction=(4.0, 45.0), payload=(0.5, 4.0),
            ),
            base=(Box((0, 0, 0.1), (0.2, 0.2, 0.1), 90.0),), links=_WELDER,
            tool=(0.11, 0.03, -0.01), tool_turn=(0.2, 0.7, 0.0),
            control_hz=1000.0, control="cascade", servo_hz=18.0, position_gain=22.0, gravity=True,
            load_friction=0.04,
        ),
    )
}  # fmt: skip
"""Classes of machines that are written here."""
