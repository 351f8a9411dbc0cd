"""Edits of an MJCF spec that effects share: names, drives without input, inertias, joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from loose_env.arms import principal
from loose_env.gap.model.nominal_model import NominalModel, mass_matrix, unused, write_inertial
from loose_env.typing import Array

_STIFF = 0.9999  # MuJoCo's largest constraint impedance
_OPEN_CIRCUIT = 1e12  # resistance at which no current brakes the rotor [ohm]
_LIGHT = 1e-9  # mass [kg] and inertia [kg·m²] of a part that weighs nothing
_NOT_COPIED = ("id", "parent", "signature", "frame", "name", "info", "classname", "compiler")
"""Attributes of a joint that its copy has of its own."""
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


def angle_unit(joint: mujoco.MjsJoint) -> float:
    """Size of one unit of the spec's angles at a joint [rad]; 1 for a slide."""
    return pi / 180 if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.compiler.degree else 1.0


def added_name(spec: mujoco.MjSpec, where: str, kind: str) -> str:
    """Return an unused name for an element: a corrected model has such already."""
    several = (spec.bodies, spec.joints, spec.sites, spec.actuators)
    taken = {element.name for elements in several for element in elements}
    return unused(f"{where}_{kind}", taken)


def add_constant(spec: mujoco.MjSpec, joint: str, name: str, torque: float) -> None:
    """Add a constant torque [N·m] or force [N] on a joint."""
    add_passive(spec, joint, name, bias=(torque, 0.0, 0.0))


def add_passive(
    spec: mujoco.MjSpec,
    joint: str,
    name: str,
    *,
    bias: Sequence[float] = (),
    limit: float = 0.0,
    cogging: Sequence[float] = (0.0, 0.0, 0.0),
) -> None:
    """Add an actuator to a joint, after the model's own ones and without a command."""
    # Its torque is affine in the joint's coordinate and speed, up to a limit, or periodic in the
    # coordinate. It is a motor with its terminals open: only motors can be without an input.
    drive = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    # The model's defaults do not apply to this one.
    drive.forcelimited = drive.ctrllimited = drive.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    drive.gear = [1, 0, 0, 0, 0, 0]
    drive.dynprm, drive.gainprm, drive.biasprm = np.zeros(10), np.zeros(10), np.zeros(10)
    drive.damping, drive.armature = np.zeros_like(drive.damping), 0.0
    drive.delay, drive.nsample = 0.0, 0
    drive.set_to_dcmotor(
        motorconst=[1.0, 0.0], resistance=_OPEN_CIRCUIT, cogging=list(cogging),
        ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE),
    )  # fmt: skip
    if bias:
        drive.biastype, drive.biasprm = mujoco.mjtBias.mjBIAS_AFFINE, [*bias, *np.zeros(7)]
    if limit:
        drive.forcelimited, drive.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-limit, limit]


def add_friction(spec: mujoco.MjSpec, joint: str, friction: float) -> None:
    """Add dry friction to a joint, down to a total of zero, that holds it at rest."""
    own = spec.joint(joint)
    own.frictionloss = max(own.frictionloss + friction, 0.0)
    make_it_stick(own, spec.option.timestep)


def make_it_stick(joint: mujoco.MjsJoint | mujoco.MjsTendon, step: float) -> None:
    """Set the friction of a joint or a tendon to the largest stiffness stable at a step [s]."""
    joint.solimp_friction = [_STIFF, _STIFF, 0.001, 0.5, 2]
    joint.solref_friction = [2 * step, 1.0]


def add_slipping_part(
    spec: mujoco.MjSpec,
    link: str,
    joint: str,
    name: str,
    *,
    turns: bool,
    axis: Array,
    pos: Array,
    friction: float,
    slack: float,
    stiffness: float,
) -> None:
    """Add a light part that a spring with slack couples to a link, and that friction holds."""
    # Its own joint, on the axis of the link's, says how far it lags behind the link; the friction
    # acts on the sum of both. Its inertia is the least with which the spring is stable at a step.
    body = spec.body(link).add_body(name=name)
    write_inertial(body, _LIGHT, pos, np.array([1.0, 0, 0, 0]), np.full(3, _LIGHT))
    own = add_extra_joint(body, name, turns=turns, axis=axis, pos=pos)
    own.armature = stiffness * (spec.option.timestep / FASTEST) ** 2
    own.damping = [float(np.sqrt(stiffness * own.armature)), 0.0, 0.0]
    for what, joints in (("spring", (name,)), ("grip", (joint, name))):
        tendon = spec.add_tendon(name=f"{name}_{what}")
        for each in joints:
            tendon.wrap_joint(each, 1.0)
        if what == "spring":
            tendon.stiffness = [stiffness, 0.0, 0.0]
            tendon.springlength = [-slack / 2, slack / 2]
        else:
            tendon.frictionloss = friction
            make_it_stick(tendon, spec.option.timestep)


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass distribution of a body."""

    mass: float  # Mass [kg]
    centre: Array  # Centre of mass, in the body's frame [m] (3,)
    tensor: Array  # Inertia about the centre, along the body's axes [kg·m²] (3, 3)


def inertial_of(machine: NominalModel, spec: mujoco.MjSpec, body: str) -> Inertial:
    """Read a body of a machine's spec, which has all inertias explicitly."""
    own = spec.body(body)
    axes = Rotation.from_quat(own.iquat, scalar_first=True).as_matrix()
    tensor = axes @ np.diag(own.inertia) @ axes.T
    return Inertial(mass=float(own.mass), centre=np.array(own.ipos), tensor=tensor)


def set_inertial(machine: NominalModel, spec: mujoco.MjSpec, body: str, inertial: Inertial) -> None:
    """Write a body's mass, centre and inertia, overriding its geoms."""
    moments, axes = principal(inertial.tensor)
    quat = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    write_inertial(spec.body(body), inertial.mass, inertial.centre, quat, moments)


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
) -> mujoco.MjsJoint:
    """Add a hinge or slide to a body, after its own joints, without model defaults."""
    free = mujoco.mjtLimited.mjLIMITED_FALSE
    return body.add_joint(
        name=name, type=mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE,
        axis=axis, pos=pos, ref=0.0, springref=0.0, armature=0.0, stiffness=[stiffness, 0, 0],
        damping=[damping, 0, 0], frictionloss=friction, limited=free, range=[0, 0], margin=0.0,
        springdamper=[0, 0], actfrclimited=free, actgravcomp=False,
    )  # fmt: skip


def set_stops(
    joint: mujoco.MjsJoint,
    gap: float,
    stiffness: float,
    ratio: float,
    *,
    weight: float,
    load: float,
) -> None:
    """Add stops with a gap between them to an added joint.

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
    end = 0.5 * gap / angle_unit(joint)
    joint.range = [-end, end]
    # Under the typical load a Hertzian stop deflects by 1.5 load / stiffness; its impedance is
    # largest at three times that, where force over travel is 1.5^-1 3^0.5 times the stiffness.
    joint.solimp_limit = [_SOFT, _SOFT / _TOUCH, 4.5 * load / stiffness, _SOFT, 2]
    joint.solref_limit = [-np.sqrt(3) / 1.5 * stiffness * weight, -damping * weight]


def keep_motor_side(machine: NominalModel, spec: mujoco.MjSpec, name: str, carried: float) -> None:
    """Keep a small inertia [kg·m² or kg] on the motor side of a joint without rotor."""
    # A Runge-Kutta or Euler step is unstable for a servo that acts on too little inertia: there it
    # is set by the servo's stiffness and damping, whatever the step of the spec is.
    joint, least, model = spec.joint(name), MOTOR_SHARE * carried, machine.model
    if joint.armature < least and int(model.opt.integrator) in _EXPLICIT:
        turn, gears = machine.time_step / FASTEST, machine.moments[machine.joint_number(name)]
        affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
        terms = np.where(affine[:, None], model.actuator_biasprm[:, 1:3], 0.0)
        stiffness, damping = np.maximum(-(gears**2 @ terms), 0.0)
        least = float(max(least, stiffness * turn**2, damping * turn))
    joint.armature = max(joint.armature, least)


def joint_inertia(spec: mujoco.MjSpec, name: str) -> tuple[float, float]:
    """Inertia on a joint, all others locked [kg·m², kg], and its inverse weight, all free."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dof = int(model.joint(name).dofadr[0])
    return float(mass_matrix(model, data)[dof, dof]), float(model.dof_invweight0[dof])


def site_pose(machine: NominalModel, site: mujoco.MjsSite) -> tuple[Array, Array]:
    """Position and quaternion of a site in its body, with frames and angles resolved."""
    model, place, turned = machine.model, np.array(site.pos), np.array(site.quat)
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site.name)
    if number < 0:
        return place, turned
    framed = site.frame is not None or not np.isfinite(place).all()
    return model.site_pos[number] if framed else place, model.site_quat[number]


def insert_first(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str) -> None:
    """Move a joint of a body before its others: these are copied behind it, under their names."""
    for old in [joint for joint in body.joints if joint.name != name]:
        new = body.add_joint()
        for field in dir(old):
            value = getattr(old, field)
            if not (field.startswith("_") or field in _NOT_COPIED or callable(value)):
                setattr(new, field, value)
        own, old.name = old.name, f"moved_{old.name}"
        spec.delete(old)
        new.name = own
