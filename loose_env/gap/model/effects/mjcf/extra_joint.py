"""Extra joint added to a link of an MJCF spec, its stops and motor-side inertia."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.model.effects.mjcf.passive_actuators import make_it_stick
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

FASTEST = 0.8
"""Largest angle by which an added spring's mode may turn in a step, at the model's zero [rad]."""
MOTOR_SHARE = 0.02
"""What stays on the motor side of a joint without rotor, as a share of what the joint carries."""
_EXPLICIT = (int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_RK4))
"""Integrators that take what an actuator gives from the state before the step."""
_SOFT = 1e-4  # MuJoCo's smallest constraint impedance
_TOUCH = 0.45
"""Impedance of a stop where it is touched, over its largest: so that a force grows with travel to
the power of 1.5 (within 6 % of it, from a fifteenth of the usual load to five times it)."""
_USUAL = _TOUCH + (1 - _TOUCH) * 5 / 9
"""Impedance under the usual load, over its largest: at a third of the way 1 - (1 - 1/3)²."""


def last_joints(machine: NominalModel) -> tuple[str, ...]:
    """List joints that are the last of their body, behind which one can be added."""
    bodies = [int(b) for b in machine.model.jnt_bodyid]
    return tuple(
        name
        for k, name in enumerate(machine.joints)
        if k + 1 == len(bodies) or bodies[k + 1] != bodies[k]
    )


def add_extra_joint(
    body: mujoco.MjsBody,
    name: str,
    *,
    turns: bool,
    axis: Array,
    pos: Array,
    stiffness: float = 0.0,
    damping: float = 0.0,
    friction: float = 0.0,
    step: float = 0.0,
) -> mujoco.MjsJoint:
    """Add a hinge or slide to a body, after its own joints, without model defaults."""
    kind = mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE
    joint = body.add_joint(
        name=name,
        type=kind,
        axis=axis,
        pos=pos,
        ref=0.0,
        springref=0.0,
        armature=0.0,
        stiffness=[stiffness, 0, 0],
        damping=[damping, 0, 0],
        frictionloss=friction,
        limited=mujoco.mjtLimited.mjLIMITED_FALSE,
        range=[0, 0],
        margin=0.0,
        springdamper=[0, 0],
        actfrclimited=mujoco.mjtLimited.mjLIMITED_FALSE,
        actgravcomp=False,
    )
    if friction > 0:
        make_it_stick(joint, step)
    return joint


def set_stops(
    joint: mujoco.MjsJoint,
    reach: float,
    *,
    stiffness: float,
    ratio: float,
    weight: float,
    load: float,
) -> None:
    """Add stops at ±reach to an added joint.

    Contact force grows with the penetration to the power of 1.5 (Hertz), and damping with the
    force. MuJoCo's smallest impedance d makes a limit a spring and a damper, d² k r + d c v, where
    r is the penetration and v its rate; d grows with r. The direct format of ``solref``, scaled
    with the inverse weight, gives parameters in N/m or N·m/rad.

    References
    ----------
    Johnson, Contact Mechanics (1985), section 4.2. MuJoCo, Modeling: solver parameters.
    """
    damping = 2 * ratio * np.sqrt(stiffness / weight) / _USUAL
    joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    unit = 1.0
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.compiler.degree:
        unit = 180.0 / np.pi
    joint.range = [-reach * unit, reach * unit]
    # Under the typical load a Hertzian stop deflects by 1.5 load / stiffness; its impedance is
    # largest at three times that, where force over travel is 1.5^-1 3^0.5 times the stiffness.
    joint.solimp_limit = [_SOFT, _SOFT / _TOUCH, 4.5 * load / stiffness, _SOFT, 2]
    joint.solref_limit = [-np.sqrt(3) / 1.5 * stiffness * weight, -damping * weight]


def keep_motor_side(machine: NominalModel, spec: mujoco.MjSpec, name: str, carried: float) -> None:
    """Keep a small inertia [kg·m² or kg] on the motor side of a joint without rotor.

    A Runge-Kutta or Euler step is unstable for a servo that acts on too little inertia: there it is
    set by the servo's stiffness and damping, whatever the step of the spec is.
    """
    joint = spec.joint(name)
    least = MOTOR_SHARE * carried
    if joint.armature < least:
        joint.armature = max(least, _stable_servo_inertia(machine, name))


def _stable_servo_inertia(machine: NominalModel, joint: str) -> float:
    """Least inertia [kg·m² or kg] for a stable servo at the machine's step."""
    model: mujoco.MjModel = machine.model
    own = int(model.opt.integrator) if machine.integrator is None else machine.integrator
    if own not in _EXPLICIT:
        return 0.0
    step = machine.time_step
    turn = step * max(machine.merged_steps // 2, 1) / FASTEST  # longest step allowed for a spring
    squares = machine.gears(joint) ** 2
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    terms = np.where(affine[:, None], model.actuator_biasprm[:, 1:3], 0.0)
    stiffness, damping = np.maximum(-(squares @ terms), 0.0)
    return float(max(stiffness * turn**2, damping * turn))


def joint_inertia(spec: mujoco.MjSpec, name: str) -> tuple[float, float]:
    """Inertia that a joint moves with all others locked [kg·m², kg], and its inverse weight.

    The inverse weight is MuJoCo's, with all joints free.
    """
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    dof = int(model.joint(name).dofadr[0])
    return float(mass[dof, dof]), float(model.dof_invweight0[dof])
