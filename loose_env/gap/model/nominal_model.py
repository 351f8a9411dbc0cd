"""Nominal model of a machine: spec, names, step, typical loads and speeds of its joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.model.element_names import with_names
from loose_env.typing import Array

_MOVING = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_AFFINE_GAINS = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
_AFFINE_BIASES = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
_AT_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
"""Ways to drive a joint itself, the same for hinges and slides."""
_POSES = 5
"""Poses in which it is looked up which joints an actuator acts on."""


@dataclass(frozen=True, eq=False)
class NominalModel:
    """A nominal model of hinges and slides."""

    spec: mujoco.MjSpec
    step: float = 0.0
    integrator: int | None = None
    loads: Array | None = None
    speeds: Array | None = None
    merged_steps: int = 1
    substeps: int = 1
    uniform_steps: bool = False

    def __post_init__(self) -> None:
        """Check, and write every inertia explicitly, so that an edit finds it in the spec."""
        object.__setattr__(self, "spec", _explicit(self.spec))
        model = self.model
        if not model.njnt:
            raise InvalidData(
                "the model has no joints; it needs some, all of them hinges or slides"
            )
        others = np.flatnonzero(~np.isin(model.jnt_type, [int(k) for k in _MOVING]))
        if len(others):
            said = _joint_words(model, int(others[0]))
            raise InvalidData(
                f"{said} is no hinge and no slide; fix that body in its place, or take it out of "
                "the model"
            )
        unnamed = [k for k in range(model.njnt) if not model.joint(k).name]
        if unnamed:
            raise InvalidData(
                f"every joint of the model needs a name; {_joint_words(model, unnamed[0])} has none"
            )

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.spec.copy().compile()

    def fresh(self) -> mujoco.MjSpec:
        """Return a copy of the spec, to be edited, with this machine's step."""
        spec = self.spec.copy()
        if self.step > 0:
            set_step(spec, self.step)
        if self.integrator is not None:
            spec.option.integrator = self.integrator
        return spec

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
        found = {}
        for k, name in enumerate(self.actuators):
            if int(self.model.actuator_trntype[k]) in _AT_JOINT:
                found[name] = self.model.joint(int(self.model.actuator_trnid[k, 0])).name
        return found

    @property
    def time_step(self) -> float:
        """Simulation step: `step`, or that of the model where it is 0 [s]."""
        return self.step or float(self.model.opt.timestep)

    @cached_property
    def affine_actuators(self) -> NDArray[np.bool_]:
        """Mask of the actuators whose gain and bias are affine (actuators,)."""
        return affine_actuators(self.model)

    def gears(self, joint: str) -> Array:
        """Torque on a joint per force of each actuator, at the model's zero (actuators,)."""
        return np.asarray(self._at_zero[self.joint_number(joint)])

    @cached_property
    def pose_dependent_joints(self) -> tuple[str, ...]:
        """Joints with an actuator whose transmission depends on the pose."""
        model: mujoco.MjModel = self.model
        changing = [k for k in range(len(self.actuators)) if not _has_one_gear(model, k)]
        if not changing:
            return ()
        rng = np.random.default_rng(0)
        poses = [model.qpos0 + rng.uniform(-1.0, 1.0, model.nq) for _ in range(_POSES)]
        acting = np.any([self._moments(pose)[:, changing] != 0 for pose in poses], axis=(0, 2))
        for k in changing:
            if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_BODY:  # acts only on contact
                acting |= np.isin(
                    model.jnt_bodyid, _up_from(model, int(model.actuator_trnid[k, 0]))
                )
        return tuple(n for n, acts in zip(self.joints, acting, strict=True) if acts)

    def _moments(self, pose: Array) -> Array:
        """Torque on each joint per force of each actuator in a pose (joints, actuators)."""
        model: mujoco.MjModel = self.model
        data = mujoco.MjData(model)
        data.qpos[:] = pose
        mujoco.mj_fwdPosition(model, data)
        dense = np.zeros((len(data.moment_rownnz), model.nv))
        mujoco.mju_sparse2dense(
            dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        return np.asarray(dense[: len(self.actuators)].T)

    @cached_property
    def _at_zero(self) -> Array:
        return self._moments(self.model.qpos0)

    @cached_property
    def tool(self) -> str:
        """Site of the tool: "tool", else the last of the last link, else the last moving.

        "" if no site moves.
        """
        model = self.model
        bodies = [int(b) for b in model.site_bodyid]
        sites = [(model.site(k).name, b) for k, b in enumerate(bodies) if model.body_weldid[b] > 0]
        last = model.body(self.last_link).id
        for chosen in (
            [name for name, _ in sites if name == "tool"],
            [name for name, body in sites if body == last],
            # Bodies without a joint between them and the last link are part of it.
            [name for name, body in sites if model.body_weldid[body] == last],
            [name for name, _ in sites],
        ):
            if chosen:
                return str(chosen[-1])
        return ""

    @cached_property
    def last_link(self) -> str:
        """Name of the link at the end of the longest chain of joints, the last of such."""
        model: mujoco.MjModel = self.model
        depth = np.zeros(model.nbody, dtype=int)
        for body in range(1, model.nbody):
            depth[body] = depth[model.body_parentid[body]] + model.body_jntnum[body]
        moved = model.body_jntnum > 0
        deepest = np.flatnonzero(moved & (depth == depth[moved].max()))
        return str(model.body(int(deepest[-1])).name)

    def joint_number(self, joint: str) -> int:
        """Index of a joint, from 0."""
        return self.joints.index(joint)

    def body_of(self, joint: str) -> str:
        """Return the name of the body that a joint moves."""
        return str(self.model.body(int(self.model.jnt_bodyid[self.joint_number(joint)])).name)

    def first_joint(self, link: str) -> str:
        """Return the first joint of a link."""
        bodies = [int(b) for b in self.model.jnt_bodyid]
        return self.joints[bodies.index(self.model.body(link).id)]

    @cached_property
    def inertias(self) -> Array:
        """Inertia on each joint with armature, the others locked [kg·m², kg] (joints,)."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        mass = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, mass)
        return np.asarray(np.maximum(np.diag(mass), 1e-9))

    @cached_property
    def load_scales(self) -> Array:
        """Typical torque [N·m] or force [N] of each joint (joints,)."""
        if self.loads is not None:
            return np.asarray(np.maximum(self.loads, 1e-9), dtype=float)
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        return np.asarray(np.abs(data.qfrc_bias) + 2.0 * self.inertias)

    @cached_property
    def speed_scales(self) -> Array:
        """Typical speed of each joint [rad/s, m/s] (joints,)."""
        if self.speeds is not None:
            return np.asarray(np.maximum(self.speeds, 1e-9), dtype=float)
        return np.ones(len(self.joints))

    def load(self, joint: str) -> float:
        """Typical torque [N·m] or force [N] of one joint."""
        return float(self.load_scales[self.joint_number(joint)])

    def speed(self, joint: str) -> float:
        """Typical speed of one joint [rad/s, m/s]."""
        return float(self.speed_scales[self.joint_number(joint)])

    def inertia(self, joint: str) -> float:
        """Inertia on one joint [kg·m², kg]."""
        return float(self.inertias[self.joint_number(joint)])

    def turns(self, joint: str) -> bool:
        """Return whether a joint is a hinge."""
        return bool(self.model.jnt_type[self.joint_number(joint)] == _MOVING[0])


def affine_actuators(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Mask of the actuators whose gain and bias are affine in length and speed (actuators,)."""
    affine = np.isin(model.actuator_gaintype, _AFFINE_GAINS)
    return np.asarray(affine & np.isin(model.actuator_biastype, _AFFINE_BIASES))


def _joint_words(model: mujoco.MjModel, joint: int) -> str:
    """Say which joint of which body one is."""
    name, body = model.joint(joint).name, model.body(int(model.jnt_bodyid[joint])).name
    return f"joint {repr(name) if name else joint} of body {body!r}"


def set_step(spec: mujoco.MjSpec, step: float) -> None:
    """Set a spec's step [s] and keep its delays, whose histories count samples."""
    spec.option.timestep = step
    for late in (*spec.actuators, *spec.sensors):
        if late.delay > 0:
            late.nsample = max(int(late.nsample), history_for(late.delay, step))


def history_for(delay: float, step: float) -> int:
    """Number of samples in MuJoCo's history for a delay [s] at a step [s], or half.

    Examples
    --------
    >>> history_for(0.0105, 0.001)
    24
    """
    return 2 * ceil(delay / step - 1e-9) + 2


def _has_one_gear(model: mujoco.MjModel, actuator: int) -> bool:
    """Return whether an actuator has the same torque per force in all poses.

    It does at a joint and at a fixed tendon, a weighted sum of joints; not at a spatial tendon, a
    site, a crank or a body.
    """
    if int(model.actuator_trntype[actuator]) in _AT_JOINT:
        return True
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_TENDON:
        return False
    first = int(model.tendon_adr[model.actuator_trnid[actuator, 0]])
    return bool(model.wrap_type[first] == mujoco.mjtWrap.mjWRAP_JOINT)


def _up_from(model: mujoco.MjModel, body: int) -> list[int]:
    """Return a body and its ancestors."""
    found = [body]
    while found[-1] > 0:
        found.append(int(model.body_parentid[found[-1]]))
    return found


def _explicit(given: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a spec with all names and explicit inertias, none inferred from shapes."""
    spec = with_names(given)
    model = spec.copy().compile()
    for body in spec.bodies[1:]:
        k = model.body(body.name).id
        body.mass = float(model.body_mass[k])
        body.ipos = model.body_ipos[k].copy()
        body.iquat = model.body_iquat[k].copy()
        body.inertia = model.body_inertia[k].copy()
        body.fullinertia = np.full(6, np.nan)
        body.explicitinertial = body.mass > 0
    # else an edited mass is inferred from shapes again, or scaled with all others to the total
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass = -1.0
    return spec
