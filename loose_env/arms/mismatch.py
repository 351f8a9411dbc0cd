"""Random mismatch between nominal and true arm, and its drift between records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.errors import InvalidSetting
from loose_env.io import Checked, NonNegative
from loose_env.streams import seeded
from loose_env.typing import Array

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
        return self.draw_all(arm, [rng])[0]

    def draw_all(self, arm: Arm, rngs: Sequence[np.random.Generator]) -> list[MismatchDraw]:
        """Draw a true arm from each of B generators."""
        n, count = arm.n, len(rngs)
        sensors = self._accelerometers(_normal(rngs, 15))
        # Seeded by the tool's, so that they take nothing from rngs and change no later draw.
        words = sensors.reshape(count, 9).view(np.uint64)
        if (words >> np.uint64(32)).all():
            own = seeded(words.view(np.uint32))
        else:  # numpy leaves out words that are zero
            own = [np.random.default_rng(row) for row in words]
        links = self._accelerometers(_normal(own, 15 * n)).reshape(count, n, 3, 3)
        names, ends, centre, deviation = self._layout(arm.model.nbody, arm.model.njnt, n)
        drawn = centre + deviation * _normal(rngs, len(centre))
        spans = [slice(*span) for span in pairwise(ends)]
        return [
            MismatchDraw(
                sensor=sensors[k],
                link_sensors=links[k],
                **{name: drawn[k, span] for name, span in zip(names, spans, strict=True)},
            )
            for k in range(count)
        ]

    @lru_cache(maxsize=64)  # noqa: B019  (settings are few, small and equal by value)
    def _layout(
        self, bodies: int, joints: int, n: int
    ) -> tuple[tuple[str, ...], tuple[int, ...], Array, Array]:
        """Parts of a draw in their order, their ends, and the mean and deviation of each number."""
        stiffness, damping = self.stiffness, self.damping
        layout = (
            ("length", bodies, 1.0, self.length),
            ("mass", bodies, 1.0, self.mass),
            ("inertia", bodies, 1.0, self.inertia),
            ("rotor", n, 1.0, self.inertia),
            ("stiffness", joints, 1.0, stiffness),
            ("damping", joints, 1.0, damping),
            ("holding_stiffness", n, 1.0, stiffness),
            ("holding_damping", n, 1.0, damping),
            ("tilt", 2, 0.0, np.radians(self.tilt)),
            ("drive_gain", n, 1.0, self.gain),
            ("joint_zero", n, 0.0, np.radians(self.joint_zero)),
        )
        names, sizes, centre, deviation = zip(*layout, strict=True)
        ends = (0, *np.cumsum(sizes).tolist())
        return names, ends, np.repeat(centre, sizes), np.repeat(deviation, sizes)

    def _accelerometers(self, variates: Array) -> Array:
        """What accelerometers make of the true acceleration (A, 3, 3), by 15 variates each."""
        drawn = variates.reshape(-1, 15)
        count = len(drawn)
        cross = self.cross_axis * drawn[:, :9].reshape(count, 3, 3)
        cross[:, range(3), range(3)] = self.gain * drawn[:, 9:12]
        mounting = np.zeros((count, 3, 3))
        turned = np.radians(self.misalignment) * drawn[:, 12:]
        mounting[:, range(3), range(3)] = 1.0
        mounting[:, (1, 2, 0), (2, 0, 1)] = turned
        mounting[:, (2, 0, 1), (1, 2, 0)] = -turned
        return np.asarray((np.eye(3) + cross) @ mounting)


def _normal(rngs: Sequence[np.random.Generator], count: int) -> Array:
    """Draw standard normal variates (B, count), those beyond the cut set to it."""
    drawn = np.empty((len(rngs), count))
    for row, rng in zip(drawn, rngs, strict=True):
        rng.standard_normal(out=row)
    return np.clip(drawn, -_CUT, _CUT)


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


@dataclass(frozen=True, kw_only=True)
class Drift(Checked):
    """Standard deviations of what changes of the true arm from record to record, a random walk.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> arm, rng = planar(2), np.random.default_rng(0)
    >>> first = MismatchDraw.none(arm)
    >>> later = Drift(joint_zero=0.1).after(first, rng)
    >>> bool(np.any(later.joint_zero)), later.drive_gain.tolist()
    (True, [1.0, 1.0])
    """

    joint_zero: NonNegative = 0.0
    """Zero of each joint encoder, per record [deg]."""
    gain: NonNegative = 0.0
    """Gain of each drive, relative, per record."""

    def after(self, draw: MismatchDraw, rng: np.random.Generator) -> MismatchDraw:
        """Return the true arm one record later."""
        steps = _normal([rng], 2 * len(draw.joint_zero)).reshape(2, -1)
        return replace(
            draw,
            joint_zero=draw.joint_zero + np.radians(self.joint_zero) * steps[0],
            drive_gain=draw.drive_gain * np.exp(self.gain * steps[1]),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class MismatchIndices:
    """Indices in a compiled model of what a mismatch changes: the same for all of a template."""

    bodies: NDArray[np.intp]
    """Bodies of the bare arm, the world left out (bodies - 1,)."""
    joints: NDArray[np.intp]
    """Joints of the bare arm."""
    dofs: NDArray[np.intp]
    """First degree of freedom of each of these."""
    drives: NDArray[np.intp]
    """Degree of freedom of each driven joint (n,)."""
    tool: int
    """Site of the tool."""
    tool_body: int
    """Body of the bare arm that carries the tool."""

    @classmethod
    def of(cls, model: mujoco.MjModel, arm: Arm) -> MismatchIndices:
        """Look the parts of an arm up by their names."""
        bare = arm.model
        joints = [model.joint(bare.joint(j).name) for j in range(bare.njnt)]
        bodies = [model.body(bare.body(b).name).id for b in range(1, bare.nbody)]
        return cls(
            bodies=np.array(bodies, dtype=np.intp),
            joints=np.array([joint.id for joint in joints], dtype=np.intp),
            dofs=np.array([joint.dofadr[0] for joint in joints], dtype=np.intp),
            drives=np.array([model.joint(j).dofadr[0] for j in arm.joints], dtype=np.intp),
            tool=model.site(arm.tool).id,
            tool_body=int(bare.site(arm.tool).bodyid[0]),
        )


def apply_mismatches(
    models: Sequence[mujoco.MjModel],
    templates: Sequence[mujoco.MjModel],
    draws: Sequence[MismatchDraw],
    indices: Sequence[MismatchIndices],
) -> None:
    """Write draws into compiled models of one arm, alike in layout, seat and instruments included.

    Factors act on what each model's template says, whatever the model said before. Call
    ``mj_setConst`` afterwards.
    """
    rotation, quaternion, tilt = np.zeros(9), np.zeros(4), np.zeros(3)
    for model, template, draw, at in zip(models, templates, draws, indices, strict=True):
        mass = draw.mass[1:]
        for name, rows, share in (
            ("body_pos", at.bodies, draw.length[1:, None]),
            ("body_mass", at.bodies, mass),
            ("body_inertia", at.bodies, (mass * draw.inertia[1:])[:, None]),
            ("jnt_stiffness", at.joints, draw.stiffness),
            ("dof_damping", at.dofs, draw.damping),
            ("dof_armature", at.drives, draw.rotor),
        ):
            values = getattr(template, name).copy()
            values[rows] *= share
            getattr(model, name)[:] = values
        model.site_pos[:] = template.site_pos
        model.site_pos[at.tool] *= draw.length[at.tool_body]
        tilt[:2] = draw.tilt
        mujoco.mju_euler2Quat(quaternion, tilt, "xyz")
        mujoco.mju_quat2Mat(rotation, quaternion)
        # Tilting the base turns gravity the other way in the base's own frame.
        model.opt.gravity[:] = rotation.reshape(3, 3).T @ template.opt.gravity
