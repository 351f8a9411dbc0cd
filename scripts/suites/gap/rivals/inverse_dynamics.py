"""Joint torque that a model needs for a motion, and its derivatives by parameters of the model.

The torque is linear in masses, first moments and inertias, so the column of an inertial parameter
is the difference of two models divided by the step, whatever its size. For angles (tilt of the
base, zero of an encoder) the step is small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.recording import Recording
from loose_env.typing import Array

__all__ = ["Columns", "Group", "InverseDynamics", "Motion", "Nuisance", "Read"]

Motion = tuple[Array, Array, Array]
"""Position, velocity and acceleration, each of shape (t, n)."""
_ANGLE = 1e-4
"""Step of angles [rad]: its square is far below the noise, its rounding error too."""
_LENGTH = 1e-3
"""Step of centres of mass [m]; torques are quadratic in them, with a small square."""


Read = Callable[[Array], dict[str, float]]
"""Parameters of an effect from its coefficients."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Columns of one effect at one location."""

    kind: str
    where: str
    width: int
    """Number of columns."""
    read: Read
    """Parameters of the effect from its coefficients."""
    basic: bool = True
    """Whether it belongs to the classical set: inertia, friction, springs and rotors."""
    grid: bool = False
    """Whether it is one value of a grid."""
    positive: bool = False
    """Whether the first coefficient cannot be negative: friction brakes, rotors add inertia."""
    nominal: float = 0.0
    """Nominal value in the unit of the first coefficient: within the tolerance of it an effect
    does not count."""
    least: float = 0.0
    """Value of the first coefficient beyond that up to which an effect does not count."""
    largest: float = np.inf
    """Largest coefficient for which the columns, which are derivatives, hold."""
    tensor: bool = False
    """Whether it is the inertia tensor of a link, which is no effect of its own."""


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """A nominal parameter that is known within a relative tolerance."""

    name: str
    factor: float = 1.0
    """Of the tolerance told."""


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Regressor of one run: rows are samples, then joints."""

    target: Array
    """Actuator torque minus nominal torque, of shape (t, n) [N m or N]."""
    nuisance: Array
    """Torque per relative change of a nominal parameter, of shape (t, n, p)."""
    candidates: Array
    """Columns of all groups side by side, of shape (t, n, c)."""
    nuisances: tuple[Nuisance, ...]
    groups: tuple[Group, ...]


@dataclass(frozen=True, kw_only=True)
class InverseDynamics:
    """Inverse dynamics of the nominal model of a recording; torques of shape (t, n)."""

    recording: Recording

    def torque(self, motion: Motion, edit: Callable[[mujoco.MjModel], None] | None = None) -> Array:
        """Torque for a motion, of the model or of an edited copy of it."""
        model = self.recording.model()
        if edit is not None:
            edit(model)
        data = mujoco.MjData(model)
        out = np.empty_like(motion[0])
        for k, (q, v, a) in enumerate(zip(*motion, strict=True)):
            data.qpos, data.qvel, data.qacc = q, v, a
            mujoco.mj_inverse(model, data)
            out[k] = data.qfrc_inverse
        return out

    def mass(self, motion: Motion, body: int, base: Array) -> Array:
        """Derivative by the relative mass of a body, its inertia growing with it."""

        def double(model: mujoco.MjModel) -> None:
            model.body_mass[body] *= 2.0
            model.body_inertia[body] *= 2.0

        return self.torque(motion, double) - base

    def inertia(self, motion: Motion, body: int, base: Array) -> Array:
        """Derivative by the relative inertia of a body about its centre of mass."""

        def double(model: mujoco.MjModel) -> None:
            model.body_inertia[body] *= 2.0

        return self.torque(motion, double) - base

    def moments(self, motion: Motion, body: int, base: Array) -> Array:
        """Derivatives by the inertia tensor of a body, of shape (t, n, 6): diagonal, then mixed.

        The step is small beside the body's own inertia, so that the tensor stays that of a body.
        """
        step = 0.1 * float(self.recording.model().body_inertia[body].min())
        columns = []
        for axis in range(3):

            def grow(model: mujoco.MjModel, axis: int = axis) -> None:
                model.body_inertia[body, axis] += step

            columns.append((self.torque(motion, grow) - base) / step)
        for first, second in ((0, 1), (0, 2), (1, 2)):

            def turn(model: mujoco.MjModel, first: int = first, second: int = second) -> None:
                _add_mixed(model, body, first, second, step)

            columns.append((self.torque(motion, turn) - base) / step)
        return np.stack(columns, axis=-1)

    def centre(self, motion: Motion, body: int, base: Array) -> Array:
        """Derivatives by the centre of mass of a body in its own frame, of shape (t, n, 3)."""
        columns = []
        for axis in range(3):

            def move(model: mujoco.MjModel, axis: int = axis) -> None:
                model.body_ipos[body, axis] += _LENGTH

            columns.append((self.torque(motion, move) - base) / _LENGTH)
        return np.stack(columns, axis=-1)

    def point_mass(self, motion: Motion, body: int, place: Array, base: Array) -> Array:
        """Torque of a kilogram at a place of a body, and by its first moment: (t, n, 4)."""

        def loaded(shift: Array) -> Array:
            def add(model: mujoco.MjModel) -> None:
                _add_point(model, body, place + shift)

            return self.torque(motion, add) - base

        at = loaded(np.zeros(3))
        moves = [(loaded(_LENGTH * axis) - at) / _LENGTH for axis in np.eye(3)]
        return np.stack([at, *moves], axis=-1)

    def tilt(self, motion: Motion, base: Array) -> Array:
        """Derivatives by a turn of the base about the world's x and y, of shape (t, n, 2)."""
        columns = []
        for axis in np.eye(3)[:2]:

            def lean(model: mujoco.MjModel, axis: Array = axis) -> None:
                # the base turns, so gravity turns back in its frame
                model.opt.gravity[:] += np.cross(-_ANGLE * axis, model.opt.gravity)

            columns.append((self.torque(motion, lean) - base) / _ANGLE)
        return np.stack(columns, axis=-1)

    def position(self, motion: Motion, joint: int, base: Array) -> Array:
        """Derivative by the position of a joint."""
        moved = motion[0].copy()
        moved[:, joint] += _ANGLE
        return (self.torque((moved, motion[1], motion[2])) - base) / _ANGLE

    def weight(self, motion: Motion, body: int) -> Array:
        """Torque that carries the weight of a body at rest."""
        still = (motion[0], np.zeros_like(motion[0]), np.zeros_like(motion[0]))
        return self.mass(still, body, self.torque(still))


def _add_point(model: mujoco.MjModel, body: int, place: Array) -> None:
    """Add a kilogram to a body, in place; the new tensor gets principal axes again."""
    mass, centre = model.body_mass[body], model.body_ipos[body].copy()
    whole = mass + 1.0
    middle = (mass * centre + place) / whole
    tensor = _tensor(model, body)
    for weight, arm in ((mass, centre - middle), (1.0, place - middle)):
        tensor += weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    model.body_mass[body], model.body_ipos[body] = whole, middle
    _set_tensor(model, body, tensor)


def _add_mixed(model: mujoco.MjModel, body: int, first: int, second: int, step: float) -> None:
    tensor = _tensor(model, body)
    tensor[first, second] += step
    tensor[second, first] += step
    _set_tensor(model, body, tensor)


def _tensor(model: mujoco.MjModel, body: int) -> Array:
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    return np.asarray(axes @ np.diag(model.body_inertia[body]) @ axes.T)


def _set_tensor(model: mujoco.MjModel, body: int, tensor: Array) -> None:
    values, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.linalg.det(axes)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    model.body_inertia[body], model.body_iquat[body] = values, quaternion
