"""Complete search for effects: forward selection, repeated with noise set to impact residuals.

No contact law matches the machine exactly, so that a part hitting its stops has acceleration
residuals many times larger than the noise. Other missing effects are small beside them: they would
be missed, or a large but wrong effect be identified instead. The search therefore continues with
each channel's noise set to its residual, updated with each identified effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count

import numpy as np

from loose_env.gap.fitting.gauss_newton import cost_of
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer
from loose_env.gap.fitting.model_structure import Nuisance
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.output.result import RankedHypothesis
from loose_env.gap.residuals.physical_units import noise_ratio
from loose_env.gap.residuals.preparation.prepare import GapProblem
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.forward_selection import Selection, StepStore, select_effects
from loose_env.gap.selection.ranking import indistinct, ranking_of
from loose_env.gap.settings import (
    IMPACT_RMS,
    SUFFICIENT_Z,
    SearchSettings,
)
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchResult:
    """Result of a search."""

    problem: GapProblem
    """The runs."""
    parts: tuple[tuple[GapProblem, Selection], ...]
    """The search and its continuations beside stops, each with the noise used."""

    @property
    def selection(self) -> Selection:
        """The last part of the search."""
        return self.parts[-1][1]

    @property
    def reweighted(self) -> GapProblem:
        """The runs with the noise used in the last part."""
        return self.parts[-1][0]

    @property
    def base(self) -> ScoredFit:
        """The nominal model, scored with the current noise."""
        return self.parts[0][1].base

    @property
    def best(self) -> ScoredFit:
        """The best hypothesis, scored with the noise of `reweighted`."""
        return self.selection.best

    @property
    def ranking(self) -> tuple[RankedHypothesis, ...]:
        """Ranking of all fits, step by step; held-out residuals use the current noise."""
        found: list[RankedHypothesis] = []
        first = 1
        for runs, named in self.parts:
            noise_scale = noise_ratio(runs.held_out, self.problem.held_out)
            found += ranking_of(
                named, runs.search, runs.held_out, noise_scale=noise_scale, first=first
            )
            first += len(named.steps) - 1
        return tuple(found)

    def confusable_with(self, effect: Effect, named: Sequence[Effect]) -> tuple[Effect, ...]:
        """Effects that held-out runs cannot distinguish from an identified one."""
        found = chain(*(indistinct(part, effect) for _, part in self.parts))
        there = {(e.kind, e.where) for e in named}
        others = {(e.kind, e.where): e for e in found}
        return tuple(e for place, e in others.items() if place not in there)

    def reweighted_base(self, base: ScoredFit) -> ScoredFit:
        """Score the nominal model, fitted to ``problem.fit``, with the noise of `reweighted`."""
        own = self.reweighted
        return _scored_with(own.fit, own.held_out_whole, self.problem.fit, base)

    def rescored(self, best: ScoredFit) -> ScoredFit:
        """Score a fit to ``reweighted.fit`` with the current noise, without refitting."""
        return _scored_with(
            self.problem.fit, self.problem.held_out_whole, self.reweighted.fit, best
        )


def search(
    problem: GapProblem,
    nuisance: Nuisance,
    sought: Sequence[Effect],
    *,
    settings: SearchSettings,
    say: Callable[[str], None] = lambda _: None,
    keep: Callable[[str], StepStore] = lambda _: StepStore(),
    earlier: Sequence[tuple[Effect, Array]] = (),
) -> SearchResult:
    """Search for effects that a model lacks."""

    def left(scored: ScoredFit) -> Array:
        return problem.search.channel_rms(scored.fitted.residual)

    def stops_leave(scored: ScoredFit) -> bool:
        return have_stops(scored.fitted.effects) and bool(left(scored).max() > IMPACT_RMS)

    reweighted, own, pause, begun = problem, settings, stops_leave, None
    parts: list[tuple[GapProblem, Selection]] = []
    # terminates: each unfinished part either identifies one more effect or drops one for good
    for number in count(1):
        named = select_effects(
            reweighted.search,
            reweighted.held_out,
            nuisance,
            sought,
            settings=own,
            say=say,
            keep=keep(f"part-{number}-" if number > 1 else ""),
            begun=begun,
            pause=pause,
            earlier=earlier,
        )
        parts.append((reweighted, named))
        if not named.unfinished:
            break
        # with the current noise, as the last identified effect may have reduced the residual of the
        # stops
        best = _scored_with(problem.search, problem.held_out, reweighted.search, named.best)
        if stops_leave(best):
            say("reweighting: the residual of the stops counts as noise")
            reweighted = problem.with_noise_scaled(np.maximum(left(best), 1.0))
            own = beside_stops(settings)
        else:
            reweighted, own = problem, settings
        # any further effect changes the residual
        pause = stops_leave if reweighted is problem else _always
        base = parts[0][1].base
        base, best = (
            _scored_with(reweighted.search, reweighted.held_out, problem.search, each)
            for each in (base, best)
        )
        begun = Selection(base=base, steps=[best], dropped=named.dropped)
    return SearchResult(problem=problem, parts=tuple(parts))


def beside_stops(settings: SearchSettings) -> SearchSettings:
    """Acceptance criteria where the residual of stops counts as noise."""
    return replace(settings, sufficient_z=SUFFICIENT_Z, swap_stops=False)


def _always(scored: ScoredFit) -> bool:
    return True


def _scored_with(
    runs: ResidualModel, held: ResidualModel, own: ResidualModel, scored: ScoredFit
) -> ScoredFit:
    """Score a fit on its own runs and on held-out runs with the noise of those runs."""
    if runs is own:
        return scored
    fitted = scored.fitted
    residual = runs.residuals([fitted.hypothesis])[0]
    return Scorer(runs, held).score(
        replace(
            fitted,
            residual=residual,
            jacobian=fitted.jacobian * noise_ratio(own, runs)[:, None],
            cost=cost_of(residual, fitted.free, fitted.structure.parameters),
        )
    )
