"""Forward selection of effects (screen, multi-start fit, held-out check), and nominal fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.holdout_score import Improvement, ScoredFit, Scorer, improvement_of
from loose_env.gap.fitting.model_structure import ModelStructure, Nuisance
from loose_env.gap.fitting.refit import STILL_GAINS, converged, fitted_on
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.parameter import free_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.residuals.windows import screening_seconds, windowed
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.candidate_fits import CandidateFits
from loose_env.gap.selection.screening.data_driven_starts import proposals
from loose_env.gap.selection.screening.joint_proposals import JointProblem
from loose_env.gap.selection.screening.linear_problem import CurrentFit
from loose_env.gap.selection.screening.screening import ScreenedCandidate, screen
from loose_env.gap.selection.screening.signatures import Signatures
from loose_env.gap.selection.screening.window_fits import WindowFits
from loose_env.gap.selection.swap_step import SwapStep
from loose_env.gap.settings import (
    ALTERNATIVES,
    CONFIRMED_Z,
    FURTHER,
    SEARCH_Z,
    WORTH_PARAMETERS,
    SearchSettings,
)
from loose_env.typing import Array

Say = Callable[[str], None]


@dataclass(kw_only=True, eq=False)
class Selection:
    """Result of a forward selection, step by step."""

    base: ScoredFit
    """The nominal model, fitted within the tolerance."""
    steps: list[ScoredFit] = field(default_factory=list)
    """The accepted hypotheses, with one effect, with two, ..."""
    swapped: ScoredFit | None = None
    """The last of them with confusable effects in place of some, where that is better."""
    rivals: list[list[tuple[ScoredFit, Improvement]]] = field(default_factory=list)
    """At each step, every hypothesis that was fitted, with its improvement over the step before;
    best first."""

    dropped: list[Effect] = field(default_factory=list)
    """Effects that a later one made insignificant."""
    unfinished: bool = False
    """Whether the search stopped after a step on request."""

    @property
    def best(self) -> ScoredFit:
        """The last accepted hypothesis, after swaps."""
        return self.swapped or (self.steps[-1] if self.steps else self.base)


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectionStep:
    """Result of the search for one more effect."""

    rivals: list[ScoredFit]
    """Every hypothesis that was fitted to whole runs, best first."""
    accepted: ScoredFit | None
    """The accepted hypothesis, with fresh sensitivities."""
    dropped: list[Effect] = field(default_factory=list)
    """Earlier effects that it made insignificant."""


class StepStore:
    """Computes the fits and steps of a search; subclasses may checkpoint them."""

    def scored(self, name: str, make: Callable[[], ScoredFit]) -> ScoredFit:
        """Return a scored fit."""
        return make()

    def step(self, name: str, make: Callable[[], SelectionStep]) -> SelectionStep:
        """Return a step of the search."""
        return make()


def select_effects(
    comparison: ResidualModel,
    held_out: ResidualModel,
    nuisance: Nuisance,
    candidates: Sequence[Effect],
    *,
    settings: SearchSettings | None = None,
    say: Say = lambda _: None,
    keep: StepStore | None = None,
    begun: Selection | None = None,
    pause: Callable[[ScoredFit], bool] = lambda _: False,
    earlier: Sequence[tuple[Effect, Array]] = (),
) -> Selection:
    """Add effects to a nominal model by forward selection with held-out validation."""
    settings, keep = settings or SearchSettings(), keep or StepStore()
    scorer = Scorer(comparison, held_out)
    short = windowed(comparison, screening_seconds(comparison))
    if begun is None:
        base = keep.scored("nominal", lambda: nominal_fit(comparison, short, scorer, nuisance))
        found = Selection(base=base)
        say(f"nominal model: {base.held_out_rms:.2f} noise standard deviations on held-out runs")
    else:
        there = begun.best.fitted
        found = Selection(base=begun.base, dropped=list(begun.dropped))
        found.steps.append(keep.scored("begun", lambda: scorer.score(fitted_on(comparison, there))))
        found.rivals.append([])
    signatures = Signatures(found.base.fitted)
    for number in range(1, settings.most_effects + 1):
        if len(found.best.fitted.effects) >= settings.most_effects:
            break
        if _white(found.best):
            say("residual is white: search ends")
            break
        step = keep.step(
            f"effect-{number}",
            lambda: _step(
                (comparison, short), scorer, candidates, found, settings, say, signatures, earlier
            ),
        )
        found.rivals.append([(j, improvement_of(j, found.best)) for j in step.rivals])
        for scored, improvement in found.rivals[-1]:
            new = scored.fitted.effects[len(found.best.fitted.effects) :]
            say(
                f"  {', '.join(map(repr, new))}: held out {scored.held_out_rms:.3f}, "
                f"z {improvement.held_out:.1f} held-out, {improvement.training:.1f} training, "
                f"share {improvement.share:.2f}"
            )
        if step.accepted is None:
            break
        for effect in step.dropped:
            say(f"  dropped {effect!r}: insignificant beside the new one")
        found.steps.append(step.accepted)
        found.dropped += step.dropped
        if len(found.best.fitted.effects) < settings.most_effects and pause(found.best):
            found.unfinished = True
            return found
    if settings.swaps and len(found.best.fitted.effects) >= 2:
        say("swap step: confusable effects in place of the identified ones")
        swap_step = SwapStep(comparison, short, scorer, candidates, found.base, settings)
        better = keep.scored(
            "exchanged", lambda: swap_step.improved(found.best, say, white=_white(found.best))
        )
        if _keys(better) != _keys(found.best):
            found.swapped = better
    return found


def nominal_fit(
    comparison: ResidualModel, short: ResidualModel, scorer: Scorer, nuisance: Nuisance
) -> ScoredFit:
    """Fit the nominal model within its tolerance."""
    structure = ModelStructure(nuisance=nuisance)
    found = scorer.score(fit(comparison, structure, structure.nominal_start))
    if CurrentFit.of(WindowFits(short, found.fitted).before).to_gain < STILL_GAINS:
        return found
    return scorer.score(converged(comparison, found.fitted))


def _white(scored: ScoredFit) -> bool:
    """Return whether nothing is left that can be explained."""
    return scored.autocorrelation_z < SEARCH_Z and not scored.above_noise


def _keys(scored: ScoredFit) -> set[tuple[str, str, str]]:
    return {effect.key for effect in scored.fitted.effects}


def _step(
    comparisons: tuple[ResidualModel, ResidualModel],
    scorer: Scorer,
    candidates: Sequence[Effect],
    found: Selection,
    settings: SearchSettings,
    say: Say,
    signatures: Signatures,
    earlier: Sequence[tuple[Effect, Array]],
) -> SelectionStep:
    """Search for one more effect."""
    comparison, short = comparisons
    best = found.best
    taken = {(e.kind, e.where) for e in (*best.fitted.effects, *found.dropped)}
    left = [c for c in candidates if (c.kind, c.where) not in taken]
    candidate_fits = CandidateFits(comparison, short, scorer, best)
    proposed = proposals(comparison, best.fitted.hypothesis, left)
    screened = screen(
        short, candidate_fits.windows.before, left, proposed=proposed, signatures=signatures
    )
    for s in screened[:8]:
        say(f"  {s.effect!r}: predicted share {s.predicted:.3f}, z {s.z:.1f}")
    # what neither shows in the blocks of time nor explains anything cannot pass the tests
    hopeful = [s for s in screened if s.z >= CONFIRMED_Z or s.predicted >= WORTH_PARAMETERS]
    screened = hopeful or screened[:1]
    acceptance = Acceptance(comparison, scorer, found.base, best, settings)
    share = best.autocorrelated / max(found.base.autocorrelated, 1e-12)
    tried = candidate_fits.fit_candidates(
        screened, lambda: _sets(short, candidate_fits, screened), say, share=share
    )
    if earlier and not best.fitted.effects:
        tried = _with_earlier(tried, comparison, scorer, best, earlier)
    ranked = acceptance.ranked(tried) if tried else []
    for each in ranked:
        scored = acceptance.within_bounds(each) if acceptance.accepts(each) else each
        if not acceptance.accepts(scored):
            continue
        if objection := acceptance.objection(scored):
            say(f"  {scored.fitted.effects[-1]!r}: {objection}")
            continue
        accepted, dropped = acceptance.accept(scored)
        first = list(best.fitted.effects)
        alone = candidate_fits.without_earlier(scored, found.base.fitted) if first else None
        if alone is not None and not acceptance.significant(improvement_of(accepted, alone)):
            acceptance = Acceptance(comparison, scorer, found.base, found.base, settings)
            accepted, dropped = acceptance.accept(alone)[0], first
        rivals = [each.bare for each in ranked]
        return SelectionStep(rivals=rivals, accepted=accepted, dropped=dropped)
    return SelectionStep(rivals=[each.bare for each in ranked], accepted=None)


def _with_earlier(
    tried: Sequence[ScoredFit],
    comparison: ResidualModel,
    scorer: Scorer,
    before: ScoredFit,
    earlier: Sequence[tuple[Effect, Array]],
) -> list[ScoredFit]:
    """Add an earlier answer to the hypotheses of a step, from its values."""
    own = before.fitted
    structure = own.structure.plus(*(effect for effect, _ in earlier))
    start = np.concatenate([own.free, *(free_of(e.parameters, v) for e, v in earlier)])
    found = scorer.score(fit(comparison, structure, start, known=own.jacobian))
    keys = {effect.key for effect, _ in earlier}
    others = [each for each in tried if {e.key for e in each.fitted.effects} != keys]
    same = [each for each in tried if {e.key for e in each.fitted.effects} == keys]
    return [*others, min((found, *same), key=lambda scored: scored.total)]


def _sets(
    short: ResidualModel, candidate_fits: CandidateFits, screened: Sequence[ScreenedCandidate]
) -> list[Sequence[ScreenedCandidate]]:
    """Sets of candidates that may explain the residual together."""
    problem = JointProblem(short, candidate_fits.windows.before, screened)
    proposed = [*problem.pairs(ALTERNATIVES), *problem.kinds(FURTHER), *problem.greedy()]
    found: dict[frozenset[tuple[str, str, str]], Sequence[ScreenedCandidate]] = {}
    for each in proposed:
        found.setdefault(frozenset(member.effect.key for member in each.members), each.members)
    return list(found.values())
