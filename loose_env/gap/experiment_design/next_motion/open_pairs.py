"""Fitted rivals of identified effects, and the pairs that the runs so far do not tell apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.arms import quiet
from loose_env.gap.experiment_design.next_motion.laplace import (
    Knowledge,
    prior_precision,
    weights_of,
)
from loose_env.gap.fitting.gauss_newton import Fit, FitSettings, cost_of, fit
from loose_env.gap.fitting.refit import with_new_jacobian
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.parameter import free_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.residuals.windows import windowed
from loose_env.gap.selection.screening.screening import ScreenedCandidate, screen
from loose_env.gap.selection.screening.window_fits import WindowFits
from loose_env.gap.settings import EQUAL_LOG_LIKELIHOOD, SCREENING_S
from loose_env.typing import Array

DECIDED = 0.5 * EQUAL_LOG_LIKELIHOOD
"""Difference in log evidence from which a pair is decided [nats]."""
NOTHING = "nothing"
"""Name of what an effect is told from that the runs would not show."""
_UNSEEN = 0.2
"""Weight of an effect that the runs would not show, beside one that competes with the answer."""
_RELINEARISE_STEP = 0.3
"""Change of a free number from which sensitivities are taken anew."""

_CLOSE = FitSettings(iterations=8, cost_tolerance=1e-4)
"""Fit of a rival: what it leaves to gain counts as evidence against it."""

Place = tuple[str, str]
"""Kind and location of an effect."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenPair:
    """An effect of the answer and one that may be there in its place, or beside the answer."""

    effect: Effect | None
    """The effect of the answer; None for one that the runs would not show beside the answer."""
    rival: Effect
    """What may be there instead."""
    fitted: Fit
    """The answer with the rival in the place of the effect, fitted to the same runs; with one that
    they would not show, of a size that matters."""
    known: Knowledge
    """What the runs say of the rival hypothesis."""
    nats: float
    """Log evidence of the answer over the rival so far."""

    @property
    def description(self) -> str:
        """Both with their locations."""
        return f"{words_of(self.effect)} from {words_of(self.rival)}"

    @property
    def weight(self) -> float:
        """Weight in the choice of a motion: what competes with the answer comes first."""
        return 1.0 if self.effect is not None else _UNSEEN


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypotheses:
    """The answer and its rivals, with what the runs say of each."""

    answer: Fit
    """The answer, fitted to the runs, with its sensitivities."""
    known: Knowledge
    """What the runs say of it."""
    weights: Array
    """Weight of each channel (C,): below 1 where the answer leaves more than noise."""
    share: float
    """Share of the rows that count as independent."""
    pairs: tuple[OpenPair, ...] = ()
    """Rivals that are not excluded, the most probable first."""
    decided: tuple[OpenPair, ...] = ()
    """Rivals that the evidence of the runs excludes."""


def words_of(effect: Effect | None) -> str:
    """Kind and location; "nothing" where there is none."""
    return NOTHING if effect is None else f"{effect.kind} at {effect.where}"


def open_hypotheses(
    comparison: ResidualModel,
    best: Fit,
    rivals: Sequence[tuple[Place, Sequence[Effect]]],
    unseen: Sequence[tuple[Effect, Array]] = (),
    *,
    say: Callable[[str], None] = lambda _: None,
) -> Hypotheses:
    """Fit rivals in the place of effects of an answer, and compare their evidence with its."""
    with quiet():
        answer = _with_sensitivities(best, comparison)
        weights, share = weights_of(comparison, answer.residual)
        rows = np.sqrt(share) * weights[comparison.rows.channel]
        known = Knowledge.of(answer, rows)
        pairs = []
        for place, forms in rivals:
            effect = next(e for e in answer.effects if (e.kind, e.where) == place)
            fitted = _replaced(comparison, answer, effect, forms)
            if fitted is None:
                continue
            there = Knowledge.of(fitted, rows)
            pair = OpenPair(
                effect=effect,
                rival=fitted.effects[-1],
                fitted=fitted,
                known=there,
                nats=known.log_evidence - there.log_evidence,
            )
            say(f"  {pair.description}: {pair.nats:.1f} nats so far")
            pairs.append(pair)
    pairs.sort(key=lambda pair: pair.nats)
    pairs += [_unseen(answer, known, effect, values) for effect, values in unseen]
    return Hypotheses(
        answer=answer,
        known=known,
        weights=weights,
        share=share,
        pairs=tuple(p for p in pairs if p.nats < DECIDED),
        decided=tuple(p for p in pairs if p.nats >= DECIDED),
    )


def _unseen(answer: Fit, known: Knowledge, effect: Effect, values: Array) -> OpenPair:
    """The answer with one more effect, of which the runs say nothing."""
    structure = answer.structure.plus(effect)
    free = np.concatenate([answer.free, free_of(effect.parameters, values)])
    prior = prior_precision(effect.parameters)
    precision = np.zeros((len(known.precision) + len(prior),) * 2)
    precision[: len(known.precision), : len(known.precision)] = known.precision
    precision[len(known.precision) :, len(known.precision) :] = np.diag(prior)
    return OpenPair(
        effect=None,
        rival=effect,
        fitted=replace(answer, structure=structure, free=free),
        known=Knowledge(precision=precision, log_evidence=known.log_evidence),
        nats=0.0,
    )


def _with_sensitivities(fitted: Fit, comparison: ResidualModel) -> Fit:
    residual = comparison.residuals([fitted.hypothesis])[0]
    fitted = replace(fitted, residual=residual)
    return (
        fitted if len(fitted.jacobian) == len(residual) else with_new_jacobian(fitted, comparison)
    )


def _replaced(
    comparison: ResidualModel, answer: Fit, effect: Effect, forms: Sequence[Effect]
) -> Fit | None:
    """Fit the best form of a rival in the place of an effect; None if none can be seen."""
    without = _without(comparison, answer, effect)
    short = windowed(comparison, SCREENING_S)
    structure = without.structure
    if short is not comparison:  # windows have other initial states
        structure = replace(structure, nuisance=replace(structure.nuisance, initial=None))
    free = without.free[len(without.free) - len(structure.parameters) :]
    before = replace(
        without, structure=structure, free=free, jacobian=without.jacobian[:, -len(free) :]
    )
    if not len(free):
        before = replace(before, jacobian=without.jacobian[:, :0])
    windows = WindowFits(short, before)
    screened = screen(short, windows.before, list(forms))
    best_of: dict[tuple[str, str, str], ScreenedCandidate] = {}
    for each in screened:
        best_of.setdefault(each.effect.key, each)
    if not best_of:
        return None
    fits, _ = windows.staged_fits([[each] for each in best_of.values()], twice=len(best_of))
    if not fits:
        return None
    own = fits[0]
    together = without.structure.plus(own.effects[-1])
    count = len(own.effects[-1].parameters)
    start = np.concatenate([without.free, own.free[len(own.free) - count :]])
    found = fit(comparison, together, start, settings=_CLOSE, known=without.jacobian)
    # The sensitivities of the rival's own parameters at the end; the others hardly change.
    return with_new_jacobian(found, comparison) if _moved(found, start) else found


def _moved(found: Fit, start: Array) -> bool:
    return bool(np.any(np.abs(found.free - start) > _RELINEARISE_STEP))


def _without(comparison: ResidualModel, answer: Fit, effect: Effect) -> Fit:
    """The answer without an effect, the rest as it is."""
    own = answer.structure.slice_of(effect)
    kept = np.delete(np.arange(len(answer.free)), np.arange(own.start, own.stop))
    structure = answer.structure.with_effects([e for e in answer.effects if e is not effect])
    free = answer.free[kept]
    residual = comparison.residuals([structure.hypothesis(free)])[0]
    return replace(
        answer,
        structure=structure,
        free=free,
        residual=residual,
        jacobian=answer.jacobian[:, kept],
        cost=cost_of(residual, free, structure.parameters),
    )
