"""Simulated sensor values of measured runs under many hypotheses at once, on a thread pool.

A hypothesis is a list of effects with their values. Its predictions are sensor values at the
samples of the run, channel by channel.

A step is simulated with the mean of a command over it. An accelerometer reads the instantaneous
value: a servo's acceleration jumps with every command. A delayed one reads the value at an earlier
time, between two steps.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from loose_env.arms import quiet
from loose_env.errors import InvalidData
from loose_env.gap.model.effect import Effect, Readings
from loose_env.gap.model.effects.sensors import column_of, is_position_or_speed
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import SETTLE, Channel, Trial, steady_activations
from loose_env.gap.torque_terms import (
    STATES,
    BatchWithTerms,
    Driven,
    has_terms,
    torque_terms,
    with_terms,
)
from loose_env.typing import Array

PARTS = 2
"""Parts of a step where commands change within it: a mean moves the speed rightly, and the place
only as far as the change lies in the middle."""
_AT_A_TIME = 1024
"""States at which sensors are worked out at a time."""


def changes_within(
    machine: NominalModel, hypothesis: Hypothesis, channels: Sequence[Channel]
) -> bool:
    """Return whether commands may change within a step, visible in a channel.

    Positions and speeds follow the mean of a command.
    """
    if all(is_position_or_speed(machine, channel.column) for channel in channels):
        return False
    return any(type(effect).command_at is not Effect.command_at for effect in hypothesis.stepping)


def late_sensors(hypothesis: Hypothesis, channels: Sequence[Channel]) -> dict[str, float]:
    """Delayed sensors among the channels, each with its delay [s]."""
    shown = {channel.column for channel in channels}
    found: dict[str, float] = {}
    for effect, own in hypothesis.pairs:
        late = effect.sensor_delay(own)
        if late is not None and late[1] > 0 and column_of(late[0]) in shown:
            found[late[0]] = found.get(late[0], 0.0) + late[1]
    return found


def states_before(states: Mapping[str, Array], at: Array, step: float) -> dict[str, Array]:
    """Interpolate the states of a simulation, for hinge and slide joints.

    Positions follow cubics through the positions and speeds at both ends of a step, within which
    commands are constant, and speeds their slopes; activations are linear.

    Examples
    --------
    >>> fallen = {"qpos": np.array([[0.0], [1.0]]), "qvel": np.array([[0.0], [2.0]])}
    >>> {name: float(v[0, 0]) for name, v in states_before(fallen, np.array([0.5]), 1.0).items()}
    {'qpos': 0.25, 'qvel': 1.0}
    """
    count = len(states["qpos"])
    steps = np.clip(at / step, 0.0, count - 1.0)
    low = np.minimum(np.floor(steps + 1e-9).astype(int), max(count - 2, 0))
    high = np.minimum(low + 1, count - 1)
    s = np.clip(steps - low, 0.0, 1.0)[:, None]
    found = {name: v[low] * (1 - s) + v[high] * s for name, v in states.items()}
    place, speed = states["qpos"], states["qvel"]
    if place.shape == speed.shape:
        way = place[high] - place[low]
        one, two = step * speed[low] - way, step * speed[high] - way
        found["qpos"] += s * (1 - s) * ((1 - s) * one - s * two)
        found["qvel"] = (way + one * (1 - s) * (1 - 3 * s) - two * s * (2 - 3 * s)) / step
    return found


def show_late_sensors(
    shown: Array,
    machine: NominalModel,
    hypothesis: Hypothesis,
    model: mujoco.MjModel,
    states: Mapping[str, Array],
    commands: Array,
    *,
    late: Mapping[str, float],
    step: float,
    parts: int = 1,
    first: int = 0,
    threads: int,
) -> None:
    """Replace the columns of delayed sensors (T, sensors) in place."""
    for name, delay in late.items():
        then: Array = np.arange(first, first + len(shown), dtype=float) * step - delay
        held = np.clip(np.floor(then / step + 1e-9).astype(int), 0, len(commands) - 1)
        before = states_before(states, then, step / parts)
        read = readings_at(machine, hypothesis, model, before, commands[held], threads)
        sensor = model.sensor(name)
        columns = slice(int(sensor.adr[0]), int(sensor.adr[0]) + int(sensor.dim[0]))
        shown[:, columns] = read[:, columns]


def commands_at(hypothesis: Hypothesis, clock: Array, controls: Array) -> Array:
    """Commands at the actuators at each step itself."""
    for effect, own in hypothesis.pairs:
        controls = effect.command_at(clock, controls, own)
    return controls


def readings_at(
    machine: NominalModel,
    hypothesis: Hypothesis,
    model: mujoco.MjModel,
    states: Mapping[str, Array],
    controls: Array,
    threads: int,
) -> Array:
    """Sensor values with instantaneous commands (T, sensors)."""
    batch = Batch(model, min(_AT_A_TIME, len(controls)), threads)
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
    sensed = batch.bind("sensordata")
    joints = [model.joint(name) for name in machine.joints]
    places = [int(joint.qposadr[0]) for joint in joints]
    dofs = [int(joint.dofadr[0]) for joint in joints]
    found = np.empty((len(controls), model.nsensordata))
    for first in range(0, len(controls), _AT_A_TIME):
        count = min(_AT_A_TIME, len(controls) - first)
        part = slice(first, first + count)
        for name, values in states.items():
            getattr(batch, name)[:count] = values[part]
        given = controls[part]
        if has_terms(hypothesis):
            at = states["qpos"][part][:, places], states["qvel"][part][:, dofs]
            given = Driven.of(hypothesis).commands(given, *at)
            batch.qfrc_applied[:count, dofs] = torque_terms(hypothesis, *at)
        batch.ctrl[:count, : controls.shape[1]] = given
        batch.forward()
        found[part] = sensed[:count]
    return found


_CHUNK = 2_000_000
"""Numbers recorded at a time."""
_AT_ONCE = 4_000_000
"""Numbers of commands, readings and states that are held at a time, 32 MB; more where a thread
would have no simulation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Slot:
    """One simulation: a run under a hypothesis."""

    key: object
    hypothesis: Hypothesis
    model: mujoco.MjModel
    number: int
    """Index of the run."""
    trial: Trial
    """The run."""
    parts: int
    """Number of substeps of each step of the run."""


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
        self._batches: dict[tuple[object, ...], Batch] = {}
        self.simulated = 0

    def predict(self, hypotheses: Sequence[Hypothesis]) -> list[list[Array]]:
        """Simulate every run under every hypothesis."""
        motions = {self._motion(hypothesis): hypothesis for hypothesis in hypotheses}
        alike: dict[tuple[object, ...], list[_Slot]] = {}
        for key, hypothesis in motions.items():
            parts = PARTS if changes_within(self.machine, hypothesis, self.channels) else 1
            models: dict[tuple[float, bool], mujoco.MjModel] = {}
            for t, trial in enumerate(self.trials):
                which = trial.step, trial.form == "free"
                if which not in models:
                    step = trial.step / parts
                    models[which] = hypothesis.model(self.machine, step, released=which[1])
                model = models[which]
                # what is stepped from Python costs by steps, whatever the number of simulations
                apart = -1 if has_terms(hypothesis) else trial.steps
                group = (_layout(model), which, apart, parts)
                slot = _Slot(
                    key=key, hypothesis=hypothesis, model=model, number=t, trial=trial, parts=parts
                )
                alike.setdefault(group, []).append(slot)
        seen: dict[tuple[object, int], tuple[mujoco.MjModel, Array]] = {}
        with quiet():
            for together in alike.values():
                for slots in _held_at_once(together, self.threads or os.cpu_count() or 1):
                    for slot, whole in zip(slots, self._simulate(slots), strict=True):
                        seen[slot.key, slot.number] = slot.model, whole
        return [
            [
                self._columns(hypothesis, *seen[self._motion(hypothesis), t], trial)
                for t, trial in enumerate(self.trials)
            ]
            for hypothesis in hypotheses
        ]

    @staticmethod
    def _motion(hypothesis: Hypothesis) -> object:
        """Key of the motion: hypotheses that differ in readings alone share it."""
        starts = (hypothesis.position, hypothesis.speed)
        return (
            hypothesis.factors.tobytes(),
            tuple(map(id, hypothesis.stepped_as)),
            *(
                (id(effect), values.tobytes())
                for effect, values in hypothesis.pairs
                if effect.moves or effect.sensor_delay(values) is not None
            ),
            *(None if start is None else start.tobytes() for start in starts),
        )

    def _simulate(self, slots: list[_Slot]) -> list[Array]:
        """Simulate the sensors at the samples (T, sensors), by slot."""
        batch = self._batch(slots)
        moved = with_terms(batch, self.machine, [slot.hypothesis for slot in slots])
        parts = slots[0].parts
        first = max((slot.trial for slot in slots), key=lambda trial: trial.steps).finer(parts)
        steps, settle = first.steps, round(SETTLE / first.step)
        self._set_start(batch, slots)
        controls = np.zeros((len(slots), steps, slots[0].model.nu))
        clock: Array = np.arange(steps, dtype=float) * first.step
        for k, slot in enumerate(slots):
            values, hypothesis = slot.trial.finer(parts).controls, slot.hypothesis
            count = len(values)
            for effect, own in hypothesis.pairs:
                values = effect.command(clock[:count], values, own)
            controls[k, :count, : values.shape[1]] = values
            controls[k, count:] = controls[k, count - 1]  # a shorter run ends there
            batch.act[k] = steady_activations(slot.model, controls[k, 0], slot.trial.step / parts)
        diverged = np.zeros(len(slots), dtype=bool)
        resting = np.array([slot.trial.resting for slot in slots])
        if resting.any() and settle:  # the clock runs on, since delayed commands are stored by time
            held = np.repeat(controls[resting, :1], settle, axis=1)
            diverged |= _advance(moved, settle, held, np.flatnonzero(resting), None)
        self.simulated += len(slots) * steps
        width = slots[0].model.nsensordata
        # where a command changes within a step, or a sensor is delayed, sensors are recomputed
        late = [late_sensors(slot.hypothesis, self.channels) for slot in slots]
        names = STATES if parts > 1 or any(late) else ()
        states: dict[str, list[Array]] = {name: [] for name in names}
        size = max(1, min(steps, _CHUNK // max(1, len(slots) * width)) // parts) * parts
        kept = np.empty((len(slots), -(-steps // parts), width))
        for start in range(0, steps, size):
            count = min(size, steps - start)
            records: dict[str, Array] = {}
            chunk = slice(start, start + count)
            before = {name: np.array(getattr(batch, name)) for name in names}
            diverged |= _advance(
                moved, count, controls[:, chunk], np.arange(len(slots)), records, names
            )
            for name, found in states.items():
                found += [before[name][:, None], records[name][:, :-1]]
            found_here = records["sensordata"][:, ::parts]
            kept[:, start // parts : start // parts + found_here.shape[1]] = found_here
        begun = {name: np.concatenate(found, axis=1) for name, found in states.items()}
        for k in np.flatnonzero(~diverged).tolist() if names else ():
            slot, count = slots[k], slots[k].trial.steps
            passed = {name: found[k, : count * parts] for name, found in begun.items()}
            commands = commands_at(
                slot.hypothesis, clock[: count * parts : parts], slot.trial.controls
            )
            shown, of = kept[k, :count], (self.machine, slot.hypothesis, slot.model)
            if parts > 1:
                at_steps = {name: found[::parts] for name, found in passed.items()}
                shown[:] = readings_at(*of, at_steps, commands, self.threads)
            show_late_sensors(
                shown, *of, passed, commands,
                late=late[k], step=slot.trial.step, parts=parts, threads=self.threads,
            )  # fmt: skip
        kept[diverged] = np.nan
        return [slot.trial.at_samples(k) for slot, k in zip(slots, kept, strict=True)]

    def _batch(self, slots: list[_Slot]) -> Batch:
        """Create a batch of as many slots, with these models."""
        key = (*_layout(slots[0].model), has_terms(slots[0].hypothesis), len(slots))
        if key not in self._batches:
            if len(self._batches) > 6:
                self._batches.clear()
            self._batches[key] = Batch(slots[0].model, len(slots), self.threads)
        batch = self._batches[key]
        batch.set_models([slot.model for slot in slots])
        return batch

    def _set_start(self, batch: Batch, slots: list[_Slot]) -> None:
        """Set every slot to the initial state of its run."""
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        qpos, qvel = batch.qpos, batch.qvel
        for k, slot in enumerate(slots):
            trial, hypothesis = slot.trial, slot.hypothesis
            at = [slot.model.joint(name) for name in self.machine.joints]
            places = [int(j.qposadr[0]) for j in at]
            dofs = [int(j.dofadr[0]) for j in at]
            position, speed = trial.position, trial.speed
            if hypothesis.position is not None:
                position = position + hypothesis.position[slot.number]
            if hypothesis.speed is not None:
                speed = speed + hypothesis.speed[slot.number]
            qpos[k] = slot.model.qpos0
            qpos[k, places] = position
            qvel[k] = 0.0
            qvel[k, dofs] = speed

    def _columns(
        self, hypothesis: Hypothesis, model: mujoco.MjModel, whole: Array, trial: Trial
    ) -> Array:
        """Channel values (T, C)."""
        readings: Readings = {}
        for column in dict.fromkeys(channel.column for channel in self.channels):
            prefix, _, name = column.partition(".")
            if prefix == "sensor":
                sensor = model.sensor(name)
                start, size = int(sensor.adr[0]), int(sensor.dim[0])
                values = whole[:, start : start + size]
                readings[column] = values[:, 0] if size == 1 else values
            else:
                forces = whole[:, model.nsensordata - len(self.machine.actuators) :]
                readings[column] = forces @ self.machine.gears(name)
        for effect, own in hypothesis.pairs:
            readings = effect.read(trial.time, readings, own)
        return np.stack(
            [
                readings[c.column] if c.axis is None else readings[c.column][:, c.axis]
                for c in self.channels
            ],
            axis=1,
        )


def _held_at_once(slots: list[_Slot], threads: int) -> Iterator[list[_Slot]]:
    """Parts of some slots that fit into the memory of `_AT_ONCE`, one for each thread at least."""
    model, parts = slots[0].model, slots[0].parts
    width = model.nsensordata + parts * (model.nu + model.nq + model.nv + model.na)
    each = max(slot.trial.steps for slot in slots) * max(width, 1)
    size = max(threads, _AT_ONCE // each)
    for start in range(0, len(slots), size):
        yield slots[start : start + size]


def _layout(model: mujoco.MjModel) -> tuple[object, ...]:
    """Key of the layout that two models must share in one batch."""
    sizes = (
        "nq", "nv", "nu", "na", "nbody", "njnt", "nsite", "nsensor", "nsensordata", "neq",
        "nhistory", "nM", "ngeom", "ntendon", "nJmom", "nC",
    )  # fmt: skip
    return (
        *(int(getattr(model, name, 0)) for name in sizes),
        tuple(model.jnt_bodyid),
        tuple(model.body_parentid),
        tuple(model.jnt_limited),
        tuple(model.dof_frictionloss > 0),
    )


def _advance(
    batch: Batch | BatchWithTerms,
    count: int,
    controls: Array,
    ids: NDArray[np.intp],
    records: dict[str, Array] | None,
    more: Sequence[str] = (),
) -> NDArray[np.bool_]:
    """Advance some slots; return the mask of diverged slots."""
    names = ("sensordata", *more) if records is not None else ("qpos",)
    diverged = np.zeros(batch.nsim, dtype=bool)
    try:
        out = batch.rollout(
            count,
            np.ascontiguousarray(controls),
            control_spec=int(mujoco.mjtState.mjSTATE_CTRL),
            record=names,
            ids=ids,
        )
    except SimulationError as error:
        raise InvalidData(f"MuJoCo cannot simulate the model: {error}") from error
    if records is not None:
        records.update(out)
    bad = ~np.isfinite(out[names[0]][:, -1]).all(axis=-1) | (
        np.abs(out[names[0]]).max(axis=(1, 2)) > 1e9
    )
    diverged[ids[bad]] = True
    return diverged
