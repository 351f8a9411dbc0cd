"""Exact fit: sets of effects in full simulation, window by window.

Windows start from the measured state, so that a simulation need not stay near the measurement for
long. Tolerances stay at what the cells say of them; the effects' parameters are refitted by
scipy's bounded least squares, each channel weighted by what is left in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.optimize import least_squares

from loose_env.gap.core.balance import Balance
from loose_env.gap.core.selection import LEAST_VALUES, SHARE_VALUES, Selection, SetFit
from loose_env.gap.core.tolerances import Nuisance
from loose_env.gap.model.effect import Effect, Parameter, free_of, values_of
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import Trial, align_run, channels_of, measured_runs
from loose_env.gap.simulator import Simulator
from loose_env.recording import Recording
from loose_env.statistics import noise_floor
from loose_env.typing import Array, IndexArray

WINDOW_S = 1.0
"""Length of a window [s]: a few periods of a joint's motion."""
_MOST_S = 16.0
"""Length of all windows of a recording, about: cost [s]."""
_ROUNDS = 2
"""Reweighted rounds of a fit."""
_EVALUATIONS = 3
"""Jacobians of one round."""
_STEP = 1e-3
"""Step of numerical derivatives, in free numbers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactFit:
    """A set of effects, fitted in simulation."""

    fit: SetFit
    """The set as its cells say."""
    values: tuple[Array, ...]
    """Parameter values of each effect."""
    spreads: tuple[Array, ...]
    """Standard deviations of their free numbers."""
    rms: Array
    """Residual of each channel [noise standard deviations] (C,)."""
    total: float
    """Minus twice the log posterior, as of `Selection`."""


class _Known(Effect):
    """Tolerances at what the cells say of them; an effect for the simulator alone."""

    kind = "tolerances"

    def __init__(self, machine: NominalModel, pulls: Sequence[tuple[Nuisance, float]]) -> None:
        self.machine, self.where, self.variant = machine, "", ""
        self._pulls = pulls

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """None."""
        return ()

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Apply each by its number of standard deviations."""
        spec.compiler.balanceinertia = True  # an inertia pulled alone may be that of no body
        for nuisance, deviations in self._pulls:
            if nuisance.edit is not None:
                nuisance.edit(spec, deviations)

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Shift the commands, linearly between steps."""
        found = controls.copy()
        for nuisance, deviations in self._pulls:
            if nuisance.late is not None:
                number, delay = nuisance.late
                at = time - deviations * delay
                found[:, number] = np.interp(at, time, controls[:, number])
        return found


class Exact:
    """Windows of the runs with commands, or free, for exact fits."""

    def __init__(
        self, recording: Recording, balance: Balance, *, threads: int = 1, between: bool = False
    ) -> None:
        self.balance, machine = balance, balance.machine
        pieces, _ = measured_runs(recording.runs, machine.model)
        runs = [run for each in pieces for run in each if run.comparison != "inverse"]
        self.channels = channels_of(runs)
        trials = [align_run(r, machine, self.channels, step=machine.time_step) for r in runs]
        floors = np.array(
            [[noise_floor(column) for column in trial.measured.T] for trial in trials]
        )
        self.noise = np.nanmedian(floors, axis=0)
        windows = [w for t in trials for w in _windows(t, balance, len(trials), between=between)]
        self.simulator = Simulator(machine, windows, self.channels, threads=threads)

    def fit(self, selection: Selection, fit: SetFit) -> ExactFit:
        """Fit the effects of a set in simulation."""
        machine, terms = self.balance.machine, fit.terms
        known = _Known(machine, _pulls(selection, fit))
        place = {k: i for i, k in enumerate(fit.numbers)}
        first = [
            term.values(fit.values[[place[k] for k in selection.evidence.columns_of(term)]])
            for term in terms
        ]
        groups = [term.effect.parameters for term in terms]
        free = np.concatenate([np.empty(0), *map(free_of, groups, first)])
        bounds = np.array([p.bounds for group in groups for p in group]).reshape(-1, 2)
        free = np.clip(free, bounds[:, 0] + 1e-9, bounds[:, 1] - 1e-9)
        cuts = np.cumsum([len(group) for group in groups])[:-1]

        def hypothesis(x: Array) -> Hypothesis:
            parts = np.split(x, cuts) if terms else []
            own = tuple(values_of(g, v) for g, v in zip(groups, parts, strict=True))
            effects = (known, *(term.effect for term in terms))
            return Hypothesis(effects=effects, values=(np.empty(0), *own))

        rows, channel = self._residuals([hypothesis(free)])[0]
        found, spread = free, np.zeros(len(free))
        for _ in range(_ROUNDS if len(free) else 0):
            level = np.maximum(_by_channel(rows, channel), 1.0)[channel]

            def weighted(x: Array, level: Array = level) -> Array:
                return np.clip(self._residuals([hypothesis(x)])[0][0] / level, -1e3, 1e3)

            def slopes(x: Array, level: Array = level) -> Array:
                moved = [x, *(x + _side(x, bounds) * row for row in np.eye(len(x)))]
                base, *others = (r for r, _ in self._residuals([hypothesis(m) for m in moved]))
                return np.stack(
                    [(o - base) / level / s for o, s in zip(others, _side(x, bounds), strict=True)],
                    axis=1,
                )

            solved = least_squares(
                weighted, found, slopes, (bounds[:, 0], bounds[:, 1]), x_scale="jac",
                loss="soft_l1", max_nfev=_EVALUATIONS,
            )  # fmt: skip
            found = solved.x
            rows = self._residuals([hypothesis(found)])[0][0]
            normal = solved.jac.T @ solved.jac + 1e-9 * np.eye(len(found))
            spread = np.sqrt(np.diag(np.linalg.inv(normal)))
        parts = np.split(found, cuts) if terms else []
        return ExactFit(
            fit=fit,
            values=tuple(values_of(g, v) for g, v in zip(groups, parts, strict=True)),
            spreads=tuple(np.split(spread, cuts)) if terms else (),
            rms=_by_channel(rows, channel),
            total=self._score(rows, channel) + selection.prior(terms),
        )

    def _residuals(self, hypotheses: Sequence[Hypothesis]) -> list[tuple[Array, IndexArray]]:
        """Residuals in noise standard deviations with their channels, one row a reading."""
        found = []
        for predicted in self.simulator.predict(hypotheses):
            rows, channels = [], []
            for trial, columns in zip(self.simulator.trials, predicted, strict=True):
                off = (trial.measured - columns) / self.noise
                seen = np.isfinite(trial.measured)
                rows.append(np.nan_to_num(off[seen], nan=1e6, posinf=1e6, neginf=-1e6))
                channels.append(np.nonzero(seen)[1])
            found.append((np.concatenate(rows), np.concatenate(channels)))
        return found

    def _score(self, rows: Array, channel: IndexArray) -> float:
        """Minus twice the log likelihood with a discrepancy in each channel."""
        windows, total = len(self.simulator.trials), 0.0
        for k in np.unique(channel):
            own = rows[channel == k]
            values = LEAST_VALUES * windows + SHARE_VALUES * len(own)
            total += values * np.log1p(max(float(own @ own) - len(own), 0.0) / values)
        return float(total)


def _by_channel(rows: Array, channel: IndexArray) -> Array:
    """Root mean square of each channel (C,)."""
    power = np.bincount(channel, rows**2) / np.maximum(np.bincount(channel), 1)
    return np.asarray(np.sqrt(power))


def _side(x: Array, bounds: Array) -> Array:
    """Steps of numerical derivatives, away from the upper bound."""
    return np.where(x + _STEP <= bounds[:, 1], _STEP, -_STEP)


def _pulls(selection: Selection, fit: SetFit) -> list[tuple[Nuisance, float]]:
    """Tolerances with their numbers of standard deviations."""
    evidence = selection.evidence
    pulls = evidence.mixed @ fit.values[: evidence.tolerances]
    return [(n, float(x)) for n, x in zip(evidence.nuisances, pulls, strict=True)]


def _windows(trial: Trial, balance: Balance, trials: int, *, between: bool) -> list[Trial]:
    """Windows of a run, evenly spread, each from the smoothed state at its beginning.

    Those between start halfway from one of them to the next.
    """
    length = float(trial.time[-1])
    count = int(np.clip(_MOST_S / WINDOW_S / trials, 1, max(length // WINDOW_S, 1)))
    starts = np.linspace(0.02 * length, max(0.98 * length - WINDOW_S, 0.0), count)
    if between and count > 1:
        starts = 0.5 * (starts[1:] + starts[:-1])
    run = next(r for r in balance.motion.runs if r.name == trial.name)
    found = []
    for start in starts:
        first = int(np.searchsorted(trial.time, start))
        last = int(np.searchsorted(trial.time, start + WINDOW_S))
        part = trial.between(first, max(last, first + 8))
        at = trial.time[first]
        middles = run.time + run.begin
        state = [
            np.array([np.interp(at, middles, column) for column in values.T])
            for values in (run.position, run.speed)
        ]
        found.append(replace(part, position=state[0], speed=state[1], resting=False))
    return found


def leading(selection: Selection, fit: SetFit, most: int = 4) -> list[SetFit]:
    """The answer and the best sets of other effects that were visited."""
    names: set[frozenset[tuple[str, str]]] = set()
    found = []
    for other in (fit, *sorted(selection.fits.values(), key=lambda f: f.total)):
        own = frozenset(term.name for term in other.terms)
        if other.allowed and own not in names:
            names.add(own)
            found.append(other)
    return found[:most]
