"""Elastic gears and position servos: the softer ways in which an arm holds its joints."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm, Gears, Holding, HoldKind, PerJoint, each_joint
from loose_env.arms.holding.gears import (
    WHEEL_TURN,
    geared_spec,
    gears_of,
    inertias,
    poses_of,
    rotors,
    rounded,
)
from loose_env.arms.response.linear import LinearArm
from loose_env.arms.spec_parts import FASTEST_TURN, SERVO_DAMPING, held_inertia
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.typing import Array

__all__ = [
    "compliant",
    "fastest_turn",
    "held",
    "servoed",
    "settling_time",
    "wind_up",
    "with_compliance",
]


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
    if hold not in ("brake", "servo", "compliant"):
        raise UnknownName(f"unknown hold {hold!r}: 'brake', 'servo' or 'compliant'")
    if hold == "servo":
        return servoed(arm)
    return compliant(arm) if hold == "compliant" else arm


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
        default (`loose_env.arms.spec_parts.SERVO_MODE_HZ`).
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


def with_compliance(
    arm: Arm,
    *,
    stiffness: PerJoint | None = None,
    mode_hz: PerJoint | None = None,
    damping_ratio: PerJoint | None = None,
) -> Arm:
    """Return the arm with elastic gears of a given stiffness or natural frequency.

    Parameters
    ----------
    arm : Arm
        Any arm.
    stiffness : float or sequence of n floats, optional
        Stiffness of the gears at the joint [N·m/rad, or N/m where it slides].
    mode_hz : float or sequence of n floats, optional
        Natural frequency of each gear with what it carries [Hz]; give this or the stiffness. With
        neither the gears are the arm's own, `Arm.gears`.
    damping_ratio : float or sequence of n floats, optional
        Damping ratio of that mode [1].

    Raises
    ------
    InvalidSetting
        If both are given, do not fit the joints, or are too stiff to simulate.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> with_compliance(planar(3), mode_hz=30.0).gear_joints
    ('gear1', 'gear2', 'gear3')
    """
    return compliant(arm, gears_of(arm, stiffness, mode_hz, damping_ratio))


def compliant(arm: Arm, gears: Gears | None = None) -> Arm:
    """Put an elastic gear between motor and link of every joint; motors at rest are braked.

    Each joint of the arm becomes its motor side: rotor, drive, brake and encoder. A new joint
    ``gear<i>`` with a spring and a damper follows on the same axis and carries the flange, the
    seat behind it, and the link. All joints get one, the excited ones too, so that motion of a
    motor reaches its link through the spring. Prediction treats gears as it does bending modes.

    The output side of a gear needs an inertia of its own, for behind an open seat it is all
    there is on the spring: where the flange has too little for the simulation step, a part of
    the rotor's inertia is moved to it, so that both together stay as they were. A joint
    without rotor inertia gets `loose_env.arms.holding.gears.BARE_ROTOR` of what it carries. Where
    stiffness asks for more than that, the step is halved, three times at most.

    Gravity winds the gears up. The rig preloads the springs so that they rest at the pose that
    was asked for: the pose is that of the links, as on a robot that corrects for its sag, and the
    wind-up is only missing as a constant in the encoder's reading. It is of the order of a
    milliradian, less than the encoders' zeros are off anyway.

    Parameters
    ----------
    arm : Arm
        Any arm; one with elastic gears gets these instead.
    gears : Gears, optional
        Parameters; by default those of the arm.

    Raises
    ------
    InvalidSetting
        If the parameters do not fit the joints, or are too stiff for an eighth of the arm's step.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> arm = compliant(planar(2), Gears(stiffness=(4e4, 1e4)))
    >>> arm.name, arm.model.joint("gear2").stiffness[0].item()
    ('planar2-compliant', 10000.0)
    """
    rigid = arm if arm.rigid is None else arm.rigid
    chosen = gears or arm.gears or Gears()
    carried, own = inertias(rigid)
    stiffness, damping = chosen.stiffness_and_damping(carried)
    rotor = rotors(rigid, carried)
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
