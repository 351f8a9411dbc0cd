"""Joints and drives read from a compiled model: PD gains, effort limit, delay, friction.

A drive with an affine force law, force = k u + b0 + b1 x + b2 v with gear g and damping d, is a PD
controller at the joint with stiffness -g² b1 and damping g² (d - b2), as MuJoCo documents for
position and velocity servos.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from loose_env.gap.model.nominal_model import affine_actuators

Mode = Literal["position", "velocity", "effort"]
_AT_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_SAME = 1e-6
"""Relative difference of two gains that are the same."""


@dataclass(frozen=True, kw_only=True)
class JointDrive:
    """One actuator at a joint."""

    name: str
    """Name of the actuator."""
    mode: Mode
    """Quantity that its command sets."""
    stiffness: float = 0.0
    """Proportional gain at the joint [N·m/rad, N/m]."""
    damping: float = 0.0
    """Derivative gain at the joint [N·m·s/rad, N·s/m]."""
    effort_limit: float | None = None
    """Largest torque or force at the joint [N·m, N]; None without a limit."""
    gear: float = 1.0
    """Torque at the joint over the force of the actuator."""
    effort_gain: float = 1.0
    """Torque at the joint per unit of an effort command."""
    delay: float = 0.0
    """Delay of the command [s]."""
    remarks: tuple[str, ...] = ()
    """Properties that a PD law does not have."""


@dataclass(frozen=True, kw_only=True)
class JointValues:
    """One joint with its passive properties."""

    name: str
    """Name of the joint."""
    turns: bool
    """Whether it is a hinge; otherwise a slide."""
    armature: float
    """Rotor inertia at the joint [kg·m², kg]."""
    frictionloss: float
    """Dry friction at rest [N·m, N]."""
    damping: float
    """Viscous friction [N·m·s/rad, N·s/m]."""
    drive: JointDrive | None = None
    """Its drive; None without one, or where it is no PD law."""
    reason: str = ""
    """Reason why a driven joint has no `drive`; "" otherwise."""


def joint_values(model: mujoco.MjModel) -> tuple[JointValues, ...]:
    """Read hinges and slides with their drives from a compiled model.

    Examples
    --------
    >>> model = mujoco.MjModel.from_xml_string('''<mujoco><worldbody><body>
    ...   <joint name="elbow" damping="0.1" armature="0.02"/><geom size="0.1"/></body></worldbody>
    ...   <actuator><position name="servo" joint="elbow" kp="5" kv="1" gear="2"
    ...   forcerange="-3 3"/></actuator></mujoco>''')
    >>> elbow = joint_values(model)[0]
    >>> elbow.damping, elbow.drive.stiffness, elbow.drive.damping, elbow.drive.effort_limit
    (0.1, 20.0, 4.0, 6.0)
    """
    found = []
    for k in range(model.njnt):
        if model.jnt_type[k] not in (_HINGE, _SLIDE):
            continue
        dof = int(model.jnt_dofadr[k])
        drive, reason = _drive(model, k)
        found.append(
            JointValues(
                name=str(model.joint(k).name),
                turns=bool(model.jnt_type[k] == _HINGE),
                armature=float(model.dof_armature[dof]),
                frictionloss=float(model.dof_frictionloss[dof]),
                damping=float(model.dof_damping[dof]),
                drive=drive,
                reason=reason,
            )
        )
    return tuple(found)


def _drive(model: mujoco.MjModel, joint: int) -> tuple[JointDrive | None, str]:
    """Return the drive of a joint, or the reason why it has none that is a PD law."""
    at_joint = np.isin(model.actuator_trntype, _AT_JOINT)
    there = np.flatnonzero(at_joint & (model.actuator_trnid[:, 0] == joint))
    # an actuator without a command, as effects add them, is no drive
    own = [int(k) for k in there if model.actuator_ctrlnum[k] > 0]
    if not own:
        return None, ""
    names = ", ".join(str(model.actuator(k).name) for k in own)
    if len(own) > 1:
        return None, f"several actuators drive it ({names})"
    k = own[0]
    if not affine_actuators(model)[k] or model.actuator_gainprm[k][1:3].any():
        return None, f"the force of {names} is not linear in command, position and speed"
    gain, gear = float(model.actuator_gainprm[k, 0]), float(model.actuator_gear[k, 0])
    bias, stiff, damped = (float(v) for v in model.actuator_biasprm[k][:3])
    remarks = []
    if bias:
        remarks.append(f"the constant force of {names}")
    # a motor with a voltage limit loses torque with speed, the reverse of a velocity servo's sign
    mode: Mode = "position" if stiff else "velocity" if damped < 0 else "effort"
    expected = {"position": -stiff, "velocity": -damped, "effort": gain}[mode]
    if abs(gain - expected) > _SAME * abs(expected):
        remarks.append(f"the factor {gain / expected:.4g} on the command of {names}")
    limit = _effort_limit(model, joint, k, gain if mode == "effort" else None)
    if limit is not None and limit[0] != limit[1]:
        remarks.append(
            f"the effort limits of {names} by direction ({limit[0]:.4g} and {limit[1]:.4g}): the "
            "smaller one is exported"
        )
    return JointDrive(
        name=names,
        mode=mode,
        stiffness=-(gear**2) * stiff + 0.0,
        damping=(gear**2) * (float(model.actuator_damping[k]) - damped) + 0.0,
        effort_limit=None if limit is None else min(limit),
        gear=gear,
        effort_gain=gear * gain,
        delay=float(model.actuator_delay[k]),
        remarks=tuple(remarks),
    ), ""


def _effort_limit(
    model: mujoco.MjModel, joint: int, actuator: int, gain: float | None
) -> tuple[float, float] | None:
    """Largest torque at the joint against and along it, or None without a limit.

    The gain is that of a drive whose command is an effort, which the command's range limits too.
    """
    gear = abs(float(model.actuator_gear[actuator, 0]))
    ends = []
    if model.actuator_forcelimited[actuator]:
        ends.append(gear * np.abs(model.actuator_forcerange[actuator]))
    if gain is not None and model.actuator_ctrllimited[actuator]:
        ends.append(gear * abs(gain) * np.abs(model.actuator_ctrlrange[actuator]))
    if model.jnt_actfrclimited[joint]:
        ends.append(np.abs(model.jnt_actfrcrange[joint]))
    if not ends:
        return None
    low, high = np.min(ends, axis=0)
    return float(low), float(high)
