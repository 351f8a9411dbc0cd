"""Nominal model of a machine: spec, names, typical loads and speeds of its joints, geometry."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from math import ceil

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.recording import joint_sensors
from loose_env.typing import Array, IndexArray

MOVING = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
"""Types of joints of one degree of freedom: hinges, slides."""
_AFFINE_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
_AFFINE_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
AT_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
"""Ways to drive a joint itself, the same for hinges and slides."""
_LISTED = 6  # names that a sentence lists


@dataclass(frozen=True, eq=False)
class NominalModel:
    """A nominal model of hinges and slides."""

    spec: mujoco.MjSpec
    loads: Array | None = None
    """Typical torque [N·m] or force [N] of each joint (joints,); None: from gravity and inertia."""
    speeds: Array | None = None
    """Typical speed of each joint [rad/s, m/s] (joints,); None: 1."""

    def __post_init__(self) -> None:
        """Check, and write every inertia explicitly, so that an edit finds it in the spec."""
        object.__setattr__(self, "spec", _explicit(self.spec))
        model = self.model
        if not model.njnt:
            raise InvalidData(
                "the model has no joints; it needs some, all of them hinges or slides"
            )
        for k in range(model.njnt):
            name, body = model.joint(k).name, model.body(int(model.jnt_bodyid[k])).name
            said = f"joint {repr(name) if name else k} of body {body!r}"
            if model.jnt_type[k] not in MOVING:
                raise InvalidData(
                    f"{said} is no hinge and no slide; fix that body in its place, or take it out "
                    "of the model"
                )
            if not name:
                raise InvalidData(f"every joint of the model needs a name; {said} has none")

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.spec.copy().compile()

    def fresh(self) -> mujoco.MjSpec:
        """Return a copy of the spec, to be edited."""
        return self.spec.copy()

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the model's order."""
        return tuple(self.model.joint(k).name for k in range(self.model.njnt))

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Names of the bodies that the joints move, in the joints' order, each once."""
        bodies = dict.fromkeys(int(b) for b in self.model.jnt_bodyid)
        return tuple(self.model.body(b).name for b in bodies)

    @cached_property
    def actuators(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return tuple(self.model.actuator(k).name for k in range(self.model.nu))

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(self.model.sensor(k).name for k in range(self.model.nsensor))

    @cached_property
    def actuated_joint(self) -> dict[str, str]:
        """Joint driven by each actuator, of those that drive a joint."""
        of, at_joint = (
            self.model.actuator_trnid[:, 0],
            np.isin(self.model.actuator_trntype, AT_JOINT),
        )
        return {n: self.joints[of[k]] for k, n in enumerate(self.actuators) if at_joint[k]}

    @cached_property
    def encoders(self) -> dict[str, str]:
        """Joint that each position sensor reads."""
        return {n: joint for joint, own in joint_sensors(self.model).items() for n in own.position}

    @property
    def time_step(self) -> float:
        """Simulation step [s]."""
        return float(self.model.opt.timestep)

    @cached_property
    def affine_actuators(self) -> NDArray[np.bool_]:
        """Mask of the actuators whose gain and bias are affine (actuators,)."""
        return affine_actuators(self.model)

    @cached_property
    def servos(self) -> dict[int, int]:
        """Joints that a position servo of affine force holds, with the number of its actuator."""
        model, found = self.model, {}
        for number in np.flatnonzero(self.affine_actuators & (model.actuator_biasprm[:, 1] != 0)):
            name = self.actuators[number]
            if name in self.actuated_joint and model.actuator_gear[number, 0]:
                found[self.joint_number(self.actuated_joint[name])] = int(number)
        return found

    @cached_property
    def moments(self) -> Array:
        """Torque on each joint per force of each actuator, at its zero (joints, actuators)."""
        data = self.at_zero
        dense = np.zeros((len(data.moment_rownnz), self.model.nv))
        mujoco.mju_sparse2dense(
            dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        return np.ascontiguousarray(dense[: len(self.actuators), : len(self.joints)].T)

    @cached_property
    def torque_limits(self) -> Array:
        """Torque limit [N·m] or force limit [N] of each joint, infinite without one (joints,)."""
        model, gears = self.model, np.abs(self.moments)
        limited = model.actuator_forcelimited.astype(bool)
        forces = np.where(limited, np.abs(model.actuator_forcerange).min(axis=1), np.inf)
        found = (gears * np.where(gears > 0, forces, 0.0)).sum(axis=1)
        found[found == 0] = np.inf
        of_joint = np.abs(model.jnt_actfrcrange).min(axis=1)
        of_joint = np.where(model.jnt_actfrclimited, of_joint, np.inf)
        return np.asarray(np.minimum(found, of_joint))

    @cached_property
    def at_zero(self) -> mujoco.MjData:
        """The evaluated model at its zero; not to be changed."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        return data

    @cached_property
    def tool(self) -> str:
        """Site of the tool: "tool", else the last of the last link, else the last moving, or ""."""
        model, last = self.model, self.model.body(self.last_link).id
        # Bodies without a joint between them and the last link are part of it.
        ranked = [
            (model.site(k).name == "tool", body == last, model.body_weldid[body] == last, k)
            for k, body in enumerate(model.site_bodyid)
            if model.body_weldid[body] > 0
        ]
        return str(model.site(max(ranked)[-1]).name) if ranked else ""

    @cached_property
    def last_link(self) -> str:
        """Name of the link at the end of the longest chain of joints, the last of such."""
        # Coupled joints, such as those of a gripper's fingers, are left out: what they hold
        # together loads the link that carries them.
        model: mujoco.MjModel = self.model
        depth = np.zeros(model.nbody, dtype=int)
        for body in range(1, model.nbody):
            depth[body] = depth[model.body_parentid[body]] + model.body_jntnum[body]
        coupled = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
        fingers = np.concatenate([model.eq_obj1id[coupled], model.eq_obj2id[coupled]])
        alone = model.body_jntnum > 0
        alone[model.jnt_bodyid[fingers[fingers >= 0]]] = False
        moved = alone if alone.any() else model.body_jntnum > 0
        deepest = np.flatnonzero(moved & (depth == depth[moved].max()))
        return str(model.body(int(deepest[-1])).name)

    def joint_number(self, joint: str) -> int:
        """Index of a joint, from 0."""
        return self.joints.index(joint)

    def body_of(self, joint: str) -> str:
        """Return the name of the body that a joint moves."""
        return str(self.model.body(int(self.model.jnt_bodyid[self.joint_number(joint)])).name)

    @cached_property
    def inertias(self) -> Array:
        """Inertia on each joint with armature, the others locked [kg·m², kg] (joints,)."""
        return np.asarray(np.maximum(np.diag(mass_matrix(self.model, self.at_zero)), 1e-9))

    @cached_property
    def load_scales(self) -> Array:
        """Typical torque [N·m] or force [N] of each joint (joints,)."""
        usual = np.abs(self.at_zero.qfrc_bias) + 2.0 * self.inertias
        return np.asarray(usual if self.loads is None else np.maximum(self.loads, 1e-9), float)

    @cached_property
    def speed_scales(self) -> Array:
        """Typical speed of each joint [rad/s, m/s] (joints,)."""
        speeds = np.ones(len(self.joints)) if self.speeds is None else self.speeds
        return np.asarray(np.maximum(speeds, 1e-9), float)

    @cached_property
    def hinges(self) -> NDArray[np.bool_]:
        """Mask of the joints that are hinges (joints,)."""
        return np.asarray(self.model.jnt_type == MOVING[0])

    def turns(self, joint: str) -> bool:
        """Return whether a joint is a hinge."""
        return bool(self.hinges[self.joint_number(joint)])


def affine_actuators(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Mask of the actuators whose gain and bias are affine in length and speed (actuators,)."""
    affine = np.isin(model.actuator_gaintype, _AFFINE_GAINS)
    return np.asarray(affine & np.isin(model.actuator_biastype, _AFFINE_BIASES))


def named(names: Sequence[str], mask: Iterable[bool]) -> tuple[str, ...]:
    """Names of elements with a name, of those in a mask."""
    return tuple(name for name, chosen in zip(names, mask, strict=True) if name and chosen)


def addresses(model: mujoco.MjModel, joints: Sequence[str]) -> tuple[IndexArray, IndexArray]:
    """Addresses of joints in positions and in speeds (joints,)."""
    numbers = [model.joint(name).id for name in joints]
    return model.jnt_qposadr[numbers], model.jnt_dofadr[numbers]


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Mass matrix (nv, nv) in an evaluated pose."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass


def set_step(spec: mujoco.MjSpec, step: float) -> None:
    """Set a spec's step [s] and keep its delays, whose histories count samples."""
    spec.option.timestep = step
    for late in (*spec.actuators, *spec.sensors):
        if late.delay > 0:
            late.nsample = max(int(late.nsample), history_for(late.delay, step))


def history_for(delay: float, step: float) -> int:
    """Number of samples in MuJoCo's history for a delay [s] at a step [s], or half."""
    return 2 * ceil(delay / step - 1e-9) + 2


def _explicit(given: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a spec with all names and explicit inertias, none inferred from shapes."""
    spec = with_names(given)
    model = spec.copy().compile()
    for body in spec.bodies[1:]:
        k = model.body(body.name).id
        mass, centre, moments = model.body_mass[k], model.body_ipos[k], model.body_inertia[k]
        write_inertial(body, float(mass), centre, model.body_iquat[k], moments)
    # else an edited mass is inferred from shapes again, or scaled with all others to the total
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass = -1.0
    return spec


def write_inertial(
    body: mujoco.MjsBody, mass: float, centre: Array, quat: Array, moments: Array
) -> None:
    """Write mass [kg], centre [m], and principal axes and moments [kg·m²] of a body's inertia."""
    body.mass, body.ipos, body.iquat, body.inertia = mass, centre, quat, moments
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.fullinertia = np.full(6, np.nan)
    body.explicitinertial = mass > 0


def with_names(given: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a spec with all bodies, sites and actuators named: links after their first joint."""
    spec = given.copy()
    for noun in ("body", "site", "actuator"):
        every = spec.bodies if noun == "body" else getattr(spec, f"{noun}s")
        taken = {element.name for element in every}
        for number, element in enumerate(every[1:] if noun == "body" else every):
            joint = element.joints[0].name if noun == "body" and element.joints else ""
            if not element.name:
                element.name = unused(f"{joint}_link" if joint else f"{noun}_{number}", taken)
                taken.add(element.name)
    return spec


def naming_notes(given: mujoco.MjSpec) -> list[str]:
    """Describe links of a model without a name of their own; none if all have one."""
    before, after = given.bodies[1:], with_names(given).bodies[1:]
    links = [new.name for old, new in zip(before, after, strict=True) if not old.name if new.joints]
    shown = ", ".join(links[:_LISTED]) + " and others" * (len(links) > _LISTED)
    note = f"links of the model without a name are called after their joint, {shown}, here and in "
    return [f"{note}model.xml; give their bodies names to see your own"] if links else []


def unused(name: str, taken: Container[str]) -> str:
    """The name, or where it is taken the first with a number behind it that is not."""
    return next(n for k in count(1) if (n := name if k == 1 else f"{name}_{k}") not in taken)


def normal_of(machine: NominalModel) -> Array | None:
    """Normal (3,) of the machine's plane of motion, world frame; None if not planar."""
    hinges, slides = (machine.at_zero.xaxis[own] for own in (machine.hinges, ~machine.hinges))
    if not len(hinges):
        return None
    normal = hinges[0] * np.sign(hinges[0][np.argmax(np.abs(hinges[0]))])
    parallel = np.allclose(np.abs(hinges @ normal), 1.0, atol=1e-6)
    return np.array(normal) if parallel and np.allclose(slides @ normal, 0, atol=1e-6) else None


def reach_of(machine: NominalModel) -> float:
    """Length of the machine along its bodies, from its first joint on [m]."""
    model = machine.model
    along, beyond = np.zeros(model.nbody), np.linalg.norm(model.body_ipos, axis=1)
    first = int(model.jnt_bodyid[0])
    for body in range(first + 1, model.nbody):
        along[body] = along[model.body_parentid[body]] + np.linalg.norm(model.body_pos[body])
    np.maximum.at(beyond, model.site_bodyid, np.linalg.norm(model.site_pos, axis=1))
    return max(float((along + beyond)[first:].max()), 1e-3)


def link_ends(machine: NominalModel, link: str) -> tuple[Array, Array]:
    """Ends of a link in its body's frame: at its joint, and at the next or the tool."""
    # The end is the farthest of the bodies with joints beyond it, or else of its sites; without
    # any, twice the distance to its centre of mass.
    model = machine.model
    body = model.body(link).id
    start = np.array(model.jnt_pos[int(model.body_jntadr[body])])
    carrying = set(model.jnt_bodyid.tolist())
    for each in range(model.nbody - 1, 0, -1):  # parents come before their children
        carrying |= {int(model.body_parentid[each])} if each in carrying else set()
    ends = [model.body_pos[b] for b in sorted(carrying) if b and model.body_parentid[b] == body]
    ends = ends or list(model.site_pos[model.site_bodyid == body])
    ends = ends or [start + 2 * (model.body_ipos[body] - start)]
    return start, np.array(max(ends, key=lambda end: float(np.linalg.norm(end - start))))


def frame_about(axis: Array) -> Array:
    """Right-handed unit vectors (3, 3), the first of them along ``axis``."""
    first = axis / np.linalg.norm(axis)
    second = np.eye(3)[int(np.argmin(np.abs(first)))]
    second = second - first * (second @ first)
    second /= np.linalg.norm(second)
    return np.array([first, second, np.cross(first, second)])
