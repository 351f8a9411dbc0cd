"""Pipeline from a recording to the effects that its model lacks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.arms import quiet
from loose_env.gap.fitting.confidence_intervals import Intervals
from loose_env.gap.fitting.gauss_newton import UNNAMED, Fit, fit, slices_of, strikes
from loose_env.gap.fitting.holdout_score import Judge, Judged, share_of
from loose_env.gap.fitting.initial_state import StartState
from loose_env.gap.fitting.refit import settled
from loose_env.gap.fitting.uncertain_parameters import NominalFigures
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.parameter import values_of
from loose_env.gap.output.checkpoints import Stage, fresh
from loose_env.gap.output.result import NamedEffect, Place, Ranked, Verdict
from loose_env.gap.preparation.prepare import Prepared, prepare
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.checkpoint_codec import KeepInFiles
from loose_env.gap.selection.forward_selection import Keep, Named
from loose_env.gap.selection.impacts.impact_pass import second_look
from loose_env.gap.selection.impacts.impact_search import Struck
from loose_env.gap.selection.revision import sure_ones
from loose_env.gap.selection.reweighted_search import Searched, search
from loose_env.gap.settings import GapSettings, NamingSettings
from loose_env.recording import Recording

__all__ = ["GapFound", "find_gap", "prepare"]

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class GapFound:
    """Result of the identification pipeline."""

    prepared: Prepared
    """The prepared recording."""
    named: Named
    """Search, step by step; its last part, with the noise of that part
    (`loose_env.gap.selection.reweighted_search`)."""
    base: Judged
    """The nominal model, fitted within the tolerance, scored on whole held-out runs."""
    best: Judged
    """The model with the identified effects, scored on whole held-out runs."""
    verdict: Verdict
    """ "named", "no_gap" or "unexplained"."""
    effects: tuple[NamedEffect, ...]
    """Effects that the model lacks."""
    ranking: tuple[Ranked, ...]
    """Ranking of all fitted hypotheses."""
    struck: Struck | None = None
    """A part with stops, identified by its impact power."""


def find_gap(
    recording: Recording,
    settings: GapSettings | None = None,
    *,
    say: Say = lambda _: None,
    stages: Stage = fresh,
) -> GapFound:
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
    settings = settings or GapSettings()
    with quiet():  # diverging simulations are part of the search
        return _find_gap(recording, settings, say, stages)


def _find_gap(recording: Recording, settings: GapSettings, say: Say, stages: Stage) -> GapFound:
    """Run the pipeline, with or without the engine's warnings."""
    prepared = prepare(recording, settings)
    machine = prepared.machine
    nominal = NominalFigures(machine, tolerance=settings.tolerance)
    given = [*_starts(prepared.search), nominal]
    sought = [c for c in candidates(machine, settings.kinds or None) if prepared.search.shows(c)]
    naming = NamingSettings(most=settings.most_effects)

    def keep(prefix: str, given: Sequence[Effect] = given) -> Keep:
        return Keep() if stages is fresh else KeepInFiles(stages, machine, given, prefix)

    found = search(prepared, given, sought, settings=naming, say=say, keep=keep)
    named, heard, base, best = found.named, found.heard, found.base, found.best
    whole, judge = (Judge(runs.fit, runs.whole_held) for runs in (prepared, heard))
    if prepared.fit is not prepared.search or prepared.held is not prepared.whole_held:
        say("fits what was found to more of the runs")
        begun = _starts(prepared.fit)  # other windows have other initial states
        kept = keep("", [*begun, nominal])
        base = kept.judged("nominal-whole", lambda: whole.judge(_again(prepared, base, begun)))
        if best.fitted.named:
            best = kept.judged("effects-whole", lambda: judge.judge(_again(heard, best, begun)))
        else:
            best = base
    if strikes(best.fitted.named):
        stops, kept = best, keep("", [e for e in best.fitted.effects if e.kind in UNNAMED])
        best = kept.judged("settled", lambda: judge.judge(settled(heard.fit, stops.fitted)))
    best, dropped, intervals = sure_ones(best, heard, judge, settings.seed, say=say)
    best = found.in_noise(best) if best.fitted.named else base
    named.dropped += dropped
    verdict, struck = _verdict(base, best), None
    if verdict == "unexplained":
        again = second_look(prepared, whole, best, sought, settings, naming, say=say)
        if again is not None:
            best, intervals, struck, verdict = again.best, again.intervals, again.struck, "named"
            named.dropped += again.dropped
    return GapFound(
        prepared=prepared,
        named=named,
        base=base,
        best=best,
        verdict=verdict,
        effects=_named(found, best.fitted, intervals, struck) if verdict == "named" else (),
        ranking=found.ranking,
        struck=struck,
    )


def _starts(comparison: Comparison) -> list[Effect]:
    """Initial states of runs that begin in motion, fitted with every hypothesis."""
    start = StartState(comparison.machine, comparison.trials, comparison.channels)
    return [start] if start.moving else []


def _again(prepared: Prepared, judged: Judged, begun: list[Effect]) -> Fit:
    """Refit to more of the runs, starting from the result of the search."""
    effects, free = judged.fitted.effects, judged.fitted.free
    if prepared.fit is prepared.search:
        return judged.fitted
    kept = [k for k, effect in enumerate(effects) if not isinstance(effect, StartState)]
    own = slices_of(effects)
    return fit(
        prepared.fit,
        [*begun, *(effects[k] for k in kept)],
        np.concatenate([np.zeros(len(b.parameters)) for b in begun] + [free[own[k]] for k in kept]),
    )


_EXPLAINED = 0.88
"""Share of what there was to explain that the named effects must explain together. An effect whose
law is a little other than the catalogue's leaves a few percent, one that stands in leaves more."""
_EXPLAINED_BY_IMPACTS = 0.45
"""The same if a link slides, or if a part with stops was found where blows were missing. When its
stops are struck depends on the last digit of friction and gap: a simulation misses some blows, and
each one missed counts twice."""
_EXPLAINED_AT_MANY = 0.5
"""The same if one kind of effect was found at several places (`_MANY`), each believed by itself: a
machine that is wrong all over lacks more than one thing, and what it still lacks does not speak
against what was found. Something else that is missing at one place is not mistaken for that."""
_MANY = 3
_SURE = 4.0
"""Sureness from which on what is left counts as a gap [standard deviations over blocks]."""


def _verdict(base: Judged, best: Judged) -> Verdict:
    """Decide whether effects are missing, and whether the catalogue explains them."""
    if not best.fitted.named:
        return "unexplained" if best.structure_sureness > _SURE or best.loud else "no_gap"
    kinds = Counter(effect.kind for effect in best.fitted.named)
    least = _EXPLAINED
    if max(kinds.values()) >= _MANY:
        least = _EXPLAINED_AT_MANY
    if "structural_looseness" in kinds or (base.blows and strikes(best.fitted.named)):
        least = min(least, _EXPLAINED_BY_IMPACTS)
    done = best.structure_sureness <= _SURE and not best.loud
    if done or share_of(best, base) >= least:
        return "named"
    return "unexplained"


def _named(
    searched: Searched, fitted: Fit, intervals: Intervals, struck: Struck | None
) -> tuple[NamedEffect, ...]:
    """Effects of the best hypothesis, without the nominal parameters."""
    found = []
    for effect, own in zip(fitted.effects, slices_of(fitted.effects), strict=True):
        if effect.kind in UNNAMED:
            continue
        values = values_of(effect.parameters, fitted.free[own])
        names = [p.name for p in effect.parameters]
        by_blows = struck is not None and effect is struck.effect
        rivals = struck.rivals if struck and by_blows else searched.indistinct(effect, fitted.named)
        ends = zip(intervals.low[own], intervals.high[own], strict=True)
        found.append(
            NamedEffect(
                kind=effect.kind,
                where=effect.where,
                parameters={n: float(v) for n, v in zip(names, values, strict=True)},
                interval_95={
                    n: (float(a), float(b)) for n, (a, b) in zip(names, ends, strict=True)
                },
                ambiguous_with=tuple(Place(kind=e.kind, where=e.where) for e in rivals),
                units={p.name: p.unit for p in effect.parameters},
                variant=effect.variant,
                in_model=effect.in_model,
                powers_explained=struck.share if struck and by_blows else None,
            )
        )
    return tuple(found)
