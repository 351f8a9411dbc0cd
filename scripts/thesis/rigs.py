"""Arms of the thesis's rigs: cylindrical arm, VERA on its shaker, slide on its bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np

from loose_env.arms import (
    HOLDING_MODE_HZ,
    LINK_LENGTH,
    Arm,
    BendingLink2,
    Gears,
    Holding,
    HoldKind,
    Shaker,
    held,
    holdings,
    new_spec,
    vera_spec,
)
from loose_env.faults import Preload, StructuralLooseness

_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE

# The cylindrical arm, after the Prab Versatran FA600 (6.2.1).
COLUMN_MODE_HZ = 8.0
"""Mode of the column on its floor, arm raised and extended, joints locked [Hz] (6.2.1)."""
COLUMN_DAMPING = 0.03
"""Damping ratio of that mode; an estimate."""
SIDE_STIFFNESS = 1.9
"""Column stiffness sideways over that fore and aft [1]: the feet are farther apart; an estimate."""
LOCK_MODE_HZ = 240.0
"""Holding mode of the mechanical locks: four times the top of the band; an estimate."""
OIL_MODE_HZ = 25.0
"""Mode of each joint on the oil of its cylinder, valves shut, for ``hold="compliant"`` [Hz]: an
estimate for large hydraulic drives, inside the band."""
GUIDE = "guide"
"""Body of the bearing blocks on the carriage, through which the boom runs."""
SWING_LIMIT = np.radians(125.0)
LIFT, REACH = 0.76, 1.05
_LOWEST = 0.60  # height of the boom over the floor, carriage down [m]
_BOOM_LENGTH, _BOOM_AHEAD = 2.40, 0.55  # length, and how much is ahead of the guide, drawn in [m]
_COLUMN_MASS, _CARRIAGE_MASS, _BLOCKS_MASS, _BOOM_MASS = 400.0, 170.0, 12.0, 110.0
_WRIST = ((16.0, 0.12), (11.0, 0.10), (8.0, 0.14))  # mass [kg] and length [m] of each wrist link


def cylindrical(*, hold: HoldKind = "brake") -> Arm:
    """Build a hydraulic cylindrical arm of six axes with gravity along -z."""
    spec = new_spec(gravity=(0, 0, -9.81))
    foot = _solid(60.0, (0.6, 0.6, 0.6))
    floor = spec.worldbody.add_body(name="column_foot", pos=[0, 0, 0], **foot)
    for name, axis in (("lean_fore", (0, 1, 0)), ("lean_side", (1, 0, 0))):
        floor.add_joint(name=name, type=_HINGE, axis=list(axis))

    solid = _solid(_COLUMN_MASS, _box(_COLUMN_MASS, 0.45, 0.45, 1.7), up=0.75)
    column = _link(floor, 1, (0, 0, 0.1), _HINGE, (0, 0, 1), (20.0, 5.0, 400.0), **solid)
    solid = _solid(_CARRIAGE_MASS, _box(_CARRIAGE_MASS, 0.6, 0.5, 0.4))
    at = (0.15, 0, _LOWEST - 0.1)
    carriage = _link(column, 2, at, _SLIDE, (0, 0, 1), (10.0, 10.0, 900.0), **solid)
    solid = _solid(_BLOCKS_MASS, _box(_BLOCKS_MASS, 0.5, 0.2, 0.2))
    blocks = carriage.add_body(name=GUIDE, pos=[0, 0, 0], **solid)
    centre = _BOOM_AHEAD - _BOOM_LENGTH / 2
    solid = _solid(_BOOM_MASS, _box(_BOOM_MASS, _BOOM_LENGTH, 0.15, 0.15), ahead=centre)
    boom = _link(blocks, 3, (0, 0, 0), _SLIDE, (1, 0, 0), (5.0, 5.0, 300.0), **solid)

    parent, place = boom, (_BOOM_AHEAD, 0.0, -0.15)
    for number, axis in ((4, (1, 0, 0)), (5, (0, 1, 0)), (6, (1, 0, 0))):
        mass, length = _WRIST[number - 4]
        solid = _solid(mass, _box(mass, length, 0.12, 0.12), ahead=length / 2)
        parent = _link(parent, number, place, _HINGE, axis, (1.0, 0.05, 5.0), **solid)
        place = (length, 0.0, 0.0)
    parent.add_site(name="tool", pos=list(place))
    boom.add_site(name="wrist_base", pos=[_BOOM_AHEAD, 0, -0.15])
    _stiffen_column(spec)

    joints = tuple(f"joint{i}" for i in range(1, 7))
    brake, servo, centring = holdings(spec, joints)
    softer = LOCK_MODE_HZ / HOLDING_MODE_HZ
    brake = Holding(
        stiffness=tuple(float(f"{k * softer**2:.3g}") for k in brake.stiffness),
        damping=tuple(float(f"{c * softer:.3g}") for c in brake.damping),
    )
    turn = np.radians(170.0)
    arm = Arm(
        name="cylindrical",
        spec=spec,
        joints=joints,
        seat_bodies=tuple(f"link{i}" for i in range(1, 7)),
        tool="tool",
        axes=(0, 1, 2),
        torque_limits=(3000.0, 9000.0, 4000.0, 400.0, 300.0, 150.0),
        joint_ranges=(
            (-SWING_LIMIT, SWING_LIMIT),
            (0.0, LIFT),
            (0.0, REACH),
            (-turn, turn),
            (-np.pi / 2, np.pi / 2),
            (-turn, turn),
        ),
        levels=(0.2, 0.6, 2.0),
        band=(15.0, 60.0),
        brake=brake,
        servo=servo,
        centring=centring,
        timestep=2e-4,
        settling=0.5,  # the column's mode, below the band, is hardly excited
        gears=Gears(mode_hz=OIL_MODE_HZ),
        probes=("wrist_base",),
    )
    return held(arm, hold)


def _stiffen_column(spec: mujoco.MjSpec) -> None:
    """Give the leaning column its mode with the arm raised and extended, joints locked."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    data.joint("joint2").qpos[0], data.joint("joint3").qpos[0] = LIFT, REACH
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dof = model.joint("lean_fore").dofadr[0]
    inertia, omega = float(full[dof, dof]), 2 * np.pi * COLUMN_MODE_HZ
    for name, factor in (("lean_fore", 1.0), ("lean_side", SIDE_STIFFNESS)):
        joint = spec.joint(name)
        joint.stiffness = [factor * inertia * omega**2, 0, 0]
        joint.damping = [factor * 2 * COLUMN_DAMPING * inertia * omega, 0, 0]


def _link(
    parent: mujoco.MjsBody,
    number: int,
    at: Sequence[float],
    kind: mujoco.mjtJoint,
    axis: Sequence[float],
    flange: tuple[float, float, float],
    **solid: Any,
) -> mujoco.MjsBody:
    """Add a flange (its mass, armature and damping) with a joint, and the link behind it."""
    mass, armature, damping = flange
    own = _solid(mass, _box(mass, 0.1, 0.1, 0.1))
    body = parent.add_body(name=f"flange{number}", pos=list(at), **own)
    joint = body.add_joint(name=f"joint{number}", type=kind, axis=list(axis))
    joint.armature, joint.damping = armature, [damping, 0, 0]
    return body.add_body(name=f"link{number}", **solid)


def _solid(mass: float, inertia: Sequence[float], ahead: float = 0.0, up: float = 0.0) -> Any:
    """Mass [kg] and principal inertia [kg·m²] of a body, its centre ahead and up of its frame."""
    place = [ahead, 0, up]
    return {"mass": mass, "ipos": place, "inertia": list(inertia), "explicitinertial": True}


def _ball(mass: float, radius: float) -> Any:
    """A ball about the body's own frame."""
    return _solid(mass, [0.4 * mass * radius**2] * 3)


def _box(mass: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Principal inertia of a box of the given sides [kg·m²]."""
    return (mass * (y**2 + z**2) / 12, mass * (x**2 + z**2) / 12, mass * (x**2 + y**2) / 12)


# VERA on its shaker, as Experiments Five and Six had it: a pin in joint 2.
Pin = Literal["engaged", "half_released", "rigid"]
STIFF_PIN_FACTOR = 20.0
"""Stiffness of the rigid pin over that of the engaged one: its mode then lies above the band."""
PROXIMAL = "link1_accelerometer"
"""Probe on link 1; its second axis is tangential and gives the reference of all correlations."""
SHAKEN_BAND = (20.0, 350.0)
"""White noise played to the shaker [Hz] (6.1.6: flat to 350 Hz)."""


@dataclass(frozen=True, kw_only=True)
class ShakenVeraParameters:
    """Parameters of the rig that the thesis does not print, one set for all cases."""

    pin_stiffness: float = 7.04e4
    """Torsional stiffness of the tapered pin between gear and link 1 [N·m/rad]."""
    pin_damping: float = 9.14
    """Its damping [N·m·s/rad]."""
    link2_mode: float = 251.0
    """First bending mode of link 2, clamped [Hz]; the thesis says over 200 Hz (6.1.2)."""
    link2_damping: float = 0.015
    """Damping ratio of that mode."""
    link1_damping: float = 0.0906
    """Damping ratio of link 1's bending mode, with cables and hitch attached."""
    seat_mass: float = 0.537
    """Mass of the looseness joint at the proximal end of link 2 [kg]."""
    joint_damping: float = 1.26
    """Damping of joint 1, whose drive is turned backwards [N·m·s/rad]."""
    hitch: float = 0.160
    """Distance of the stinger from joint 1 [m]."""
    accelerometer: float = 0.167
    """Distance of link 1's accelerometer from joint 1 [m]."""
    coil_mass: float = 0.805
    """Coil and table of the shaker [kg]."""
    suspension_stiffness: float = 2.29e5
    """Suspension of the coil [N/m]."""
    suspension_damping: float = 136.0
    """Its damping [N·s/m]."""


STIFF_PIN_FIT = ShakenVeraParameters(
    pin_stiffness=1.41e6,
    pin_damping=40.9,
    link2_mode=207.0,
    link2_damping=0.0108,
    link1_damping=0.0428,
    seat_mass=0.406,
    joint_damping=3.24,
    hitch=0.187,
    accelerometer=0.179,
    coil_mass=3.46,
    suspension_stiffness=4.99e4,
    suspension_damping=369.0,
)
"""The same fit with the pin held at `STIFF_PIN_FACTOR` times its stiffness and damped alike
(``identify_vera.py --stiff-pin``): the rival explanation of the healthy cases."""
STINGER_STIFFNESS, STINGER_DAMPING, STINGER_LENGTH = 1.56e7, 50.0, 0.17
"""The threaded rod between shaker and link (6.12) [N/m, N·s/m, m]."""


def shaken_vera(*, pin: Pin = "engaged", parameters: ShakenVeraParameters | None = None) -> Arm:
    """Build VERA on the shaker: link 1 is pushed, joint 2 is blocked by a pin."""
    stiffness = {"engaged": 1.0, "half_released": 0.5, "rigid": STIFF_PIN_FACTOR}
    rig = ShakenVeraParameters() if parameters is None else parameters
    spec = vera_spec(
        mode_damping=rig.link1_damping,
        link2=BendingLink2(
            mode_hz=rig.link2_mode, damping=rig.link2_damping, seat_mass=rig.seat_mass
        ),
    )
    root = LINK_LENGTH / 3
    # The accelerometer lies beyond the bending hinge, as the beam there does bend.
    spec.body("link1_end").add_site(name=PROXIMAL, pos=[rig.accelerometer - root, 0, 0])
    joints = ("joint1", "joint2")
    brake, servo, centring = holdings(spec, joints)
    factor = stiffness[pin]
    pinned = Holding(
        stiffness=(brake.stiffness[0], rig.pin_stiffness * factor),
        damping=(brake.damping[0], rig.pin_damping * factor**0.5),
    )
    # Joint 1 turns freely; the suspension of the coil centres it.
    centring = Holding(
        stiffness=(0.0, centring.stiffness[1]), damping=(rig.joint_damping, centring.damping[1])
    )
    return Arm(
        name="vera-shaken" if pin == "engaged" else f"vera-shaken-{pin.replace('_', '-')}",
        spec=spec,
        joints=joints,
        seat_bodies=("link1", "link2"),
        tool="tool",
        axes=(0, 1),
        torque_limits=(5.08, 3.39),
        joint_ranges=(None, None),
        levels=(1.0, 3.0, 9.0),
        band=SHAKEN_BAND,
        brake=pinned,
        servo=servo,
        centring=centring,
        timestep=1e-4,
        settling=0.3,
        probes=(PROXIMAL,),
        shaker=Shaker(
            joint=1,
            body="link1_end",
            point=(rig.hitch - root, 0.0, 0.0),
            direction=(0.0, 1.0, 0.0),
            coil_mass=rig.coil_mass,
            stinger_stiffness=STINGER_STIFFNESS,
            stinger_damping=STINGER_DAMPING,
            stinger_length=STINGER_LENGTH,
            suspension_stiffness=rig.suspension_stiffness,
            suspension_damping=rig.suspension_damping,
        ),
    )


# The slide rig of Experiments Two to Four: one slide on a bench, pushed by a shaker.
Stinger = Literal["threaded_rod", "stiff"]
Mount = Literal["bolted", "loose"]
SLIDE, BENCH = "slide_accelerometer", "bench_accelerometer"
"""Probes on the slide and on the bench under it; their first axes lie along the sliding motion."""
LOOSE_GAP = 2e-4
"""Travel of the looseness joint, its stops turned back by a quarter turn [m] (6.3.3)."""
SLIDE_MASS = 0.50
"""Slide with its attachments [kg] (6.3.2)."""
CUBE_MASS = 0.15
"""Share of it that is the cube of accelerometers [kg]; an estimate."""
DISTAL_MASS = 0.40
"""Looseness joint's moving half, distal link and cube, on top of the slide [kg]; an estimate."""
COIL_MASS = 0.39
"""Coil and table of the shaker [kg]; an estimate."""
STINGER_HZ = 710.0
"""Resonance of slide and coil on the threaded rod, as measured (6.3.2) [Hz]."""
SLIDE_STINGER: dict[Stinger, float] = {
    "threaded_rod": (2 * np.pi * STINGER_HZ) ** 2
    * SLIDE_MASS
    * COIL_MASS
    / (SLIDE_MASS + COIL_MASS),
    "stiff": 6.0e7,
}
"""Stinger [N/m]. The rod's follows from its resonance with a free coil: 4.4e6, where AE/L (6.12)
of the rod alone is 1.6e7."""
BENCH_MASS, BENCH_INERTIA = 80.0, 8.0
"""Bench [kg, kg·m²]; an estimate."""
BENCH_MODES_HZ = (20.0, 50.5, 101.0)
"""Bench nearly along the slide, nearly across it and in yaw; the last two as seen (6.3.1)."""
BENCH_DAMPING = 0.01
"""Damping ratio of those modes; an estimate."""
BENCH_CANT = np.radians(30.0)
"""Angle of the bench's principal axes from the rails [rad]; an estimate."""
RAILS = (0.35, 0.10)
"""Slide from the bench's centre of mass, along and beside the rails [m]; an estimate."""
_MOUNT_PLAY = (1e-4, 1e-4, 3e-3)
"""Play of the loose mounting plate along x and y [m] and about its screw [rad]."""


def slide_rig(
    *,
    looseness_angle: float | None = None,
    cube_angle: float = 0.0,
    stinger: Stinger = "stiff",
    mount: Mount = "bolted",
) -> Arm:
    """Build the slide rig."""
    angle = 0.0 if looseness_angle is None else looseness_angle

    spec = new_spec(gravity=(0, 0, -9.81))
    bench = _bench(spec)
    ball = _ball(SLIDE_MASS - (CUBE_MASS if looseness_angle is None else 0.0), 0.04)
    slide = bench.add_body(name="flange1", pos=[*RAILS, 0.1], **ball)
    slide.add_joint(name="slide", type=_SLIDE, axis=[1, 0, 0], damping=[2.0, 0, 0])
    slide.add_site(name=SLIDE)
    carrier = _loose_plate(slide) if mount == "loose" else slide
    ball = _ball(CUBE_MASS if looseness_angle is None else DISTAL_MASS, 0.05)
    link = carrier.add_body(name="link1", quat=_about_z(angle), **ball)
    link.add_site(name="tool", quat=_about_z(cube_angle))
    return Arm(
        name="slide",
        spec=spec,
        joints=("slide",),
        seat_bodies=("link1",),
        tool="tool",
        axes=(0, 1),
        torque_limits=(100.0,),
        joint_ranges=((-0.01, 0.01),),
        levels=(1.0, 3.0, 9.0),
        band=SHAKEN_BAND,
        brake=Holding(stiffness=(1e7,), damping=(1e3,)),
        servo=Holding(stiffness=(2e4,), damping=(1e2,)),
        centring=Holding(stiffness=(0.0,), damping=(0.0,)),  # the shaker's suspension centres it
        timestep=5e-5,
        settling=0.3,
        probes=(SLIDE, BENCH),
        shaker=Shaker(
            joint=1,
            body="flange1",
            point=(0.0, 0.0, 0.0),
            direction=(1.0, 0.0, 0.0),
            coil_mass=COIL_MASS,
            stinger_stiffness=SLIDE_STINGER[stinger],
            stinger_damping=30.0,
            stinger_length=0.12,
            suspension_stiffness=1.24e5,
            suspension_damping=142.0,
            stand="bench",
        ),
    )


def _bench(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    bench = spec.worldbody.add_body(name="bench", **_solid(BENCH_MASS, [BENCH_INERTIA] * 3))
    # Its supports are not square to the rails, and the rails do not pass through its centre of
    # mass, so pushing along them also moves and turns the bench across them.
    c, s = float(np.cos(BENCH_CANT)), float(np.sin(BENCH_CANT))
    # What rides on the bench moves with it across the rails and in yaw.
    load = SLIDE_MASS + COIL_MASS
    for name, kind, axis, hz, inertia in (
        ("bench_x", _SLIDE, [c, s, 0], BENCH_MODES_HZ[0], BENCH_MASS),
        ("bench_y", _SLIDE, [-s, c, 0], BENCH_MODES_HZ[1], BENCH_MASS + load * c**2),
        ("bench_yaw", _HINGE, [0, 0, 1], BENCH_MODES_HZ[2], BENCH_INERTIA + load * RAILS[0] ** 2),
    ):
        omega = 2 * np.pi * hz
        bench.add_joint(
            name=name,
            type=kind,
            axis=axis,
            stiffness=[inertia * omega**2, 0, 0],
            damping=[2 * BENCH_DAMPING * inertia * omega, 0, 0],
        )
    bench.add_site(name=BENCH, pos=[*RAILS, 0])
    return bench


def _loose_plate(slide: mujoco.MjsBody) -> mujoco.MjsBody:
    plate = slide.add_body(name="plate", **_ball(0.15, 0.04))
    for name, kind, axis, play in zip(
        ("plate_x", "plate_y", "plate_yaw"),
        (_SLIDE, _SLIDE, _HINGE),
        ([1, 0, 0], [0, 1, 0], [0, 0, 1]),
        _MOUNT_PLAY,
        strict=True,
    ):
        plate.add_joint(
            name=name,
            type=kind,
            axis=axis,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=[-play, play],
            frictionloss=0.5 if kind == _SLIDE else 0.01,
            solref_limit=[4e-4, 0.4],  # a stop with a contact mode near 400 Hz
        )
    return plate


def _about_z(angle: float) -> list[float]:
    return [float(np.cos(angle / 2)), 0.0, 0.0, float(np.sin(angle / 2))]


Direction = tuple[float, float, float]


def loosened(*, link: int, direction: Direction) -> StructuralLooseness:
    """Return the joint with its stops turned back by a quarter turn: 0.2 mm of travel (6.3.3)."""
    return StructuralLooseness(
        link=link,
        direction=direction,
        gap=LOOSE_GAP,
        stiffness=(4e6, 2.4e6),
        damping=(1600.0, 960.0),
        friction=0.3,
    )


def finger_tight(*, link: int, direction: Direction) -> Preload:
    """Return the joint with its stops finger-tight: stiff, but not as a solid part."""
    return Preload(link=link, direction=direction, stiffness=5e7, damping=2e3)
