"""Exact fit: sets of effects in full simulation, window by window.

Windows start from the measured state, so that a simulation need not stay near the measurement for
long, and are compared after a lead that late commands take. Tolerances stay at what the cells say
of them; the effects' parameters are refitted by scipy's bounded least squares, each channel
weighted by what is left in it. Where cells leave a joint open, which stands still, is at its limit
or strikes stops, sets are searched in simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.optimize import least_squares

from loose_env.gap.core.balance import Balance
from loose_env.gap.core.catalogue import Term, at_joint
from loose_env.gap.core.evidence import is_exact
from loose_env.gap.core.selection import (
    EXPLAINED,
    LEAST_VALUES,
    SHARE_VALUES,
    Selection,
    Set,
    SetFit,
)
from loose_env.gap.model.effect import free_of, values_of
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.effects.drives import DriveLimit
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import Trial, align_run, channels_of, measured_runs
from loose_env.gap.simulator import Simulator
from loose_env.recording import Recording
from loose_env.statistics import noise_floor
from loose_env.typing import Array, IndexArray

WINDOW_S = 1.0
"""Length of a window [s]: a few periods of a joint's motion, before errors of its start grow."""
_MOST_S = 16.0  # length of all windows of a recording, about: cost [s]
LEAD_S = 0.3
"""Time from the measured state to what is compared: longer than most drives are late [s]."""
LARGE = 3.0
"""Residual from which something is left [noise standard deviations]: 1 in 370 by chance."""
_ROUNDS = 2  # reweighted rounds of a fit
_EVALUATIONS = 3  # jacobians of one round
_MOST_KINDS = 6  # kinds of effect in a set that is searched for in simulation
_TRIED = 3  # effects that are fitted in one step of that search
_GUESSED = 4  # windows in which starts are compared, at least
_LEAST_GAIN = 0.5  # fall of the total for which a step is taken
_MOST_STEPS = 1e7  # steps of simulations after which a search ends with the best set so far: cost
_PULLED = 0.1  # standard deviations from which a pull of a tolerance is simulated
_STEP = 1e-3  # step of numerical derivatives, in free numbers


Start = tuple[Set, tuple[Array, ...]]
"""Effects, and the values from which they are fitted."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactFit:
    """A set of effects, fitted in simulation."""

    terms: Set  # The effects
    values: tuple[Array, ...]  # Parameter values of each effect
    spreads: tuple[Array, ...]  # Standard deviations of their free numbers
    rms: Array  # Residual of each channel [noise standard deviations] (C,)
    total: float  # Minus twice the log posterior, as of `Selection`


class Exact:
    """Windows of the runs with commands, or free, for exact fits."""

    def __init__(
        self,
        recording: Recording,
        balance: Balance,
        *,
        law: float = 0.0,  # What the law of an effect misses, as a share of what it changes
        threads: int = 1,
        between: bool = False,
    ) -> None:
        self.balance, machine = balance, balance.machine
        pieces, _ = measured_runs(recording.runs, machine.model)
        runs = [run for run in pieces if run.comparison != "inverse"]
        self.channels = channels_of(runs)
        trials = [align_run(r, machine, self.channels, step=machine.time_step) for r in runs]
        floors = np.array(
            [[noise_floor(column) for column in trial.measured.T] for trial in trials]
        )
        self.noise = np.nanmedian(floors, axis=0)
        windows = [w for t in trials for w in _windows(t, balance, len(trials), between=between)]
        self.simulator = self._nominal = Simulator(machine, windows, self.channels, threads=threads)
        self.steps = [0]  # of all simulations, also of those on some windows
        self.law = law
        self._known: dict[object, Array] = {}

    def fit(self, selection: Selection, fit: SetFit) -> ExactFit:
        """Fit the effects of a set in simulation, from what the cells say of them."""
        return self.beside(selection, fit).refit(selection, fit.terms, selection.values_in(fit))

    def beside(self, selection: Selection, fit: SetFit) -> Exact:
        """The same with the tolerances at what the cells say of them beside a set."""
        own = self._nominal
        pulls = [(n, x) for n, x in selection.pulls(fit) if abs(x) > _PULLED]
        spec = own.machine.fresh()
        spec.compiler.balanceinertia = True  # an inertia pulled alone may be that of no body
        for nuisance, deviations in pulls:
            if nuisance.edit is not None:
                nuisance.edit(spec, deviations)
        late = [(*n.late, deviations) for n, deviations in pulls if n.late is not None]
        trials = [_shifted(trial, late) for trial in own.trials]
        machine = replace(own.machine, spec=spec)
        return self._of(machine, trials)

    def _of(self, machine: NominalModel, trials: Sequence[Trial]) -> Exact:
        """The same with simulations of another model, or of other windows."""
        found, threads = copy(self), self.simulator.threads
        found.simulator = Simulator(machine, trials, self.channels, threads=threads)
        found._known = {}
        return found

    def refit(
        self, selection: Selection, terms: Set, first: Sequence[Array], rounds: int = _ROUNDS
    ) -> ExactFit:
        """Fit effects in simulation from given values, beside the known tolerances."""
        groups = [term.effect.parameters for term in terms]
        free = np.concatenate([np.empty(0), *map(free_of, groups, first)])
        bounds = np.array([p.bounds for group in groups for p in group]).reshape(-1, 2)
        free = np.clip(free, bounds[:, 0] + 1e-9, bounds[:, 1] - 1e-9)
        cuts = np.cumsum([len(group) for group in groups])[:-1]

        def hypothesis(x: Array) -> Hypothesis:
            parts = np.split(x, cuts) if terms else []
            return self._hypothesis(terms, list(map(values_of, groups, parts)))

        rows, channel = self._residuals([hypothesis(free)])[0]
        found, spread = free, np.zeros(len(free))
        for _ in range(rounds if len(free) else 0):
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
            # rows repeat a discrepancy, which counts for as many values as in the likelihood
            count = np.bincount(channel)
            share = (self._values(count) / np.maximum(count, 1))[channel]
            normal = solved.jac.T @ (share[:, None] * solved.jac)
            # that values lie anywhere between their bounds is known, too
            normal += np.diag(12 / np.diff(bounds)[:, 0] ** 2)
            spread = np.sqrt(np.diag(np.linalg.inv(normal)))
        values = tuple(map(values_of, groups, np.split(found, cuts) if terms else []))
        return ExactFit(
            terms=terms,
            values=values,
            spreads=tuple(np.split(spread, cuts)) if terms else (),
            rms=_by_channel(rows, channel),
            total=self._score(terms, values, rows, channel) + selection.prior(terms),
        )

    def searched(
        self,
        selection: Selection,
        best: ExactFit,
        pool: Sequence[Start],
        joints: int,
        leaves_open: Callable[[ExactFit], bool],
        say: Callable[[str], None],
    ) -> list[ExactFit]:
        """Add, remove and exchange effects of a pool in simulation; all sets, the best first."""
        # They are exchanged only while they leave open one of the joints that they should explain.
        visited, count = [best], len(self.simulator.trials)
        # guesses take as long for many joints as for one
        some = self.on(range(0, count, max(min(1 + joints, count // _GUESSED), 1)))

        def likely(by: Exact, starts: Sequence[Start]) -> list[ExactFit]:
            guesses = by._totals(selection, [s for s, _ in starts], [v for _, v in starts])
            tried: dict[frozenset[tuple[str, str]], ExactFit] = {}
            for k in np.argsort(guesses):
                names = frozenset(term.name for term in starts[k][0])
                if len(tried) < _TRIED and names not in tried:
                    terms, first = starts[k]
                    tried[names] = self.refit(selection, terms, first, 1)
            visited.extend(tried.values())
            return list(tried.values())

        def with_more(rest: ExactFit) -> ExactFit:
            forms = {term.form for term in rest.terms}
            new = [own for own in pool if not forms & {term.form for term in own[0]}]
            starts = [((*rest.terms, *terms), (*rest.values, *values)) for terms, values in new]
            return min(likely(some, starts), key=lambda f: f.total, default=rest)

        def with_fewer() -> list[ExactFit]:
            members = range(len(best.terms))
            kinds = [term.effect.kind for term in best.terms]
            parts: set[tuple[int, ...]] = {(k,) for k in members}
            parts |= {tuple(k for k in members if kinds[k] == kind) for kind in kinds}
            rests = [[k for k in members if k not in part] for part in sorted(parts)]
            starts = [
                (tuple(best.terms[k] for k in rest), tuple(best.values[k] for k in rest))
                for rest in rests
            ]
            return likely(self, starts)

        while True:
            fewer = with_fewer() if best.terms else []
            more = [best] if len({t.effect.kind for t in best.terms}) < _MOST_KINDS else []
            # a member that stands in for another one is exchanged when nothing else helps
            exchanged = fewer if leaves_open(best) else []
            steps = chain(fewer, map(with_more, more), map(with_more, exchanged))
            better = (step for step in steps if step.total < best.total - _LEAST_GAIN)
            top = next(better, None) if self.steps[0] < _MOST_STEPS else None
            if top is None:
                return sorted(visited, key=lambda f: f.total)
            say(f"simulated: {', '.join(repr(term.effect) for term in top.terms)}")
            best = self.refit(selection, top.terms, top.values)
            visited.append(best)

    def only(self, selection: Selection, fit: ExactFit, kept: Sequence[int]) -> ExactFit:
        """Fit some members of a set."""
        own = tuple(fit.terms[k] for k in kept)
        return self.refit(selection, own, [fit.values[k] for k in kept], 1)

    def by_joint(self) -> dict[int, int]:
        """Joints with their channels of positions."""
        encoders, columns = self.balance.encoders, [c.column for c in self.channels]
        return {
            joint: columns.index(f"sensor.{name}")
            for name, joint in encoders.items()
            if f"sensor.{name}" in columns
        }

    def on(self, windows: Sequence[int]) -> Exact:
        """The same on some of the windows."""
        own = self.simulator
        return self._of(own.machine, [own.trials[k] for k in windows])

    def score(self, fit: ExactFit) -> tuple[float, Array]:
        """Minus twice the log likelihood of the windows for a fit, and its residuals (C,)."""
        rows, channel = self._residuals([self._hypothesis(fit.terms, fit.values)])[0]
        return self._score(fit.terms, fit.values, rows, channel), _by_channel(rows, channel)

    def _totals(
        self, selection: Selection, sets: Sequence[Set], values: Sequence[Sequence[Array]]
    ) -> list[float]:
        """Totals of sets at some values."""
        found = self._residuals(list(map(self._hypothesis, sets, values)))
        each = zip(sets, values, found, strict=True)
        return [self._score(own, at, *rows) + selection.prior(own) for own, at, rows in each]

    def _hypothesis(self, terms: Set, values: Sequence[Array]) -> Hypothesis:
        return Hypothesis(effects=tuple(term.effect for term in terms), values=tuple(values))

    def _residuals(self, hypotheses: Sequence[Hypothesis]) -> list[tuple[Array, IndexArray]]:
        """Residuals in noise standard deviations with their channels, one row a reading."""
        found = []
        length = sum(float(trial.time[-1]) for trial in self.simulator.trials)
        self.steps[0] += round(len(hypotheses) * length / self.balance.machine.time_step)
        for predicted in self.simulator.predict(hypotheses):
            rows, channels = [], []
            for trial, columns in zip(self.simulator.trials, predicted, strict=True):
                off = (trial.measured - columns) / self.noise
                seen = np.isfinite(trial.measured)
                rows.append(np.nan_to_num(off[seen], nan=1e6, posinf=1e6, neginf=-1e6))
                channels.append(np.nonzero(seen)[1])
            found.append((np.concatenate(rows), np.concatenate(channels)))
        return found

    def _score(
        self, terms: Set, values: Sequence[Array], rows: Array, channel: IndexArray
    ) -> float:
        """Minus twice the log likelihood with a discrepancy in each channel."""
        # What the laws of the effects may miss is no evidence for other effects.
        count, power = np.bincount(channel), np.bincount(channel, rows**2)
        level, missed = self._values(count), 0.0 * power
        if not all(is_exact(term.effect) for term in terms):
            changed = rows - self._as_by_exact(terms, values)
            missed = self.law**2 * np.bincount(channel, changed**2)
        return float(level @ np.log1p((np.maximum(power - count, 0.0) + missed) / level))

    def _as_by_exact(self, terms: Set, values: Sequence[Array]) -> Array:
        """Residuals with those of some effects whose laws miss nothing."""
        own = [(t, v) for t, v in zip(terms, values, strict=True) if is_exact(t.effect)]
        key = tuple((*term.effect.key, *at) for term, at in own)
        if key not in self._known:
            known = tuple(term for term, _ in own)
            self._known[key] = self._residuals([self._hypothesis(known, [v for _, v in own])])[0][0]
        return self._known[key]

    def _values(self, count: IndexArray) -> Array:
        """Values of the discrepancy of each channel, of so many rows (C,)."""
        values = LEAST_VALUES * len(self.simulator.trials) + SHARE_VALUES * count
        return np.asarray(values, dtype=float)


def _by_channel(rows: Array, channel: IndexArray) -> Array:
    """Root mean square of each channel (C,)."""
    power = np.bincount(channel, rows**2) / np.maximum(np.bincount(channel), 1)
    return np.asarray(np.sqrt(power))


def _side(x: Array, bounds: Array) -> Array:
    """Steps of numerical derivatives, away from the upper bound."""
    return np.where(x + _STEP <= bounds[:, 1], _STEP, -_STEP)


def _shifted(trial: Trial, late: Iterable[tuple[int, float, float]]) -> Trial:
    """A run with commands of some actuators later by so many delays, linearly between steps."""
    controls, count = np.concatenate([trial.before, trial.controls]), len(trial.before)
    time = np.arange(len(controls)) * trial.step
    for number, delay, deviations in late:
        at = time - deviations * delay
        controls[:, number] = np.interp(at, time, controls[:, number])
    return replace(trial, before=controls[:count], controls=controls[count:])


def _windows(trial: Trial, balance: Balance, trials: int, *, between: bool) -> list[Trial]:
    """Windows of a run, evenly spread, each from the smoothed state at its beginning."""
    # Those between start halfway from one of them to the next.
    length = float(trial.time[-1])
    count = int(np.clip(_MOST_S / WINDOW_S / trials, 1, max(length // WINDOW_S, 1)))
    starts = np.linspace(0.02 * length, max(0.98 * length - LEAD_S - WINDOW_S, 0.0), count)
    if between and count > 1:
        starts = 0.5 * (starts[1:] + starts[:-1])
    run = next(r for r in balance.motion.runs if r.name == trial.name)
    found = []
    for start in starts:
        first = int(np.searchsorted(trial.time, start))
        last = int(np.searchsorted(trial.time, start + LEAD_S + WINDOW_S))
        part = trial.between(first, max(last, first + 8))
        shown = np.where(part.time[:, None] < LEAD_S, np.nan, part.measured)
        at = trial.time[first]
        middles = run.time + run.begin
        state = [
            np.array([np.interp(at, middles, column) for column in values.T])
            for values in (run.position, run.speed)
        ]
        found.append(
            replace(part, measured=shown, position=state[0], speed=state[1], resting=False)
        )
    return found


def open_joints(exact: Exact, nominal: ExactFit, best: ExactFit, cells: Iterable[int]) -> set[str]:
    """Joints of some that cells leave open, of whose motion a set leaves much open, too."""
    found, by_joint = set(), exact.by_joint()
    for joint in set(cells) & set(by_joint):
        left, before = best.rms[by_joint[joint]], nominal.rms[by_joint[joint]]
        if left > LARGE and 1 - (left / before) ** 2 < EXPLAINED:
            found.add(exact.balance.machine.joints[joint])
    return found


def pool_of(
    selection: Selection, joints: set[str], kinds: Iterable[str], *, loose: bool
) -> tuple[set[str], list[Start]]:
    """Places of some joints, and starts of every effect there, alone and at all of them at once."""
    # Starts are its own and those in the evidence. With those of loose parts anywhere, if asked
    # for.
    evidence = selection.evidence
    balance, known = evidence.balance, evidence.terms
    places = {place for joint in joints for place in at_joint(balance.machine, joint)}
    found: list[Start] = []
    everywhere: dict[tuple[str, str, int], list[Term]] = {}
    for effect in candidates(balance.machine, kinds):
        shows = effect.moves or effect.where in balance.encoders
        there = effect.where in places or (loose and effect.has_stops)
        if not there or not shows or effect.is_read_off:
            continue
        starts = list(effect.starts)
        if not starts or effect.adds_motion or isinstance(effect, DriveLimit):
            starts += [t.axes[0] for t in known if t.effect.key == effect.key and t.law]
        for k, start in enumerate(dict.fromkeys(tuple(map(float, s)) for s in starts)):
            term = Term(effect, (start,), "", law=True, columns=())
            found.append(((term,), (np.array(start),)))
            everywhere.setdefault((effect.kind, effect.variant, k), []).append(term)
    for terms in everywhere.values():
        if len(terms) == len(joints) > 1:
            found.append((tuple(terms), tuple(np.array(term.axes[0]) for term in terms)))
    return places, found
