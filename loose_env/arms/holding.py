"""Brakes, servos and elastic gears added to an arm; spec and link builders, settling time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import (
    GEAR_MODE_HZ,
    Arm,
    Gears,
    Holding,
    HoldKind,
    PerJoint,
    checked_hold,
    each_joint,
    quat_of,
)
from loose_env.arms.linear import LinearArm
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

HOLDING_MODE_HZ = 800.0
"""Holding mode of a default brake: several times the top of the default band."""
SERVO_MODE_HZ = 25.0
"""Holding mode of a default position servo: what industrial drives reach on a large arm."""
SERVO_DAMPING = 0.5
"""Damping ratio of that mode."""
CENTRING_MODE_HZ = 4.0
"""Mode of an excited joint on its centring spring: below the band."""
GRAVITY = 9.81
"""Gravity of the arms in the library, and 1 g of a preload [m/s²]."""
CREST_FACTOR = 3.0
"""Peak over rms that a drive has to deliver [1]; rarer peaks are clipped at its limit."""
FASTEST_TURN = 1.4
"""Largest angle by which a spring's or a stop's mode may turn in one simulation step [rad]:
stepping is stable below 2."""
MOTOR_SIDE = 0.05
"""Share of a link's mass and inertia that is the flange on the motor side [1]; an estimate."""


def new_spec(*, gravity: Sequence[float]) -> mujoco.MjSpec:
    """Return an empty spec in radians, without contacts, under the given gravity [m/s²]."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    spec.option.gravity = list(gravity)
    return spec


def add_link(
    parent: mujoco.MjsBody,
    number: int,
    *,
    at: Sequence[float],
    flange_mass: float,
    rotor_inertia: float,
    joint_damping: float,
) -> mujoco.MjsBody:
    """Add link ``number``: a flange that carries the joint, and on it the still massless link.

    The flange is the link's share on the motor side of a loose seat; the seat lies between
    flange and link. ``at`` is the joint's place in the parent's frame [m].
    """
    flange = parent.add_body(
        name=f"flange{number}",
        pos=list(at),
        mass=flange_mass,
        ipos=[0, 0, 0],
        # A disc of 40 mm radius about the joint axis.
        inertia=[flange_mass * 0.0004, flange_mass * 0.0004, flange_mass * 0.0008],
        explicitinertial=True,
    )
    flange.add_joint(
        name=f"joint{number}",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        armature=rotor_inertia,
        damping=[joint_damping, 0, 0],
    )
    return flange.add_body(name=f"link{number}")


def held_inertia(
    spec: mujoco.MjSpec, joints: Sequence[str], poses: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Inertia that each joint holds, rotor included [kg·m², or kg where it slides] (n,).

    It is that of everything distal to the joint with all joints at zero or, with ``poses``
    (m, n) given, the largest over these [rad or m].
    """
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    full = np.zeros((model.nv, model.nv))
    inertia = np.zeros(len(joints))
    dofs = [int(model.joint(j).dofadr[0]) for j in joints]
    for pose in [None] if poses is None else poses:
        if pose is not None:
            data.qpos[[int(model.joint(j).qposadr[0]) for j in joints]] = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = np.maximum(inertia, full[dofs, dofs])
    return inertia


def holdings(
    spec: mujoco.MjSpec,
    joints: Sequence[str],
    *,
    damping_ratio: float = 0.1,
    poses: NDArray[np.float64] | None = None,
) -> tuple[Holding, Holding, Holding]:
    """Brake, servo and centring spring for every joint, from the modes they should have.

    The inertia a joint holds is that of everything distal to it with all joints at zero or,
    with ``poses`` given, the largest over these. Where a joint slides, it is a mass, and spring
    and damper are per metre.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The arm.
    joints : sequence of str
        Its joints, base first.
    damping_ratio : float
        Of the brakes.
    poses : ndarray (m, n), optional
        Joint positions at which the inertia is looked at [rad or m].
    """
    inertia = held_inertia(spec, joints, poses)

    def holding(mode_hz: float, ratio: float) -> Holding:
        omega = 2 * np.pi * mode_hz
        return Holding(
            stiffness=tuple(float(f"{k:.3g}") for k in inertia * omega**2),
            damping=tuple(float(f"{c:.3g}") for c in 2 * ratio * inertia * omega),
        )

    return (
        holding(HOLDING_MODE_HZ, damping_ratio),
        holding(SERVO_MODE_HZ, SERVO_DAMPING),
        holding(CENTRING_MODE_HZ, 0.7),
    )


STIFFNESS_PER_TORQUE = 300.0
"""Gear stiffness per peak torque of the drive [1/rad], where no stiffness is known: an estimate, a
wind-up of 3.3 mrad under peak torque."""


BARE_ROTOR = 0.25
"""Rotor inertia over the inertia it carries [1], for a joint without any; an estimate."""


WHEEL_TURN = 0.8
"""Angle a gear's output side alone on its spring may turn in one simulation step [rad]; the rest
of the stable range is left to a stop that pushes on it."""


def proposed_gears(arm: Arm) -> Gears:
    """Propose gears for an arm of which only drives and inertias are known.

    Turning joints have `STIFFNESS_PER_TORQUE` times their torque limit, but no more than can be
    simulated with the arm's step; sliding ones a mode of `GEAR_MODE_HZ`.
    """
    carried, _, rotor = inertias(arm)
    stiffest = 0.25 * rotor * (WHEEL_TURN / arm.timestep) ** 2
    by_torque = STIFFNESS_PER_TORQUE * np.array(arm.torque_limits)
    by_mode = carried * (2 * np.pi * GEAR_MODE_HZ) ** 2
    stiffness = np.where(arm.sliding, by_mode, by_torque)
    return Gears(stiffness=rounded(np.minimum(stiffness, stiffest)))


def geared_spec(
    arm: Arm, stiffness: Array, damping: Array, rotor: Array, moved: Array
) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """Copy an arm's spec and add a gear to the body of every joint, behind the joint."""
    spec = arm.spec.copy()
    taken = {joint.name for joint in spec.joints}
    gears = []
    for i, name in enumerate(arm.joints):
        joint = spec.joint(name)
        flange = joint.parent
        if flange.name == arm.seat_bodies[i]:
            raise InvalidSetting(
                f"arm {arm.name!r}: link {i + 1} has no flange between its joint {name!r} and its "
                "seat, where the gear's output would be; put the joint on a body of its own and "
                "the link on a child of it"
            )
        gear = f"gear{i + 1}"
        while gear in taken:
            gear += "_"
        taken.add(gear)
        joint.armature = float(rotor[i])
        axis = np.asarray(joint.axis, dtype=float)
        flange.add_joint(
            name=gear,
            type=joint.type,
            axis=list(axis),
            pos=list(joint.pos),
            stiffness=[float(stiffness[i]), 0, 0],
            damping=[float(damping[i]), 0, 0],
        )
        if moved[i] > 0:
            slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
            add_wheel(flange, float(moved[i]), axis / np.linalg.norm(axis), slides=slides)
        gears.append(gear)
    return spec, tuple(gears)


def add_wheel(flange: mujoco.MjsBody, inertia: float, axis: Array, *, slides: bool) -> None:
    """Add an inertia about (or a mass along) an axis to a flange, at its centre of mass."""
    if slides:
        flange.mass += inertia
        return
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(flange.iquat, dtype=float))
    axes = rotation.reshape(3, 3)
    tensor = axes @ np.diag(np.asarray(flange.inertia, dtype=float)) @ axes.T
    # A flat disc: half as much about its diameters.
    tensor += inertia * (np.eye(3) + np.outer(axis, axis)) / 2
    moments, axes = principal(tensor)
    flange.iquat, flange.inertia = quat_of(axes), list(moments)
    flange.explicitinertial = True


def principal(tensor: Array) -> tuple[Array, Array]:
    """Moments (3,) and axes (3, 3), a rotation, of an inertia tensor."""
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    # Of a flat body the largest moment is the sum of the others; rounding must not exceed it.
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-12))
    return moments, axes


def inertias(arm: Arm) -> tuple[Array, Array, Array]:
    """Inertia at each joint without its rotor, its flange's share of that, and its rotor's (n,).

    The rotor of a bare joint is estimated.
    """
    model = arm.model
    rotors = np.array([float(model.dof_armature[model.joint(j).dofadr[0]]) for j in arm.joints])
    carried = held_inertia(arm.spec, arm.joints, poses_of(arm)) - rotors
    own = np.zeros(arm.n)
    for i, name in enumerate(arm.joints):
        joint = model.joint(name)
        body = int(model.jnt_bodyid[joint.id])
        mass = float(model.body_mass[body])
        if model.jnt_type[joint.id] == mujoco.mjtJoint.mjJNT_SLIDE:
            own[i] = mass
            continue
        axis = model.jnt_axis[joint.id]
        lever = np.cross(axis, model.body_ipos[body] - model.jnt_pos[joint.id])
        turned, back = np.zeros(3), np.zeros(4)
        mujoco.mju_negQuat(back, model.body_iquat[body])
        mujoco.mju_rotVecQuat(turned, axis, back)
        own[i] = float(model.body_inertia[body] @ turned**2) + mass * float(lever @ lever)
    return carried, own, np.where(rotors > 0, rotors, BARE_ROTOR * carried)


def poses_of(arm: Arm) -> Array:
    """The zero pose and random ones, always the same."""
    rng = np.random.default_rng(0)
    return np.array([np.zeros(arm.n), *(arm.random_pose(rng) for _ in range(24))])


def rounded(values: Array) -> tuple[float, ...]:
    """Round to three digits."""
    return tuple(float(f"{v:.3g}") for v in values)


_HALVINGS = 3
_POSES = 8


def held(arm: Arm, hold: HoldKind) -> Arm:
    """Hold the joints of an arm by its brakes, by its servos, or by brakes behind elastic gears.

    Raises
    ------
    UnknownName
        If there is no such hold.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> held(planar(3), "compliant").gear_joints
    ('gear1', 'gear2', 'gear3')
    """
    if checked_hold(hold) == "servo":
        return servoed(arm)
    return with_compliance(arm) if hold == "compliant" else arm


def servoed(
    arm: Arm, *, mode_hz: PerJoint | None = None, damping_ratio: PerJoint | None = None
) -> Arm:
    """Hold the joints that are not excited by closed-loop position servos.

    The servo is a proportional and a derivative gain at the motor, which is what a spring and a
    damper on the joint are: the gains are `Arm.servo`, one pair for each joint. They are chosen
    for the bandwidth with all other joints held and the arm where it is heaviest for the joint.
    Elastic gears, if the arm has them, stay.

    Parameters
    ----------
    arm : Arm
        Any arm.
    mode_hz : float or sequence of n floats, optional
        Bandwidth: natural frequency of each joint on its servo [Hz]. The arm's own gains by
        default (`loose_env.arms.holding.SERVO_MODE_HZ`).
    damping_ratio : float or sequence of n floats, optional
        Damping ratio of that mode [1]; 0.5 by default.

    Raises
    ------
    InvalidSetting
        If a figure is not positive, or there are not as many as joints.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> stiff = servoed(planar(2), mode_hz=50.0)
    >>> stiff.name, round(stiff.servo.stiffness[0] / planar(2).servo.stiffness[0], 1)
    ('planar2-servo', 4.0)
    """
    gains = arm.servo
    if mode_hz is not None or damping_ratio is not None:
        inertia = held_inertia(arm.spec, arm.joints, poses_of(arm))
        if mode_hz is None:
            stiffness = np.array(arm.servo.stiffness)
        else:
            omega = 2 * np.pi * each_joint("mode_hz", mode_hz, arm.n)
            stiffness = inertia * omega**2
        ratio = each_joint(
            "damping_ratio", SERVO_DAMPING if damping_ratio is None else damping_ratio, arm.n
        )
        gains = Holding(
            stiffness=rounded(stiffness), damping=rounded(2 * ratio * np.sqrt(stiffness * inertia))
        )
    return replace(arm, name=f"{arm.name.removesuffix('-servo')}-servo", hold="servo", servo=gains)


def with_compliance(arm: Arm, gears: Gears | None = None) -> Arm:
    """Put an elastic gear between motor and link of every joint; motors at rest are braked.

    Each joint of the arm becomes its motor side: rotor, drive, brake and encoder. A new joint
    ``gear<i>`` with a spring and a damper follows on the same axis and carries the flange, the
    seat behind it, and the link. All joints get one, the excited ones too, so that motion of a
    motor reaches its link through the spring. Prediction treats gears as it does bending modes.

    The output side of a gear needs an inertia of its own, for behind an open seat it is all
    there is on the spring: where the flange has too little for the simulation step, a part of
    the rotor's inertia is moved to it, so that both together stay as they were. A joint
    without rotor inertia gets `loose_env.arms.holding.BARE_ROTOR` of what it carries. Where
    stiffness asks for more than that, the step is halved, three times at most.

    Gravity winds the gears up. The rig preloads the springs so that they rest at the pose that
    was asked for: the pose is that of the links, as on a robot that corrects for its sag, and the
    wind-up is only missing as a constant in the encoder's reading. It is of the order of a
    milliradian, less than the encoders' zeros are off anyway.

    Parameters
    ----------
    arm : Arm
        Any arm; gears that it has are replaced.
    gears : Gears, optional
        Stiffness or mode of the gears; the arm's own, `Arm.gears`, by default.

    Raises
    ------
    InvalidSetting
        If they do not fit the joints, or are too stiff to simulate.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> with_compliance(planar(3), Gears(mode_hz=30.0)).gear_joints
    ('gear1', 'gear2', 'gear3')
    """
    rigid = arm if arm.rigid is None else arm.rigid
    chosen = gears or arm.gears or Gears()
    carried, own, rotor = inertias(rigid)
    stiffness, damping = chosen.stiffness_and_damping(carried)
    name = rigid.name.removesuffix("-servo")
    needed = np.zeros(rigid.n)
    for halving in range(_HALVINGS + 1):
        step = rigid.timestep / 2**halving
        needed = stiffness * (step / WHEEL_TURN) ** 2 + step * damping
        moved = np.maximum(needed - own, 0.0)
        if (rotor - moved < needed).any():
            continue
        spec, joints = geared_spec(rigid, stiffness, damping, rotor - moved, moved)
        slowest_ratio = float(np.min(np.broadcast_to(chosen.damping_ratio, rigid.n)))
        made = replace(
            rigid,
            name=f"{name}-compliant",
            spec=spec,
            hold="compliant",
            gears=chosen,
            gear_joints=joints,
            rigid=rigid,
            timestep=step,
            settling=settling_time(rigid, slowest_ratio),
        )
        if fastest_turn(made) <= FASTEST_TURN:
            return made
    worst = int(np.argmax(needed / rotor))
    raise InvalidSetting(
        f"arm {rigid.name!r}: a gear of {stiffness[worst]:.3g} at joint {worst + 1} is too stiff "
        f"to simulate between a rotor of {rotor[worst]:.3g} and a link that feels like "
        f"{carried[worst]:.3g}, even with a step of {rigid.timestep / 2**_HALVINGS:.1g} s: give it "
        f"about {stiffness[worst] * rotor[worst] / needed[worst] / 2:.1g} or less, or hold the "
        "joints with hold='brake', which is what a gear as stiff as this amounts to"
    )


def wind_up(
    model: mujoco.MjModel, pose: Array, joints: NDArray[np.intp], gears: NDArray[np.intp]
) -> None:
    """Preload the springs of gears against gravity, so that the links rest at a pose.

    Parameters
    ----------
    model : mujoco.MjModel
        An arm with elastic gears; the rest positions of their springs are changed.
    pose : ndarray (n,)
        Where the joints are [rad or m].
    joints : ndarray (n,)
        Their places in ``qpos``.
    gears : ndarray (g,)
        Numbers of the gears' joints.
    """
    data = mujoco.MjData(model)
    data.qpos[joints] = pose
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    load = data.qfrc_bias[model.jnt_dofadr[gears]]
    model.qpos_spring[model.jnt_qposadr[gears]] = load / model.jnt_stiffness[gears]


def fastest_turn(arm: Arm) -> float:
    """Largest angle by which a mode of springs in the arm turns in one simulation step [rad].

    All joints are free, and every seat is open in turn; the joints' dampers count as well,
    because the rig takes them explicitly. Stepping is stable below 2.
    """
    linear = LinearArm(arm, points=2)
    step = arm.timestep
    stiffness, damping = linear.springs
    moving = np.concatenate([linear.joint_dofs, linear.flexible_dofs])
    most = 0.0
    for pose in poses_of(arm)[:_POSES]:
        inertia = linear.at(pose).inertia
        for link in range(arm.n):
            for seat in (linear.slide_dofs[link], linear.hinge_dofs[link : link + 1]):
                free = np.concatenate([moving, seat])
                weight = np.linalg.inv(inertia[np.ix_(free, free)])
                turn = step**2 * np.linalg.eigvals(weight * stiffness[free]).real.max()
                decay = 2 * step * np.linalg.eigvals(weight * damping[free]).real.max()
                most = max(most, float(turn), float(turn + decay) / 2)
    return float(np.sqrt(most))


def settling_time(arm: Arm, damping_ratio: float) -> float:
    """Let a gear's mode at the lower edge of the band die away to a seventh, in half a second."""
    wanted = 2 / (max(damping_ratio, 1e-6) * 2 * np.pi * arm.band[0])
    return max(arm.settling, round(min(wanted, 0.5), 3))
