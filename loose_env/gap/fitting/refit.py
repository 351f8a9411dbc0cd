"""Refits of a fit: new Jacobian, further iterations, one effect dropped or in another form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loose_env.gap.fitting.gauss_newton import (
    STOP_FIT_SETTINGS,
    Fit,
    FitSettings,
    cost_of,
    fit,
    fit_settings_for,
    sensitivities,
    step_of,
)
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import ResidualModel

_ROUGHLY = 0.01
"""Share of the cost below which a further step is not worth it where a fit is only compared with a
better one."""
STILL_GAINS = 0.01
"""Share of the cost that a fit with fresh sensitivities gains, from which it is worth while: what
the parameters of a model would gain, any further effect seems to explain."""
_ROUNDS = 8
"""Most such rounds."""


def fit_without(
    comparison: ResidualModel, fitted: Fit, effect: Effect, *, roughly: bool = False
) -> Fit:
    """Drop one effect of a fit and refit the others."""
    others, kept = _without(fitted, effect)
    settings, reference = fit_settings_for(others), np.inf
    if roughly:
        tolerance = max(settings.cost_tolerance, _ROUGHLY)
        settings, reference = replace(settings, cost_tolerance=tolerance), fitted.cost
    known = fitted.jacobian[:, kept]
    return fit(
        comparison,
        others,
        fitted.free[kept],
        settings=settings,
        known=known,
        reference=reference,
    )


def needed_least(comparison: ResidualModel, fitted: Fit, effects: Sequence[Effect]) -> list[Effect]:
    """Sort effects of a fit by what is lost without each, the least first.

    Backward elimination by approximation: each effect is taken out by simulation, and the others
    are refitted to first order, as in a Wald test (J. F. Lawless and K. Singhal, Biometrics 34,
    1978).
    """
    left = [_without(fitted, effect) for effect in effects]
    residuals = comparison.residuals(
        [structure.hypothesis(fitted.free[kept]) for structure, kept in left]
    )
    losses = []
    for (structure, kept), residual in zip(left, residuals, strict=True):
        free, jacobian, parameters = (
            fitted.free[kept],
            fitted.jacobian[:, kept],
            structure.parameters,
        )
        step = step_of(jacobian, residual, free, parameters)
        losses.append(cost_of(residual + jacobian @ step, free + step, parameters))
    return [effects[k] for k in np.argsort(losses, kind="stable")]


def _without(fitted: Fit, effect: Effect) -> tuple[ModelStructure, list[int]]:
    """Structure of a fit without one of its effects, and indices of its free numbers."""
    own = fitted.structure.slice_of(effect)
    kept = [k for k in range(len(fitted.free)) if not own.start <= k < own.stop]
    others = [each for each in fitted.effects if each is not effect]
    return fitted.structure.with_effects(others), kept


def with_last(fitted: Fit, effect: Effect) -> Fit:
    """The same fit with one of its effects listed last."""
    structure, kept = _without(fitted, effect)
    own = fitted.structure.slice_of(effect)
    order = [*kept, *range(own.start, own.stop)]
    return replace(
        fitted,
        structure=structure.plus(effect),
        free=fitted.free[order],
        jacobian=fitted.jacobian[:, order],
    )


def fit_in_form(comparison: ResidualModel, fitted: Fit, effect: Effect, form: Effect) -> Fit:
    """Fit another form of an effect in its place, as far as it may be better."""
    own = fitted.structure.slice_of(effect)
    known = dict(
        zip(
            (p.name for p in effect.parameters),
            values_of(effect.parameters, fitted.free[own]),
            strict=True,
        )
    )
    otherwise = form.starts[0] if form.null_values is None else form.null_values
    values = [
        float(known.get(p.name, value)) for p, value in zip(form.parameters, otherwise, strict=True)
    ]
    structure, kept = _without(fitted, effect)
    start = np.concatenate([fitted.free[kept], free_of(form.parameters, np.array(values))])
    known_columns = fitted.jacobian[:, kept]
    return fit(comparison, structure.plus(form), start, known=known_columns, reference=fitted.cost)


def fitted_on(comparison: ResidualModel, fitted: Fit) -> Fit:
    """Continue a fit with its existing sensitivities."""
    return fit(
        comparison,
        fitted.structure,
        fitted.free,
        known=fitted.jacobian,
        residual=fitted.residual,
    )


def refit_with_new_jacobian(comparison: ResidualModel, fitted: Fit) -> Fit:
    """Continue a fit with sensitivities recomputed once."""
    return fitted_on(comparison, with_new_jacobian(fitted, comparison))


def converged(comparison: ResidualModel, fitted: Fit) -> Fit:
    """Continue a fit with fresh sensitivities while its parameters have more to gain.

    Beside stops once: every nudge finds another local optimum there.
    """
    for _ in range(1 if have_stops(fitted.effects) else _ROUNDS):
        before = fitted.cost
        fitted = refit_with_new_jacobian(comparison, fitted)
        if before - fitted.cost < STILL_GAINS * before:
            break
    return fitted


def with_new_jacobian(fitted: Fit, comparison: ResidualModel) -> Fit:
    """Recompute all sensitivities of a fit."""
    jacobian = sensitivities(
        comparison,
        fitted.structure,
        fitted.free,
        fitted.residual,
        range(len(fitted.free)),
        difference=fit_settings_for(fitted.structure).finite_difference_step,
    )
    return replace(fitted, jacobian=jacobian)


def converged_with_short_steps(comparison: ResidualModel, fitted: Fit) -> Fit:
    """Converge a hypothesis with stops by short differences, where that is better.

    Long differences bridge the discontinuity between a missed and an actual impact; near
    convergence short ones are more accurate.
    """
    short = replace(STOP_FIT_SETTINGS, finite_difference_step=FitSettings.finite_difference_step)
    found = fit(comparison, fitted.structure, fitted.free, settings=short, residual=fitted.residual)
    return with_new_jacobian(found, comparison) if found.cost < fitted.cost else fitted
