"""The slide rig of Experiments Two to Four: one slide on a bench, pushed by a shaker."""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np

from loose_env.arms import Arm, Holding, Shaker, new_spec
from loose_env.faults import Preload, StructuralLooseness
from loose_env.thesis.rigs.shaken_vera import SHAKEN_BAND

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
STINGER_STIFFNESS: dict[Stinger, float] = {
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
    """Build the slide rig.

    The arm's one joint is the slide, along the bench's x axis. Its link is what rides on it:
    the cube of accelerometers alone, or the looseness joint with a distal link and the cube.
    The link's x axis lies along the looseness joint, so a seat there has direction (1, 0, 0).

    ``looseness_angle``: angle of the looseness joint from the sliding motion [rad] (the thesis's
    β); None mounts the cube on the slide itself. ``cube_angle``: angle of the cube's x axis from
    the link's [rad] (the thesis's α). ``mount``: whether the plate under the looseness joint is
    bolted down or its one screw has lost its preload: it then slides and turns within its play,
    whatever the seat does.

    Examples
    --------
    >>> rig = slide_rig(looseness_angle=np.radians(309))
    >>> rig.joints, rig.probes
    (('slide',), ('slide_accelerometer', 'bench_accelerometer'))
    """
    angle = 0.0 if looseness_angle is None else looseness_angle

    spec = new_spec(gravity=(0, 0, -9.81))
    bench = _bench(spec)
    slide = bench.add_body(name="flange1", pos=[*RAILS, 0.1])
    _weigh(slide, SLIDE_MASS - (CUBE_MASS if looseness_angle is None else 0.0), 0.04)
    slide.add_joint(
        name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0], damping=[2.0, 0, 0]
    )
    slide.add_site(name=SLIDE)
    carrier = _loose_plate(slide) if mount == "loose" else slide
    link = carrier.add_body(name="link1", quat=_about_z(angle))
    _weigh(link, CUBE_MASS if looseness_angle is None else DISTAL_MASS, 0.05)
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
            stinger_stiffness=STINGER_STIFFNESS[stinger],
            stinger_damping=30.0,
            stinger_length=0.12,
            suspension_stiffness=1.24e5,
            suspension_damping=142.0,
            stand="bench",
        ),
    )


def _bench(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    bench = spec.worldbody.add_body(
        name="bench",
        mass=BENCH_MASS,
        ipos=[0, 0, 0],
        inertia=[BENCH_INERTIA] * 3,
        explicitinertial=True,
    )
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    # Its supports are not square to the rails, and the rails do not pass through its centre of
    # mass, so pushing along them also moves and turns the bench across them.
    c, s = float(np.cos(BENCH_CANT)), float(np.sin(BENCH_CANT))
    # What rides on the bench moves with it across the rails and in yaw.
    load = SLIDE_MASS + COIL_MASS
    for name, kind, axis, hz, inertia in (
        ("bench_x", slide, [c, s, 0], BENCH_MODES_HZ[0], BENCH_MASS),
        ("bench_y", slide, [-s, c, 0], BENCH_MODES_HZ[1], BENCH_MASS + load * c**2),
        ("bench_yaw", hinge, [0, 0, 1], BENCH_MODES_HZ[2], BENCH_INERTIA + load * RAILS[0] ** 2),
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
    plate = slide.add_body(name="plate")
    _weigh(plate, 0.15, 0.04)
    for name, kind, axis, play in zip(
        ("plate_x", "plate_y", "plate_yaw"),
        (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE),
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
            frictionloss=0.5 if kind == mujoco.mjtJoint.mjJNT_SLIDE else 0.01,
            solref_limit=[4e-4, 0.4],  # a stop with a contact mode near 400 Hz
        )
    return plate


def _weigh(body: mujoco.MjsBody, mass: float, radius: float) -> None:
    body.mass = mass
    body.ipos = [0, 0, 0]
    body.inertia = [0.4 * mass * radius**2] * 3
    body.explicitinertial = True


def _about_z(angle: float) -> list[float]:
    return [float(np.cos(angle / 2)), 0.0, 0.0, float(np.sin(angle / 2))]


Direction = tuple[float, float, float]


def loosened(*, link: int, direction: Direction) -> StructuralLooseness:
    """Return the joint with its stops turned back by a quarter turn: 0.2 mm of travel (6.3.3).

    Travel is the thesis's. It runs on linear bushings of low friction between steel stops whose
    stiffness differs; those figures are estimates, the same on both rigs.

    Examples
    --------
    >>> loosened(link=2, direction=(1.0, 0.0, 0.0)).gap
    0.0002
    """
    return StructuralLooseness(
        link=link,
        direction=direction,
        gap=LOOSE_GAP,
        stiffness=(4e6, 2.4e6),
        damping=(1600.0, 960.0),
        friction=0.3,
    )


def finger_tight(*, link: int, direction: Direction) -> Preload:
    """Return the joint with its stops finger-tight: stiff, but not as a solid part.

    Examples
    --------
    >>> finger_tight(link=2, direction=(1.0, 0.0, 0.0)).kind
    'healthy'
    """
    return Preload(link=link, direction=direction, stiffness=5e7, damping=2e3)
