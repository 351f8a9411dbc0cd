"""How the nominal arm answers small excitation: a closed form, no simulation.

The arm is linearised about a pose. Joints and bending modes move; each held joint has its
brake or servo, each excited one its soft centring spring. On top of those, the model has
every seat the arm could have: the sliding directions of each link and the link side of each
joint. Their columns say what a seat has to transmit, and how the arm would move were it open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.errors import InvalidSetting

__all__ = ["LinearArm", "LinearPose", "OpenResponse", "Response", "inertance_rate"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def inertance_rate(timestep: float) -> float:
    """Corner [rad/s] of the holding constraint: its inertance is stiffness / corner².

    A brake is a constraint of MuJoCo's solver. The solver adds an inertance to the spring
    and the damper, which keeps a stiff brake stable; half a radian per step is well inside
    the stable range of the integrator.
    """
    return 0.5 / timestep


@dataclass(frozen=True, kw_only=True)
class Response:
    """The healthy arm's answer per unit torque at each excited joint, over the band."""

    frequency: Array
    """Frequencies [Hz] (K,)."""
    joint: Complex
    """Joint acceleration per torque [rad/s² per N·m], (K, n joints, m excited)."""
    tool: Complex
    """Tool acceleration per torque, tool frame [m/s² per N·m], (K, d, m)."""
    slide: Complex
    """Force each shut slide transmits per torque [N per N·m], (K, n links, s axes, m)."""
    hinge: Complex
    """Torque each joint's link side transmits per torque [1], (K, n joints, m)."""


@dataclass(frozen=True, kw_only=True)
class OpenResponse:
    """How the arm would answer through each of its seats, were it open, over the band."""

    tool_open_slide: Complex
    """Change of tool acceleration per unit seat acceleration, (K, d, n links, s axes)."""
    joint_open_slide: Complex
    """Change of excited joint acceleration per unit seat acceleration, (K, m, n, s)."""
    mass_slide: Complex
    """Apparent mass seen by the seats' slides [kg], (K, n, s, s)."""
    tool_open_hinge: Complex
    """As `tool_open_slide`, for play in a joint, (K, d, n)."""
    joint_open_hinge: Complex
    """As `joint_open_slide`, for play in a joint, (K, m, n)."""
    inertia_hinge: Complex
    """Apparent inertia seen by the joints' link sides [kg·m²], (K, n)."""


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
        for i, (body_name, joint_name) in enumerate(
            zip(arm.seat_bodies, arm.joints, strict=True), start=1
        ):
            body, joint = spec.body(body_name), spec.joint(joint_name)
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
        self.hinge_dofs = np.array(
            [address.pop(f"open_hinge{i}") for i in range(1, arm.n + 1)], dtype=np.intp
        )
        self.slide_dofs = np.array(
            [
                [address.pop(f"open_slide{i}_{k}") for k in range(len(sliding))]
                for i in range(1, arm.n + 1)
            ],
            dtype=np.intp,
        )
        self.flexible_dofs = np.array(sorted(address.values()), dtype=np.intp)
        self.tool = model.site(arm.tool).id
        if points is None:
            # Bending and servo modes reach into the band; brakes lie far above it.
            points = 240 if len(self.flexible_dofs) or arm.hold == "servo" else 24
        self.frequency = np.linspace(*arm.band, points)
        self._remember = remember
        self._cache: dict[bytes, LinearPose] = {}

    def at(self, pose: Sequence[float] | Array) -> LinearPose:
        """Linearise at a pose [rad] (n,). Recent poses are remembered.

        Raises
        ------
        InvalidSetting
            If the pose does not have one finite number for every joint.
        """
        q = np.asarray(pose, dtype=float)
        if q.shape != (self.arm.n,) or not np.isfinite(q).all():
            raise InvalidSetting(
                f"a pose of {self.arm.name!r} is {self.arm.n} finite numbers [rad], got {pose!r}"
            )
        key = q.tobytes()
        found = self._cache.get(key)
        if found is None:
            while len(self._cache) >= self._remember:
                del self._cache[next(iter(self._cache))]  # the oldest
            found = self._cache[key] = self._linearise(q)
        return found

    def _linearise(self, q: Array) -> LinearPose:
        model, data = self.model, self._data
        mujoco.mj_resetData(model, data)
        for name, value in zip(self.arm.joints, q, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_forward(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, self.tool)
        frame = data.site_xmat[self.tool].reshape(3, 3)
        return LinearPose(
            linear=self,
            pose=q,
            inertia=inertia,
            jacobian=(frame.T @ jacobian)[list(self.arm.axes)],
            load=data.qfrc_bias.copy(),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearPose:
    """The linear arm at one pose."""

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
    def kinematic(self) -> Array:
        """Tool motion per joint motion, every other joint still (d, n) [m]."""
        return self.jacobian[:, self.linear.joint_dofs]

    @property
    def gravity_torque(self) -> Array:
        """Torque that holds each joint against gravity [N·m] (n,)."""
        return self.load[self.linear.joint_dofs]

    @property
    def seat_load(self) -> Array:
        """Force that each link's slides carry at rest [N] (n, s)."""
        return self.load[self.linear.slide_dofs]

    @cached_property
    def _responses(self) -> dict[tuple[bool, ...], Response]:
        return {}

    @property
    def _moving(self) -> NDArray[np.intp]:
        """Degrees of freedom that answer: joints, then bending modes."""
        return np.concatenate([self.linear.joint_dofs, self.linear.flexible_dofs])

    @property
    def _seats(self) -> NDArray[np.intp]:
        """Degrees of freedom of all seats: slides, then link sides of joints."""
        return np.concatenate([self.linear.slide_dofs.ravel(), self.linear.hinge_dofs])

    def response(self, excited: Sequence[bool] | NDArray[np.bool_]) -> Response:
        """Return the frequency response with the given joints excited and all others held."""
        mask = tuple(bool(e) for e in excited)
        found = self._responses.get(mask)
        if found is None:
            found = self._responses[mask] = self._respond(np.array(mask))
        return found

    def _stiffness(self, excited: NDArray[np.bool_]) -> Complex:
        """Dynamic stiffness of joints and bending modes (K, v, v)."""
        lin = self.linear
        arm, model, move = lin.arm, lin.model, self._moving
        omega = 2 * np.pi * lin.frequency
        s = 1j * omega
        diagonal = np.zeros((len(omega), len(move)), dtype=complex)
        diagonal += s[:, None] * model.dof_damping[move]
        joint_of = model.dof_jntid[move]
        diagonal += model.jnt_stiffness[joint_of]
        centring, holding = arm.centring, arm.holding
        for j in range(arm.n):
            diagonal[:, j] += centring.stiffness[j] + s * centring.damping[j]
            if not excited[j]:
                k, c = holding.stiffness[j], holding.damping[j]
                inertance = k / inertance_rate(arm.timestep) ** 2
                diagonal[:, j] += k + s * c - omega**2 * inertance
        mass = self.inertia[np.ix_(move, move)]
        stiffness = -(omega**2)[:, None, None] * mass.astype(complex)
        stiffness[:, np.arange(len(move)), np.arange(len(move))] += diagonal

        return np.asarray(stiffness)

    def _respond(self, excited: NDArray[np.bool_]) -> Response:
        lin, move = self.linear, self._moving
        n, axes = lin.arm.n, lin.slide_dofs.shape[1]
        driven = np.flatnonzero(excited)
        count, m = len(lin.frequency), len(driven)
        torque = np.zeros((count, len(move), m), dtype=complex)
        torque[:, driven, np.arange(m)] = 1.0
        acceleration = self._accelerations(excited, torque)
        coupling = self.inertia[np.ix_(move, self._seats)]
        transmitted = np.einsum("vs,kvm->ksm", coupling, acceleration)
        slides = n * axes
        return Response(
            frequency=lin.frequency,
            joint=acceleration[:, :n],
            tool=np.einsum("dv,kvm->kdm", self.jacobian[:, move], acceleration),
            slide=transmitted[:, :slides].reshape(count, n, axes, m),
            hinge=transmitted[:, slides:],
        )

    def open_response(self, excited: Sequence[bool] | NDArray[np.bool_]) -> OpenResponse:
        """Return the answer through every seat, with the given joints excited."""
        lin, move, seats = self.linear, self._moving, self._seats
        mask = np.array([bool(e) for e in excited])
        n, axes, d = lin.arm.n, lin.slide_dofs.shape[1], self.jacobian.shape[0]
        driven = np.flatnonzero(mask)
        count, m = len(lin.frequency), len(driven)
        # Unit seat acceleration pushes back on the moving coordinates through the inertia.
        coupling = self.inertia[np.ix_(move, seats)]
        push = np.broadcast_to(-coupling.astype(complex), (count, *coupling.shape))
        by_seat = self._accelerations(mask, push)
        tool = np.einsum("dv,kvs->kds", self.jacobian[:, move], by_seat) + self.jacobian[:, seats]
        apparent = np.einsum("vs,kvt->kst", coupling, by_seat) + self.inertia[np.ix_(seats, seats)]
        ns = n * axes
        blocks = apparent[:, :ns, :ns].reshape(count, n, axes, n, axes)
        return OpenResponse(
            tool_open_slide=tool[:, :, :ns].reshape(count, d, n, axes),
            joint_open_slide=by_seat[:, driven, :ns].reshape(count, m, n, axes),
            mass_slide=np.einsum("kiaib->kiab", blocks),
            tool_open_hinge=tool[:, :, ns:],
            joint_open_hinge=by_seat[:, driven, ns:],
            inertia_hinge=np.einsum("kii->ki", apparent[:, ns:, ns:]),
        )

    def _accelerations(self, excited: NDArray[np.bool_], force: Complex) -> Complex:
        """Accelerations of joints and bending modes under generalised forces (K, v, ...)."""
        omega = 2 * np.pi * self.linear.frequency
        motion = np.linalg.solve(self._stiffness(excited), force)
        return np.asarray(-(omega**2)[:, None, None] * motion, dtype=np.complex128)
