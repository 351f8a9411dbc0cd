"""Trial: a measured run aligned with simulation steps; Channel: one compared scalar column."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import ceil

import mujoco
import numpy as np

from loose_env.gap.data.initial_rest import comes_to_rest, stays
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Run
from loose_env.statistics import noise_floor, resolution_of
from loose_env.typing import Array

_REGULAR = 0.02
"""Largest deviation of a stamp from an even grid, as a share of the sample interval, that counts
as even; or:"""
_ROUNDED = 0.75
"""The same as a share of what the stamps are rounded to: half of it, and a margin for the grid."""
_FINE = 0.25
"""Rounding of stamps over the sample interval, below which it does not hide a lost row."""
_REST = 0.01
"""How much of the beginning tells whether the arm rests there [s]; an arm may set off at once."""
_PARABOLA_S = 0.05
"""How far about the start of a window lines are drawn [s]."""
_BEYOND = 0.25
"""How far beyond readings a parabola through them is followed, as a share of what they span."""
AXES = {3: ("x", "y", "z")}


@dataclass(frozen=True)
class Channel:
    """One scalar column that is compared."""

    column: str
    """Column without the axis: "sensor.name" or "torque.name"."""
    axis: int | None = None
    """Axis: 0, 1, 2 for x, y, z of a vector."""

    @property
    def name(self) -> str:
        """Column name as in the recording, axis included."""
        return self.column if self.axis is None else f"{self.column}.{'xyz'[self.axis]}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One run, aligned for comparison with a simulation."""

    name: str
    """File of the run."""
    form: str
    """ "forward", "inverse" or "free"."""
    time: Array
    """Sample times [s], from 0 (T,)."""
    measured: Array
    """Readings of the channels; NaN where nothing was read (T, C)."""
    step: float
    """Simulation step [s]."""
    steps: int
    """Number of simulation steps from the first to the last sample, both included."""
    controls: Array
    """Commands at every step (steps, actuators); zero without commands."""
    position: Array
    """Joint positions at the first sample [rad, m] (joints,)."""
    speed: Array
    """Joint speeds at the first sample [rad/s, m/s] (joints,)."""
    resting: bool
    """Whether the arm is at rest at the first samples, held by its commands."""
    settles: bool = True
    """Whether the nominal model settles under constant commands."""
    joints: tuple[str, ...] = ()
    """Names of the joints, in the model's order."""
    excited: tuple[str, ...] = ()
    """Joints excited by random noise."""
    motion: dict[str, Array] = field(default_factory=dict)
    """Joint -> its measured position at the samples (T,); measured joints only."""

    @property
    def rate(self) -> float:
        """Mean sample rate [1/s]."""
        return (len(self.time) - 1) / float(self.time[-1])

    def finer(self, parts: int) -> Trial:
        """Copy with every step divided into a number of substeps."""
        if parts == 1:
            return self
        steps = (self.steps - 1) * parts + 1
        controls = np.repeat(self.controls, parts, axis=0)[:steps]
        return replace(self, step=self.step / parts, steps=steps, controls=controls)

    def coarser(self, most: int) -> Trial:
        """Copy with several steps merged, up to a number, that keeps all command changes.

        Samples and changes of commands stay at the beginning of a step.
        """
        return next((found for k in range(most, 1, -1) if (found := self._joined(k))), self)

    def _joined(self, parts: int) -> Trial | None:
        """Copy with steps merged; None where samples or commands come between."""
        at, steps = self.time / (self.step * parts), -(-(self.steps - 1) // parts) + 1
        controls = self.controls[::parts]
        between = np.any(np.abs(at - np.round(at)) > 1e-5)
        if between or np.any(np.repeat(controls, parts, axis=0)[: self.steps] != self.controls):
            return None
        controls = np.concatenate([controls, self.controls[-1:]])[:steps]
        return replace(self, step=self.step * parts, steps=steps, controls=controls)

    def until(self, seconds: float) -> Trial:
        """Beginning of the run, of a length in seconds; the whole if it is no longer."""
        count = int(np.searchsorted(self.time, seconds, side="right"))
        if count >= len(self.time):
            return self
        steps = ceil(float(self.time[count - 1]) / self.step - 1e-6) + 1
        return replace(
            self,
            time=self.time[:count],
            measured=self.measured[:count],
            steps=steps,
            controls=self.controls[:steps],
            motion={joint: values[:count] for joint, values in self.motion.items()},
        )

    def between(self, first: int, last: int) -> Trial:
        """Window of the run, from one sample to before another, as a run of its own.

        Its initial state is taken from parabolas through the measured motion about it; where a
        joint was not read there, from a straight line between its readings before and after.
        """
        if first <= 0 and last >= len(self.time):
            return self
        begun = round(float(self.time[first]) / self.step)
        time = self.time[first:last] - begun * self.step
        steps = ceil(float(time[-1]) / self.step - 1e-6) + 1
        position, speed, resting = self.position.copy(), np.zeros_like(self.speed), True
        for joint, values in self.motion.items():
            number = self.joints.index(joint)
            away = self.time - self.time[first]
            near = np.abs(away) <= max(_PARABOLA_S, 4.1 / self.rate)
            if _tells(away[near], values[near]):
                position[number], speed[number], still = _line(away[near], values[near], whole=True)
            elif np.isfinite(values).any():
                position[number], speed[number], still = _across(away, values)
            else:
                continue  # never read: the initial position of the run is the best estimate
            resting &= still
        controls = self.controls[begun : begun + steps]
        before = self.controls[max(begun - 50, 0) : begun + 1]  # no column without actuators
        resting &= not np.ptp(before, axis=0).any()
        resting &= self.settles
        return replace(
            self,
            time=time,
            measured=self.measured[first:last],
            steps=len(controls),
            controls=controls,
            position=position,
            speed=np.zeros_like(speed) if resting else speed,
            resting=resting,
            motion={joint: values[first:last] for joint, values in self.motion.items()},
        )

    def at_samples(self, values: Array) -> Array:
        """Interpolate values at the steps (..., steps, C) to the samples (..., T, C)."""
        at = np.clip(self.time / self.step, 0, self.steps - 1)
        low = np.minimum(np.floor(at + 1e-6).astype(int), self.steps - 1)
        high = np.minimum(low + 1, self.steps - 1)
        share = np.clip(at - low, 0.0, 1.0)[:, None]
        if np.all(share < 1e-5):
            return np.asarray(values[..., low, :])
        return np.asarray(values[..., low, :] * (1 - share) + values[..., high, :] * share)


def channels_of(runs: list[Run]) -> tuple[Channel, ...]:
    """List every column of any run, in the order of its first appearance."""
    found: dict[Channel, None] = {}
    for run in runs:
        for prefix, columns in (("sensor", run.sensors), ("torque", run.torques)):
            for name, values in columns.items():
                axes = [None] if values.ndim == 1 else list(range(values.shape[1]))
                for axis in axes:
                    found[Channel(f"{prefix}.{name}", axis)] = None
    return tuple(found)


def _even_interval(time: Array) -> float | None:
    """Sample interval [s] of stamps (T,) that are even but for rounding; None if they are not."""
    number = np.arange(len(time))
    interval, first = np.polyfit(number, time - time[0], 1)
    off = float(np.max(np.abs(time - time[0] - first - interval * number)))
    rounded = _resolution(time)
    rounding = rounded if rounded < _FINE * interval else 0.0
    return float(interval) if off <= max(_REGULAR * interval, _ROUNDED * rounding) else None


def _resolution(time: Array) -> float:
    """What time stamps (T,) are rounded to: the largest of 10 ms, 1 ms, ... [s]; 0 if finer."""
    spacing = float(np.spacing(np.max(np.abs(time))))
    for digits in range(2, 8):
        counts = (time - time[0]) * 10**digits
        if np.all(np.abs(counts - np.round(counts)) <= 1e-3 + spacing * 10**digits):
            return float(10.0**-digits)
    return 0.0


def align_run(
    run: Run, machine: NominalModel, channels: tuple[Channel, ...], *, step: float
) -> Trial:
    """Align a run with simulation steps.

    Commands are held from the step nearest to their sample to that of the next. A missing command
    keeps the one before. Stamps that are even but for their rounding become even.
    """
    time, interval = run.time - run.time[0], _even_interval(run.time)
    if interval is not None:
        time = interval * np.arange(len(time))
        step = interval / ceil(interval / step * (1 - 1e-9))
    steps = ceil(float(time[-1]) / step - 1e-6) + 1
    measured = np.full((len(time), len(channels)), np.nan)
    for k, channel in enumerate(channels):
        prefix, _, name = channel.column.partition(".")
        values = (run.sensors if prefix == "sensor" else run.torques).get(name)
        if values is not None:
            measured[:, k] = values if channel.axis is None else values[:, channel.axis]
    controls = np.zeros((steps, len(machine.actuators)))
    held = np.searchsorted(time, (np.arange(steps) + 0.5) * step, side="right") - 1
    for k, name in enumerate(machine.actuators):
        if name in run.controls:
            controls[:, k] = _filled(run.controls[name])[held]
    position, speed, resting, motion = _start(run, machine, time)
    forward = run.comparison == "forward"  # a free arm is released
    settles = not forward or comes_to_rest(machine, position, controls[0])
    commands = np.column_stack([_filled(values) for values in run.controls.values()] or [time * 0])
    resting = resting and forward and settles
    resting = resting and all(stays(time, each, commands) for each in motion.values())
    return Trial(
        name=run.name,
        form=run.comparison,
        time=time,
        measured=measured,
        step=step,
        steps=steps,
        controls=controls,
        position=position,
        speed=speed,
        resting=resting,
        settles=settles,
        joints=machine.joints,
        excited=tuple(run.excited),
        motion=motion,
    )


def _filled(values: Array) -> Array:
    """Forward-fill gaps in values; those at the start take the first value."""
    good = np.isfinite(values)
    if good.all():
        return values
    at = np.maximum.accumulate(np.where(good, np.arange(len(values)), -1))
    return np.asarray(values[np.where(at < 0, np.argmax(good), at)])


def _start(
    run: Run, machine: NominalModel, time: Array
) -> tuple[Array, Array, bool, dict[str, Array]]:
    """Position, speed and rest at the first sample, and the measured motion."""
    model = machine.model
    position, speed = model.qpos0.copy(), np.zeros(model.nv)
    resting, motion = True, {}
    for k, joint in enumerate(machine.joints):
        if run.pose and joint in run.pose:
            position[k] = run.pose[joint]
    for name, values in run.sensors.items():
        sensor = model.sensor(name)
        if int(sensor.type[0]) == mujoco.mjtSensor.mjSENS_JOINTPOS:
            if not np.isfinite(values).any():
                continue  # never read: the noted pose stays
            number = int(sensor.objid[0])
            motion[machine.joints[number]] = values
            position[number], speed[number], still = _line(time, values)
            resting &= still
    for name, values in run.sensors.items():
        sensor = model.sensor(name)
        if int(sensor.type[0]) == mujoco.mjtSensor.mjSENS_JOINTVEL:
            first = values[: max(3, int(np.searchsorted(time, 0.005)))]
            if np.isfinite(first).any():
                number = int(sensor.objid[0])
                speed[number] = float(np.nanmean(first))
                moves = abs(speed[number]) > 4.0 * noise_floor(values)
                encoder = motion.get(machine.joints[number])
                resting &= not (moves and _allows(time, encoder, speed[number]))
    if resting:
        speed[:] = 0.0
    return position, speed, resting, motion


def _tells(time: Array, values: Array) -> bool:
    """Return whether readings (T,) cover time 0 well enough for a parabola."""
    read = time[np.isfinite(values)]
    return len(read) >= 4 and max(read[0], -read[-1]) <= _BEYOND * (read[-1] - read[0])


def _across(time: Array, values: Array) -> tuple[float, float, bool]:
    """Value and slope at time 0 by a line across a gap in readings, and whether flat.

    Before the first reading and after the last one it is flat.
    """
    good = np.isfinite(values)
    t, v = time[good], values[good]
    after = int(np.searchsorted(t, 0.0))
    if after in (0, len(t)):
        return float(v[min(after, len(t) - 1)]), 0.0, True
    change, apart = float(v[after] - v[after - 1]), float(t[after] - t[after - 1])
    if abs(change) <= 4.0 * noise_floor(values):
        return float(v[after - 1] + v[after]) / 2, 0.0, True
    slope = change / apart
    return float(v[after - 1] - slope * t[after - 1]), slope, False


def _allows(time: Array, positions: Array | None, speed: float) -> bool:
    """Return whether readings that look at rest are too coarse to contradict a speed."""
    if positions is None:
        return True
    travel = abs(speed) * float(time[_count(time) - 1] - time[0])
    return travel <= resolution_of(positions) + 4.0 * noise_floor(positions)


def _count(time: Array) -> int:
    """Number of the first samples, from which the start is read."""
    return int(np.clip(np.searchsorted(time, _REST), 8, len(time)))


def _line(time: Array, values: Array, *, whole: bool = False) -> tuple[float, float, bool]:
    """Value and slope at time 0 by a parabola, and whether it is at rest there.

    Fitted to the first samples, or to all of them. At rest means a slope of less than three
    standard errors.
    """
    count = len(time) if whole else _count(time)
    good = np.isfinite(values[:count])
    if good.sum() < 4:
        good = np.isfinite(values)
        return float(values[good][0]) if good.any() else 0.0, 0.0, True
    t, v = time[:count][good], values[:count][good]
    terms = np.stack([np.ones_like(t), t, t**2], axis=1)
    found, *_ = np.linalg.lstsq(terms, v, rcond=None)
    scatter = float(np.sqrt(np.sum((v - terms @ found) ** 2) / max(len(v) - 3, 1))) + 1e-9
    error = scatter * float(np.sqrt(np.linalg.pinv(terms.T @ terms)[1, 1]))
    still = abs(float(found[1])) < 3 * error
    return float(found[0]), 0.0 if still else float(found[1]), still
