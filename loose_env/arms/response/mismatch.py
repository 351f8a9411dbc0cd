"""Model error: deviations of the true arm from the nominal one."""

from __future__ import annotations

from dataclasses import dataclass, fields

import mujoco
import numpy as np

from loose_env.arms.arm import Arm
from loose_env.errors import InvalidSetting
from loose_env.io import Checked, NonNegative
from loose_env.typing import Array

__all__ = ["Mismatch", "MismatchDraw"]

_CUT = 3.0  # draws beyond three standard deviations are cut off
_RELATIVE = ("length", "mass", "inertia", "stiffness", "damping", "gain", "cross_axis")


@dataclass(frozen=True, kw_only=True)
class Mismatch(Checked):
    """Standard deviations of what the nominal model gets wrong about the true arm."""

    length: NonNegative = 0.002
    """Link lengths, relative."""
    mass: NonNegative = 0.03
    """Masses of bodies, relative."""
    inertia: NonNegative = 0.03
    """Inertias of bodies and rotors, relative."""
    stiffness: NonNegative = 0.10
    """Stiffness of bending modes, brakes and servos, relative."""
    damping: NonNegative = 0.10
    """Damping of joints, bending modes, brakes and servos, relative."""
    tilt: NonNegative = 1.0
    """Tilt of the base about each horizontal axis [deg]."""
    gain: NonNegative = 0.01
    """Gains of drives and of accelerometer axes, relative."""
    cross_axis: NonNegative = 0.02
    """Leakage of each accelerometer axis into each other one, relative."""
    misalignment: NonNegative = 0.5
    """Rotation of each accelerometer about each of its axes [deg]."""
    joint_zero: NonNegative = 0.2
    """Zero of each joint encoder [deg]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in _RELATIVE:
            if getattr(self, name) * _CUT >= 1:
                raise InvalidSetting(
                    f"mismatch {name} is relative and drawn up to {_CUT:g} standard deviations: "
                    f"it must be below {1 / _CUT:.2f}, or a factor may turn negative; got "
                    f"{getattr(self, name)!r}"
                )

    def scaled(self, factor: float) -> Mismatch:
        """Return the same mismatch, every deviation multiplied by a factor."""
        return Mismatch(**{f.name: factor * getattr(self, f.name) for f in fields(self)})

    def draw(self, arm: Arm, rng: np.random.Generator) -> MismatchDraw:
        """Draw one true arm."""
        bodies, n = arm.model.nbody, arm.n

        def normal(*shape: int) -> Array:
            return np.clip(rng.standard_normal(shape), -_CUT, _CUT)

        sensor = self._accelerometer(rng)
        # Seeded by the tool's, so that they take nothing from rng and change no later draw.
        own = np.random.default_rng(sensor.ravel().view(np.uint64))
        link_sensors = np.array([self._accelerometer(own) for _ in range(n)])
        return MismatchDraw(
            length=1 + self.length * normal(bodies),
            mass=1 + self.mass * normal(bodies),
            inertia=1 + self.inertia * normal(bodies),
            rotor=1 + self.inertia * normal(n),
            stiffness=1 + self.stiffness * normal(arm.model.njnt),
            damping=1 + self.damping * normal(arm.model.njnt),
            holding_stiffness=1 + self.stiffness * normal(n),
            holding_damping=1 + self.damping * normal(n),
            tilt=np.radians(self.tilt) * normal(2),
            drive_gain=1 + self.gain * normal(n),
            sensor=sensor,
            link_sensors=link_sensors,
            joint_zero=np.radians(self.joint_zero) * normal(n),
        )

    def _accelerometer(self, rng: np.random.Generator) -> Array:
        """Draw what one accelerometer makes of the true acceleration (3, 3)."""

        def normal(*shape: int) -> Array:
            return np.clip(rng.standard_normal(shape), -_CUT, _CUT)

        cross = self.cross_axis * normal(3, 3)
        np.fill_diagonal(cross, self.gain * normal(3))
        x, y, z = np.radians(self.misalignment) * normal(3)
        mounting = np.array([[1.0, z, -y], [-z, 1.0, x], [y, -x, 1.0]])
        return np.asarray((np.eye(3) + cross) @ mounting)


@dataclass(frozen=True, kw_only=True, eq=False)
class MismatchDraw:
    """One true arm, as factors and offsets on the nominal one."""

    length: Array
    """Factor on each body's offset from its parent (bodies,)."""
    mass: Array
    """Factor on each body's mass (bodies,)."""
    inertia: Array
    """Factor on each body's inertia, beside that of its mass (bodies,)."""
    rotor: Array
    """Factor on each joint's rotor inertia (n,)."""
    stiffness: Array
    """Factor on the stiffness of each joint of the bare arm, bending modes included."""
    damping: Array
    """Factor on the damping of each joint of the bare arm."""
    holding_stiffness: Array
    """Factor on each joint's brake or servo stiffness (n,)."""
    holding_damping: Array
    """Factor on each joint's brake or servo damping (n,)."""
    tilt: Array
    """Rotation of the base about its x and y axes [rad] (2,)."""
    drive_gain: Array
    """Torque delivered per torque commanded (n,)."""
    sensor: Array
    """Tool accelerometer, output per true acceleration: gains, cross-axis, mounting (3, 3)."""
    link_sensors: Array
    """The same of each link's accelerometer, base first (n, 3, 3)."""
    joint_zero: Array
    """True joint position minus encoder reading [rad] (n,)."""

    @classmethod
    def none(cls, arm: Arm) -> MismatchDraw:
        """Return the draw in which the true arm is the nominal one."""
        zero = Mismatch().scaled(0.0)
        return zero.draw(arm, np.random.default_rng(0))

    def apply(self, model: mujoco.MjModel, arm: Arm, data: mujoco.MjData) -> None:
        """Write the draw into a compiled model of the arm, seat and instruments included.

        The model must be a fresh copy of its template: factors act on what they find.
        ``data`` is scratch space of the same layout.
        """
        bare = arm.model
        for b in range(1, bare.nbody):
            i = model.body(bare.body(b).name).id
            model.body_pos[i] *= self.length[b]
            model.body_mass[i] *= self.mass[b]
            model.body_inertia[i] *= self.mass[b] * self.inertia[b]
        tool = model.site(arm.tool)
        model.site_pos[tool.id] *= self.length[int(bare.site(arm.tool).bodyid[0])]
        for j in range(bare.njnt):
            joint = model.joint(bare.joint(j).name)
            model.jnt_stiffness[joint.id] *= self.stiffness[j]
            model.dof_damping[joint.dofadr[0]] *= self.damping[j]
        for j, name in enumerate(arm.joints):
            model.dof_armature[model.joint(name).dofadr[0]] *= self.rotor[j]
        rotation = np.zeros(9)
        quaternion = np.zeros(4)
        mujoco.mju_euler2Quat(quaternion, np.array([*self.tilt, 0.0]), "xyz")
        mujoco.mju_quat2Mat(rotation, quaternion)
        # Tilting the base turns gravity the other way in the base's own frame.
        model.opt.gravity[:] = rotation.reshape(3, 3).T @ model.opt.gravity
        mujoco.mj_setConst(model, data)
