"""Expected gain of a motion in log evidence between the fitted effects and each of their rivals.

Both are simulated along a motion, each at its fitted values. Parameters of the effects are worked
out first, those of the nominal model only where a motion is still promising: with fewer parameters
fitted the gain is larger, so that it bounds the gain with all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.experiment_design.next_motion.laplace import (
    Knowledge,
    Separation,
    bounded,
    separation,
)
from loose_env.gap.experiment_design.next_motion.motion_trials import MotionRuns, Played
from loose_env.gap.experiment_design.next_motion.open_pairs import DECIDED, Hypotheses, OpenPair
from loose_env.gap.fitting.gauss_newton import Fit, FitSettings, fit_settings_for
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.typing import Array, IndexArray

_MEMORY = 40_000_000
"""Numbers of predictions and sensitivities that are held at a time, 320 MB."""
_SHARES = (1.0, 0.5, 0.2)
"""Shares of a linearised step that are simulated: beyond some shift it is not linear."""
_REFITS, _ENOUGH = 4, 0.03
"""Most steps of a refit by simulation, and the share of its cost below which it ends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """Expected gains of one motion."""

    if_answer: tuple[float, ...]
    """Gain of the answer over each rival if the answer is right [nats]."""
    if_rival: tuple[float, ...]
    """Gain of each rival over the answer if the rival is right [nats]."""
    occam: tuple[float, ...] = ()
    """Part of `if_answer` that the rival pays for its parameters [nats]."""
    shifts: tuple[Array, ...] = ()
    """Refit of each rival that takes up most of what the answer shows, in its free numbers."""


def value_of(gains: Gains, pairs: Sequence[OpenPair]) -> float:
    """Worth of a motion: for each pair the logarithm of its gain over what decides it.

    Gains if one or the other is right count by how probable each is now. The logarithm prefers to
    decide one more pair to deciding one twice.
    """
    found = 0.0
    for pair, ahead, behind in zip(pairs, gains.if_answer, gains.if_rival, strict=True):
        odds = 1.0 / (1.0 + np.exp(-np.clip(pair.nats, -50.0, 50.0)))
        expected = odds * max(ahead, 0.0) + (1 - odds) * max(behind, 0.0)
        found += pair.weight * float(np.log1p(expected / DECIDED))
    return found


class GainModel:
    """Computes expected gains of motions."""

    def __init__(self, hypotheses: Hypotheses, runs: MotionRuns) -> None:
        self.hypotheses, self.runs = hypotheses, runs
        self._answer = _Own.of(hypotheses.answer, hypotheses.known)
        self._rivals = [_Own.of(pair.fitted, pair.known) for pair in hypotheses.pairs]
        self._springs = any(effect.adds_motion for effect in hypotheses.answer.effects)
        self._root = float(np.sqrt(hypotheses.share))

    def bounds(self, motions: Sequence[Played]) -> list[Gains]:
        """Gains with the parameters of the two effects alone fitted: hardly ever too small."""
        return self._gains(motions, whole=False)

    def gains(self, motions: Sequence[Played]) -> list[Gains]:
        """Gains with all parameters fitted."""
        return self._gains(motions, whole=True)

    def _gains(self, motions: Sequence[Played], *, whole: bool) -> list[Gains]:
        pairs = self.hypotheses.pairs
        samples = max((len(m.time) for m in motions), default=1)
        columns = sum(own.count for own in (self._answer, *self._rivals)) + len(pairs)
        each = samples * len(self.runs.comparison.channels) * columns
        size = max(1, _MEMORY // each)
        found: list[Gains] = []
        starts = range(0, len(motions), size)
        for first in counted("motions, in batches", starts):
            found += self._of_batch(motions[first : first + size], whole=whole)
        return found

    def _of_batch(self, motions: Sequence[Played], *, whole: bool) -> list[Gains]:
        """Gains of motions that are simulated together."""
        pairs = self.hypotheses.pairs
        # A cheaper integrator in both terms of a difference; springs need the steps of the fits.
        whole_steps = self.runs.compared(motions)
        compared = whole_steps if self._springs else whole_steps.with_cheaper_integrator()
        nothing = compared.residuals([self._answer.hypothesis()])[0]
        effects = tuple(pair.effect for pair in pairs if pair.effect is not None)
        chosen = self._answer.of_effects(self._answer.structure.effects if whole else effects)
        common = self._answer.nominal if whole else ()
        own = self._columns(compared, self._answer, nothing, (*common, *chosen))
        mine = np.array((*common, *chosen), dtype=np.intp)
        known = self._answer.known.of_some(mine)
        found: list[list[tuple[Separation, float, Array]]] = [[] for _ in motions]
        for pair, rival in zip(pairs, self._rivals, strict=True):
            last = rival.of_effects((pair.rival,))
            steps, base = compared, nothing
            if pair.rival.adds_motion and compared is not whole_steps:
                steps = whole_steps
                base = steps.residuals([self._answer.hypothesis()])[0]
            residual = steps.residuals([rival.hypothesis()])[0]
            extra = self._columns(steps, rival, residual, last)
            others = [k for k in range(rival.count) if k not in last]
            # Other columns are those of the answer: what both have changes both nearly alike.
            shared, at = self._shared(rival, others, (*common, *chosen))
            jacobian = np.concatenate([own[:, at], extra], axis=1)
            kept = np.array([*shared, *last], dtype=np.intp)
            there = rival.known.of_some(kept)
            for number in range(len(motions)):
                rows = compared.rows.trial == number
                apart = self._root * (residual[rows] - base[rows])
                one, other = -self._root * own[rows], -self._root * jacobian[rows]
                ahead = separation(apart, (known, one), (there, other), rival.room(kept))
                behind = separation(-apart, (there, other), (known, one), self._answer.room(mine))
                shift = np.zeros(rival.count)
                shift[kept] = ahead.shift
                found[number].append((ahead, behind.nats, shift))
        return [
            Gains(
                if_answer=tuple(ahead.nats for ahead, _, _ in each),
                occam=tuple(ahead.occam for ahead, _, _ in each),
                if_rival=tuple(behind for _, behind, _ in each),
                shifts=tuple(shift for _, _, shift in each),
            )
            for each in found
        ]

    def _shared(
        self, rival: _Own, others: Sequence[int], columns: Sequence[int]
    ) -> tuple[list[int], list[int]]:
        """Parameters of a rival that the answer has too, and where their columns are."""
        names = {key: k for k, key in enumerate(self._answer.keys)}
        place = {k: at for at, k in enumerate(columns)}
        shared, at = [], []
        for k in others:
            same = names.get(rival.keys[k])
            if same is not None and same in place:
                shared.append(k)
                at.append(place[same])
        return shared, at

    def _columns(
        self, compared: ResidualModel, own: _Own, residual: Array, which: Sequence[int]
    ) -> Array:
        """Change of the residual with some free numbers (N, len(which)); inward at bounds."""
        tried, steps = [], []
        for k in which:
            free = own.free.copy()
            step = own.difference if free[k] + own.difference <= own.high[k] else -own.difference
            free[k] += step
            tried.append(own.hypothesis(free))
            steps.append(step)
        if not tried:
            return np.zeros((len(residual), 0))
        changes = compared.residuals(tried) - residual
        return np.asarray((changes / np.array(steps)[:, None]).T)

    def confirmed(self, motion: Played, gains: Gains) -> Gains:
        """The same with the hypothesis that is not right refitted by simulation.

        The linearised refit is its start. Where a hypothesis is not linear over that distance, such
        as dry friction that holds or slips, the linearised gain is off.
        """
        compared = self.runs.compared([motion])
        answer = self._answer
        nothing = compared.residuals([answer.hypothesis()])[0]
        ahead, behind = [], []
        for rival, occam, shift in zip(self._rivals, gains.occam, gains.shifts, strict=True):
            residual = compared.residuals([rival.hypothesis()])[0]
            ahead.append(self._refitted(compared, rival, nothing, shift) + occam)
            away = np.zeros(answer.count)
            behind.append(self._refitted(compared, answer, residual, away) - occam)
        return replace(gains, if_answer=tuple(ahead), if_rival=tuple(behind))

    def _refitted(self, compared: ResidualModel, own: _Own, truth: Array, shift: Array) -> float:
        """Half the cost that a hypothesis leaves of another, after a refit [nats]."""

        def at(shifts: Sequence[Array]) -> list[tuple[float, Array, Array]]:
            tried = [np.clip(own.free + s, own.low, own.high) for s in shifts]
            left = self._root * (compared.residuals([own.hypothesis(f) for f in tried]) - truth)
            moved = [f - own.free for f in tried]
            costs = (
                0.5 * float(r @ r + m @ own.known.precision @ m)
                for r, m in zip(left, moved, strict=True)
            )
            return list(zip(costs, moved, left, strict=True))

        best = min(at([share * shift for share in (0.0, *_SHARES)]), key=_cost)
        for _ in range(_REFITS):
            here = replace(own, free=own.free + best[1])
            base = best[2] / self._root + truth
            jacobian = self._root * self._columns(compared, here, base, range(own.count))
            curvature = jacobian.T @ jacobian + own.known.precision
            slope = jacobian.T @ best[2] + own.known.precision @ best[1]
            step = bounded(curvature, -slope, here.room(np.arange(own.count)))
            found = min(at([best[1] + share * step for share in _SHARES]), key=_cost)
            gained, best = best[0] - found[0], min(best, found, key=_cost)
            if gained < _ENOUGH * best[0]:
                break
        return best[0]


def _cost(tried: tuple[float, Array, Array]) -> float:
    return tried[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Own:
    """A hypothesis at its fit, without the initial states of the runs."""

    structure: ModelStructure
    free: Array
    known: Knowledge
    low: Array
    high: Array
    keys: tuple[tuple[str, ...], ...]
    """Name of each free number: the same in two hypotheses that share it."""
    difference: float

    @classmethod
    def of(cls, fitted: Fit, known: Knowledge) -> _Own:
        """Of a fit to the runs so far."""
        nuisance = fitted.structure.nuisance
        structure = replace(fitted.structure, nuisance=replace(nuisance, initial=None))
        bounds = np.array([p.bounds for p in structure.parameters]).reshape(-1, 2)
        keys: list[tuple[str, ...]] = [("nominal", p.name) for p in structure.nuisance.parameters]
        keys += [(*e.key, p.name) for e in structure.effects for p in e.parameters]
        return cls(
            structure=structure,
            free=fitted.free[nuisance.initial_slice.stop :],
            known=known,
            low=bounds[:, 0],
            high=bounds[:, 1],
            keys=tuple(keys),
            difference=fit_settings_for(structure).finite_difference_step
            if structure.effects
            else FitSettings().finite_difference_step,
        )

    @property
    def count(self) -> int:
        """Number of free numbers."""
        return len(self.free)

    @property
    def nominal(self) -> tuple[int, ...]:
        """Indices of the nominal parameters."""
        own = self.structure.nuisance.nominal_slice
        return tuple(range(own.start, own.stop))

    def of_effects(self, effects: Sequence[Effect]) -> tuple[int, ...]:
        """Indices of the parameters of some effects."""
        keys = {effect.key for effect in effects}
        slices = zip(self.structure.effects, self.structure.slices, strict=True)
        return tuple(k for e, own in slices if e.key in keys for k in range(own.start, own.stop))

    def room(self, kept: IndexArray) -> tuple[Array, Array]:
        """Least and largest shift of some free numbers."""
        return self.low[kept] - self.free[kept], self.high[kept] - self.free[kept]

    def hypothesis(self, free: Array | None = None) -> Hypothesis:
        """The hypothesis at some free numbers, by default those fitted."""
        return self.structure.hypothesis(self.free if free is None else free)
