"""Edits of an MJCF spec that effects share.

Names and units, actuators without input, dry friction that holds, mass and inertia of a body, extra
joints with their stops, and the split of a body, whose children, sites and geoms move to a new one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from loose_env.gap.model.nominal_model import (
    NominalModel,
    mass_matrix,
    unused,
    write_inertial,
)
from loose_env.typing import Array

_STIFF = 0.9999  # MuJoCo's largest constraint impedance
_OPEN_CIRCUIT = 1e12
"""Resistance at which no current brakes the rotor [ohm]."""
_MOVED = "moved_"
"""Prefix of what is on its way; only copies of the model's defaults keep it."""
_NOT_COPIED = frozenset(
    (
        "id", "parent", "signature", "frame", "name", "info", "plugin", "classname", "compiler",
        "pos", "quat", "fromto",
    )
)  # fmt: skip
_ROUNDING = 1e-9
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
    """Return an unused name for an element that an effect adds to a model.

    A corrected model that is compared again has elements added before, and an effect may occur
    twice.
    """
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
    """Add an actuator to a joint, after the model's own ones and without a command.

    Its torque is affine in the joint's coordinate and speed, up to a limit, or periodic in the
    coordinate. It is a motor with its terminals open: only motors can be without an input.
    """
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
    """Set a joint's or tendon's friction to the largest stiffness stable at a step [s]."""
    joint.solimp_friction = [_STIFF, _STIFF, 0.001, 0.5, 2]
    joint.solref_friction = [2 * step, 1.0]


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass distribution of a body."""

    mass: float
    """Mass [kg]."""
    centre: Array
    """Centre of mass, in the body's frame [m] (3,)."""
    tensor: Array
    """Inertia about the centre, along the body's axes [kg·m²] (3, 3)."""


def inertial_of(machine: NominalModel, spec: mujoco.MjSpec, body: str) -> Inertial:
    """Read a body of a machine's spec, which has all inertias explicitly."""
    own = spec.body(body)
    axes = Rotation.from_quat(own.iquat, scalar_first=True).as_matrix()
    tensor = axes @ np.diag(own.inertia) @ axes.T
    return Inertial(mass=float(own.mass), centre=np.array(own.ipos), tensor=tensor)


def set_inertial(machine: NominalModel, spec: mujoco.MjSpec, body: str, inertial: Inertial) -> None:
    """Write a body's mass, centre and inertia, overriding its geoms."""
    moments, axes = np.linalg.eigh(inertial.tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    # Of a flat body the largest moment is the sum of the others; rounding must not exceed it.
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-15))
    quat = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    write_inertial(spec.body(body), inertial.mass, inertial.centre, quat, moments)


def steiner(mass: float, lever: Array) -> Array:
    """Inertia (3, 3) [kg·m²] of a point mass [kg] at a lever (3,) [m]."""
    return mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))


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
    end = reach / angle_unit(joint)
    joint.range = [-end, end]
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
    if int(model.opt.integrator) not in _EXPLICIT:
        return 0.0
    turn = machine.time_step / FASTEST
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
    dof = int(model.joint(name).dofadr[0])
    return float(mass_matrix(model, data)[dof, dof]), float(model.dof_invweight0[dof])


def site_pose(machine: NominalModel, site: mujoco.MjsSite) -> tuple[Array, Array]:
    """Position and quaternion of a site in its body, with frames and angles resolved."""
    model, place, turned = machine.model, np.array(site.pos), np.array(site.quat)
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site.name)
    if number >= 0:
        turned = model.site_quat[number]
        if site.frame is not None or not np.isfinite(place).all():
            place = model.site_pos[number]
    return place, turned


def move_beyond(
    machine: NominalModel,
    spec: mujoco.MjSpec,
    old: mujoco.MjsBody,
    new: mujoco.MjsBody,
    along: Array,
) -> None:
    """Move what lies on the far side of ``new`` from ``old`` to it: bodies, sites and geoms.

    Geoms in frames stay.
    """
    here = np.array(new.pos)

    def beyond(place: Array) -> bool:
        return bool((place - here) @ along >= -_ROUNDING)

    moving = []
    for child in list(old.bodies):
        place, turn = _pose(machine, child)
        if child.name != new.name and beyond(place):
            moving.append((child.name, place - here, turn))
    if moving:
        _move_bodies(spec, new, moving)
    for site in list(old.sites):
        place, turn = site_pose(machine, site)
        if beyond(place):
            moved = new.add_site()
            _move(spec, site, moved, {"pos": place - here, "quat": turn})
            moved.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    for geom in list(old.geoms):
        ends = np.array(geom.fromto).reshape(2, 3)
        spanned = bool(np.isfinite(ends).all())
        place = ends.mean(axis=0) if spanned else np.array(geom.pos)
        if geom.frame is None and beyond(place):
            placed = {"pos": place - here, "quat": geom.quat}
            placed = {"fromto": (ends - here).ravel()} if spanned else placed
            _move(spec, geom, new.add_geom(), placed)


def _move_bodies(
    spec: mujoco.MjSpec, new: mujoco.MjsBody, moving: Sequence[tuple[str, Array, Array | None]]
) -> None:
    """Move bodies with their subtrees: name, position and quaternion of each.

    MuJoCo cannot move a body within a spec; a copy of it is attached instead. References by name,
    actuators and sensors among them, keep their order: the names are released before the originals
    are deleted and reassigned to the copies.
    """
    copy = spec.copy()
    for several in (
        copy.actuators, copy.sensors, copy.equalities, copy.tendons, copy.keys, copy.excludes,
        copy.pairs,
    ):  # fmt: skip
        for element in list(several):
            copy.delete(element)
    frame = new.add_frame()
    for name, place, turn in moving:
        original = spec.body(name)
        for element in _elements(original):
            if element.name:
                element.name = _MOVED + "old_" + element.name
        spec.delete(original)
        prefix = f"{_MOVED}{name}_"  # a separate copy, since every copy brings the defaults along
        moved = frame.attach_body(copy.body(name), prefix, "")
        moved.pos = place
        if turn is not None:
            moved.quat = turn
            moved.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        for element in _elements(moved):
            element.name = element.name.removeprefix(prefix)


def insert_first(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str) -> None:
    """Move a joint of a body before its others, which MuJoCo's order of creation does not allow.

    The others are copied behind it; references by name are kept.
    """
    for joint in list(body.joints):
        if joint.name != name:
            _move(spec, joint, body.add_joint(), {"pos": np.array(joint.pos)})


def keep_from_touching(spec: mujoco.MjSpec, near: mujoco.MjsBody, far: mujoco.MjsBody) -> None:
    """Exclude contacts that the link could not have before it was cut.

    MuJoCo excludes contacts between a body and its parent, and bodies fixed to either. Once ``far``
    is a child of ``near``, the links beyond it are no longer children of ``near``, and it is no
    longer a child of the parent of ``near``.
    """
    if spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        return
    carrier = near.parent
    while carrier.name != "world" and not list(carrier.joints):
        carrier = carrier.parent
    ends = _fixed_together(far)
    beyond = [b for end in ends for link in end.bodies if list(link.joints)
              for b in _fixed_together(link)]  # fmt: skip
    pairs = [(a, b) for a in _fixed_together(near) for b in beyond]
    if carrier.name != "world":
        pairs += [(a, b) for a in _fixed_together(carrier) for b in ends]
    for several in pairs:
        for number, body in enumerate(several):
            if not body.name:
                body.name = added_name(spec, far.name, f"part_{number}")
        spec.add_exclude(bodyname1=several[0].name, bodyname2=several[1].name)


def _fixed_together(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    """Return a body and those that are fixed to it."""
    fixed = [child for child in body.bodies if not list(child.joints)]
    return [body, *(each for child in fixed for each in _fixed_together(child))]


def _move(spec: mujoco.MjSpec, old: Any, new: Any, placed: dict[str, Array]) -> None:
    """Transfer all of ``old`` but its pose to ``new``, name included; delete ``old``."""
    for name in dir(old):
        value = getattr(old, name)
        if name.startswith("_") or name in _NOT_COPIED or callable(value):
            continue
        if name == "alt":
            for part in ("type", "axisangle", "xyaxes", "zaxis", "euler"):
                setattr(new.alt, part, getattr(value, part))
        else:
            setattr(new, name, value)
    for name, value in placed.items():
        setattr(new, name, value)
    name, old.name = old.name, f"{_MOVED}old_{old.name}" if old.name else ""
    spec.delete(old)
    new.name = name


def _elements(body: mujoco.MjsBody) -> list[Any]:
    """List all elements in a body and in its subtree."""
    kinds = ("body", "joint", "geom", "site", "camera", "light")
    return [body, *(element for kind in kinds for element in body.find_all(kind))]


def _pose(machine: NominalModel, body: mujoco.MjsBody) -> tuple[Array, Array | None]:
    """Pose of a body in its parent; its quaternion too if a frame lies in between."""
    model = machine.model
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body.name)
    if body.frame is None or number < 0:
        return np.array(body.pos), None
    return np.array(model.body_pos[number]), np.array(model.body_quat[number])
