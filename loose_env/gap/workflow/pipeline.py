"""Search for the effects that a model lacks, from a recording to a verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from loose_env.arms import quiet
from loose_env.gap.fitting.confidence_intervals import Intervals
from loose_env.gap.fitting.gauss_newton import Fit, fit
from loose_env.gap.fitting.holdout_score import Judge, Judged, share_of
from loose_env.gap.fitting.model_structure import Nuisance, nuisance_of
from loose_env.gap.fitting.refit import settled
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.output.checkpoints import Stage, fresh
from loose_env.gap.output.result import NamedEffect, Place, Ranked, Verdict
from loose_env.gap.preparation.prepare import GapProblem, prepare
from loose_env.gap.selection.checkpoint_codec import KeepInFiles
from loose_env.gap.selection.forward_selection import Keep
from loose_env.gap.selection.impacts.impact_pass import second_look
from loose_env.gap.selection.impacts.impact_search import Struck
from loose_env.gap.selection.revision import sure_ones
from loose_env.gap.selection.reweighted_search import search
from loose_env.gap.settings import (
    EXPLAINED,
    EXPLAINED_AT_MANY,
    EXPLAINED_BY_IMPACTS,
    FAMILY_LOCATIONS,
    UNEXPLAINED_Z,
    GapSettings,
    SearchSettings,
)
from loose_env.recording import Recording

__all__ = ["GapSolution", "find_gap", "named_effects"]

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class GapSolution:
    """Effects that a model lacks, with the fits that show it."""

    problem: GapProblem
    """The prepared recording."""
    base: Judged
    """The nominal model, fitted within the tolerance, scored on whole held-out runs."""
    best: Judged
    """The model with the identified effects, or those nearly accepted, scored in the same way."""
    verdict: Verdict
    """ "named", "no_gap" or "unexplained"."""
    effects: tuple[NamedEffect, ...] = ()
    """Identified effects, with intervals and confusable effects."""
    ranking: tuple[Ranked, ...] = ()
    """Ranking of all fitted hypotheses."""
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

    Raises
    ------
    InvalidData
        If the recording has too few runs, or a run lacks what its comparison needs.
    """
    with quiet():  # diverging simulations are part of the search
        return _solved(prepare(recording, settings or GapSettings()), say, stages)


def _solved(problem: GapProblem, say: Say, stages: Stage) -> GapSolution:
    """Search, refit to more of the runs, drop insignificant effects, decide."""
    settings, machine = problem.settings, problem.machine
    nuisance = nuisance_of(problem.search, machine, tolerance=settings.tolerance)
    kinds = settings.kinds or None
    sought = [c for c in candidates(machine, kinds) if problem.search.shows(c)]
    naming = SearchSettings(most_effects=settings.most_effects)

    def keep(prefix: str, nuisance: Nuisance = nuisance) -> Keep:
        return Keep() if stages is fresh else KeepInFiles(stages, machine, nuisance, prefix)

    found = search(problem, nuisance, sought, settings=naming, say=say, keep=keep)
    heard, base, best = found.heard, found.base, found.best
    whole, judge = (Judge(runs.fit, runs.whole_held) for runs in (problem, heard))
    if problem.fit is not problem.search or problem.held is not problem.whole_held:
        say("fits what was found to more of the runs")
        own = nuisance_of(problem.fit, machine, tolerance=settings.tolerance)
        longer = replace(nuisance, initial=own.initial)  # windows have other initial states
        kept = keep("", longer)
        base = kept.judged("nominal-whole", lambda: whole.judge(_refit(problem, base, longer)))
        if best.fitted.effects:
            best = kept.judged("effects-whole", lambda: judge.judge(_refit(heard, best, longer)))
        else:
            best = base
    if have_stops(best.fitted.effects):
        stops, kept = best, keep("", best.fitted.structure.nuisance)
        best = kept.judged("settled", lambda: judge.judge(settled(heard.fit, stops.fitted)))
    best, _, intervals = sure_ones(best, heard, judge, settings.seed, say=say)
    best = found.in_noise(best) if best.fitted.effects else base
    verdict, struck = _verdict(base, best), None
    if verdict == "unexplained":
        again = second_look(problem, whole, best, sought, settings, say=say)
        if again is not None:
            best, intervals, struck, verdict = again.best, again.intervals, again.struck, "named"

    def rivals(effect: Effect) -> Iterable[Effect]:
        if struck is not None and effect is struck.effect:
            return struck.rivals
        return found.indistinct(effect, best.fitted.effects)

    named = verdict == "named"
    return GapSolution(
        problem=problem,
        base=base,
        best=best,
        verdict=verdict,
        effects=named_effects(best.fitted, intervals, rivals=rivals, struck=struck)
        if named
        else (),
        ranking=found.ranking,
        warnings=(*problem.warnings, *([] if struck is None else [struck.words])),
    )


def _refit(problem: GapProblem, judged: Judged, nuisance: Nuisance) -> Fit:
    """Refit to more of the runs, starting from the result of the search."""
    if problem.fit is problem.search:
        return judged.fitted
    structure = replace(judged.fitted.structure, nuisance=nuisance)
    kept = judged.fitted.free[judged.fitted.structure.nuisance.initial_slice.stop :]
    initial = np.zeros(nuisance.initial_slice.stop)
    return fit(problem.fit, structure, np.concatenate([initial, kept]))


def _verdict(base: Judged, best: Judged) -> Verdict:
    """Decide whether effects are missing, and whether the catalogue explains them."""
    if not best.fitted.effects:
        return "unexplained" if best.structure_sureness > UNEXPLAINED_Z or best.loud else "no_gap"
    kinds = Counter(effect.kind for effect in best.fitted.effects)
    least = EXPLAINED
    if max(kinds.values()) >= FAMILY_LOCATIONS:
        least = EXPLAINED_AT_MANY
    if "structural_looseness" in kinds or (base.blows and have_stops(best.fitted.effects)):
        least = min(least, EXPLAINED_BY_IMPACTS)
    done = best.structure_sureness <= UNEXPLAINED_Z and not best.loud
    if done or share_of(best, base) >= least:
        return "named"
    return "unexplained"


def named_effects(
    fitted: Fit,
    intervals: Intervals,
    *,
    rivals: Callable[[Effect], Iterable[Effect]] = lambda _: (),
    struck: Struck | None = None,
) -> tuple[NamedEffect, ...]:
    """Effects of a fit in the form of a result.

    Parameters
    ----------
    fitted : Fit
        The fit.
    intervals : Intervals
        Confidence intervals of all its parameters.
    rivals : callable
        Returns the effects that the held-out runs cannot distinguish from one.
    struck : Struck, optional
        Part with stops among the effects, identified by its impact power.
    """
    found = []
    hypothesis = fitted.hypothesis
    for (effect, values), own in zip(hypothesis.pairs, fitted.structure.slices, strict=True):
        names = [p.name for p in effect.parameters]
        ends = zip(intervals.low[own].tolist(), intervals.high[own].tolist(), strict=True)
        by_power = struck is not None and effect is struck.effect
        found.append(
            NamedEffect(
                kind=effect.kind,
                where=effect.where,
                parameters=dict(zip(names, values.tolist(), strict=True)),
                interval_95=dict(zip(names, ends, strict=True)),
                ambiguous_with=tuple(Place(kind=e.kind, where=e.where) for e in rivals(effect)),
                units={p.name: p.unit for p in effect.parameters},
                variant=effect.variant,
                in_model=effect.in_model,
                powers_explained=struck.share if struck and by_power else None,
            )
        )
    return tuple(found)
