"""Linear actuator models of joints: torque per command, stiffness, damping; drive of each joint.

An actuator of MuJoCo gives a joint the torque ``gain u + offset - stiffness q - damping q'``: a
motor has a gain alone, a position servo a stiffness too, and its command is a position. All
values are at the joint, the gear ratio included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, Holding
from loose_env.typing import Array

_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_LAGS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))


@dataclass(frozen=True, kw_only=True)
class JointDrive:
    """Linear model of one actuator on the joint that it drives."""

    actuator: str
    """Name in the model."""
    joint: str
    """Name in the model."""
    gain: float
    """Torque per command [N·m per unit of the command; N where the joint slides]."""
    stiffness: float = 0.0
    """Of a position servo [N·m/rad, N/m where the joint slides]; 0: a motor."""
    damping: float = 0.0
    """Of a servo [N·m·s/rad, N·s/m where the joint slides]."""
    offset: float = 0.0
    """Torque at the command 0 with the joint at 0 and at rest [N·m, N]."""
    lag: float = 0.0
    """Time constant of a first-order lag between command and torque [s]."""
    limit: float = np.inf
    """Largest torque of the actuator [N·m, N]."""
    command_range: tuple[float, float] = (-np.inf, np.inf)
    """Allowed commands [unit of the command]."""

    @property
    def servo(self) -> bool:
        """True if it servoes a position by itself."""
        return self.stiffness > 0

    def command(self, torque: Array | float, position: float) -> Array | float:
        """Command for a steady torque beside the spring's, at a position and at rest.

        Parameters
        ----------
        torque : ndarray or float
            Wanted force or torque [N·m, N].
        position : float
            Position of the joint [rad or m].

        Examples
        --------
        >>> servo = JointDrive(actuator="a", joint="j", gain=100.0, stiffness=100.0)
        >>> servo.command(5.0, 0.3)
        0.35
        """
        return (torque - self.offset + self.stiffness * position) / self.gain

    def torque(self, command: float, position: float) -> float:
        """Torque under a constant command, at a position and at rest [N·m, N].

        Examples
        --------
        >>> servo = JointDrive(actuator="a", joint="j", gain=100.0, stiffness=100.0)
        >>> round(servo.torque(0.35, 0.3), 6)
        5.0
        """
        return self.gain * command + self.offset - self.stiffness * position


@dataclass(frozen=True, kw_only=True)
class PassedOver:
    """Skipped actuator: not modelled by a spring, a damper and a lagged gain."""

    actuator: str
    """Name in the model."""
    joint: str
    """Name in the model; "" if it acts on something else than one joint."""
    why: str
    """Reason, to be read after the actuator's name."""


def actuators_on(
    model: mujoco.MjModel, joints: Sequence[str]
) -> tuple[tuple[JointDrive, ...], tuple[PassedOver, ...]]:
    """Read every actuator that may act on joints, in the model's order."""
    found, passed = [], []
    for a in range(model.nu):
        name = model.actuator(a).name
        if int(model.actuator_trntype[a]) not in _JOINT:
            passed.append(PassedOver(actuator=name, joint="", why="acts on no single joint"))
            continue
        joint = model.joint(int(model.actuator_trnid[a, 0])).name
        if joint not in joints:
            continue
        if why := _unusable(model, a):
            passed.append(PassedOver(actuator=name, joint=joint, why=why))
        else:
            found.append(_drive(model, a, name, joint))
    return tuple(found), tuple(passed)


@dataclass(frozen=True, kw_only=True, eq=False)
class ActuatorForces:
    """Forces of A actuators on n joints, linear in command, position and velocity."""

    names: tuple[str, ...]
    """Actuators of the joints (A,)."""
    joint: NDArray[np.intp]
    """Index of the joint that each drives (A,)."""
    force: Array
    """Force on each joint per command of each actuator (n, A)."""
    stiffness: Array
    """Force against each joint's displacement (n,) [N·m/rad or N/m]."""
    damping: Array
    """Force against each joint's velocity (n,) [N·m·s/rad or N·s/m]."""
    lag: Array
    """Time constant of each actuator's filter (A,) [s]; 0 for none."""
    unknown: tuple[str, ...]
    """Actuators whose law is not of this kind: their joints' forces are taken as unknown."""

    def driven_joint(self, actuator: str) -> int:
        """Index of the joint that an actuator drives."""
        return int(self.joint[self.names.index(actuator)])


def actuator_forces(model: mujoco.MjModel, joints: Sequence[str]) -> ActuatorForces:
    """Collect the forces of all actuators on joints, by `actuators_on`."""
    drives, passed = actuators_on(model, joints)
    n, driven = len(joints), [joints.index(drive.joint) for drive in drives]
    force, stiffness, damping = np.zeros((n, len(drives))), np.zeros(n), np.zeros(n)
    for a, (drive, j) in enumerate(zip(drives, driven, strict=True)):
        force[j, a] = drive.gain
        stiffness[j] += drive.stiffness
        damping[j] += drive.damping
    return ActuatorForces(
        names=tuple(drive.actuator for drive in drives),
        joint=np.array(driven, dtype=np.intp),
        force=force,
        stiffness=stiffness,
        damping=damping,
        lag=np.array([drive.lag for drive in drives]),
        unknown=tuple(other.actuator for other in passed),
    )


def drives_of(
    model: mujoco.MjModel, joints: Sequence[str]
) -> tuple[tuple[JointDrive | None, ...], tuple[str, ...]]:
    """Find the actuator that servoes and excites each joint.

    Of several that is the first position servo, which holds by itself; of several motors the first.

    Examples
    --------
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <actuator><position name="servo" joint="turn" kp="50" kv="2" forcerange="-9 9"/></actuator>
    ... </mujoco>'''
    >>> found, notes = drives_of(mujoco.MjModel.from_xml_string(xml), ["turn"])
    >>> found[0].stiffness, found[0].damping, found[0].limit
    (50.0, 2.0, 9.0)
    """
    drives, passed = actuators_on(model, joints)
    notes = [
        f"actuator {p.actuator!r} of joint {p.joint!r} {p.why}; its joint counts as undriven"
        for p in passed
        if p.joint
    ]
    found: dict[str, JointDrive] = {}
    for drive in sorted(drives, key=lambda one: not one.servo):
        lacks = "name" if not drive.actuator else "gain" if drive.gain == 0 else ""
        if lacks:
            notes.append(
                f"actuator {drive.actuator!r} of joint {drive.joint!r} has no {lacks}; its joint "
                "counts as undriven"
            )
        elif drive.joint in found:
            notes.append(
                f"joint {drive.joint!r} has several actuators; "
                f"{found[drive.joint].actuator!r} is played, {drive.actuator!r} told to give no "
                "torque in the pose"
            )
        else:
            found[drive.joint] = drive
    return tuple(found.get(joint) for joint in joints), tuple(notes)


def held_by_drives(arm: Arm, model: mujoco.MjModel, joints: Sequence[str]) -> Arm:
    """Apply actuator stiffness and damping to the joints of an arm.

    A joint with a position servo is on that servo's spring and damper, also while it is shaken:
    its command moves the spring's rest. Springs and dampers of several actuators on a joint add up.
    A torque motor holds nothing by itself: its joint is kept near its place by a controller that is
    slow beside the band, the arm's soft centring spring, and is free within the band.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> xml = '''<mujoco><worldbody><body><joint name="a"/><geom size=".1"/>
    ... <body pos="1 0 0"><joint name="b"/><geom size=".1"/></body></body></worldbody>
    ... <actuator><position joint="a" kp="900" kv="30"/></actuator></mujoco>'''
    >>> arm = held_by_drives(planar(2), mujoco.MjModel.from_xml_string(xml), ["a", "b"])
    >>> arm.hold, arm.centring.stiffness[0], arm.holding.stiffness
    ('servo', 900.0, (0.0, 0.0))
    """
    soft, own = arm.centring, actuator_forces(model, joints)
    held = own.stiffness > 0
    stiffness = np.where(held, own.stiffness, soft.stiffness)
    damping = own.damping + np.where(held, 0.0, soft.damping)
    none = (0.0,) * arm.n
    return replace(
        arm,
        hold="servo",
        centring=Holding(stiffness=tuple(stiffness.tolist()), damping=tuple(damping.tolist())),
        servo=Holding(stiffness=none, damping=none),
    )


def _unusable(model: mujoco.MjModel, a: int) -> str:
    """Reason why an actuator is no spring, damper and lagged gain; "" if it is."""
    gain, bias = int(model.actuator_gaintype[a]), int(model.actuator_biastype[a])
    dynamics = int(model.actuator_dyntype[a])
    affine = int(mujoco.mjtGain.mjGAIN_AFFINE)
    if dynamics not in (int(mujoco.mjtDyn.mjDYN_NONE), *_LAGS):
        return f"has dynamics of its own ({mujoco.mjtDyn(dynamics).name.removeprefix('mjDYN_')})"
    varies = gain == affine and bool(np.any(model.actuator_gainprm[a, 1:3]))
    if gain not in (int(mujoco.mjtGain.mjGAIN_FIXED), affine) or varies:
        return "has a gain that depends on the motion"
    if bias not in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)):
        return "has a torque of its own that is no spring and damper"
    return ""


def _drive(model: mujoco.MjModel, a: int, name: str, joint: str) -> JointDrive:
    gear = float(model.actuator_gear[a, 0])
    affine = int(model.actuator_biastype[a]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    bias = model.actuator_biasprm[a, :3] if affine else np.zeros(3)
    limit, commands = np.inf, (-np.inf, np.inf)
    if model.actuator_forcelimited[a]:
        limit = float(np.abs(model.actuator_forcerange[a]).min() * abs(gear))
    if model.actuator_ctrllimited[a]:
        low, high = (float(x) for x in model.actuator_ctrlrange[a])
        commands = (low, high)
    lagging = int(model.actuator_dyntype[a]) in _LAGS
    return JointDrive(
        actuator=name,
        joint=joint,
        gain=float(model.actuator_gainprm[a, 0]) * gear,
        stiffness=0.0 - float(bias[1]) * gear**2,
        damping=0.0 - float(bias[2]) * gear**2,
        offset=float(bias[0]) * gear,
        lag=float(model.actuator_dynprm[a, 0]) if lagging else 0.0,
        limit=limit,
        command_range=commands,
    )
