"""Linear arm with its model errors, to first order.

With x the motion of joints, gears and bending modes, and s that of the seats, the arm obeys

    (D - w^2 M_xx) x = f + w^2 M_xs s,    a = -w^2 (J_x x + J_s s),

M its inertia, J the tool's Jacobian, D the springs, dampers and brakes. Inertia, Jacobian,
springs and gains are linear in small errors, so the change of any reading by each error follows
from the motion alone, without solving the arm again.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm, LinearPose, Mismatch, MismatchDraw, inertance_rate
from loose_env.diagnosis.records.model_uncertainty import sensor_matrices
from loose_env.typing import Array, ComplexArray

__all__ = ["Answer", "UncertainArm", "UncertainPose"]


_OF_BODIES = ("length", "mass", "inertia")


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """Response of one arm to torques and seats in one pose; c readings: d tool, m encoders.

    Encoders are those of the m excited joints, as accelerations.
    """

    by_torque: ComplexArray
    """Acceleration of every degree of freedom per torque of each excited joint (K, nv, m)."""
    by_seat: ComplexArray
    """The same per acceleration of each seat: n links' slides, n joints' play (K, nv, n s + n)."""
    transfer: ComplexArray
    """Readings per torque (K, c, m)."""
    columns: ComplexArray
    """Readings per acceleration of each seat (K, c, n s + n)."""
    by_force: ComplexArray
    """Readings per force on each moving degree of freedom (K, c, v)."""


class UncertainArm:
    """Nominal arm with model errors, scaled by their standard deviations.

    Errors are counted in standard deviations of a `Mismatch`; those that cannot occur are left
    out. The zero of a sliding joint is off by as many metres as that of a turning one by radians.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    mismatch : Mismatch
        Standard deviations of what it gets wrong.

    Examples
    --------
    >>> from loose_env.arms import planar, with_compliance
    >>> arm = UncertainArm(LinearArm(with_compliance(planar(2))), Mismatch())
    >>> arm.names[-7:]
    ('drive_gain1', 'drive_gain2', 'sensor1', 'sensor2', 'sensor3', 'sensor4', 'sensor5')
    """

    def __init__(self, linear: LinearArm, mismatch: Mismatch) -> None:
        self.linear, self.mismatch = linear, mismatch
        arm, none = linear.arm, MismatchDraw.none(linear.arm)
        names: list[str] = []
        self._changed: list[LinearArm] = []
        for field in (*_OF_BODIES, "rotor"):
            size = getattr(mismatch, "inertia" if field == "rotor" else field)
            factors = getattr(none, field)
            for k in range(1 if field in _OF_BODIES else 0, len(factors)):
                if size > 0:
                    factor = factors.copy()
                    factor[k] += size
                    self._changed.append(_changed(linear, replace(none, **{field: factor})))
                    names.append(
                        f"rotor{k + 1}" if field == "rotor" else f"{field}_{arm.model.body(k).name}"
                    )
        self._zeros = np.radians(mismatch.joint_zero) * np.eye(arm.n)
        self._zeros = self._zeros[: arm.n if mismatch.joint_zero > 0 else 0]
        names += [f"joint_zero{j + 1}" for j in range(len(self._zeros))]
        self.moving = np.concatenate([linear.joint_dofs, linear.flexible_dofs])
        stiffness, damping = (values[self.moving] for values in linear.springs)
        springs: list[Array] = []  # of each error: stiffness, damping, held the same (4, v)
        held = np.zeros((2, len(self.moving)))
        held[:, : arm.n] = arm.holding.stiffness, arm.holding.damping
        for row, values in enumerate((stiffness, damping, *held)):
            size = (mismatch.stiffness, mismatch.damping)[row % 2]
            kind = ("stiffness", "damping", "holding_stiffness", "holding_damping")[row]
            for k in map(int, np.flatnonzero(values * size)):
                change = np.zeros((4, len(self.moving)))
                change[row, k] = size * values[k]
                springs.append(change)
                names.append(f"{kind}{k + 1}")
        self.springs = np.array(springs).reshape(-1, 4, len(self.moving))
        self.drives = arm.n if mismatch.gain > 0 else 0
        names += [f"drive_gain{j + 1}" for j in range(self.drives)]
        matrices = sensor_matrices(len(arm.axes), mismatch)
        self.sensor = matrices[np.any(matrices, axis=(1, 2))]
        names += [f"sensor{k + 1}" for k in range(len(self.sensor))]
        self.names: tuple[str, ...] = tuple(names)
        """Name of each error (P,)."""
        self._remembered: dict[bytes, UncertainPose] = {}

    @property
    def seats(self) -> NDArray[np.intp]:
        """Degrees of freedom of all links' slides, then of all joints' play."""
        return np.concatenate([self.linear.slide_dofs.ravel(), self.linear.hinge_dofs])

    def at(self, pose: Array) -> UncertainPose:
        """Linearise the arm in a pose [rad or m] (n,), and its errors about it."""
        key = np.asarray(pose, dtype=float).tobytes()
        if key not in self._remembered:
            nominal = self.linear.at(pose)
            moved = [one.at(pose) for one in self._changed]
            moved += [self.linear.at(pose + zero) for zero in self._zeros]
            size = nominal.inertia.shape
            self._remembered[key] = UncertainPose(
                arm=self,
                nominal=nominal,
                inertia=np.array([m.inertia - nominal.inertia for m in moved]).reshape(-1, *size),
                jacobian=np.array([m.jacobian - nominal.jacobian for m in moved]).reshape(
                    -1, *nominal.jacobian.shape
                ),
            )
        return self._remembered[key]


@dataclass(frozen=True, kw_only=True, eq=False)
class UncertainPose:
    """The uncertain arm in one pose. Errors come in the order of `UncertainArm.names`."""

    arm: UncertainArm
    nominal: LinearPose
    inertia: Array
    """Change of the inertia matrix by each error of bodies, rotors and zeros (G, nv, nv)."""
    jacobian: Array
    """Change of the tool's Jacobian by the same (G, d, nv)."""

    @cached_property
    def _parts(self) -> tuple[slice, slice, slice, slice]:
        """Indices of the errors of bodies, springs, drives and the accelerometer."""
        sizes = len(self.inertia), len(self.arm.springs), self.arm.drives, len(self.arm.sensor)
        ends = np.cumsum(sizes)
        bodies, springs, drives, sensor = (
            slice(int(end - size), int(end)) for end, size in zip(ends, sizes, strict=True)
        )
        return bodies, springs, drives, sensor

    def sensor(self, errors: Array) -> Array:
        """Reading of the tool accelerometer per true acceleration (d, d)."""
        d = len(self.nominal.jacobian)
        change = np.einsum("p,pij->ij", errors[self._parts[3]], self.arm.sensor)
        return np.asarray(np.eye(d) + change)

    def tool(self, errors: Array) -> Array:
        """Tool motion per motion of each degree of freedom (d, nv)."""
        change = np.einsum("p,pij->ij", errors[self._parts[0]], self.jacobian)
        return np.asarray(self.nominal.jacobian + change)

    def answer(self, frequency: Array, excited: NDArray[np.bool_], errors: Array) -> Answer:
        """Answer of the arm with some errors.

        Parameters
        ----------
        frequency : ndarray (K,)
            Where [Hz].
        excited : ndarray (n,)
            Joints that are driven, m of them; the others are held.
        errors : ndarray (P,)
            In standard deviations.
        """
        move, seats, bodies = self.arm.moving, self.arm.seats, self._parts[0]
        inertia = self.nominal.inertia + np.einsum("p,pij->ij", errors[bodies], self.inertia)
        omega = 2 * np.pi * frequency
        power = -(omega**2)[:, None, None]
        stiffness = power * inertia[np.ix_(move, move)].astype(complex)
        stiffness += _diagonals(self._diagonal(omega, excited, errors))
        compliance = power * np.linalg.inv(stiffness)  # acceleration per force
        driven = np.flatnonzero(excited)
        nv = len(inertia)
        by_torque = np.zeros((len(omega), nv, len(driven)), dtype=complex)
        gain = 1 + np.pad(errors[self._parts[2]], (0, len(excited)))[: len(excited)] * (
            self.arm.mismatch.gain
        )
        by_torque[:, move] = compliance[:, :, driven] * gain[driven]
        by_seat = np.zeros((len(omega), nv, len(seats)), dtype=complex)
        by_seat[:, move] = -compliance @ inertia[np.ix_(move, seats)]
        by_seat[:, seats, np.arange(len(seats))] = 1.0
        jacobian = self.sensor(errors) @ self.tool(errors)
        rows = np.vstack([jacobian, np.eye(nv)[self.arm.linear.joint_dofs[driven]]])
        return Answer(
            by_torque=by_torque,
            by_seat=by_seat,
            transfer=np.asarray(rows @ by_torque, dtype=complex),
            columns=np.asarray(rows @ by_seat, dtype=complex),
            by_force=np.asarray(rows[:, move] @ compliance, dtype=complex),
        )

    def slopes(
        self,
        frequency: Array,
        excited: NDArray[np.bool_],
        errors: Array,
        answer: Answer,
        motion: ComplexArray,
        torque: ComplexArray,
    ) -> ComplexArray:
        """Change of the readings by each error, in standard deviations (P, K, c).

        Parameters
        ----------
        frequency, excited, errors, answer
            As in `answer`, and what it returned.
        motion : ndarray (K, nv)
            Accelerations of all degrees of freedom, seats included.
        torque : ndarray (K, m)
            Torque of the excited joints in it [N·m].
        """
        bodies, springs, drives, sensor = self._parts
        d, move = len(self.nominal.jacobian), self.arm.moving
        omega = 2 * np.pi * frequency
        count = len(self.arm.names)
        slopes = np.zeros((count, *answer.by_force.shape[:2]), dtype=complex)
        forces = _moved(self.inertia[:, move], motion)
        slopes[bodies] = -_onto(answer.by_force, forces)
        slopes[bodies, :, :d] += _moved(self.sensor(errors) @ self.jacobian, motion)
        # A spring's force per acceleration is that per motion over -w^2.
        change = _springs(self.arm.springs, omega, excited, self.arm.linear.arm.timestep)
        push = change * (motion[:, move] / (omega**2)[:, None])
        slopes[springs] = _onto(answer.by_force, push)
        for column, joint in enumerate(np.flatnonzero(excited)):
            if self.arm.drives:
                per_gain = answer.by_force[:, :, joint] * torque[:, column, None]
                slopes[drives.start + joint] = self.arm.mismatch.gain * per_gain
        tool = motion @ self.tool(errors).T
        slopes[sensor, :, :d] = _moved(self.arm.sensor, tool)
        return slopes

    def _diagonal(self, omega: Array, excited: NDArray[np.bool_], errors: Array) -> ComplexArray:
        """Springs, dampers and brakes on the moving degrees of freedom (K, v)."""
        linear, move = self.arm.linear, self.arm.moving
        arm = linear.arm
        nominal = np.zeros((4, len(move)))
        nominal[:2] = [values[move] for values in linear.springs]
        nominal[2:, : arm.n] = arm.holding.stiffness, arm.holding.damping
        nominal = nominal + np.einsum("p,pij->ij", errors[self._parts[1]], self.arm.springs)
        total = _springs(nominal[None], omega, excited, arm.timestep)[0]
        total[:, : arm.n] += arm.centring.stiffness
        total[:, : arm.n] += 1j * omega[:, None] * np.array(arm.centring.damping)
        return np.asarray(total)


def _springs(
    figures: Array, omega: Array, excited: NDArray[np.bool_], timestep: float
) -> ComplexArray:
    """Force per motion of springs, dampers and holdings: (P, 4, v) to (P, K, v)."""
    s = 1j * omega[None, :, None]
    stiffness, damping, held_stiffness, held_damping = np.moveaxis(figures, 1, 0)[:, :, None]
    free = np.zeros(figures.shape[-1], dtype=bool)
    free[: len(excited)] = excited
    # The holding constraint has an inertance of its own; see `inertance_rate`.
    held = held_stiffness * (1 + (s / inertance_rate(timestep)) ** 2) + s * held_damping
    return np.asarray(stiffness + s * damping + np.where(free, 0.0, held))


def _moved(matrices: Array, motion: ComplexArray) -> ComplexArray:
    """Every matrix (P, i, j) applied to every row (K, j): (P, K, i)."""
    rows = matrices.reshape(-1, matrices.shape[-1])
    both = rows @ motion.real.T + 1j * (rows @ motion.imag.T)
    return np.asarray(both.reshape(*matrices.shape[:2], len(motion)).swapaxes(1, 2))


def _onto(by_force: ComplexArray, forces: ComplexArray) -> ComplexArray:
    """Readings (P, K, c) under forces (P, K, v)."""
    return np.asarray(np.moveaxis(by_force @ forces.transpose(1, 2, 0), 2, 0))


def _diagonals(values: ComplexArray) -> ComplexArray:
    """Diagonal matrices (K, v, v) of rows (K, v)."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _changed(linear: LinearArm, draw: MismatchDraw) -> LinearArm:
    """Copy a linear arm and change its bodies."""
    other = copy.copy(linear)
    other.model = copy.copy(linear.model)
    other._data = mujoco.MjData(other.model)
    other._cache = {}
    draw.apply(other.model, linear.arm, other._data)
    return other
