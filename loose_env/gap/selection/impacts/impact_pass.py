"""Impact pass: refits, adds a part with stops by impact power, and drops proxies for it.

The impacts of a part against its stops cannot be identified sample by sample. The effects found so
far are refitted with each channel weighted by its residual, the part is identified by its impact
power (`loose_env.gap.selection.impacts.impact_search`), and effects that were only proxies for it
are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals, joined
from loose_env.gap.fitting.gauss_newton import Fit, cost_of, fit
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer
from loose_env.gap.fitting.refit import with_new_jacobian
from loose_env.gap.model.effect import Effect
from loose_env.gap.residuals.physical_units import noise_ratio
from loose_env.gap.residuals.preparation.prepare import GapProblem
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.deletion import at_bound, worse_quantity
from loose_env.gap.selection.impacts.impact_power import ImpactPower
from loose_env.gap.selection.impacts.impact_search import ImpactFit, find_impacts
from loose_env.gap.selection.swap_step import drop_insignificant, refit_without
from loose_env.gap.settings import GapSettings


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpactPassResult:
    """Result of the impact pass."""

    best: ScoredFit
    """The remaining earlier effects, with the part."""
    intervals: Intervals
    """Confidence intervals of all parameters."""
    impact_fit: ImpactFit
    """The part with stops."""


def impact_pass(
    problem: GapProblem,
    scorer: Scorer,
    base: ScoredFit,
    best: ScoredFit,
    sought: Sequence[Effect],
    settings: GapSettings,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> ImpactPassResult | None:
    """Search for a part that hits its stops where a residual is unexplained."""
    if not all(map(ImpactPower.worth_while, (problem.search, problem.held_out))):
        return None
    # Impacts dominate the accelerations, whose residual is no smaller for correct parameters than
    # for wrong ones; positions and speeds are hardly affected.
    left = problem.fit.channel_rms(best.fitted.residual)
    reweighted = problem.with_noise_scaled(np.maximum(left, 1.0))
    own = Scorer(reweighted.fit, reweighted.held_out_whole)
    rigid = _without_slides(best, problem, reweighted, own)
    if len(rigid.fitted.effects) >= settings.most_effects:
        return None
    known, rng = rigid.fitted.hypothesis.of_model, np.random.default_rng(settings.seed)
    impact_fit = find_impacts(problem, known, sought, rng, say=say)
    if impact_fit is None:
        return None
    rigid = own.score(with_new_jacobian(rigid.fitted, reweighted.fit))
    for effect in impact_fit.insignificant:
        say(f"  dropped {effect!r}: a proxy for the part with stops")
        rigid = refit_without(effect, rigid, reweighted, own)
    rigid, intervals = drop_insignificant(rigid, reweighted, own, settings.seed, say=say)
    found = scorer.score(_with_impact_part(problem.fit, rigid.fitted, impact_fit))
    bounded = at_bound(found.fitted.structure, found.fitted.free)
    worse = worse_quantity(scorer.held_out, found, base)
    if bounded or worse:
        reason = f"{bounded[0][1]} is at its bound" if bounded else f"the {worse} is worse"
        say(f"  rejected {impact_fit.effect!r}: {reason}")
        return None
    return ImpactPassResult(
        best=found,
        intervals=joined(intervals, impact_fit.intervals),
        impact_fit=impact_fit,
    )


def _without_slides(
    best: ScoredFit, problem: GapProblem, reweighted: GapProblem, scorer: Scorer
) -> ScoredFit:
    """Refit the hypothesis without slides, which the impact pass searches again."""
    fitted = best.fitted
    slides = [
        own
        for effect, own in zip(fitted.effects, fitted.structure.slices, strict=True)
        if effect.kind == "structural_looseness"
    ]
    kept = np.ones(len(fitted.free), dtype=bool)
    for own in slides:
        kept[own] = False
    rigid = fitted.structure.with_effects(
        [effect for effect in fitted.effects if effect.kind != "structural_looseness"]
    )
    known = fitted.jacobian[:, kept] * noise_ratio(problem.fit, reweighted.fit)[:, None]
    return scorer.score(fit(reweighted.fit, rigid, fitted.free[kept], known=known))


def _with_impact_part(comparison: ResidualModel, rigid: Fit, impact_fit: ImpactFit) -> Fit:
    """Add a part fitted by its impact power to a fit, without refitting."""
    whole = Fit(
        structure=rigid.structure.plus(impact_fit.effect),
        free=np.concatenate([rigid.free, impact_fit.fitted.free]),
        residual=np.zeros(0),
        jacobian=np.zeros((len(comparison), 0)),
        cost=0.0,
    )
    residual = comparison.residuals([whole.hypothesis])[0]
    none = np.zeros((len(comparison), len(impact_fit.fitted.free)))
    return replace(
        whole,
        residual=residual,
        jacobian=np.concatenate([rigid.jacobian, none], axis=1),
        cost=cost_of(residual, whole.free, whole.structure.parameters),
    )
