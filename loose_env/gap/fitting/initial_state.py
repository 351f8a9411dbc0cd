"""Initial states of runs, estimated from noisy sensors and fitted as nuisance parameters.

A free response, or a run that begins in motion, is simulated from its measured first samples. Their
errors are fitted with every hypothesis and never reported as an effect. A run depends on its own
initial state only, so all runs share the simulations of the sensitivities: two for each joint,
however many runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.statistics import noise_floor
from loose_env.typing import Array

if TYPE_CHECKING:
    from loose_env.gap.model.hypothesis import Hypothesis
    from loose_env.gap.residuals.residual_model import ResidualModel


_LINE = 0.05
"""How much of a run the first state is taken from [s]."""
_FURTHEST = 30.0
"""How far a start may be off, in standard deviations."""
_MEMORY_S = (3.0, 12.0)
"""How much of a run is simulated for what its initial state changes [s]; all of it where that still
shows at the end."""
_TAIL_SHARE = 0.75
"""Share of the beginning after which nothing of it may show."""
_ITERATIONS = 3
"""Gauss-Newton iterations of initial states alone."""
_MEMORY_TOLERANCE = 0.01
"""Change by a standard deviation of the initial state that does not show [noise standard
deviations]."""


class InitialStates:
    """Offsets of the measured initial position and speed, for the joints of each run."""

    def __init__(
        self, machine: NominalModel, trials: Sequence[Trial], channels: tuple[Channel, ...]
    ) -> None:
        self.machine = machine
        self.trials, self.channels = tuple(trials), channels

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Indices of the runs that do not start at rest."""
        return tuple(
            t
            for t, trial in enumerate(self.trials)
            if trial.form == "free"
            or (trial.form == "forward" and not trial.resting and _compared_at_once(trial))
        )

    @cached_property
    def _lengths(self) -> tuple[float, ...]:
        """Lengths of beginnings that are tried [s]; a free response seldom forgets its own."""
        driven = any(self.trials[t].form != "free" for t in self.moving)
        return (*_MEMORY_S, np.inf) if driven else (np.inf,)

    @cached_property
    def spreads(self) -> Array:
        """Standard deviation of the measured initial state (runs, 2, joints)."""
        return np.array([_spread(self.machine, self.trials[t], self.channels) for t in self.moving])

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters: by run, position of every joint, speed of every joint."""
        found = []
        for k, t in enumerate(self.moving):
            for which, name in enumerate(("position", "speed")):
                for j, joint in enumerate(self.machine.joints):
                    spread = float(self.spreads[k, which, j])
                    unit = ("rad" if self.machine.turns(joint) else "m") + ("", "/s")[which]
                    found.append(
                        Parameter(
                            name=f"{name}.{joint}.{self.trials[t].name}", unit=unit,
                            low=-_FURTHEST * spread, high=_FURTHEST * spread, scale=spread,
                            centre=0.0, spread=1.0,
                        )
                    )  # fmt: skip
        return tuple(found)

    def offsets(self, values: Array) -> tuple[Array, Array]:
        """Offsets of the measured initial positions and speeds (trials, joints) each."""
        found = np.zeros((2, len(self.trials), len(self.machine.joints)))
        if self.moving:
            own = np.reshape(values, (len(self.moving), 2, len(self.machine.joints)))
            found[:, list(self.moving)] = own.swapaxes(0, 1)
        return found[0], found[1]

    def sensitivities(
        self,
        comparison: ResidualModel,
        hypothesis: Hypothesis,
        residual: Array,
        *,
        difference: float = 0.05,
    ) -> Array:
        """Jacobian of the residual in the initial states (N, P), all runs at a time."""
        joints = len(self.machine.joints)
        found = np.zeros((len(residual), len(self.parameters)))
        if not self.moving:
            return found
        at = [
            np.zeros((len(self.trials), joints)) if start is None else start
            for start in (hypothesis.position, hypothesis.speed)
        ]
        tried = []
        for which in range(2):
            for j in range(joints):
                moved = [start.copy() for start in at]
                moved[which][list(self.moving), j] += difference * self.spreads[:, which, j]
                tried.append(_with_start(hypothesis, moved[0], moved[1]))
        for t, own, changes in self._changes(comparison, hypothesis, tried):
            k = self.moving.index(t)
            found[own, k * 2 * joints : (k + 1) * 2 * joints] = changes.T / difference
        return found

    def _changes(
        self, comparison: ResidualModel, hypothesis: Hypothesis, tried: Sequence[Hypothesis]
    ) -> Iterator[tuple[int, NDArray[np.intp], Array]]:
        """Index of a run, rows of its beginning (n,), and their changes (tried, n), by run.

        A machine with servos or friction forgets its initial state: what follows is not simulated.
        """
        places = {int(run): k for k, run in enumerate(comparison.runs)}
        left = [t for t in self.moving if t in places]
        for seconds in self._lengths:
            if not left:
                return
            part = comparison.beginnings(tuple(places[t] for t in left), seconds)
            before, *after = part.residuals([hypothesis, *tried])
            persistent, late = [], _at_the_end(part)
            for k, t in enumerate(left):
                own = part.rows.trial == k
                changes = np.array([residual[own] - before[own] for residual in after])
                shown = np.abs(changes[:, late[own]]).max(initial=0.0) > _MEMORY_TOLERANCE
                if shown and len(part.trials[k].time) < len(comparison.trials[places[t]].time):
                    persistent.append(t)
                    continue
                rows = np.flatnonzero(comparison.rows.trial == places[t])
                yield t, rows[: own.sum()], changes
            left = persistent

    def fitted(self, comparison: ResidualModel, hypothesis: Hypothesis) -> tuple[Hypothesis, Array]:
        """Fit the initial states alone, for runs outside the training data."""
        free = np.zeros(len(self.parameters))
        moving = tuple(k for k, run in enumerate(comparison.runs) if int(run) in self.moving)
        for seconds in self._lengths if moving else ():
            part = comparison.beginnings(moving, seconds)
            free, persistent = self._fitted_on(part, hypothesis, free)
            whole = all(
                len(trial.time) == len(comparison.trials[k].time)
                for k, trial in zip(moving, part.trials, strict=True)
            )
            if whole or not persistent:
                break
        now = self._at(hypothesis, free)
        return now, comparison.residuals([now])[0]

    def _fitted_on(
        self, part: ResidualModel, hypothesis: Hypothesis, free: Array
    ) -> tuple[Array, bool]:
        """Free numbers fitted to the beginnings of runs, and whether they show at the end."""
        now = self._at(hypothesis, free)
        residual, jacobian = part.residuals([now])[0], None
        for _ in range(_ITERATIONS):
            jacobian = self.sensitivities(part, now, residual)
            curvature = jacobian.T @ jacobian + np.eye(len(free))
            step = -np.linalg.solve(curvature, jacobian.T @ residual + free)
            tried = [np.clip(free + share * step, -_FURTHEST, _FURTHEST) for share in (1.0, 0.3)]
            found = part.residuals([self._at(hypothesis, f) for f in tried])
            costs = [float(r @ r + f @ f) for r, f in zip(found, tried, strict=True)]
            before = float(residual @ residual + free @ free)
            best = int(np.argmin(costs))
            if costs[best] >= before:
                break
            free, residual = tried[best], found[best]
            now = self._at(hypothesis, free)
            if before - costs[best] < 1e-3 * before:
                break
        late = _at_the_end(part)
        shown = jacobian is not None and np.abs(jacobian[late]).max(initial=0.0) > _MEMORY_TOLERANCE
        return free, bool(shown)

    def _at(self, hypothesis: Hypothesis, free: Array) -> Hypothesis:
        if not self.moving:
            return replace(hypothesis, position=None, speed=None)
        scales = np.array([p.scale for p in self.parameters])
        return _with_start(hypothesis, *self.offsets(free * scales))


def _compared_at_once(trial: Trial) -> bool:
    """Return whether the first samples count; those of a window are transient."""
    return bool(np.isfinite(trial.measured[: max(1, round(_LINE * trial.rate))]).any())


def _at_the_end(part: ResidualModel) -> NDArray[np.bool_]:
    """Mask of the rows (N,) at the ends of some beginnings."""
    found = np.zeros(len(part), dtype=bool)
    for k, trial in enumerate(part.trials):
        own = part.rows.trial == k
        found[own] = trial.time[part.rows.sample[own]] > _TAIL_SHARE * trial.time[-1]
    return found


def _with_start(hypothesis: Hypothesis, position: Array, speed: Array) -> Hypothesis:
    """Replace the initial states of a hypothesis."""
    return replace(hypothesis, position=position, speed=speed)


def _spread(machine: NominalModel, trial: Trial, channels: tuple[Channel, ...]) -> Array:
    """Standard deviation of a run's measured initial state (2, joints).

    That of a straight line through the first samples by its noise, and by its distance from a
    parabola: an accelerating arm deviates from the line. A measured speed has the accuracy of its
    sensor.
    """
    count = int(np.clip(np.searchsorted(trial.time, _LINE), 6, len(trial.time)))
    time = trial.time[:count]
    reach = float(time[-1])
    loads = np.maximum(machine.load_scales / machine.inertias, 1e-9)
    # Without readings: the range that the joint's typical load can reach.
    found = np.stack([loads * reach**2, loads * reach])
    read = np.zeros(len(machine.joints), dtype=bool)
    for k, channel in enumerate(channels):
        prefix, _, name = channel.column.partition(".")
        values = trial.measured[:, k]
        good = np.isfinite(values[:count])
        if prefix != "sensor" or good.sum() < 4:
            continue
        sensor = machine.model.sensor(name)
        kind, joint = int(sensor.type[0]), int(sensor.objid[0])
        floor = noise_floor(values)
        if not np.isfinite(floor):
            continue  # too few readings
        if kind == mujoco.mjtSensor.mjSENS_JOINTPOS:
            line = np.polyfit(time[good], values[:count][good], 1)[::-1]
            bent = np.polyfit(time[good], values[:count][good], 2)[::-1]
            seen = np.sqrt(good.sum())
            found[0, joint] = np.hypot(3 * floor / seen, line[0] - bent[0])
            if not read[joint]:
                found[1, joint] = np.hypot(14 * floor / seen / reach, line[1] - bent[1])
        elif kind == mujoco.mjtSensor.mjSENS_JOINTVEL:
            first = max(3, int(np.searchsorted(trial.time, 0.005)))
            known = int(good[:first].sum())
            if not known:
                continue  # not read at the start of the run: the speed is not from this sensor
            short = np.ptp(values[:count][good][: 2 * first])
            found[1, joint] = np.hypot(floor / np.sqrt(known), short)
            read[joint] = True
    return found
