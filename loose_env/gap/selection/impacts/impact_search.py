"""Search for a part with stops (backlash, loose link), fitted to the impact power of runs.

The search compares sample by sample, where a loose link with hard impacts has a larger residual
than no effect at all. Where it ends with an unexplained residual, parts with stops are fitted again
with `loose_env.gap.selection.impacts.impact_power.ImpactPower`, on top of the identified effects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals, bootstrap, widened
from loose_env.gap.fitting.gauss_newton import Fit, FitSettings, fit, sensitivities
from loose_env.gap.fitting.holdout_score import residual_z
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.parameter import free_of
from loose_env.gap.residuals.preparation.prepare import GapProblem
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.windows import windowed
from loose_env.gap.selection.impacts.impact_power import ImpactPower
from loose_env.gap.selection.screening.data_driven_starts import proposals
from loose_env.gap.settings import (
    ACCEPTED_Z,
    CONFIRMED_Z,
    IMPACT_EXPLAINED,
    IMPACT_PREDICTED,
    SCREENING_S,
    TIE_Z,
)
from loose_env.typing import Array

_FITTED = 2
"""Candidates that are fitted."""
_NOISE_MEAN_SQUARE = 0.5
"""Mean square of what noise alone leaves: half of it, for less than noise counts as noise."""
_MULTISTARTS = 3
"""Starts from which each of them is fitted."""
_TITLE = "parts with stops"
_STEP = 0.05
_ROUGH, _FINE = (
    FitSettings(finite_difference_step=step, iterations=n) for step, n in ((0.2, 8), (_STEP, 4))
)
"""Powers scatter with the times of impacts: sensitivities are taken over long steps first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpactFit:
    """A part that hits its stops, identified by impact power."""

    fitted: Fit
    """The part alone, added to the known effects."""
    intervals: Intervals
    """Confidence intervals of its parameters."""
    explained: float
    """Share of the impact power of held-out runs that it explains."""
    window_s: float
    """Length of the stretches over which power is computed [s]."""
    rivals: tuple[Effect, ...] = ()
    """Effects that those runs cannot distinguish from it."""
    insignificant: tuple[Effect, ...] = ()
    """Earlier effects that were only proxies for it."""

    @property
    def effect(self) -> Effect:
        """The part with stops."""
        return self.fitted.effects[0]

    @property
    def description(self) -> str:
        """Notes for the reader."""
        return (
            f"{self.effect.where} hits its stops at times that no simulation reproduces: it is "
            f"identified by the impact power in windows of {self.window_s:.2g} s, of which it "
            f"explains {100 * self.explained:.0f} % on held-out runs; sample by sample the "
            "residual shrinks less, or grows"
        )


def find_impacts(
    problem: GapProblem,
    known: Hypothesis,
    candidates: Sequence[Effect],
    rng: np.random.Generator,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> ImpactFit | None:
    """Search for a part that hits its stops in runs with commands."""
    there = {(e.kind, e.where) for e in known.effects}
    with_stops = [c for c in candidates if _has_clearance(c) and (c.kind, c.where) not in there]
    short = windowed(problem.search, SCREENING_S)
    if not with_stops or not all(map(ImpactPower.worth_while, (short, problem.held_out))):
        return None
    say("impact pass: parts with stops, by the power of the residual")
    proposed, sorting = proposals(problem.search, known, with_stops), ImpactPower(short, known)
    starts = {e.key: proposed.get(e.key) or e.starts for e in with_stops}
    ordered = [(e, _sorted(sorting, e, starts[e.key])) for e in counted(_TITLE, with_stops)]
    promising = [(e, found) for e, found in ordered if found[0][0] > IMPACT_PREDICTED]
    promising.sort(key=lambda each: -each[1][0][0])
    for effect, found in promising:
        say(f"  {effect!r}: predicted share {found[0][0]:.3f}")
    if not promising:
        return None
    held = ImpactPower(problem.held_out, known)
    rough = [
        _roughly(sorting, e, [start for _, start in found])
        for e, found in counted(_TITLE, promising[:_FITTED])
    ]
    # what only fits the windows that it was fitted to does not explain other runs
    rough = [
        each
        for each in rough
        if _explained(held.measured, held.residuals([each.hypothesis])[0]) > IMPACT_PREDICTED
    ]
    if not rough:
        return None
    searched = ImpactPower(problem.search, known)

    def left(hypothesis: Hypothesis) -> _ImpactResiduals:
        return _ImpactResiduals.of(hypothesis, searched, held)

    fits = [fit(searched, each.structure, each.free, settings=_FINE) for each in rough]
    tried = sorted(((left(each.hypothesis), each) for each in fits), key=lambda t: t[0].total)
    best, fitted = tried[0]
    before = _ImpactResiduals((searched, searched.measured), (held, held.measured))
    share = _explained(held.measured, best.held[1])
    say(f"  {fitted.effects[0]!r}: explains {share:.2f} of the impact power of held-out runs")
    if share < IMPACT_EXPLAINED or not best.ahead_of(before):
        return None
    if not best.ahead_of(left(_without_clearance(fitted))):
        say("  rejected: no clearance is needed to explain it")
        return None
    numbers = range(len(fitted.free))
    jacobian = sensitivities(
        searched, fitted.structure, fitted.free, fitted.residual, numbers, difference=_STEP
    )
    fitted = replace(fitted, jacobian=jacobian)
    return ImpactFit(
        fitted=fitted,
        intervals=widened(searched, fitted, bootstrap(searched, fitted, rng)),
        explained=share,
        window_s=held.stretch,
        insignificant=_insignificant(problem, known, fitted.hypothesis),
        rivals=tuple(
            other.effects[0] for rest, other in tried[1:] if best.improvement_of(rest)[1] < TIE_Z
        ),
    )


@dataclass(frozen=True)
class _ImpactResiduals:
    """Residuals of a hypothesis in the impact powers of training and held-out runs."""

    fitted: tuple[ImpactPower, Array]
    held: tuple[ImpactPower, Array]

    @classmethod
    def of(
        cls, hypothesis: Hypothesis, searched: ImpactPower, held: ImpactPower
    ) -> _ImpactResiduals:
        return cls(
            *(
                (impact_power, impact_power.residuals([hypothesis])[0])
                for impact_power in (searched, held)
            )
        )

    @property
    def total(self) -> float:
        return sum(float(left @ left) for _, left in (self.fitted, self.held))

    def improvement_of(self, behind: _ImpactResiduals) -> tuple[float, float]:
        """Return the improvement (z) on the training runs and on the held-out runs."""
        first, second = (
            residual_z(impact_power, more, less)
            for (impact_power, less), (_, more) in (
                (self.fitted, behind.fitted),
                (self.held, behind.held),
            )
        )
        return first, second

    def ahead_of(self, behind: _ImpactResiduals) -> bool:
        """Return whether the improvement is significant."""
        z_scores = self.improvement_of(behind)
        return max(z_scores) >= ACCEPTED_Z and min(z_scores) >= CONFIRMED_Z


def _sorted(
    impact_power: ImpactPower, effect: Effect, starts: Sequence[tuple[float, ...]]
) -> list[tuple[float, tuple[float, ...]]]:
    """Share of power that each start explains by itself, with the start; best first."""
    left = impact_power.residuals(
        [Hypothesis(effects=(effect,), values=(np.array(start),)) for start in starts]
    )
    found = [
        (_explained(impact_power.measured, r), tuple(s)) for r, s in zip(left, starts, strict=True)
    ]
    return sorted(found, key=lambda each: -each[0])


def _roughly(impact_power: ImpactPower, effect: Effect, starts: Sequence[tuple[float, ...]]) -> Fit:
    """Return the best of rough fits from the first starts."""
    structure = ModelStructure(effects=(effect,))
    found = [
        fit(impact_power, structure, free_of(effect.parameters, np.array(start)), settings=_ROUGH)
        for start in starts[:_MULTISTARTS]
    ]
    return min(found, key=lambda each: each.cost)


def _has_clearance(effect: Effect) -> bool:
    """Return whether an effect has stops and a clearance that can be closed."""
    return effect.has_stops and any(p.name == "gap" for p in effect.parameters)


def _without_clearance(fitted: Fit) -> Hypothesis:
    """Return the part with its smallest clearance."""
    (effect,), (values,) = fitted.effects, fitted.hypothesis.values
    shut = values.copy()
    for number, parameter in enumerate(effect.parameters):
        if parameter.name == "gap":
            shut[number] = parameter.low
    return Hypothesis(effects=(effect,), values=(shut,))


def _insignificant(problem: GapProblem, known: Hypothesis, part: Hypothesis) -> tuple[Effect, ...]:
    """Effects that are insignificant once the part is in the model; last first."""
    kept, own = list(known.pairs), part.pairs
    if not kept:
        return ()
    nominal = known.of_model.with_effects(())
    searched, held = (ImpactPower(runs, nominal) for runs in (problem.search, problem.held_out))
    none = Hypothesis()
    best = _ImpactResiduals.of(none.with_effects([*kept, *own]), searched, held)
    insignificant: list[Effect] = []
    for pair in reversed(kept.copy()):
        without = [each for each in kept if each is not pair]
        left = _ImpactResiduals.of(none.with_effects([*without, *own]), searched, held)
        if not best.ahead_of(left):
            insignificant.append(pair[0])
            kept, best = without, left
    return tuple(insignificant)


def _explained(before: Array, after: Array) -> float:
    """Share of the power beyond sampling error that is explained, 1 at most."""
    more, left = (float(np.sum(each**2 - _NOISE_MEAN_SQUARE)) for each in (before, after))
    return 1.0 - max(left, 0.0) / more if more > 0 else 0.0
