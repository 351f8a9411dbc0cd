"""Open-loop prediction error by horizon, with restarts from the measured state.

A restart takes the simulated state of the hypothesis at that time of the run and corrects it by the
prediction error of the joint sensors. Joints that are not measured, and coordinates added by an
effect, keep their simulated state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from loose_env.arms import quiet
from loose_env.gap.data.actuator_states import steady_activations
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.data.initial_rest import SETTLE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import BURN_IN, DIVERGED_RESIDUAL
from loose_env.gap.simulation.applied_torque_terms import STATES, BatchWithTerms, with_terms
from loose_env.gap.simulation.sensor_timing import (
    PARTS,
    changes_within,
    commands_at,
    late_sensors,
    readings_at,
    show_late_sensors,
)
from loose_env.gap.simulation.simulator import Simulator
from loose_env.gap.simulation.time_step import stepped
from loose_env.typing import Array

HORIZONS = (0.1, 0.5, 2.0)
"""Horizons of open-loop prediction [s]."""
_EVERY = 1.0
"""Time between restarts [s]."""
_AROUND = 0.03
"""Length of the readings that a restart goes by [s]; at least `_LEAST` samples."""
_LEAST = 5
_BEFORE = 0.3
"""Simulated readings before a restart that late sensors still show [s]."""


@dataclass(frozen=True, kw_only=True)
class HorizonError:
    """Open-loop prediction error over one horizon."""

    horizon: float
    """Length of the horizon [s]."""
    rms: float
    """Root mean square over all samples up to then, in noise standard deviations."""
    by_channel: dict[str, float]
    """Root mean square by channel."""
    starts: int
    """Number of restarts."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Whole:
    """A run simulated from its start to its end."""

    model: mujoco.MjModel
    controls: Array
    """Controls after delays and filters (steps, controls)."""
    states: dict[str, Array]
    """qpos, qvel, act at every step (steps, ...)."""
    shown: Array
    """Sensor values at the samples (T, sensors)."""


def horizon_errors(
    machine: NominalModel,
    trials: Sequence[Trial],
    channels: tuple[Channel, ...],
    floors: Array,
    hypothesis: Hypothesis,
    *,
    horizons: Sequence[float] = HORIZONS,
    every: float = _EVERY,
    threads: int = 0,
) -> tuple[HorizonError, ...]:
    """Compute open-loop prediction errors with restarts from the measured state."""
    longest = max(horizons)
    squares = np.zeros((len(horizons), len(channels)))
    counts, starts = np.zeros_like(squares), np.zeros(len(horizons), dtype=int)
    for t, trial in enumerate(trials):
        if trial.form == "inverse":
            continue
        simulator = Simulator(machine, [trial], channels, threads=threads)
        own = replace(
            hypothesis,
            position=None if hypothesis.position is None else hypothesis.position[t : t + 1],
            speed=None if hypothesis.speed is None else hypothesis.speed[t : t + 1],
        )
        begun = _starts(trial, every, min(horizons))
        trial = stepped(trial, machine, hypothesis.effects)
        if changes_within(machine, hypothesis, channels):
            trial = trial.finer(PARTS)
        with quiet():
            whole = _whole(simulator, own, trial)
            errors = _restarted(simulator, own, trial, whole, begun, longest, floors)
        for first, error in zip(begun, errors, strict=True):
            passed = trial.time[first : first + len(error)] - trial.time[first]
            left = float(trial.time[-1] - trial.time[first])
            for h, horizon in enumerate(horizons):
                if horizon > left * (1 + 1e-9):
                    continue
                part = error[(passed > 0) & (passed <= horizon * (1 + 1e-9))]
                squares[h] += np.nansum(part**2, axis=0)
                counts[h] += np.isfinite(part).sum(axis=0)
                starts[h] += 1
    return tuple(
        HorizonError(
            horizon=float(horizon),
            rms=float(np.sqrt(squares[h].sum() / counts[h].sum())),
            by_channel={
                channel.name: float(np.sqrt(squares[h, c] / counts[h, c]))
                for c, channel in enumerate(channels)
                if counts[h, c]
            },
            starts=int(starts[h]),
        )
        for h, horizon in enumerate(horizons)
        if counts[h].sum()
    )


def _starts(trial: Trial, every: float, shortest: float) -> NDArray[np.intp]:
    """Samples at which the simulation is restarted (S,)."""
    first = min(BURN_IN, 0.2 * float(trial.time[-1]))
    times = np.arange(first, float(trial.time[-1]) - shortest, every)
    return np.unique(np.searchsorted(trial.time, times))


def _whole(simulator: Simulator, hypothesis: Hypothesis, trial: Trial) -> _Whole:
    """Simulate a run from its start, and store every state."""
    machine = simulator.machine
    model = hypothesis.model(machine, trial.step, released=trial.form == "free")
    commanded = trial.controls
    clock: Array = np.arange(trial.steps, dtype=float) * trial.step
    for effect, values in hypothesis.pairs:
        commanded = effect.command(clock, commanded, values)
    controls = np.zeros((1, trial.steps, model.nu))
    controls[0, :, : commanded.shape[1]] = commanded
    batch = Batch(model, 1, simulator.threads)
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
    positions, dofs = _places(machine, model)
    batch.qpos[0] = model.qpos0
    batch.qpos[0, positions] = trial.position + (
        0.0 if hypothesis.position is None else hypothesis.position[0]
    )
    batch.qvel[0] = 0.0
    batch.qvel[0, dofs] = trial.speed + (0.0 if hypothesis.speed is None else hypothesis.speed[0])
    batch.act[0] = steady_activations(model, controls[0, 0], trial.step)
    moved = with_terms(batch, machine, [hypothesis])
    if trial.resting:
        held = np.repeat(controls[:, :1], round(SETTLE / trial.step), axis=1)
        _rollout(moved, held, ("qpos",))
        batch.time[:] = 0.0
    states, found = _followed(moved, batch, controls)
    shown = _shown(simulator, hypothesis, trial, model, np.arange(trial.steps)[None], states, found)
    return _Whole(
        model=model,
        controls=controls[0],
        states={name: values[0] for name, values in states.items()},
        shown=trial.at_samples(shown[0]),
    )


def _restarted(
    simulator: Simulator,
    hypothesis: Hypothesis,
    trial: Trial,
    whole: _Whole,
    starts: NDArray[np.intp],
    longest: float,
    floors: Array,
) -> list[Array]:
    """Errors (T', C) from each start, in noise deviations; the first row is the start."""
    if not len(starts):
        return []
    model, machine = whole.model, simulator.machine
    predicted = simulator._columns(hypothesis, model, whole.shown, trial)
    offset, drift = _corrections(simulator, trial, trial.measured - predicted, starts)
    at = np.minimum(np.round(trial.time[starts] / trial.step).astype(int), trial.steps - 1)
    count = min(round(longest / trial.step) + 2, trial.steps)
    passed = np.minimum(at[:, None] + np.arange(count), trial.steps - 1)
    controls = whole.controls[passed]
    batch = Batch(model, len(starts), simulator.threads)
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
    for name, values in whole.states.items():
        getattr(batch, name)[:] = values[at]
    positions, dofs = _places(machine, model)
    batch.qpos[:, positions] += offset
    batch.qvel[:, dofs] += drift
    batch.time[:] = trial.time[starts]
    moved = with_terms(batch, machine, [hypothesis] * len(starts))
    states, record = _followed(moved, batch, controls)
    earlier_states = [{n: v[:first] for n, v in whole.states.items()} for first in at]
    shown = _shown(simulator, hypothesis, trial, model, passed, states, record, earlier_states)
    found = []
    for k, first in enumerate(starts):
        until = trial.time[first] + longest * (1 + 1e-9)
        last = int(np.searchsorted(trial.time, until, side="right"))
        earlier = int(np.searchsorted(trial.time, trial.time[first] - _BEFORE))
        steps = trial.time[first:last] / trial.step - at[k]
        own = _between(shown[k], np.clip(steps, 0, count - 1))
        seen = np.vstack([whole.shown[earlier:first], own])
        beside = replace(trial, time=trial.time[earlier:last])
        read = simulator._columns(hypothesis, model, seen, beside)[first - earlier :]
        measured = trial.measured[first:last]
        error = np.clip((measured - read) / floors, -DIVERGED_RESIDUAL, DIVERGED_RESIDUAL)
        error[~np.isfinite(read) & np.isfinite(measured)] = DIVERGED_RESIDUAL
        found.append(error)
    return found


def _corrections(
    simulator: Simulator, trial: Trial, residual: Array, starts: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Prediction error of the joint sensors: positions and speeds (S, joints)."""
    machine = simulator.machine
    interval = float(np.median(np.diff(trial.time)))
    half = max(_LEAST // 2, round(0.5 * _AROUND / interval))
    offset = np.zeros((len(starts), len(machine.joints)))
    drift = np.zeros_like(offset)
    rates: set[int] = set()
    kinds = mujoco.mjtSensor
    for c, channel in enumerate(simulator.channels):
        prefix, _, name = channel.column.partition(".")
        if prefix != "sensor":
            continue
        sensor = machine.model.sensor(name)
        kind, joint = int(sensor.type[0]), int(sensor.objid[0])
        if kind not in (int(kinds.mjSENS_JOINTPOS), int(kinds.mjSENS_JOINTVEL)):
            continue
        for k, first in enumerate(starts):
            here = slice(max(0, first - half), first + half + 1)
            value, slope = _line(trial.time[here] - trial.time[first], residual[here, c])
            if kind == int(kinds.mjSENS_JOINTVEL):
                drift[k, joint] = value
            else:
                offset[k, joint] = value
                if joint not in rates:
                    drift[k, joint] = slope
        if kind == int(kinds.mjSENS_JOINTVEL):
            rates.add(joint)
    return offset, drift


def _line(time: Array, values: Array) -> tuple[float, float]:
    """Intercept and slope of a straight line; both 0 where nothing was read."""
    good = np.isfinite(values)
    if good.sum() < 3:
        return 0.0, 0.0
    slope, value = np.polyfit(time[good], values[good], 1)
    return float(value), float(slope)


def _places(machine: NominalModel, model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Addresses of the machine's joints in qpos and qvel."""
    at = [model.joint(name) for name in machine.joints]
    return [int(j.qposadr[0]) for j in at], [int(j.dofadr[0]) for j in at]


def _followed(
    moved: Batch | BatchWithTerms, batch: Batch, controls: Array
) -> tuple[dict[str, Array], dict[str, Array]]:
    """States at the beginning of every step (sims, steps, ...), and the record.

    MuJoCo records the state after a step, and the readings before it.
    """
    begin = {name: np.array(getattr(batch, name)) for name in STATES}
    found = _rollout(moved, controls, (*STATES, "sensordata"))
    states = {
        name: np.concatenate([begin[name][:, None], found[name][:, :-1]], axis=1) for name in STATES
    }
    return states, found


def _shown(
    simulator: Simulator,
    hypothesis: Hypothesis,
    trial: Trial,
    model: mujoco.MjModel,
    steps: NDArray[np.intp],
    states: dict[str, Array],
    found: dict[str, Array],
    earlier: Sequence[dict[str, Array]] | None = None,
) -> Array:
    """Sensor values (sims, steps, sensors).

    `steps` are those of the run which each simulation passes (sims, steps), `earlier` the states
    before the first of them, which delayed sensors show.
    """
    machine, threads, shown = simulator.machine, simulator.threads, found["sensordata"]
    within = changes_within(machine, hypothesis, simulator.channels)
    late = late_sensors(hypothesis, simulator.channels)
    if not (within or late):
        return shown
    clock = np.arange(trial.steps, dtype=float) * trial.step
    commands = commands_at(hypothesis, clock, trial.controls)
    for k in np.flatnonzero(np.isfinite(shown).all(axis=(1, 2))).tolist():
        own = {name: values[k] for name, values in states.items()}
        if within:
            shown[k] = readings_at(machine, hypothesis, model, own, commands[steps[k]], threads)
        first = 0
        if late and earlier is not None:
            first = len(earlier[k]["qpos"])
            own = {name: np.concatenate([earlier[k][name], values]) for name, values in own.items()}
        show_late_sensors(
            shown[k], machine, hypothesis, model, own, commands, late=late, step=trial.step,
            first=first, threads=threads,
        )  # fmt: skip
    return shown


def _between(values: Array, steps: Array) -> Array:
    """Interpolate values (steps, K) linearly at fractional steps (T,)."""
    low = np.minimum(np.floor(steps + 1e-6).astype(int), len(values) - 1)
    high = np.minimum(low + 1, len(values) - 1)
    share = np.clip(steps - low, 0.0, 1.0)[:, None]
    return np.asarray(values[low] * (1 - share) + values[high] * share)


def _rollout(
    batch: Batch | BatchWithTerms, controls: Array, names: tuple[str, ...]
) -> dict[str, Array]:
    """Advance every simulation; a diverged one is NaN from its start."""
    try:
        found = batch.rollout(
            controls.shape[1],
            np.ascontiguousarray(controls),
            control_spec=int(mujoco.mjtState.mjSTATE_CTRL),
            record=names,
            ids=np.arange(batch.nsim),
        )
    except SimulationError:
        return {
            name: np.full((*controls.shape[:2], batch.bind(name).shape[1]), np.nan)
            for name in names
        }
    out = {name: np.array(found[name], dtype=float) for name in names}
    for values in out.values():
        if values.shape[-1]:
            bad = ~np.isfinite(values).all(axis=(1, 2)) | (np.abs(values).max(axis=(1, 2)) > 1e9)
            values[bad] = np.nan
    return out
