"""Inverse dynamics torques of measured motion under hypotheses, compared with measured torques.

The motion is smoothed (`loose_env.gap.data.smoothing`), and the model of each hypothesis evaluated
on it: M(q) a + bias - passive forces, for all samples at once on MuJoCo's thread pool. Dry friction
is a law of the smoothed speed, not MuJoCo's constraint, whose force at rest is a reaction force and
not the drive torque. The measured torque passes the same filter as the motion.

An inverse comparison is insensitive to commands, accelerometers, contacts and joint stops. Samples
around the reversals of a joint are left out for that joint, since the direction of its friction is
not known there.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np
from mujoco.batch import Batch

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.data.smoothing import SmoothedMotion, filled, smooth_motion, with_readings
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.mjcf.sensor_columns import column_of
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.simulation.applied_torque_terms import has_terms, torque_terms
from loose_env.gap.simulation.compared_torques import ComparedTorques, compared_torques
from loose_env.gap.simulation.driven_effects import has_friction, load_dependent_friction
from loose_env.gap.simulation.simulator import _layout
from loose_env.gap.simulation.unmeasured_dofs import PrescribedMotionSimulator
from loose_env.statistics import noise_floor
from loose_env.typing import Array

_REPEATS = 12
"""Steps in which a reading is followed back to what was there."""
_SEED = 20
"""Of the noise that is added to see what becomes of it."""
_LONG_STEP = 2e-3
"""Step of the cheaper copy [s]: a fourteenth of the period of the stiffest spring from which fits
start."""
_OFF = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)


class InverseDynamics:
    """Predicts the torques of inverse runs; replaces a `Simulator`."""

    def __init__(
        self,
        machine: NominalModel,
        trials: Sequence[Trial],
        channels: tuple[Channel, ...],
        *,
        threads: int = 0,
    ) -> None:
        self.machine, self.trials, self.channels = machine, list(trials), channels
        self.threads = threads
        self.simulated = 0
        self._batches: dict[tuple[object, ...], tuple[Batch, list[Array]]] = {}
        self.motions = [smooth_motion(trial, machine, channels) for trial in self.trials]
        self._corrected: dict[object, list[SmoothedMotion]] = {}
        self._drive = PrescribedMotionSimulator(machine, threads=threads)
        self._exact = True

    def with_longer_steps(self) -> InverseDynamics:
        """Copy that takes longer steps where there are unmeasured degrees of freedom.

        Their torques are corrected by what the steps change in the nominal model.
        """
        found = copy.copy(self)
        found._drive = PrescribedMotionSimulator(
            self.machine, threads=self.threads, step=_LONG_STEP
        )
        found._exact, found.simulated = False, 0
        return found

    @cached_property
    def torque_joints(self) -> dict[int, int]:
        """Joints of the torque channels, by channel index."""
        pairs = ((k, c.column.partition(".")) for k, c in enumerate(self.channels))
        return {k: self.machine.joint_number(n) for k, (kind, _, n) in pairs if kind == "torque"}

    @cached_property
    def _runs(self) -> list[ComparedTorques]:
        """Compared torques with their noise."""
        spread = self._propagated()
        runs = zip(self.trials, self.motions, spread, strict=True)
        return [compared_torques(trial, m, self.torque_joints, noise) for trial, m, noise in runs]

    def measured(self, trial: int) -> Array:
        """Return torques of a run as compared, NaN elsewhere (T, C)."""
        return self._runs[trial].measured

    def floors(self, trial: int) -> Array:
        """Noise of the compared torques, from torque and motion (C,); NaN if not compared."""
        return self._runs[trial].floors

    def levels(self, hypothesis: Hypothesis) -> list[Array]:
        """Noise of each run's torques under a hypothesis, over that of the rigid arm (C,).

        The inverse dynamics torque carries the noise of the measured acceleration. Behind a spring
        it is attenuated, or amplified near a resonance. The factor is measured by adding noise a
        second time, the same for every hypothesis.
        """
        model = hypothesis.model(self.machine, self.machine.step or self.machine.model.opt.timestep)
        if model.nv <= self.machine.model.nv:
            return [np.ones(len(self.channels)) for _ in self.trials]
        changed = self._change(hypothesis)
        found = []
        for run, own, rigid in zip(self._runs, changed, self._rigid_change, strict=True):
            level = np.ones(len(self.channels))
            for channel, joint in self.torque_joints.items():
                compared = np.isfinite(run.measured[run.motion.chosen, channel])
                if compared.any():
                    noise = run.torque[channel] ** 2
                    now, then = (float(np.mean(c[compared, joint] ** 2)) for c in (own, rigid))
                    if np.isfinite(now):  # a diverged simulation gives no estimate
                        level[channel] = np.sqrt((noise + now) / (noise + then))
            found.append(level)
        return found

    def _change(self, hypothesis: Hypothesis) -> list[Array]:
        """Change of the torques (E, joints) of each run with added motion noise."""
        pair = (self._needed(hypothesis, motions) for motions in (self._noisier, self.motions))
        return [one - other for one, other in zip(*pair, strict=True)]

    @cached_property
    def _rigid_change(self) -> list[Array]:
        """Change of the nominal model's torques with added motion noise."""
        return self._change(Hypothesis(effects=(), values=()))

    @cached_property
    def _noisier(self) -> list[SmoothedMotion]:
        """Motions with sensor noise added a second time."""
        found = []
        for number, (run, motion) in enumerate(zip(self.trials, self.motions, strict=True)):
            rng = np.random.default_rng([_SEED, number])
            readings = {
                c.column: run.measured[:, k]
                + noise_floor(filled(run.time, run.measured[:, k], motion.time))
                * rng.standard_normal(len(run.time))
                for k, c in enumerate(self.channels)
                if self._motion_sensor(c.column) and np.isfinite(run.measured[:, k]).any()
            }
            found.append(with_readings(motion, run, self.machine, self.channels, readings))
        return found

    def spacing(self, trial: int) -> int:
        """Spacing of the compared samples."""
        return int(self.motions[trial].chosen[1])

    def shows(self, effect: Effect) -> bool:
        """Return whether an effect changes the inverse dynamics torque.

        Of a sensor only those of joint positions and speeds do. A bias of a position is the same as
        an offset of the encoder, which represents both.
        """
        if effect.drives or type(effect).sensed_torque is not Effect.sensed_torque:
            start, lone = np.array(effect.starts[0]), np.ones(1)
            return any(effect.sensed_torque(j, lone, start)[0] != 1.0 for j in self.machine.joints)
        if effect.moves:
            return True
        column = column_of(effect.where)
        used = {c.column for c in self.channels if self._motion_sensor(c.column)}
        return column in used and effect.kind != "sensor_bias"

    def _motion_sensor(self, column: str) -> bool:
        prefix, _, name = column.partition(".")
        if prefix != "sensor" or name not in self.machine.sensors:
            return False
        of_motion = (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL)
        return int(self.machine.model.sensor(name).type[0]) in map(int, of_motion)

    def predict(self, hypotheses: Sequence[Hypothesis]) -> list[list[Array]]:
        """Predict torques of every run under every hypothesis."""
        return [self._columns(hypothesis) for hypothesis in hypotheses]

    def _columns(self, hypothesis: Hypothesis) -> list[Array]:
        needed = self._needed(hypothesis, self._motions_for(hypothesis))
        found = []
        for trial, motion, torque in zip(self.trials, self.motions, needed, strict=True):
            columns = np.full((len(trial.time), len(self.channels)), np.nan)
            kept = motion.chosen
            for channel, joint in self.torque_joints.items():
                columns[kept, channel] = torque[:, joint]
            found.append(columns)
        return found

    def _needed(self, hypothesis: Hypothesis, motions: list[SmoothedMotion]) -> list[Array]:
        """Drive torques (E, joints) in each run."""
        # a drive's limit is an actuator's damping in MJCF, which a measured torque includes
        shown = [(effect, own) for effect, own in hypothesis.pairs if self.shows(effect)]
        hypothesis = hypothesis.with_effects(shown)
        model = hypothesis.model(self.machine, self.machine.step or self.machine.model.opt.timestep)
        self.simulated += sum(len(m.chosen) for m in motions)
        if model.nv > self.machine.model.nv:
            found = [self._driven(hypothesis, m) for m in motions]
            if not self._exact:
                found = [f + error for f, error in zip(found, self._step_errors, strict=True)]
        else:
            rigid = self.rigid(model, motions)
            extra = [self._dry(hypothesis, model, m) for m in motions]
            found = [r + e for r, e in zip(rigid, extra, strict=True)]
        if any(map(has_friction, hypothesis.effects)):
            each = zip(found, self.motions, self._loads, strict=True)
            found = [
                torque + load_dependent_friction(hypothesis, m, torque, load)
                for torque, m, load in each
            ]
        for effect, own in hypothesis.pairs:
            if type(effect).sensed_torque is Effect.sensed_torque:
                continue
            for torque in found:
                for joint, name in enumerate(self.machine.joints):
                    torque[:, joint] = effect.sensed_torque(name, torque[:, joint], own)
        return found

    def _driven(self, hypothesis: Hypothesis, motion: SmoothedMotion) -> Array:
        """Drive torques (E, joints) with unmeasured degrees of freedom."""
        return motion.band.smooth(self._drive.torque(hypothesis, motion))[motion.chosen]

    @cached_property
    def _step_errors(self) -> list[Array]:
        """What the drive's steps change in the nominal model's torques (E, joints), run by run."""
        nominal = Hypothesis(effects=(), values=())
        rigid = self._needed(nominal, self.motions)
        return [r - self._driven(nominal, m) for r, m in zip(rigid, self.motions, strict=True)]

    @cached_property
    def _loads(self) -> list[Array]:
        """Torques of gravity and inertial coupling in the nominal arm (E, joints), run by run."""
        model = copy.copy(self.machine.model)
        return [-bias for bias in self.rigid(model, self.motions, bias_only=True)]

    def rigid(
        self, model: mujoco.MjModel, motions: list[SmoothedMotion], *, bias_only: bool = False
    ) -> list[Array]:
        """Rigid-body term M a + bias - passive of all runs (E, joints) each, or the bias alone."""
        states = [m.states for m in motions]
        position, speed, acceleration = (np.concatenate(part) for part in zip(*states, strict=True))
        model.opt.disableflags |= _OFF
        batch, (mass, bias, passive) = self._batch(model, len(position))
        batch.set_models(model)
        batch.qpos[:], batch.qvel[:] = position, speed
        batch.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)
        torque = bias if bias_only else _times(model, mass, acceleration) + bias - passive
        return np.split(torque, np.cumsum([len(s[0]) for s in states])[:-1])

    def _batch(self, model: mujoco.MjModel, count: int) -> tuple[Batch, list[Array]]:
        """Batch with room for all samples, and its mass matrices and forces."""
        key = (*_layout(model), count)
        if key not in self._batches:
            if len(self._batches) > 6:
                self._batches.clear()
            batch = Batch(model, count, self.threads)
            fields = [batch.bind(name) for name in ("M", "qfrc_bias", "qfrc_passive")]
            self._batches[key] = batch, fields
        return self._batches[key]

    def _dry(self, hypothesis: Hypothesis, model: mujoco.MjModel, motion: SmoothedMotion) -> Array:
        """Torques of dry friction, unmodelled drives and torque terms (E, joints)."""
        direction = np.tanh(motion.speed / np.maximum(motion.noise[1], 1e-12))
        found: Array = np.asarray(model.dof_frictionloss * direction)
        for effect, own in hypothesis.pairs:
            if type(effect).passive_actuator_torque is not Effect.passive_actuator_torque:
                joint = self.machine.joint_number(effect.where)
                found[:, joint] += effect.passive_actuator_torque(
                    motion.position[:, joint], motion.speed[:, joint], own
                )
        if has_terms(hypothesis):
            found -= torque_terms(hypothesis, motion.position, motion.speed)
        if not found.any():
            return found[motion.chosen]
        return motion.band.smooth(found)[motion.chosen]

    def _motions_for(self, hypothesis: Hypothesis) -> list[SmoothedMotion]:
        """Motions, corrected for a hypothesis' sensor effects."""
        reading = [
            (effect, values)
            for effect, values in hypothesis.pairs
            if type(effect).read is not Effect.read and self._motion_sensor(column_of(effect.where))
        ]
        if not reading:
            return self.motions
        key = tuple((effect, values.tobytes()) for effect, values in reading)
        if key not in self._corrected:
            if len(self._corrected) > 32:
                self._corrected.clear()
            self._corrected[key] = [
                self._corrected_motion(t, reading) for t in range(len(self.trials))
            ]
        return self._corrected[key]

    def _corrected_motion(self, trial: int, reading: list[tuple[Effect, Array]]) -> SmoothedMotion:
        """Invert the sensor effects on readings by fixed-point iteration."""
        run, motion, shown = self.trials[trial], self.motions[trial], self._shown[trial]
        there = shown
        for _ in range(_REPEATS):
            read = there
            for effect, values in reading:
                read = effect.read(motion.time, read, values)
            there = {name: there[name] + shown[name] - read[name] for name in shown}
        raw = {
            c.column: filled(run.time, run.measured[:, k], motion.time)
            + there[c.column]
            - shown[c.column]
            for k, c in enumerate(self.channels)
            if c.column in shown and not np.array_equal(there[c.column], shown[c.column])
        }
        return with_readings(motion, run, self.machine, self.channels, raw)

    @cached_property
    def _shown(self) -> list[dict[str, Array]]:
        """Smoothed readings (G,) of each run's joint positions and speeds, by column."""
        return [
            {
                c.column: motion.band.smooth(filled(run.time, run.measured[:, k], motion.time))
                for k, c in enumerate(self.channels)
                if self._motion_sensor(c.column) and np.isfinite(run.measured[:, k]).any()
            }
            for run, motion in zip(self.trials, self.motions, strict=True)
        ]

    def _propagated(self) -> list[Array]:
        """Variance of the torque due to the motion's noise (joints,), run by run.

        Finite differences of the nominal model's torque, over all samples: the root mean square
        change by a standard deviation of each joint's position, speed and acceleration.
        """
        nominal = Hypothesis(effects=(), values=())
        model = nominal.model(self.machine, self.machine.step or self.machine.model.opt.timestep)
        base = self.rigid(model, self.motions)
        found = [np.zeros(len(self.machine.joints)) for _ in self.motions]
        for kind in range(3):
            for joint in range(len(self.machine.joints)):
                moved = [_moved(motion, kind, joint) for motion in self.motions]
                for total, one, other in zip(found, self.rigid(model, moved), base, strict=True):
                    total += np.mean((one - other) ** 2, axis=0)
        return found


def _times(model: mujoco.MjModel, mass: Array, acceleration: Array) -> Array:
    """Multiply packed lower-triangular mass matrices (E, nC) by vectors (E, nv)."""
    found = np.zeros_like(acceleration)
    rows = np.repeat(np.arange(model.nv), model.M_rownnz)
    for k, (row, column) in enumerate(zip(rows, model.M_colind, strict=True)):
        found[:, row] += mass[:, k] * acceleration[:, column]
        if row != column:
            found[:, column] += mass[:, k] * acceleration[:, row]
    return found


def _moved(motion: SmoothedMotion, kind: int, joint: int) -> SmoothedMotion:
    """Perturb the motion of one joint by its noise in position, speed or acceleration."""
    parts = [motion.position, motion.speed, motion.acceleration]
    parts[kind] = parts[kind].copy()
    parts[kind][:, joint] += motion.noise[kind, joint]
    return replace(motion, position=parts[0], speed=parts[1], acceleration=parts[2])
