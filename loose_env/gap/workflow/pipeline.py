"""Search for the effects that a model lacks (find_gap): recording in, verdict with fits out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from loose_env.arms import quiet
from loose_env.doctor import Finding
from loose_env.gap.fitting.confidence_intervals import Intervals
from loose_env.gap.fitting.gauss_newton import Fit, fit
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer, explained_share
from loose_env.gap.fitting.model_structure import Nuisance, initial_states_of, nuisance_of
from loose_env.gap.fitting.refit import converged_with_short_steps
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.parameter import Parameter
from loose_env.gap.output.calibration import stored_calibration, widened_interval
from loose_env.gap.output.checkpoints import Stage, fresh
from loose_env.gap.output.result import (
    DeletionTest,
    EffectLocation,
    GapResult,
    NamedEffect,
    RankedHypothesis,
    Verdict,
)
from loose_env.gap.residuals.preparation.prepare import GapProblem, prepare
from loose_env.gap.residuals.progress import counted, reported
from loose_env.gap.selection.checkpoint_codec import StepFiles
from loose_env.gap.selection.deletion import (
    at_bound,
    deletion_of,
    material,
    significant,
    worse_quantity,
)
from loose_env.gap.selection.forward_selection import StepStore
from loose_env.gap.selection.impacts.impact_pass import impact_pass
from loose_env.gap.selection.impacts.impact_search import ImpactFit
from loose_env.gap.selection.reweighted_search import search
from loose_env.gap.selection.swap_step import drop_insignificant, refit_without
from loose_env.gap.settings import (
    EXPLAINED,
    UNEXPLAINED_Z,
    GapSettings,
    SearchSettings,
)
from loose_env.recording import Recording
from loose_env.typing import Array

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class GapSolution:
    """Effects that a model lacks, with the fits that show it."""

    problem: GapProblem
    """The prepared recording."""
    base: ScoredFit
    """The nominal model, fitted within the tolerance, scored on whole held-out runs."""
    best: ScoredFit
    """The model with the identified effects, or those nearly accepted, scored in the same way."""
    verdict: Verdict
    """ "named", "no_gap" or "unexplained"."""
    effects: tuple[NamedEffect, ...] = ()
    """Identified effects, with intervals and confusable effects."""
    doubtful: tuple[NamedEffect, ...] = ()
    """Effects of the corrected model that are not reported as identified."""
    ranking: tuple[RankedHypothesis, ...] = ()
    """Ranking of all fitted hypotheses."""
    preflight: tuple[Finding, ...] = ()
    """Findings of `loose_env.doctor` in the recording, for the result."""
    warnings: tuple[str, ...] = ()
    """Notes for the reader."""

    @property
    def nominal(self) -> Hypothesis:
        """The nominal model, with its parameters fitted within the tolerance."""
        return self.base.fitted.hypothesis.of_model

    @property
    def corrected(self) -> Hypothesis:
        """The corrected model."""
        return self.best.fitted.hypothesis.of_model

    @property
    def unnamed(self) -> Hypothesis:
        """Effects of the corrected model that are not reported as identified."""
        named = {(effect.kind, effect.where) for effect in self.effects}
        pairs = [(e, v) for e, v in self.corrected.pairs if (e.kind, e.where) not in named]
        return Hypothesis().with_effects(pairs)


def find_gap(
    recording: Recording,
    settings: GapSettings | None = None,
    *,
    say: Say = lambda _: None,
    stages: Stage = fresh,
    earlier: GapResult | None = None,
) -> GapSolution:
    """Identify the effects that the model of a recording lacks.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    settings : GapSettings, optional
        Settings of the comparison.
    say : callable
        Receives progress messages, line by line.
    stages : callable
        Checkpoints of stages, such as `loose_env.gap.output.checkpoints.Stages`; an interrupted
        run goes on from there.
    earlier : GapResult, optional
        Result of some of the runs. Its effects are one more hypothesis of the first step: they are
        accepted by the same tests, on all runs, and only the search for them is spared.

    Raises
    ------
    InvalidData
        If the recording has too few runs, or a run lacks what its comparison needs.
    """
    # diverging simulations are part of the search
    with quiet(), reported(say) as told:
        return _solved(prepare(recording, settings or GapSettings()), told, stages, earlier)


def _solved(problem: GapProblem, say: Say, stages: Stage, earlier: GapResult | None) -> GapSolution:
    """Search, refit to more of the runs, drop insignificant effects, decide."""
    settings, machine = problem.settings, problem.machine
    nuisance = nuisance_of(problem.search, tolerance=settings.tolerance)
    sought = problem.sought
    search_settings = SearchSettings(most_effects=settings.most_effects)

    def keep(prefix: str, nuisance: Nuisance = nuisance) -> StepStore:
        return StepStore() if stages is fresh else StepFiles(stages, machine, nuisance, prefix)

    before = () if earlier is None else _earlier_effects(problem, earlier)
    found = search(
        problem, nuisance, sought, settings=search_settings, say=say, keep=keep, earlier=before
    )
    reweighted, base, best = found.reweighted, found.base, found.best
    whole, scorer = (Scorer(runs.fit, runs.held_out_whole) for runs in (problem, reweighted))
    if problem.fit is not problem.search or problem.held_out is not problem.held_out_whole:
        say("final fit: more of the runs")
        # windows have other initial states
        longer = replace(nuisance, initial=initial_states_of(problem.fit))
        kept = keep("", longer)
        base = kept.scored("nominal-whole", lambda: whole.score(_refit(problem, base, longer)))
        if best.fitted.effects:
            best = kept.scored(
                "effects-whole", lambda: scorer.score(_refit(reweighted, best, longer))
            )
        else:
            best = base
    if have_stops(best.fitted.effects):
        stops, kept = best, keep("", best.fitted.structure.nuisance)
        best = kept.scored(
            "settled",
            lambda: scorer.score(converged_with_short_steps(reweighted.fit, stops.fitted)),
        )
    best, intervals = drop_insignificant(best, reweighted, scorer, settings.seed, say=say)
    fitted, alike = best, found.reweighted_base(base)

    def deleted() -> dict[tuple[str, str, str], DeletionTest]:
        if not fitted.fitted.effects:
            return {}
        say("deletion test of each effect")
        return {
            effect.key: deletion_of(reweighted.fit, scorer, alike, fitted, effect)
            for effect in counted("deletion tests", fitted.fitted.effects)
        }

    while True:
        best = found.rescored(fitted) if fitted.fitted.effects else base
        untenable, deletions = _bounded(best), {}
        if untenable is None:
            deletions = deleted()
            untenable = _untenable(whole, base, best, deletions)
        if untenable is None:
            break
        effect, reason = untenable
        say(f"  dropped {effect!r}: {reason}")
        fitted = refit_without(effect, fitted, reweighted, scorer)
        fitted, intervals = drop_insignificant(fitted, reweighted, scorer, settings.seed, say=say)
    named, impact_fit = _named(base, best, deletions), None
    if not have_stops(named) and _gap(best) and not _whole(base, best):
        again = impact_pass(problem, whole, base, best, sought, settings, say=say)
        if again is not None:
            best, intervals, impact_fit = again.best, again.intervals, again.impact_fit
            named, deletions = best.fitted.effects, {}

    def rivals(effect: Effect) -> Iterable[Effect]:
        if impact_fit is not None and effect is impact_fit.effect:
            return impact_fit.rivals
        return found.confusable_with(effect, best.fitted.effects)

    effects = named_effects(
        best.fitted, intervals, rivals=rivals, impact_fit=impact_fit, deletions=deletions
    )
    keys = {(effect.kind, effect.where) for effect in named}
    return GapSolution(
        problem=problem,
        base=base,
        best=best,
        verdict="named" if named else "unexplained" if _gap(best) else "no_gap",
        effects=tuple(e for e in effects if (e.kind, e.where) in keys),
        doubtful=tuple(e for e in effects if (e.kind, e.where) not in keys),
        ranking=found.ranking,
        warnings=(*problem.warnings, *([] if impact_fit is None else [impact_fit.description])),
    )


def _earlier_effects(problem: GapProblem, earlier: GapResult) -> tuple[tuple[Effect, Array], ...]:
    """Effects of an earlier result with their values, as far as they are sought here."""
    sought = {each.key: each for each in problem.sought}
    found = []
    for named in (*earlier.effects, *earlier.doubtful):
        effect = sought.get((named.kind, named.where, named.variant))
        if effect is None or {p.name for p in effect.parameters} != set(named.parameters):
            continue
        values = [p.clipped(named.parameters[p.name]) for p in effect.parameters]
        found.append((effect, np.array(values)))
    return tuple(found)


def _bounded(best: ScoredFit) -> tuple[Effect, str] | None:
    """Return an effect with a parameter at its bound, and the reason to drop it."""
    for effect, name in at_bound(best.fitted.structure, best.fitted.free):
        return effect, f"{name} is at its bound"
    return None


def _untenable(
    scorer: Scorer,
    base: ScoredFit,
    best: ScoredFit,
    deletions: Mapping[tuple[str, str, str], DeletionTest],
) -> tuple[Effect, str] | None:
    """Return an effect that must not stay in an answer, and the reason; None if all may."""
    if not best.fitted.effects:
        return None
    order = sorted(
        best.fitted.effects,
        key=lambda e: deletions[e.key].held_out_z + deletions[e.key].training_z,
    )
    worse = worse_quantity(scorer.held_out, best, base)
    if worse:
        return order[0], f"the {worse} is predicted worse than by the nominal model"
    weak = (effect for effect in order if not significant(deletions[effect.key]))
    return next(((effect, "not needed beside the others") for effect in weak), None)


def _refit(problem: GapProblem, scored: ScoredFit, nuisance: Nuisance) -> Fit:
    """Refit to more of the runs, starting from the result of the search."""
    if problem.fit is problem.search:
        return scored.fitted
    structure = replace(scored.fitted.structure, nuisance=nuisance)
    kept = scored.fitted.free[scored.fitted.structure.nuisance.initial_slice.stop :]
    initial = np.zeros(nuisance.initial_slice.stop)
    return fit(problem.fit, structure, np.concatenate([initial, kept]))


def _gap(best: ScoredFit) -> bool:
    """Return whether a residual shows that something is missing."""
    return best.autocorrelation_z > UNEXPLAINED_Z or best.above_noise


def _whole(base: ScoredFit, best: ScoredFit) -> bool:
    """Return whether the effects of a hypothesis explain the residual together."""
    if not best.fitted.effects:
        return False
    return not _gap(best) or explained_share(best, base) >= EXPLAINED


def _named(
    base: ScoredFit, best: ScoredFit, deletions: Mapping[tuple[str, str, str], DeletionTest]
) -> tuple[Effect, ...]:
    """Effects that are reported as identified: all where they explain the residual together.

    Else those that explain nearly all of it somewhere, whatever else is missing.
    """
    if _whole(base, best):
        return best.fitted.effects
    return tuple(e for e in best.fitted.effects if material(deletions[e.key], e))


def named_effects(
    fitted: Fit,
    intervals: Intervals,
    *,
    rivals: Callable[[Effect], Iterable[Effect]] = lambda _: (),
    impact_fit: ImpactFit | None = None,
    deletions: Mapping[tuple[str, str, str], DeletionTest] = MappingProxyType({}),
) -> tuple[NamedEffect, ...]:
    """Effects of a fit in the form of a result."""
    found = []
    hypothesis = fitted.hypothesis
    for (effect, values), own in zip(hypothesis.pairs, fitted.structure.slices, strict=True):
        ends = zip(intervals.low[own].tolist(), intervals.high[own].tolist(), strict=True)
        by_power = impact_fit is not None and effect is impact_fit.effect
        found.append(
            NamedEffect(
                kind=effect.kind,
                where=effect.where,
                parameters={
                    p.name: float(v) for p, v in zip(effect.parameters, values, strict=True)
                },
                interval_95={
                    p.name: _calibrated(effect, p, float(v), end)
                    for p, v, end in zip(effect.parameters, values, ends, strict=True)
                },
                ambiguous_with=tuple(
                    EffectLocation(kind=e.kind, where=e.where) for e in rivals(effect)
                ),
                units={p.name: p.unit for p in effect.parameters},
                variant=effect.variant,
                in_model=effect.in_model,
                impact_power_explained=impact_fit.explained if impact_fit and by_power else None,
                deletion=deletions.get(effect.key),
            )
        )
    return tuple(found)


def _calibrated(
    effect: Effect, parameter: Parameter, value: float, interval: tuple[float, float]
) -> tuple[float, float]:
    """Interval of a value with the calibrated factor, within its bounds."""
    factor = stored_calibration().factor_of(effect, parameter.name)
    low, high = widened_interval(value, interval, factor)
    return parameter.clipped(low), parameter.clipped(high)
