"""Linearised nominal arm: frequency response in a pose, healthy and through each open seat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.typing import Array, ComplexArray, IndexArray


def inertance_rate(timestep: float) -> float:
    """Corner [rad/s] of the holding constraint: its inertance is stiffness / corner².

    A brake is a constraint of MuJoCo's solver. The solver adds an inertance to the spring
    and the damper, which keeps a stiff brake stable; half a radian per step is well inside
    the stable range of the integrator.
    """
    return 0.5 / timestep


def solved(stiffness: ComplexArray, force: ComplexArray) -> ComplexArray:
    """Solve systems of equations that lie along the last axes, (v, v, ...) and (v, m, ...).

    Gauss-Jordan elimination of all of them at once, by operations on single elements: a system's
    solution does not depend on the others. Dampers keep the pivots of a dynamic stiffness off
    zero. Both arrays are overwritten.
    """
    for p in range(len(stiffness)):
        factor, scale = stiffness[:, p, None], 1.0 / stiffness[p, p]
        ahead = stiffness[p, p + 1 :] * scale
        known = force[p] * scale
        stiffness[:, p + 1 :] -= factor * ahead
        force -= factor * known
        stiffness[p, p + 1 :] = ahead
        force[p] = known
    return force


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """The healthy arm's answer per unit torque at each excited joint, over the band."""

    pose: LinearPose
    """The arm in its pose."""
    acceleration: ComplexArray
    """Acceleration of joints, then bending modes, per torque (K, v, m)."""
    tool: ComplexArray
    """Tool acceleration per torque, tool frame [m/s² per N·m], (K, d, m)."""

    @property
    def frequency(self) -> Array:
        """Frequencies [Hz] (K,)."""
        return self.pose.linear.frequency

    @property
    def joint(self) -> ComplexArray:
        """Joint acceleration per torque [rad/s² per N·m], (K, n joints, m excited)."""
        return self.acceleration[:, : self.pose.linear.arm.n]

    @property
    def slide(self) -> ComplexArray:
        """Force each shut slide transmits per torque [N per N·m], (K, n links, s axes, m)."""
        n, axes = self.pose.linear.slide_dofs.shape
        return self._transmitted[:, : n * axes].reshape(-1, n, axes, self.tool.shape[-1])

    @property
    def hinge(self) -> ComplexArray:
        """Load each joint's link side transmits per torque (K, n joints, m).

        A torque [1], or a force where the joint slides [N per N·m].
        """
        n, axes = self.pose.linear.slide_dofs.shape
        return self._transmitted[:, n * axes : n * axes + n]

    @cached_property
    def _transmitted(self) -> ComplexArray:
        return np.asarray(self.pose.alone.transmitted(self.acceleration[None])[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmGeometry:
    """An arm in B poses, in the base's axes."""

    slides: Array
    """Sliding axes of every link, unit vectors (B, n, 3, d)."""
    motion: Array
    """Tool motion per joint motion [m/rad, or 1] (B, n, 3)."""
    axes: Array
    """Axes of the joints, unit vectors (B, n, 3)."""
    places: Array
    """Places of the joints from the tool [m] (B, n, 3)."""


class LinearArm:
    """The nominal arm with all its seats, linearised wherever it is asked to be.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    points : int, optional
        Number of frequencies across the band. Default: 24 where every mode lies outside the
        band, 240 where the arm has bending modes of its own or is held by servos.
    remember : int
        Number of poses whose answers are kept.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> at = LinearArm(planar(2)).at([0.0, 0.5])
    >>> at.kinematic.shape
    (2, 2)
    """

    def __init__(self, arm: Arm, *, points: int | None = None, remember: int = 512) -> None:
        self.arm = arm
        spec = arm.spec.copy()
        sliding = np.eye(3)[: len(arm.axes)]
        made = arm.sliding  # play that the link's slides already hold is made of them
        for i, (body_name, joint_name) in enumerate(
            zip(arm.seat_bodies, arm.joints, strict=True), start=1
        ):
            body, joint = spec.body(body_name), spec.joint(joint_name)
            if not made[i - 1]:
                body.add_joint(
                    name=f"open_hinge{i}",
                    type=mujoco.mjtJoint.mjJNT_HINGE,
                    axis=joint.axis,
                    pos=joint.pos,
                )
            for k, axis in enumerate(sliding):
                body.add_joint(
                    name=f"open_slide{i}_{k}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(axis)
                )
        self.model = model = spec.compile()
        self._data = mujoco.MjData(model)
        address = {model.joint(j).name: model.joint(j).dofadr[0] for j in range(model.njnt)}
        self.joint_dofs = np.array([address.pop(j) for j in arm.joints], dtype=np.intp)
        self._positions = model.jnt_qposadr[model.dof_jntid[self.joint_dofs]]
        places = range(1, arm.n + 1)
        slides = [[address.pop(f"open_slide{i}_{k}") for k in range(len(sliding))] for i in places]
        self.slide_dofs = np.array(slides, dtype=np.intp)
        self.hinge_dofs = np.asarray(model.nv - 1 + np.cumsum(made), dtype=np.intp)
        for joint in np.flatnonzero(~made):
            self.hinge_dofs[joint] = address.pop(f"open_hinge{joint + 1}")
        # Play made of slides of the link (nv, joints); None where no joint has it.
        self.play = self._play_columns(np.flatnonzero(made)) if made.any() else None
        self.flexible_dofs = np.array(sorted(address.values()), dtype=np.intp)
        self.tool = model.site(arm.tool).id
        if points is None:
            # Bending and servo modes reach into the band; brakes lie far above it.
            points = 240 if len(self.flexible_dofs) or arm.hold == "servo" else 24
        self.frequency = np.linspace(*arm.band, points)
        self.weights = np.full(points, 1 / points)
        """Weight of each frequency in means over the band (K,)."""
        self._remember = remember
        self._cache: dict[bytes, LinearPose] = {}

    def variant(self, arm: Arm, model: mujoco.MjModel | None = None) -> LinearArm:
        """Answer for the same bodies in another band, held otherwise, or with other springs."""
        other = copy(self)
        other.arm, other.model, other._cache = arm, self.model if model is None else model, {}
        other.frequency = np.linspace(*arm.band, len(self.frequency))
        for name in ("_joint_stiffness", "_per_motion"):
            other.__dict__.pop(name, None)
        return other

    def thinned(self) -> LinearArm:
        """Return the same arm with few frequencies, weighted for the same means over the band.

        Gauss's rule for the mean over the frequencies there are, by the eigenvalues of Jacobi's
        matrix (Golub and Welsch, Mathematics of Computation 23, 1969). Where no mode lies in the
        band, answers are so smooth over the logarithm of the frequency that eight nodes give means
        over 24 frequencies to 1e-10. Elsewhere the arm is returned as it is.
        """
        if len(self.flexible_dofs) or self.arm.hold != "brake" or len(self.frequency) <= _NODES:
            return self
        other, log = self.variant(self.arm), np.log(self.frequency)
        middle, half = (log[0] + log[-1]) / 2, (log[-1] - log[0]) / 2
        x = (log - middle) / half
        basis = np.linalg.qr(np.vander(x, _NODES, increasing=True))[0]
        nodes, vectors = np.linalg.eigh(basis.T @ (x[:, None] * basis))
        other.frequency, other.weights = np.exp(middle + half * nodes), vectors[0] ** 2
        return other

    @cached_property
    def moving(self) -> NDArray[np.intp]:
        """Degrees of freedom that answer: joints, then bending modes (v,)."""
        return np.concatenate([self.joint_dofs, self.flexible_dofs])

    @cached_property
    def seats(self) -> NDArray[np.intp]:
        """Degrees of freedom of all seats: slides, then link sides of joints."""
        return np.concatenate([self.slide_dofs.ravel(), self.hinge_dofs])

    @property
    def springs(self) -> tuple[Array, Array]:
        """Stiffness and damping of the arm itself at every degree of freedom (nv,) each.

        In the order of `LinearPose.inertia`; nothing of what holds the joints is in it.
        """
        model = self.model
        more = 0 if self.play is None else self.play.shape[1]
        stiffness = model.jnt_stiffness[model.dof_jntid]
        return np.pad(stiffness, (0, more)), np.pad(model.dof_damping, (0, more))

    def _play_columns(self, joints: NDArray[np.intp]) -> Array:
        """Motion of some joints' link sides in the model's coordinates (nv, joints)."""
        model, bare = self.model, self.arm.model
        columns = np.zeros((model.nv, len(joints)))
        for column, i in enumerate(joints):
            axis = bare.joint(self.arm.joints[i]).axis
            columns[self.slide_dofs[i], column] = axis[: self.slide_dofs.shape[1]]
        return columns

    def at(self, pose: Sequence[float] | Array) -> LinearPose:
        """Linearise at a pose [rad] (n,). Recent poses are remembered.

        Raises
        ------
        InvalidSetting
            If the pose does not have one finite number for every joint.
        """
        q = self.arm.checked_pose(pose)
        key = q.tobytes()
        found = self._cache.get(key)
        if found is None:
            while len(self._cache) >= self._remember:
                del self._cache[next(iter(self._cache))]  # the oldest
            found = self._cache[key] = self.at_all(q[None])[0]
        return found

    def at_all(self, poses: Array) -> LinearPoses:
        """Linearise at poses [rad] (B, n), without remembering them."""
        model, data, count = self.model, self._data, len(poses)
        inertia = np.zeros((count, model.nv, model.nv))
        load, jacobian = np.zeros((count, model.nv)), np.zeros((count, 3, model.nv))
        frames, frame = np.empty((count, 3, 3)), data.site_xmat[self.tool].reshape(3, 3)
        for k in self._placed(poses):
            mujoco.mj_makeM(model, data)
            mujoco.mj_fullM(model, data, inertia[k])
            mujoco.mj_rne(model, data, 0, load[k])  # at rest: gravity alone
            mujoco.mj_jacSite(model, data, jacobian[k], None, self.tool)
            frames[k] = frame
        jacobian = (frames.transpose(0, 2, 1) @ jacobian)[:, list(self.arm.axes)]
        if self.play is not None:
            all_of = np.hstack([np.eye(model.nv), self.play])
            inertia = all_of.T @ inertia @ all_of
            jacobian, load = jacobian @ all_of, load @ all_of
        return LinearPoses(linear=self, pose=poses, inertia=inertia, jacobian=jacobian, load=load)

    def kinematics(self, poses: Array) -> Array:
        """Tool motion per joint motion at poses [rad] (B, n), as `LinearPose.kinematic`."""
        jacobian, frames = self._jacobians(poses)
        turned = frames.transpose(0, 2, 1) @ jacobian[:, :, self.joint_dofs]
        return turned[:, list(self.arm.axes)]

    def geometry(self, poses: Array) -> ArmGeometry:
        """Where links and joints are and how they move the tool, at poses [rad] (B, n)."""
        model, data = self.model, self._data
        joints, count = model.dof_jntid[self.joint_dofs], len(poses)
        jacobian, axes, places = np.zeros((count, 3, model.nv)), *np.empty((2, *poses.shape, 3))
        for k in self._placed(poses):
            mujoco.mj_jacSite(model, data, jacobian[k], None, self.tool)
            axes[k], places[k] = (
                data.xaxis[joints],
                data.xanchor[joints] - data.site_xpos[self.tool],
            )
        return ArmGeometry(
            slides=jacobian[:, :, self.slide_dofs].transpose(0, 2, 1, 3),
            motion=jacobian[:, :, self.joint_dofs].transpose(0, 2, 1),
            axes=axes,
            places=places,
        )

    def _jacobians(self, poses: Array) -> tuple[Array, Array]:
        """Tool motion per coordinate in the base's axes (B, 3, nv); the tool's axes (B, 3, 3)."""
        model, data = self.model, self._data
        jacobian = np.zeros((len(poses), 3, model.nv))
        frames, frame = np.empty((len(poses), 3, 3)), data.site_xmat[self.tool].reshape(3, 3)
        for k in self._placed(poses):
            mujoco.mj_jacSite(model, data, jacobian[k], None, self.tool)
            frames[k] = frame
        return jacobian, frames

    def gravity_torques(self, poses: Array) -> Array:
        """Torque that holds each joint against gravity at poses [rad] (B, n) [N·m] (B, n)."""
        load = np.zeros((len(poses), self.model.nv))
        for k in self._placed(poses):
            mujoco.mj_rne(self.model, self._data, 0, load[k])
        return load[:, self.joint_dofs]

    def _placed(self, poses: Array) -> Iterator[int]:
        """Put the model into one pose after the other."""
        model, data = self.model, self._data
        position = np.empty((len(poses), model.nq))
        position[:] = model.qpos0
        position[:, self._positions] = poses
        qpos = data.qpos
        for k, own in enumerate(position):
            qpos[:] = own
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            yield k

    def dynamic_stiffness(self, mass: Array, excited: NDArray[np.bool_]) -> ComplexArray:
        """Force per motion of joints, then bending modes, over the band (v, v, B, K)."""
        loose, held = (own[:, None] for own in self._joint_stiffness)
        stiffness = mass.transpose(1, 2, 0)[..., None] * (self._per_motion + 0j)
        count, n = len(loose), self.arm.n
        own = stiffness.reshape(count * count, *stiffness.shape[2:])[:: count + 1]
        own[:n] += np.where(excited.T[..., None], loose[:n], held[:n])
        own[n:] += loose[n:]  # bending modes are never held
        return np.asarray(stiffness)

    @cached_property
    def _per_motion(self) -> Array:
        """Acceleration per motion over the band (K,)."""
        return np.asarray(-((2 * np.pi * self.frequency) ** 2))

    @cached_property
    def _joint_stiffness(self) -> tuple[ComplexArray, ComplexArray]:
        """Force per own motion of joints, then bending modes, free and held (v, K) each."""
        arm = self.arm
        springs, dampers = (own[self.moving] for own in self.springs)
        omega = 2 * np.pi * self.frequency
        s = 1j * omega
        loose = s * dampers[:, None] + springs[:, None]
        for j in range(arm.n):
            loose[j] += arm.centring.stiffness[j] + s * arm.centring.damping[j]
        held = loose.copy()
        for j in range(arm.n):
            k, c = arm.holding.stiffness[j], arm.holding.damping[j]
            inertance = k / inertance_rate(arm.timestep) ** 2
            held[j] += k + s * c - omega**2 * inertance
        return loose.astype(np.complex128), held.astype(np.complex128)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Placed:
    """The linear arm where it is; of B poses, arrays have an axis more in front."""

    linear: LinearArm
    pose: Array
    """Joint positions [rad] (n,)."""
    inertia: Array
    """Inertia matrix of joints, bending modes and seats (nv, nv)."""
    jacobian: Array
    """Tool motion per motion of each degree of freedom, tool frame (d, nv)."""
    load: Array
    """Generalised force that holds each degree of freedom against gravity (nv,)."""

    @property
    def gravity_torque(self) -> Array:
        """Torque that holds each joint against gravity [N·m] (n,)."""
        return self.load[..., self.linear.joint_dofs]

    def _parts(self, rows: Any) -> dict[str, Any]:
        """Fields whose arrays are some rows of these."""
        arrays = ("pose", "inertia", "jacobian", "load")
        return {"linear": self.linear} | {name: getattr(self, name)[rows] for name in arrays}


def distinct(poses: Array) -> tuple[Array, IndexArray]:
    """Rows that differ of poses (B, n), and the number of each pose among them (B,)."""
    rows = np.ascontiguousarray(poses).view(np.dtype((np.void, poses.itemsize * poses.shape[1])))
    _, first, back = np.unique(rows[:, 0], return_index=True, return_inverse=True)
    return poses[first], back


class LinearPoses(_Placed):
    """The linear arm at B poses: arrays as of `LinearPose`, an axis more in front."""

    def __len__(self) -> int:
        return len(self.pose)

    def __getitem__(self, k: int) -> LinearPose:
        """One of the poses."""
        return LinearPose(**self._parts(k))

    def some(self, rows: IndexArray) -> LinearPoses:
        """Some of the poses."""
        return LinearPoses(**self._parts(rows))

    def responses(self, excited: NDArray[np.bool_]) -> tuple[ComplexArray, ComplexArray]:
        """Accelerations and tool accelerations per torque, as of `Response`.

        ``excited`` (B, n) says which joints are excited in each pose, in all equally many, m; all
        others are held.

        Returns
        -------
        ndarray (B, K, v, m)
        ndarray (B, K, d, m)
        """
        lin = self.linear
        chunk = max(1, _FIT // (len(lin.moving) ** 2 * len(lin.frequency)))
        found = [
            self._responses(slice(first, first + chunk), excited[first : first + chunk])
            for first in range(0, len(self), chunk)
        ]
        if len(found) == 1:
            return found[0]
        accelerations, tools = zip(*found, strict=True)
        return np.concatenate(accelerations), np.concatenate(tools)

    def _responses(
        self, some: slice, excited: NDArray[np.bool_]
    ) -> tuple[ComplexArray, ComplexArray]:
        lin, move = self.linear, self.linear.moving
        mass = self.inertia[some, move[:, None], move]
        count, m = len(excited), int(excited[0].sum())
        torque = np.zeros((len(move), m, count, len(lin.frequency)), dtype=complex)
        owner, driven = np.nonzero(excited)
        torque[driven, np.arange(m * count) % m, owner] = 1.0
        answer = solved(lin.dynamic_stiffness(mass, excited), torque)
        answer *= lin._per_motion
        jacobian = self.jacobian[some, :, move].transpose(2, 1, 0)
        tool = (jacobian[:, :, None, :, None] * answer[:, None]).sum(0)
        # Contiguous for each pose, so that sums over it do not depend on the others.
        return (
            np.ascontiguousarray(answer.transpose(2, 3, 0, 1)),
            np.ascontiguousarray(tool.transpose(2, 3, 0, 1)),
        )

    def transmitted(self, acceleration: ComplexArray) -> ComplexArray:
        """Load through each shut seat (B, K, s, m) while the arm accelerates (B, K, v, m)."""
        lin = self.linear
        coupling = self.inertia[:, lin.moving[:, None], lin.seats]
        return np.asarray(np.einsum("bvs,bkvm->bksm", coupling, acceleration))

    def open_responses(
        self, excited: NDArray[np.bool_], pairs: tuple[IndexArray, IndexArray]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Answers through every seat, were it open, with equally many joints excited (B, n).

        Seats are the slides of every link, axis by axis, then the link sides of the joints.

        Returns
        -------
        ndarray (B, seats, m + d, K)
            Change of the accelerations of excited joints and tool per seat acceleration.
        ndarray (B, pairs, K)
            Apparent mass or inertia between the seats of each pair [kg, kg·m²].
        """
        lin, move, seats = self.linear, self.linear.moving, self.linear.seats
        one, other = pairs
        # Unit seat acceleration pushes back on the moving coordinates through the inertia.
        coupling = self.inertia[:, move[:, None], seats]
        mass = self.inertia[:, move[:, None], move]
        push = np.empty((*coupling.shape[1:], len(self), len(lin.frequency)), dtype=complex)
        push[:] = -coupling.transpose(1, 2, 0)[..., None]
        answer = solved(lin.dynamic_stiffness(mass, excited), push)
        answer *= lin._per_motion
        by_seat = np.ascontiguousarray(answer.transpose(2, 1, 0, 3))  # (B, seats, v, K)
        # Contiguous for each pose, so that sums over it do not depend on the others.
        moved = np.ascontiguousarray(self.jacobian[:, :, move])[:, None]
        tool = (moved @ by_seat.view(float)).view(complex)
        tool += self.jacobian[:, :, seats].mT[..., None]
        own = self.inertia[:, seats[one], seats[other]][..., None]
        towards = np.ascontiguousarray(coupling.mT[:, one])[:, :, None]
        back = towards @ np.ascontiguousarray(by_seat[:, other]).view(float)
        driven = np.nonzero(excited)[1].reshape(len(self), 1, -1, 1)
        joint = np.take_along_axis(by_seat, driven, axis=2)
        return np.concatenate([joint, tool], axis=2), back[:, :, 0].view(complex) + own


_NODES = 8
"""Frequencies of `LinearArm.thinned`."""
_FIT = 1 << 15
"""Complex numbers of a chunk's largest array, for the processor's cache."""


class LinearPose(_Placed):
    """The linear arm at one pose."""

    @property
    def kinematic(self) -> Array:
        """Tool motion per joint motion, every other joint still (d, n) [m]."""
        return self.jacobian[:, self.linear.joint_dofs]

    @property
    def seat_load(self) -> Array:
        """Force that each link's slides carry at rest [N] (n, s)."""
        return self.load[self.linear.slide_dofs]

    @cached_property
    def remembered(self) -> dict[tuple[bool, ...], Response]:
        """Responses so far, by the joints excited."""
        return {}

    @property
    def alone(self) -> LinearPoses:
        """The pose as a batch of one."""
        return LinearPoses(**self._parts(None))

    def response(self, excited: Sequence[bool] | NDArray[np.bool_]) -> Response:
        """Return the frequency response with the given joints excited and all others held."""
        mask = tuple(np.asarray(excited, dtype=bool).tolist())
        if mask not in self.remembered:
            acceleration, tool = self.alone.responses(np.array([mask]))
            self.remembered[mask] = Response(pose=self, acceleration=acceleration[0], tool=tool[0])
        return self.remembered[mask]
