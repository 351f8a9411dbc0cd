"""Simulated sensor values of measured runs under many hypotheses at once, on a thread pool.

A hypothesis is a list of effects with their values. Its predictions are sensor values at the
samples of the run, channel by channel.

A step is simulated with the mean of a command over it.

MJCF cannot express torque terms and driven effects, so that Python applies them step by step. Under
a Runge-Kutta method the term in the middle of the step is held over it, predicted from the
acceleration at its beginning; at the beginning, as by other methods, sensors are computed. A dry
friction that depends on the drives' torques is set before each step from those at its beginning.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch, SimulationError
from numpy.typing import NDArray

from loose_env.arms import quiet
from loose_env.errors import InvalidData
from loose_env.gap.model.effect import Effect, Readings
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel, addresses
from loose_env.gap.runs import SETTLE, Channel, Trial, steady_activations
from loose_env.typing import Array, IndexArray

State = tuple[Array, Array]
"""Positions and speeds of the machine's joints, (sims, joints) or (states, sims, joints) each."""
_RUNGE_KUTTA = int(mujoco.mjtIntegrator.mjINT_RK4)
_WRITTEN = ("qpos", "qvel", "ctrl", "qfrc_applied")
"""What effects and the middle of a step are read from or written to."""
_LOADS = ("qfrc_actuator", "qfrc_bias")
"""Forces of the drives, and of gravity and inertial coupling."""
_AT_ONCE = 4_000_000
"""Numbers of commands and readings that are held at a time, 32 MB; more where a thread
would have no simulation."""


_TERMS = ("torque", "feedback", "dry_friction")  # what effects do step by step
_Row = tuple[Any, Array, IndexArray | slice]  # effect, its values, simulations that have it


def _rows(each: Sequence[Hypothesis], method: str, *, stacked: bool) -> list[_Row]:
    """Effects that have a method, in their order: values, of all simulations if stacked; which."""
    found: dict[tuple[int, int, bytes], tuple[Effect, list[Array], list[int]]] = {}
    for k, hypothesis in enumerate(each):
        for place, (effect, values) in enumerate(hypothesis.pairs):
            if effect.overrides(method):
                key = place, id(effect), b"" if stacked else values.tobytes()
                _, own, those = found.setdefault(key, (effect, [], []))
                own.append(values)
                those.append(k)
    return [
        (
            effect,
            np.stack(own, axis=-1) if stacked else own[0],
            slice(None) if len(those) == len(each) else np.array(those),
        )
        for _, (effect, own, those) in sorted(found.items(), key=lambda item: item[0][0])
    ]


class _Stepped:
    """Simulations of a batch with torque terms and driven effects, stepped from Python."""

    def __init__(self, batch: Batch, joints: Sequence[str], slots: Sequence[_Slot]) -> None:
        self.batch, hypotheses = batch, [slot.hypothesis for slot in slots]
        self._places, self._dofs = map(_slice, addresses(slots[0].model, joints))
        self._rows = _rows(hypotheses, "torque", stacked=False)
        self._feeds = _rows(hypotheses, "feedback", stacked=True)
        self._rubs = _rows(hypotheses, "dry_friction", stacked=True)
        self._option = slots[0].model.opt
        if self._rubs:
            # each simulation has its own friction
            _expand(batch, [slot.model for slot in slots])
            self._friction = batch.expand("dof_frictionloss")
            self._base = self._friction[:, self._dofs].copy()

    def rollout(self, count: int, control: Array, *, record: Sequence[str]) -> dict[str, Array]:
        """Advance the simulations, as `mujoco.batch.Batch.rollout` does."""
        # Readings and forces are those at the beginning of each step, under its own command. A
        # simulation with a MuJoCo warning is NaN from the beginning, since a term may make it
        # diverge.
        batch, places, dofs = self.batch, self._places, self._dofs
        # requested first: a field is computed from the next call on
        loads = _LOADS if self._rubs else ()
        fields = {name: batch.bind(name) for name in (*record, "qacc", *loads)}
        qpos, qvel, commands, applied = (batch.bind(name) for name in _WRITTEN)
        found = {name: np.empty((count, *batch.bind(name).shape)) for name in record}
        read = [name for name in record if name != "qpos"]
        warned = np.array(batch.warning)
        step = float(self._option.timestep)
        looks_ahead = int(self._option.integrator) == _RUNGE_KUTTA
        rate = np.zeros_like(qvel[:, dofs])
        half_way = [np.zeros_like(rate) for _ in loads]
        for k in range(count):
            now = qpos[:, places], qvel[:, dofs]
            if looks_ahead:
                commands[:] = self._commands(control[:, k], now)
                if self._rows:
                    applied[:, dofs] = _terms(self._rows, now)
                batch.forward()
                for name in read:
                    found[name][k] = fields[name]
                rate = fields["qacc"][:, dofs]
            begun = [fields[name][:, dofs].copy() for name in loads]
            half, (position, speed) = 0.5 * step, now  # at constant acceleration
            middle = position + half * (speed + 0.5 * half * rate), speed + half * rate
            if self._rows:
                applied[:, dofs] = _terms(self._rows, middle if looks_ahead else now)
            commands[:] = self._commands(control[:, k], middle)
            if looks_ahead and loads:
                # forces change as in the step before, at whose end they are known
                self._set_friction([a + b for a, b in zip(begun, half_way, strict=True)], middle[1])
            elif loads:
                before = qpos.copy(), qvel.copy()
                qpos[:, places], qvel[:, dofs] = middle
                batch.forward()
                self._set_friction([fields[name][:, dofs] for name in loads], middle[1])
                qpos[:], qvel[:] = before
            batch.step()
            half_way = [0.5 * (fields[n][:, dofs] - a) for n, a in zip(loads, begun, strict=True)]
            rate = fields["qacc"][:, dofs]
            for name in record:
                if not (looks_ahead and name in read):
                    found[name][k] = fields[name]
        applied[:] = 0.0
        diverged = (batch.warning != warned).any(axis=(1, 2))
        for values in found.values():
            values[:, diverged] = np.nan
        return {name: values.swapaxes(0, 1) for name, values in found.items()}

    def _commands(self, command: Array, state: State) -> Array:
        """Commands (sims, actuators) that reach the actuators in a state."""
        found, (position, speed) = command.copy(), state
        for effect, values, own in self._feeds:
            at = own, slice(len(effect.machine.actuators))
            found[at] = effect.feedback(found[at], position[own], speed[own], values)
        return found

    def _set_friction(self, forces: Sequence[Array], speed: Array) -> None:
        """Set the dry friction by the forces of `_LOADS` and the speed (sims, joints)."""
        drive, bias = forces
        friction = self._base.copy()
        for effect, values, own in self._rubs:
            friction[own] += effect.dry_friction(drive[own], -bias[own], speed[own], values)
        self._friction[:, self._dofs] = friction


def _slice(at: IndexArray) -> IndexArray | slice:
    """Indices as a slice where they follow each other."""
    return slice(int(at[0]), int(at[-1]) + 1) if np.all(np.diff(at) == 1) else at


def _expand(batch: Batch, models: Sequence[mujoco.MjModel]) -> None:
    """Give each simulation of a batch the values of its own model, which then can be written."""
    batch.set_models(None)
    several = {id(model): model for model in models}
    for name in MODEL_FIELDS:
        own = {key: np.asarray(attrgetter(name)(model)) for key, model in several.items()}
        if len({values.tobytes() for values in own.values()}) > 1:
            batch.expand(name)[:] = np.stack([own[id(model)] for model in models])


def _terms(rows: Sequence[_Row], state: State) -> Array:
    """Sum of the torque terms in a state (sims, joints) [N·m, N]."""
    position, speed = state
    found = np.zeros(position.shape)
    with np.errstate(all="ignore"):  # a diverging simulation is detected from its state
        for effect, values, own in rows:
            here = position[own]
            given = np.asarray(effect.torque(here, speed[own], values))
            if given.shape != here.shape:
                raise InvalidData(
                    f"{effect!r}: torque gives an array of the shape {given.shape}; one number for "
                    f"each joint is needed, {here.shape} as its position"
                )
            found[own] += given
    return found


@dataclass(frozen=True, eq=False)
class _Slot:
    """One simulation: a run under a hypothesis."""

    hypothesis: Hypothesis  # What is simulated
    trial: Trial  # The run
    model: mujoco.MjModel  # Model of the hypothesis


class Simulator:
    """Simulates the runs of a recording."""

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

    def predict(self, hypotheses: Sequence[Hypothesis]) -> list[list[Array]]:
        """Simulate every run under every hypothesis."""
        motions = {self._motion(hypothesis): hypothesis for hypothesis in hypotheses}
        slots = {key: self._slots(hypothesis) for key, hypothesis in motions.items()}
        alike: dict[object, list[_Slot]] = {}
        for slot in (slot for own in slots.values() for slot in own):
            alike.setdefault(self._layout(slot), []).append(slot)
        found: dict[_Slot, Array] = {}
        with quiet():
            for together in alike.values():
                size = self._at_once(together)
                for first in range(0, len(together), size):
                    part = together[first : first + size]
                    found |= zip(part, self._simulate(part), strict=True)
        return [
            [self._columns(own, slot, found[slot]) for slot in slots[self._motion(own)]]
            for own in hypotheses
        ]

    def _slots(self, hypothesis: Hypothesis) -> list[_Slot]:
        """Simulations of every run under a hypothesis."""
        keys = [(trial.step, trial.form == "free") for trial in self.trials]
        own = {k: hypothesis.model(self.machine, k[0], released=k[1]) for k in dict.fromkeys(keys)}
        return [_Slot(hypothesis, t, own[k]) for t, k in zip(self.trials, keys, strict=True)]

    @staticmethod
    def _motion(hypothesis: Hypothesis) -> object:
        """Key of the motion: hypotheses that differ in readings alone share it."""
        return tuple((id(e), values.tobytes()) for e, values in hypothesis.pairs if e.moves)

    def _layout(self, slot: _Slot) -> object:
        """What simulations of one batch share; those stepped from Python cost by their steps."""
        terms, trial = any(x.overrides(*_TERMS) for x in slot.hypothesis.effects), slot.trial
        joints = slot.model.jnt_bodyid.tobytes(), slot.model.body_parentid.tobytes()
        steps = trial.step, terms or trial.steps
        return sizes_of(slot.model), joints, steps, trial.form, trial.resting

    def _at_once(self, slots: Sequence[_Slot]) -> int:
        """Number of simulations that fit into the memory of `_AT_ONCE`, one a thread at least."""
        model = slots[0].model
        each = max(slot.trial.steps for slot in slots) * max(model.nsensordata + model.nu, 1)
        return int(max(self.threads or os.cpu_count() or 1, _AT_ONCE // each))

    def _simulate(self, slots: list[_Slot]) -> list[Array]:
        """Simulate the sensors at the samples (T, sensors), by slot."""
        batch = Batch(slots[0].model, len(slots), self.threads)
        batch.set_models([slot.model for slot in slots])
        terms = any(x.overrides(*_TERMS) for slot in slots for x in slot.hypothesis.effects)
        moved = _Stepped(batch, self.machine.joints, slots) if terms else batch
        first = max((slot.trial for slot in slots), key=lambda trial: trial.steps)
        steps, settle = first.steps, round(SETTLE / first.step)
        controls = np.zeros((len(slots), steps, slots[0].model.nu))
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        qpos, qvel, act = batch.qpos, batch.qvel, batch.act
        for k, slot in enumerate(slots):
            places, dofs = addresses(slot.model, self.machine.joints)
            qpos[k] = slot.model.qpos0
            qpos[k, places], qvel[k, dofs] = slot.trial.position, slot.trial.speed
            values = np.concatenate([slot.trial.before, slot.trial.controls])
            clock = np.arange(len(values), dtype=np.float64) * first.step
            for effect, own in slot.hypothesis.pairs:
                values = effect.command(clock, values, own)
            count = len(slot.trial.controls)
            controls[k, :count, : values.shape[1]] = values[len(slot.trial.before) :]
            controls[k, count:] = controls[k, count - 1]  # a shorter run ends there
            act[k] = steady_activations(slot.model, controls[k, 0])
        diverged = np.zeros(len(slots), dtype=bool)
        if slots[0].trial.resting and settle:
            # the clock runs on, since delayed commands are stored by time
            _advance(moved, np.repeat(controls[:, :1], settle, axis=1), diverged, ("qpos",))
        kept = _advance(moved, controls, diverged, ("sensordata",))["sensordata"]
        kept[diverged] = np.nan
        return [slot.trial.at_samples(k) for slot, k in zip(slots, kept, strict=True)]

    def _columns(self, hypothesis: Hypothesis, slot: _Slot, whole: Array) -> Array:
        """Channel values (T, C)."""
        readings: Readings = {}
        for column in dict.fromkeys(channel.column for channel in self.channels):
            prefix, _, name = column.partition(".")
            if prefix == "sensor":
                readings[column] = sensed(slot.model, name, whole)
            else:
                forces = whole[:, slot.model.nsensordata - len(self.machine.actuators) :]
                readings[column] = forces @ self.machine.moments[self.machine.joint_number(name)]
        for effect, own in hypothesis.pairs:
            readings = effect.read(slot.trial.time, readings, own)
        every = [(readings[c.column], c.axis) for c in self.channels]
        return np.stack([own if axis is None else own[:, axis] for own, axis in every], axis=1)


def sensed(model: mujoco.MjModel, name: str, readings: Array) -> Array:
    """Readings of one sensor (T,), or (T, 3) of a vector, among those of all (T, sensordata)."""
    sensor = model.sensor(name)
    own = readings[:, int(sensor.adr[0]) :][:, : int(sensor.dim[0])]
    return own[:, 0] if own.shape[1] == 1 else own


_SIZES = (
    "nq", "nv", "nu", "na", "nbody", "njnt", "nsite", "nsensor", "nsensordata", "neq", "nhistory",
    "nM", "ngeom", "ntendon", "nJmom", "nC", "nactuator",
)  # fmt: skip


def sizes_of(model: mujoco.MjModel) -> tuple[int, ...]:
    """Sizes that models share in one batch."""
    return tuple(int(getattr(model, name, 0)) for name in _SIZES)


def _advance(
    batch: Batch | _Stepped, controls: Array, diverged: NDArray[np.bool_], names: Sequence[str]
) -> dict[str, Array]:
    """Advance some slots; return what is recorded, and mark the slots that diverged."""
    try:
        out: dict[str, Array] = batch.rollout(controls.shape[1], controls, record=names)
    except SimulationError as error:
        raise InvalidData(f"MuJoCo cannot simulate the model: {error}") from error
    first = out[names[0]]
    diverged |= ~np.isfinite(first[:, -1]).all(axis=-1)
    diverged |= np.abs(first).max(axis=(1, 2)) > 1e9
    return out
