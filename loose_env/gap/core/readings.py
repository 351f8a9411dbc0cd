"""Readings beside the motion: what velocity and inertial sensors show along it.

The motion foretells their readings, velocities from the positions alone. A sensor's gain, bias,
delay and misalignment are the difference; forces that a model lacks are not, since the motion was
measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType

import mujoco
import numpy as np

from loose_env.gap.core.motion import FINER, Motion, RunMotion, finer, low_passed
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.sensors import column_of
from loose_env.typing import Array

_NUDGE = 1e-4  # displacement of numerical derivatives [rad, m]
_POSES = 12  # states at which the sensitivity of readings to the motion is looked up
_KINEMATIC = ("body_pos", "body_quat", "jnt_pos", "jnt_axis", "qpos0", "site_pos", "site_quat")


class Readings:
    """Foretold readings of the sensors that a motion carries."""

    def __init__(self, model: mujoco.MjModel, motion: Motion) -> None:
        self.motion, self.model = motion, model
        self._turned: dict[int, list[Array]] = {}
        names = dict.fromkeys(name for name, _ in motion.sensors)
        self.sensors = [
            (name, [k for k, (n, _) in enumerate(motion.sensors) if n == name]) for name in names
        ]
        self.names = tuple(
            column_of(n) + (f".{'xyz'[a]}" if a >= 0 else "") for n, a in motion.sensors
        )
        fields = ("position", "derived", "acceleration")
        self._states = tuple(motion.stacked(name) for name in fields)
        self.foretold = self.of(model, *self._states) if motion.sensors else self.nothing
        self._gains = self._sensitivity() if motion.sensors else np.zeros((3, 0, 1))

    @property
    def nothing(self) -> Array:
        """No change of any reading (T, R)."""
        return np.zeros((len(self.motion.stacked("position")), len(self.motion.sensors)))

    def accelerated(self, reading: int | slice = slice(None)) -> bool:
        """Whether a reading, or any, depends on the joints' acceleration."""
        return bool(np.any(self._gains[2, reading]))

    @cached_property
    def _finer(self) -> list[Array]:
        """Foretold readings of each run on finer points."""
        return [*map(finer, self.motion.split(self.foretold))]

    def change(
        self,
        model: mujoco.MjModel | None,
        effect: Effect | None,
        values: Array,
        *,
        turned: Array | float = 0.0,
        positions: Mapping[str, Array] = MappingProxyType({}),
    ) -> Array:
        """Change of the readings by an edited model, and by an effect on the sensors (T, R)."""
        # Of a joint that moves otherwise than is read with the change by that motion, and the
        # positions (T,) by column.
        found = self.foretold if isinstance(turned, float) else self.foretold + turned
        if not self.motion.sensors:
            return self.nothing
        if model is not None and model.nv == self.model.nv and self._moved(model):
            found = self.of(model, *self._states)
        if effect is not None and effect.overrides("read"):
            fine = self._finer
            if found is not self.foretold or positions:
                columns = np.column_stack([found, *positions.values()])
                fine = [*map(finer, self.motion.split(columns))]
            found = found + np.concatenate(
                [
                    self._read(run, own, effect, values, tuple(positions))
                    for run, own in zip(self.motion.runs, fine, strict=True)
                ]
            )
        return found - self.foretold

    def of(self, model: mujoco.MjModel, q: Array, v: Array, a: Array) -> Array:
        """Readings of a model along a motion of all its joints (T, R)."""
        data = mujoco.MjData(model)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        rows = np.array(
            [int(model.sensor(name).adr[0]) + max(axis, 0) for name, axis in self.motion.sensors]
        )
        found = np.empty((len(q), len(rows)))
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            found[k] = data.sensordata[rows]
        return found

    def turned(self, joint: int, moved: list[Array]) -> Array:
        """Change of the readings by another motion of one joint, to first order (T, R)."""
        if not self.names:
            return self.nothing
        if joint not in self._turned:
            self._turned[joint] = self.slopes(self.model, self._states, joint)
        pairs = zip(self._turned[joint], moved, strict=True)
        return np.asarray(sum(slope * part[:, None] for slope, part in pairs))

    def noise(self, reading: int, frequency: Array) -> Array:
        """Standard deviation of a reading less the foretold one (F,)."""
        own = self.motion.sensor_noise[reading] ** 2
        return np.asarray(np.sqrt(own + self.foretold_variance(reading, frequency).sum(axis=1)))

    def foretold_variance(self, reading: int, frequency: Array) -> Array:
        """Variance of a foretold reading by the noise of each joint's motion (F, joints)."""
        turn = 2 * np.pi * frequency[:, None]
        # the speed is the derived one, and the acceleration that of both readings
        moved = (
            self._gains[0, reading] ** 2 + (turn * self._gains[1, reading]) ** 2
        ) * self.motion.noise[0] ** 2
        known = self.motion.precision(turn[:, 0])
        return np.asarray(moved + (turn**2 * self._gains[2, reading]) ** 2 / known)

    @cached_property
    def by_joint(self) -> Array:
        """Foretold readings by the swing of each joint, to first order (J, T, R)."""
        position, *rates = self._states
        swings = [own - own.mean(axis=0) for own in self.motion.split(position)]
        states = np.stack([np.concatenate(swings), *rates])
        return np.stack([self.turned(k, list(states[..., k])) for k in range(states.shape[2])])

    def _moved(self, model: mujoco.MjModel) -> bool:
        """Whether an edit moves or tilts anything that a sensor stands on."""
        pairs = ((getattr(model, n), getattr(self.model, n)) for n in _KINEMATIC)
        same = all(a.shape == b.shape and np.array_equal(a, b) for a, b in pairs)
        return not same or bool(np.any(model.opt.gravity != self.model.opt.gravity))

    def slopes(self, model: mujoco.MjModel, states: Sequence[Array], joint: int) -> list[Array]:
        """Change of readings by position, speed and acceleration of a joint (3, T, R)."""
        still, found = self.of(model, *states), []
        for order in range(3):
            moved = [x.copy() for x in states]
            moved[order][:, joint] += _NUDGE
            found.append((self.of(model, *moved) - still) / _NUDGE)
        return found

    def _sensitivity(self) -> Array:
        """Root mean square change of each reading by each joint's motion (3, R, joints)."""
        rows = np.linspace(0, len(self._states[0]) - 1, _POSES).astype(int)
        states = [x[rows] for x in self._states]
        slopes = [self.slopes(self.model, states, joint) for joint in range(states[0].shape[1])]
        return np.asarray(np.sqrt(np.mean(np.square(slopes), axis=2))).transpose(1, 2, 0)

    def _read(
        self, run: RunMotion, own: Array, effect: Effect, values: Array, beside: Sequence[str]
    ) -> Array:
        """Change of one run's readings by an effect on sensors (T, R), from finer columns."""
        time, count = np.arange(len(own)) * run.step / FINER, len(self.names)
        given = dict(zip(beside, own[:, count:].T, strict=True))
        given |= {
            column_of(name): own[:, at] if len(at) > 1 else own[:, at[0]]
            for name, at in self.sensors
        }
        shown, found = effect.read(time, given, values), np.zeros((len(own) // FINER, count))
        for name, at in self.sensors:
            if shown[column_of(name)] is not given[column_of(name)]:
                off = shown[column_of(name)].reshape(len(own), len(at)) - own[:, at]
                found[:, at] = low_passed(off, self.motion.band, run.step / FINER)[::FINER]
        return found
