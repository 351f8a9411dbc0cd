"""The suspect arm as rigid bodies: what a plan and a diagnosis both know of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from loose_env.arms import Chain, ModelFile, find_chain, read_model_file, report
from loose_env.instrument.clearance import Collisions, Ground
from loose_env.instrument.recording_model import RecordingModel, recording_model
from loose_env.instrument.tool_site import body_beyond, sensed_sites, tool_site
from loose_env.kinematics import carried_bodies
from loose_env.typing import Array, ComplexArray, IndexArray

BOLTS, GEARS = "structural_looseness", "backlash"
"""Kinds of place that can be loose: the seat of a link on its joint; the teeth of a joint."""
ROCKS = 6
"""Turns of a square base plate that are tried, 15 degrees apart: it rocks about both its axes."""
AXES = 2 * ROCKS
"""Axes in the plate; every `ROCKS` apart are at right angles."""
_TURN = 2 * np.pi
_ROUNDING = 1e-12
"""Least share of its inertia that the base rocks with: free joints may take up all of it [1]."""


def place_name(kind: str, at: str) -> str:
    """Name of a place, as ``backlash@elbow``."""
    return f"{kind}@{at}"


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseModel:
    """Rigid dynamics of the arm in one pose as one accelerometer feels it; n joints.

    The accelerometer is called the tool's, where it may be one at a link before it, too.
    """

    inertia: Array
    """Inertia of the links about the joints, rotors left out (n, n) [kg·m², kg]."""
    jacobian: Array
    """Acceleration of the tool by joint acceleration, tool frame (3, n)."""
    turning: Array
    """Angular acceleration of the tool by joint acceleration, tool frame (3, n)."""
    up: Array
    """Reading of a sensor at rest: gravity's reaction, tool frame (3,) [m/s²]."""
    carried: tuple[Array, ...]
    """Mass times velocity Jacobian of all that hangs on each link, link frame, n of (3, n) [kg]."""
    mass: Array
    """Mass that hangs on each link (n,) [kg]."""
    weight: Array
    """Force that each seat carries at rest, link frame (n, 3) [N]."""
    torque: Array
    """Torque that each joint carries at rest (n,) [N·m, N]."""
    frames: Array
    """Turns link frames into the tool's (n, 3, 3); zero for links beyond the accelerometer."""
    held: Array
    """Inertia about the joints of a unit mass in the hand (n, n) [m²; 1 where both slide]."""
    rocked: Array
    """Moment on the base about each axis of its plate by joint acceleration (AXES, n) [kg·m²]."""
    moment: Array
    """The same at rest (AXES,) [N·m]."""
    bulk: Array
    """Inertia of the whole arm about each (AXES,) [kg·m²]."""
    swung: Array
    """Acceleration of the tool by angular acceleration about each, tool frame (AXES, 3)."""

    def tilt(self, acceleration: ComplexArray, hertz: Array) -> ComplexArray:
        """Gravity that turns through the sensor (..., k, 3), by lines of joint acceleration."""
        angle = -acceleration / (_TURN * hertz[:, None]) ** 2
        return np.asarray(angle @ np.cross(self.up, self.turning.T))

    def throws(self, stiffening: Array) -> tuple[Array, Array, Array, Array]:
        """Motion of the tool by a force pair within the arm, above the modes of its gears.

        Parameters
        ----------
        stiffening : ndarray
            Inertia that each joint has beside the links' own, less what its gear's spring takes
            off (n,) [kg·m², kg].

        Returns
        -------
        seats : ndarray
            Acceleration of the tool by unit force across each seat (n, 3, 3), tool by link frame.
        stiff : ndarray
            Force by unit acceleration of each seat's opening, link frame (n, 3, 3) [kg].
        turns : ndarray
            Acceleration of the tool by unit acceleration of each joint's opening, and about each
            axis of the base (n + AXES, 3); zero where the joints take up all of it.
        free : ndarray
            Torque by unit acceleration of each (n + AXES,) [kg·m², kg].
        """
        inverse = np.linalg.inv(self.inertia + np.diag(stiffening))
        seats, stiff = [], []
        for frame, carried, mass in zip(self.frames, self.carried, self.mass, strict=True):
            seats.append(frame - self.jacobian @ inverse @ carried.T)
            stiff.append(mass * np.eye(3) - carried @ inverse @ carried.T)
        base = self.bulk - np.einsum("ki,ij,kj->k", self.rocked, inverse, self.rocked)
        base = np.maximum(base, _ROUNDING * self.bulk)
        turns, joints = (self.jacobian @ inverse).T, 1 / np.diag(inverse)
        swings = self.swung - self.rocked @ turns
        turns = np.vstack([turns * joints[:, None], swings])
        return np.array(seats), np.array(stiff), turns, np.r_[joints, base]


@dataclass(frozen=True, kw_only=True, eq=False)
class SuspectArm:
    """Arm of a model file as rigid bodies with an accelerometer; n joints, base first."""

    path: Path
    recording_model: RecordingModel
    """Self-contained model that recordings of the arm are checked against."""
    joints: tuple[str, ...]
    links: tuple[str, ...]
    """Body that each joint moves."""
    slides: Array
    """True where a joint slides (n,)."""
    low: Array
    """Lowest allowed position (n,) [rad, m]; a full turn where the model has no range."""
    high: Array
    torque_limit: Array
    """Peak torque of each drive (n,) [N·m, N]; infinite where the model states none."""
    collisions: Collisions
    notes: tuple[str, ...]
    """Omissions and assumptions, in sentences."""

    @property
    def n(self) -> int:
        """Number of joints, and of links."""
        return len(self.joints)

    @property
    def places(self) -> tuple[str, ...]:
        """Names of all places that can be loose: seats of links, teeth of joints, the base."""
        return (
            *(place_name(BOLTS, link) for link in self.links),
            *(place_name(GEARS, joint) for joint in self.joints),
            place_name(BOLTS, self.base),
        )

    @cached_property
    def base(self) -> str:
        """Body that carries the first link and is bolted to the ground."""
        parent = int(self.model.body_parentid[self.model.body(self.links[0]).id])
        free = (name for name in ("base", "ground", "floor") if name not in self.links)
        return self.model.body(parent).name if parent else next(free)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The recording's model."""
        return self.recording_model.model

    @cached_property
    def accelerometers(self) -> dict[str, int]:
        """Accelerometers that the joints of the arm alone move, by their sites; the tool's first.

        One on the ground, or beyond a finger's joint, is none of them.
        """
        m, own = self.model, set(self.dofs.tolist())
        first, found = self.recording_model.accelerometer, {}
        for k in np.flatnonzero(m.sensor_type == mujoco.mjtSensor.mjSENS_ACCELEROMETER):
            site = int(m.sensor_objid[k])
            on = int(m.site_bodyid[site])
            moves = {d for d, b in enumerate(m.dof_bodyid) if carried_bodies(m, int(b))[on]}
            name = m.sensor(k).name
            if name == first or (moves and moves <= own):
                found[name] = site
        return dict(sorted(found.items(), key=lambda item: item[0] != first))

    @cached_property
    def addresses(self) -> IndexArray:
        """Index of each joint in the model's positions (n,)."""
        return np.array([int(self.model.joint(j).qposadr[0]) for j in self.joints], dtype=np.intp)

    @cached_property
    def dofs(self) -> IndexArray:
        """Index of each joint in the model's velocities (n,)."""
        return np.array([int(self.model.joint(j).dofadr[0]) for j in self.joints], dtype=np.intp)

    @cached_property
    def rotors(self) -> Array:
        """Rotor inertia that the model states for each joint (n,) [kg·m², kg]."""
        return np.array(self.model.dof_armature[self.dofs])

    @cached_property
    def ground(self) -> Ground:
        """The plane that the arm stands on."""
        first = [self.model.body(link).id for link in self.links]
        return Ground.of(self.model, self.addresses, first, self.recording_model.site)

    def pose_of(self, named: dict[str, float]) -> Array:
        """Joint positions (n,) of a pose by names; others are at the model's reference."""
        own = self.model.qpos0[self.addresses]
        return np.array([named.get(j, float(q)) for j, q in zip(self.joints, own, strict=True)])

    def at(self, pose: Array, sensor: str | None = None) -> PoseModel:
        """Rigid dynamics in a pose (n,), as an accelerometer feels it; by default the tool's."""
        m = self.model
        data = mujoco.MjData(m)
        data.qpos[:] = m.qpos0
        data.qpos[self.addresses] = pose
        mujoco.mj_forward(m, data)
        dofs = self.dofs
        inertia = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, data, inertia)
        inertia = inertia[np.ix_(dofs, dofs)] - np.diag(m.dof_armature[dofs])
        hand = m.site(self.recording_model.site).id
        site = hand if sensor is None else self.accelerometers[sensor]
        move, turn = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        mujoco.mj_jacSite(m, data, move, None, hand)
        held = move[:, dofs].T @ move[:, dofs]
        mujoco.mj_jacSite(m, data, move, turn, site)
        tool = data.site_xmat[site].reshape(3, 3)
        gravity = np.array(m.opt.gravity)
        if m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
            gravity = np.zeros(3)
        jac = np.zeros((3, m.nv))
        carried, mass, weight, frames = [], [], [], []
        for link in self.links:
            body = m.body(link).id
            own = np.zeros((3, m.nv))
            beyond = np.flatnonzero(carried_bodies(m, body))
            for b in beyond:
                mujoco.mj_jacBodyCom(m, data, jac, None, int(b))
                own += m.body_mass[b] * jac
            turned = data.xmat[body].reshape(3, 3)
            total = float(m.body_mass[beyond].sum())
            carried.append(turned.T @ own[:, dofs])
            mass.append(total)
            weight.append(-total * turned.T @ gravity)
            frames.append(tool.T @ turned * (m.site_bodyid[site] in beyond))
        rocked, moment, bulk, swung = self._rocking(data, data.site_xpos[site], gravity)
        return PoseModel(
            inertia=inertia,
            jacobian=tool.T @ move[:, dofs],
            turning=tool.T @ turn[:, dofs],
            up=-tool.T @ gravity,
            carried=tuple(carried),
            mass=np.array(mass),
            weight=np.array(weight),
            torque=np.array(data.qfrc_bias[dofs]),
            frames=np.array(frames),
            held=held,
            rocked=rocked,
            moment=moment,
            bulk=bulk,
            swung=swung @ tool,
        )

    def _rocking(
        self, data: mujoco.MjData, site: Array, gravity: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Moment by joint acceleration and at rest, inertia, and swing of the tool by each axis."""
        m, first = self.model, self.model.body(self.links[0]).id
        base = int(m.body_parentid[first])
        origin = data.xpos[base if base else first]
        angle = np.pi * np.arange(AXES) / AXES
        plate = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
        axes = plate @ data.xmat[base].reshape(3, 3).T
        move, turn = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        by, moment, bulk = np.zeros((3, m.nv)), np.zeros(3), np.zeros((3, 3))
        for b in np.flatnonzero(carried_bodies(m, base if base else first)):
            mujoco.mj_jacBodyCom(m, data, move, turn, int(b))
            arm, own = data.xipos[b] - origin, data.ximat[b].reshape(3, 3)
            spin = own @ np.diag(m.body_inertia[b]) @ own.T
            by += m.body_mass[b] * np.cross(arm, move, axisb=0, axisc=0) + spin @ turn
            moment -= m.body_mass[b] * np.cross(arm, gravity)
            bulk += m.body_mass[b] * (arm @ arm * np.eye(3) - np.outer(arm, arm)) + spin
        inertia = np.einsum("ka,ab,kb->k", axes, bulk, axes)
        return axes @ by[:, self.dofs], axes @ moment, inertia, np.cross(axes, site - origin)


def read_arm(
    path: str | Path,
    *,
    tool: str | None = None,
    package: str | Path | None = None,
    payload_kg: float = 0.0,
    payload_at_m: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> SuspectArm:
    """Read the arm of a model file: MJCF or URDF of a serial arm on a fixed base.

    Parameters
    ----------
    path : str or Path
        The file.
    tool : str, optional
        Site or body that carries the accelerometer; by default where the model's own is, else the
        site 'tool', else the last site or body.
    package : str or Path, optional
        Folder of the ROS package in which the meshes of a URDF lie.
    payload_kg : float
        Mass at the tool that the model lacks [kg].
    payload_at_m : tuple of float
        Its centre in the tool frame [m].

    Raises
    ------
    InvalidData, UnknownName
        If there is no such arm, or no such tool.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM
    >>> arm = read_arm(DESK_ARM)
    >>> arm.joints[:2], arm.places[0]
    (('base', 'shoulder'), 'structural_looseness@column')
    """
    file = read_model_file(path, package=package)
    chain, notes = _chain_to_tool(file, tool)
    made = recording_model(file, chain, payload_kg=payload_kg, payload_at_m=payload_at_m)
    found = report(file, chain)
    slides = np.array([joint.kind == "slide" for joint in found.joints])
    wide = np.where(slides, 0.25, np.pi)
    ranges = [j.range or (-w, w) for j, w in zip(found.joints, wide, strict=True)]
    low, high = np.array(ranges, dtype=float).T
    limits = [np.inf if j.torque_limit is None else j.torque_limit for j in found.joints]
    joints = tuple(joint.name for joint in found.joints)
    return SuspectArm(
        path=Path(path),
        recording_model=made,
        joints=joints,
        links=found.links,
        slides=slides,
        low=low,
        high=high,
        torque_limit=np.array(limits, dtype=float),
        collisions=Collisions.of(file.spec, joints),
        notes=(*found.warnings, *made.notes, *notes),
    )


def _chain_to_tool(file: ModelFile, tool: str | None) -> tuple[Chain, list[str]]:
    """Chain from the base to the accelerometer, and notes on what was assumed."""
    sites, own = sensed_sites(file.spec), tool_site(file.spec)
    if tool is not None or own is not None:
        several = tool is None and len(sites) > 1
        note = (
            f"the model has accelerometers at {', '.join(sites)}: those that a run has columns of "
            f"are used; the tool is at {own}, or name another place with --tool"
        )
        return find_chain(file, own if tool is None else tool, None), [note] if several else []
    chain = find_chain(file, None, None)
    outermost = body_beyond(file, chain)
    if outermost is None:
        return chain, []
    note = (
        f"the accelerometer is thought to sit at {outermost!r}, which is fixed to the last link; "
        "name another site or body with --tool"
    )
    return find_chain(file, outermost, None), [note]
