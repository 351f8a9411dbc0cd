"""Arms of the library: planar arms, VERA, the PUMA 560, a SCARA."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from loose_env.arms.arm import Arm, Gears, HoldKind
from loose_env.arms.holding import (
    CREST_FACTOR,
    GRAVITY,
    MOTOR_SIDE,
    STIFFNESS_PER_TORQUE,
    add_link,
    held,
    holdings,
    new_spec,
)
from loose_env.errors import InvalidSetting


def _arm(name: str, spec: mujoco.MjSpec, hold: HoldKind, **settings: Any) -> Arm:
    """Arm of bodies link1, link2, ... behind joint1, joint2, ..., with its holdings."""
    n = len(settings["torque_limits"])
    joints = tuple(f"joint{i}" for i in range(1, n + 1))
    brake, servo, centring = holdings(spec, joints)
    arm = Arm(
        name=name,
        spec=spec,
        joints=joints,
        seat_bodies=tuple(f"link{i}" for i in range(1, n + 1)),
        tool="tool",
        band=(30.0, 150.0),
        brake=brake,
        servo=servo,
        centring=centring,
        **settings,
    )
    return held(arm, hold)


def planar(n_links: int = 4, *, vertical: bool = False, hold: HoldKind = "brake") -> Arm:
    """Build a planar arm of ``n_links`` equal lengths whose masses taper towards the tool.

    Each link is 0.30 m long; link 1 has 4 kg, each next one 0.75 of it, centre of mass at
    0.55 of the length because the next joint's drive sits at the far end. A drive's
    reflected rotor inertia is half the inertia it moves with the arm straight, as on
    industrial arms (PUMA 560: 1.1 and 4.7 kg·m² at the first two joints). Torque limits
    are what the top level asks of each joint with the arm straight, peaks included. Elastic
    gears have a mode of 60 Hz each (`loose_env.arms.arm.GEAR_MODE_HZ`): for three
    links 3e5, 8.4e4 and 1.1e4 N·m/rad, within what industrial drives have.

    Parameters
    ----------
    n_links : int
        2 to 7.
    vertical : bool
        Whether the plane of motion holds gravity; else gravity is normal to it.
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding`.

    Raises
    ------
    InvalidSetting
        If ``n_links`` is not 2 to 7.

    Examples
    --------
    >>> planar(3).joints
    ('joint1', 'joint2', 'joint3')
    """
    whole = isinstance(n_links, (int, np.integer)) and not isinstance(n_links, bool)
    if not whole or n_links not in range(2, 8):
        raise InvalidSetting(f"a planar arm has 2 to 7 links, got n_links={n_links!r}")
    if not isinstance(vertical, (bool, np.bool_)):
        raise InvalidSetting(f"vertical is True or False, got {vertical!r}")
    length, first_mass, taper, centre = 0.30, 4.0, 0.75, 0.55
    levels = (1.0, 4.0, 12.0)
    # The plane of motion is x-y: gravity along -y makes the arm a vertical one.
    spec = new_spec(gravity=(0, -GRAVITY, 0) if vertical else (0, 0, -GRAVITY))
    parent = spec.worldbody
    masses = [first_mass * taper**i for i in range(n_links)]
    for i in range(1, n_links + 1):
        mass = masses[i - 1]
        link = add_link(
            parent,
            i,
            at=(0.0 if i == 1 else length, 0, 0),
            flange_mass=MOTOR_SIDE * mass,
            rotor_inertia=0.5 * _distal_inertia(masses[i - 1 :], length, centre),
            joint_damping=0.3 * taper ** (i - 1),
        )
        link.mass = (1 - MOTOR_SIDE) * mass
        link.ipos = [centre * length, 0, 0]
        across = (1 - MOTOR_SIDE) * mass * length**2 / 12
        link.inertia = [0.1 * across, across, across]
        link.explicitinertial = True
        parent = link
    parent.add_site(name="tool", pos=[length, 0, 0])
    limit = np.radians(150.0)
    return _arm(
        f"planar{n_links}{'v' if vertical else ''}",
        spec,
        hold,
        axes=(0, 1),
        torque_limits=tuple(
            float(f"{_peak_torque(masses[i:], length, centre, levels[-1]):.2g}")
            for i in range(n_links)
        ),
        joint_ranges=((-np.pi, np.pi), *[(-limit, limit)] * (n_links - 1)),
        levels=levels,
        timestep=2e-4,
    )


def _distal_inertia(masses: list[float], length: float, centre: float) -> float:
    """Inertia of straight links about the joint of the first of them [kg·m²]."""
    return sum(m * length**2 * (1 / 12 + (k + centre) ** 2) for k, m in enumerate(masses))


def _peak_torque(masses: list[float], length: float, centre: float, level: float) -> float:
    """Peak torque that shakes the tool of the straight arm at a level [N·m]."""
    inertia = 1.5 * _distal_inertia(masses, length, centre)
    return CREST_FACTOR * level * inertia / (len(masses) * length)


INNER, OUTER = 0.325, 0.275
"""Lengths of the two arms, 0.60 m together [m]."""
STROKE = 0.21
"""Travel of the quill [m]."""

_TOOL = (0.08, 0.0, -0.03)  # accelerometer on a bracket, or it would not see the wrist turn [m]
_BELOW = -0.15  # wrist below the outer arm's plane, quill drawn up [m]
_FLANGES = (0.5, 0.4, 0.1, 0.05)  # [kg]
_SCARA_ROTORS = (1.5, 0.30, 8.0, 0.02)  # seen at the joints [kg·m², kg for the quill]
_DAMPING = (2.0, 0.6, 60.0, 0.02)  # [N·m·s/rad, N·s/m for the quill]
_SCARA_TORQUES = (150.0, 60.0, 250.0, 8.0)  # [N·m, N for the quill]
_SCREW_STIFFNESS = 1e6  # of a ball screw turned by a belt [N/m]
# Mass [kg], centre of mass [m] and inertia about it [kg·m²] of each link.
_SCARA_LINKS = (
    (8.0, (0.15, 0.0, 0.0), (0.030, 0.110, 0.120)),
    (10.0, (0.09, 0.0, 0.10), (0.090, 0.130, 0.100)),
    (1.8, (0.0, 0.0, 0.02), (0.020, 0.020, 0.0002)),
    (0.6, (0.0, 0.0, -0.02), (0.0006, 0.0006, 0.0004)),
)


def scara(*, hold: HoldKind = "brake") -> Arm:
    """Build a SCARA of four axes with gravity along -z.

    Joint 1 turns the inner arm (0.325 m) and joint 2 the outer one (0.275 m), both about the
    vertical [rad]; joint 3 lifts the quill [m], zero drawn up and negative below; joint 4 turns
    the wrist at its end [rad]. Where joint 3 is meant, every figure of `Arm` that is given
    there per radian or in N·m is per metre or in N. Only this joint carries weight: gravity is
    along the other axes.

    Lengths, stroke and ranges are those usual in arms of 600 mm. Masses, inertias, drives,
    damping and torque limits are estimates for that class: arms of 8 and 10 kg (the outer one
    carries the drives of the quill), a quill and wrist of 2.6 kg, a ball screw whose rotor feels
    like 8 kg along the stroke. Links are rigid, so that shaking the plane does not move the
    tool along the vertical, nor the other way round, unless a seat is open. The accelerometer
    sits on a bracket 80 mm off the wrist's axis, without mass; on the axis it would not see
    joint 4. Play in joint 3 (`Backlash`) is that of the screw, along the stroke; a quill that
    turns in its spline is a `RotationalLooseness` of link 3 about the vertical.

    Elastic gears (``hold="compliant"``) are estimates too: strain-wave gears with
    `loose_env.arms.holding.STIFFNESS_PER_TORQUE` times the torque limits (4.5e4, 1.8e4 and
    2.4e3 N·m/rad) and a screw of 1e6 N/m; the arm sways in the plane at about 17 Hz.

    Parameters
    ----------
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding`.

    Examples
    --------
    >>> arm = scara()
    >>> arm.n, arm.joint_ranges[2]
    (4, (-0.21, 0.0))
    """
    spec = new_spec(gravity=(0, 0, -GRAVITY))
    parent = spec.worldbody
    places = ((0.0, 0.0, 0.0), (INNER, 0.0, 0.0), (OUTER, 0.0, 0.0), (0.0, 0.0, _BELOW))
    for i, place in enumerate(places):
        link = add_link(
            parent,
            i + 1,
            at=place,
            flange_mass=_FLANGES[i],
            rotor_inertia=_SCARA_ROTORS[i],
            joint_damping=_DAMPING[i],
        )
        mass, centre, inertia = _SCARA_LINKS[i]
        link.mass, link.ipos, link.inertia = mass, list(centre), list(inertia)
        link.explicitinertial = True
        parent = link
    spec.joint("joint3").type = mujoco.mjtJoint.mjJNT_SLIDE
    parent.add_site(name="tool", pos=list(_TOOL))

    first, second = float(np.radians(105.0)), float(np.radians(150.0))
    return _arm(
        "scara",
        spec,
        hold,
        axes=(0, 1, 2),
        torque_limits=_SCARA_TORQUES,
        joint_ranges=((-first, first), (-second, second), (-STROKE, 0.0), (-2 * np.pi, 2 * np.pi)),
        levels=(0.5, 2.0, 6.0),
        timestep=2e-4,
        gears=Gears(
            stiffness=tuple(
                _SCREW_STIFFNESS if i == 2 else STIFFNESS_PER_TORQUE * t
                for i, t in enumerate(_SCARA_TORQUES)
            )
        ),
    )


TOOL = (0.10, 0.0, 0.05625)
"""Accelerometer in the frame of link 6 [m]: on a bracket beside the mounting flange, which
lies 56.25 mm before the wrist's centre. On the axis itself it would not see joint 6. The
bracket, 0.10 m, is an estimate and has no mass."""

# Modified Denavit-Hartenberg parameters: alpha and a of the link before [rad, m], d [m].
_DH = (
    (0.0, 0.0, 0.0),
    (-np.pi / 2, 0.0, 0.2435),
    (0.0, 0.4318, -0.0934),
    (np.pi / 2, -0.0203, 0.4331),
    (-np.pi / 2, 0.0, 0.0),
    (np.pi / 2, 0.0, 0.0),
)
# Mass [kg], centre of mass [m] and inertia about it [kg·m²] of each link, in its own frame.
_PUMA_LINKS = (
    (13.0, (0.0, 0.0, 0.0), (0.35, 0.35, 0.35)),
    (17.40, (0.068, 0.006, -0.016), (0.130, 0.524, 0.539)),
    (4.80, (0.0, -0.070, 0.014), (0.0686, 0.0151, 0.0834)),
    (0.82, (0.0, 0.0, -0.019), (0.0018, 0.0018, 0.0013)),
    (0.34, (0.0, 0.0, 0.0), (0.0003, 0.0003, 0.0004)),
    (0.09, (0.0, 0.0, 0.032), (0.00015, 0.00015, 0.00004)),
)
_PUMA_ROTORS = (1.14, 4.71, 0.827, 0.200, 0.179, 0.193)
_GEARS = (62.6, 107.8, 53.7, 76.0, 71.9, 76.7)
_MOTOR_DAMPING = (1.48e-3, 0.817e-3, 1.38e-3, 71.2e-6, 82.6e-6, 36.7e-6)
_PUMA_TORQUES = (97.6, 186.4, 89.4, 24.2, 20.1, 21.3)
_RANGES = ((-160, 160), (-225, 45), (-45, 225), (-110, 170), (-100, 100), (-266, 266))


def six_axis(*, hold: HoldKind = "brake") -> Arm:
    """Build an arm of six turning joints after the PUMA 560, gravity along -z.

    Masses, centres of mass, inertias and the drives' inertias seen at the joints (1.14 kg·m²
    at joint 1 to 0.193 at joint 6) are those measured by Armstrong, Khatib and Burdick [1]_,
    in their modified Denavit-Hartenberg frames: with all joints at zero the upper arm lies
    along x and the forearm points up; ``(0, -pi/2, pi/2, 0, 0, 0)`` is the ready pose, both
    up. The world's origin is in the shoulder, where the axes of joints 1 and 2 cross.

    Three things are not as printed. Link 1 was only measured about its axis (0.35 kg·m²): its
    mass of 13 kg, which nothing but its own seat feels, and its other two inertias are
    estimates. The moments of link 3 (0.066, 0.0125, 0.086 kg·m²; copies with 0.066 for the last
    do not give the paper's own constant I6) cannot be those of a rigid body, as the largest
    exceeds the sum of the others; each is moved by 0.0026, just enough to mend it. And each link
    is split into a flange (`MOTOR_SIDE`) and the rest, both about the link's centre of mass,
    so that their sum is the printed link.

    The constants of the explicit model that the same paper prints follow from its links to
    within their rounding, with two exceptions: those of joint 1's own inertia, 1.43 and 1.38 kg·m²,
    where the links give 1.56 and 1.60. The links are kept. The inertia about joint 1 is then
    0.13 (arm up) to 0.35 kg·m² (upper arm level) above the explicit model's 2.6 to 3.9, about
    what the paper states as the uncertainty of the drive's share, 0.27, and of the two constants.

    Friction: joints have the viscous friction measured at the motors [2]_, times the gear
    ratio squared (5.8, 9.5, 4.0, 0.41, 0.43, 0.22 N·m·s/rad). The Coulomb friction of the real
    joints, about 25, 8 to 14, 6 to 7, 1, 0.8 and 0.5 N·m, is left out, because the linear
    prediction has none: the arm answers as if its joints were sliding already. At the lowest
    level the torques are mostly no larger than that friction, so a real arm would need more.
    Torque limits are the motors' times their gears; with the tool close to the axis of a joint
    they allow less than the top level. The coupling of the wrist's gears and bending of links
    are left out as well. Gears are stiff unless ``hold="compliant"``: then they have
    `loose_env.arms.holding.STIFFNESS_PER_TORQUE` times the torque limits, 5.6e4 N·m/rad
    at joint 2 and 6e3 in the wrist, which is derived and not measured; the arm sways at about
    15 Hz about joint 1 and 25 Hz about joint 2.

    Parameters
    ----------
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding`.

    References
    ----------
    .. [1] B. Armstrong, O. Khatib, J. Burdick, "The explicit dynamic model and inertial
       parameters of the PUMA 560 arm", IEEE Int. Conf. Robotics and Automation, 1986.
    .. [2] P. Corke, B. Armstrong-Hélouvry, "A search for consensus among model parameters
       reported for the PUMA 560 robot", IEEE Int. Conf. Robotics and Automation, 1994.

    Examples
    --------
    >>> arm = six_axis()
    >>> arm.n, arm.torque_limits[1]
    (6, 186.4)
    """
    spec = new_spec(gravity=(0, 0, -GRAVITY))
    parent = spec.worldbody
    for i, (alpha, a, d) in enumerate(_DH):
        flange = parent.add_body(
            name=f"flange{i + 1}",
            pos=[a, -float(np.sin(alpha)) * d, float(np.cos(alpha)) * d],
            quat=[float(np.cos(alpha / 2)), float(np.sin(alpha / 2)), 0, 0],
        )
        flange.add_joint(
            name=f"joint{i + 1}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            armature=_PUMA_ROTORS[i],
            damping=[_MOTOR_DAMPING[i] * _GEARS[i] ** 2, 0, 0],
        )
        link = flange.add_body(name=f"link{i + 1}")
        mass, centre, inertia = _PUMA_LINKS[i]
        for body, share in ((flange, MOTOR_SIDE), (link, 1 - MOTOR_SIDE)):
            body.mass, body.ipos = share * mass, list(centre)
            body.inertia = [share * moment for moment in inertia]
            body.explicitinertial = True
        parent = link
    parent.add_site(name="tool", pos=list(TOOL))

    return _arm(
        "six_axis",
        spec,
        hold,
        axes=(0, 1, 2),
        torque_limits=_PUMA_TORQUES,
        joint_ranges=tuple((float(np.radians(a)), float(np.radians(b))) for a, b in _RANGES),
        levels=(1.0, 2.0, 4.0),
        timestep=2e-4,
        gears=Gears(stiffness=tuple(STIFFNESS_PER_TORQUE * t for t in _PUMA_TORQUES)),
    )


LINK_LENGTH = 0.40
"""Length of either link [m] (6.1.2)."""
BEAM_MASS = 1.34
"""Mass of the beam of link 1 [kg] (6.1.2)."""
END_MASS = 3.2
"""Mass at the end of link 1, the drive of joint 2 [kg] (6.1.2)."""
GEAR_MASS, GEAR_RADIUS = 4.0, 0.12
"""Gear wheel of joint 1, a steel disc: mass [kg] and radius [m]; an estimate."""
BENDING_MODE_HZ = 83.0
"""First bending mode of link 1 alone, clamped at joint 1 [Hz] (eq. 6.6)."""
MODE_DAMPING = 0.01
"""Damping ratio of that mode: a bolted aluminium beam."""
LINK2_MASS, BLOCK_MASS, BLOCK_SIDE = 0.85, 0.25, 0.05
"""Beam of link 2 and the block of accelerometers at its end [kg, kg, m]; estimates."""
SEAT_SIDE = 0.06
"""Side of the looseness joint, where it is mounted [m]; an estimate."""


@dataclass(frozen=True, kw_only=True)
class BendingLink2:
    """Link 2 as a bending beam with the looseness joint at its proximal end."""

    mode_hz: float
    """First bending mode, clamped at joint 2 [Hz]."""
    damping: float
    """Its damping ratio."""
    seat_mass: float
    """Mass of the looseness joint [kg]."""


def vera(*, hold: HoldKind = "brake") -> Arm:
    """Build VERA: two links of 0.40 m in the horizontal plane, the first of them bending.

    Lengths, the masses of link 1, the bending mode and the peak torques (5.08 and
    3.39 N·m) are those of chapter 6 of the thesis. Link 2, which the thesis does not weigh,
    is taken as a beam of 0.85 kg with a 0.25 kg block of accelerometers at its end. The gear
    wheel of joint 1 and the rotors behind gears of 6:1 and 4:1 are estimates too.

    The bending mode is a hinge in link 1 at a third of its length: there, deflection and
    slope under a force at the end are those of a clamped beam (deflection F L³ / 3EI,
    slope F L² / 2EI), with 3EI/L³ from eq. 6.6. The thesis does not say how stiff the gears
    are; elastic ones have a mode of 60 Hz each, an estimate (1.6e5 and 1.2e4 N·m/rad).

    Parameters
    ----------
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding`.

    Examples
    --------
    >>> vera().torque_limits
    (5.08, 3.39)
    """
    spec = vera_spec()
    return _arm(
        "vera",
        spec,
        hold,
        axes=(0, 1),
        torque_limits=(5.08, 3.39),
        joint_ranges=(None, None),
        levels=(0.25, 0.75, 2.25),
        timestep=1e-4,
        settling=0.2,  # the bending mode dies away in 0.2 s
    )


def vera_spec(
    *, link2: BendingLink2 | None = None, mode_damping: float = MODE_DAMPING
) -> mujoco.MjSpec:
    """Bodies, joints and tool of VERA.

    Parameters
    ----------
    link2 : BendingLink2, optional
        How link 2 bends; it is stiff without it.
    mode_damping : float
        Damping ratio of link 1's bending mode.
    """
    spec = new_spec(gravity=(0, 0, -GRAVITY))
    length = LINK_LENGTH
    root = length / 3
    arm_out = length - root
    density = BEAM_MASS / length

    link1 = add_link(
        spec.worldbody, 1, at=(0, 0, 0.3), flange_mass=0.3, rotor_inertia=0.03, joint_damping=0.05
    )
    # Root of the beam and gear wheel on the shaft; beam end and drive of joint 2.
    wheel = GEAR_MASS * GEAR_RADIUS**2 / 2
    _set_inertia(link1, density * root, root, GEAR_MASS, 0.0, wheel, wheel / 2)
    stiffness_at_end = (2 * np.pi * BENDING_MODE_HZ) ** 2 * (END_MASS + 0.23 * BEAM_MASS)
    hinge_stiffness = stiffness_at_end * arm_out**2
    tip = link1.add_body(name="link1_end", pos=[root, 0, 0])
    drive = END_MASS * 0.05**2 / 2  # a disc
    _set_inertia(tip, density * arm_out, arm_out, END_MASS, arm_out, drive, drive)
    tip.add_joint(
        name="bending1",
        axis=[0, 0, 1],
        stiffness=[float(hinge_stiffness), 0, 0],
        damping=[float(2 * mode_damping * hinge_stiffness / (2 * np.pi * BENDING_MODE_HZ)), 0, 0],
    )

    flange2 = add_link(
        tip, 2, at=(arm_out, 0, 0), flange_mass=0.15, rotor_inertia=0.01, joint_damping=0.03
    )
    end = _stiff_link2(flange2) if link2 is None else _bending_link2(flange2, link2)
    end.add_site(name="tool", pos=[length if end is flange2 else length - root, 0, 0])
    return spec


def _set_inertia(
    body: mujoco.MjsBody,
    beam: float,
    length: float,
    mass: float,
    at: float,
    own: float,
    slim: float,
) -> float:
    """Make a body of a beam from its origin along x and a mass on it; return inertia about z.

    ``own`` is the inertia of the mass about its centre, ``slim`` that of the body about x.
    """
    body.mass = beam + mass
    centre = (beam * length / 2 + mass * at) / body.mass
    about_z = beam * (length**2 / 12 + (length / 2 - centre) ** 2) + mass * (at - centre) ** 2 + own
    body.ipos, body.inertia = [centre, 0, 0], [slim, about_z, about_z]
    body.explicitinertial = True
    return float(about_z)


def _stiff_link2(link2: mujoco.MjsBody) -> mujoco.MjsBody:
    block = BLOCK_MASS * BLOCK_SIDE**2 / 6
    _set_inertia(link2, LINK2_MASS, LINK_LENGTH, BLOCK_MASS, LINK_LENGTH, block, 0.001)
    return link2


def _bending_link2(link2: mujoco.MjsBody, beam: BendingLink2) -> mujoco.MjsBody:
    """Split link 2 at a third of its length, as link 1; return its outer part."""
    root = LINK_LENGTH / 3
    out = LINK_LENGTH - root
    density = LINK2_MASS / LINK_LENGTH
    seat = beam.seat_mass * SEAT_SIDE**2 / 6
    _set_inertia(link2, density * root, root, beam.seat_mass, 0.0, seat, 0.001)
    end = link2.add_body(name="link2_end", pos=[root, 0, 0])
    block = BLOCK_MASS * BLOCK_SIDE**2 / 6
    about_z = _set_inertia(end, density * out, out, BLOCK_MASS, out, block, 0.001)
    omega = 2 * np.pi * beam.mode_hz
    stiffness = (about_z + end.mass * float(end.ipos[0]) ** 2) * omega**2
    end.add_joint(
        name="bending2",
        axis=[0, 0, 1],
        stiffness=[float(stiffness), 0, 0],
        damping=[float(2 * beam.damping * stiffness / omega), 0, 0],
    )
    return end
