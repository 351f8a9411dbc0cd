"""Confidence intervals tightened where the runs refute an end at a limit, or zero effect.

The bootstrap of an interval draws steps of a linearised fit. In impact-dominated runs the sum of
squares is not quadratic, and such an interval may reach a limit that the runs clearly refute, such
as a seat that sticks for ever; or zero effect, with which no fit is as good.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loose_env.gap.fitting.confidence_intervals import Intervals
from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import residual_z
from loose_env.gap.fitting.refit import fit_without
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import (
    ACCEPTED_Z,
    REFUTED_Z,
)

_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9)
"""Values that are looked at: shares of the way to the limit, in free numbers."""


def tightened_at_limit(
    comparison: ResidualModel, fitted: Fit, intervals: Intervals, effect: Effect
) -> Intervals:
    """Tighten interval ends that lie beyond values which the runs refute."""
    if not effect.limit:
        return intervals
    own = fitted.structure.slice_of(effect)
    here = fitted.free[own]
    limit = free_of(effect.parameters, effect.at_limit(values_of(effect.parameters, here)))
    tried = []
    for share in (*_SHARES, 1.0):
        free = fitted.free.copy()
        free[own] = here + share * (limit - here)
        tried.append(free)
    residuals = comparison.residuals([fitted.structure.hypothesis(free) for free in tried])
    z_scores = [
        residual_z(comparison, residual, fitted.residual, by_rank=effect.has_stops)
        for residual in residuals
    ]
    if not z_scores[-1] >= ACCEPTED_Z:
        return intervals
    first = next(k for k, improvement in enumerate(z_scores) if improvement >= REFUTED_Z)
    ends = values_of(effect.parameters, tried[first][own])
    low, high = intervals.low.copy(), intervals.high.copy()
    to_low = [dict(effect.limit).get(p.name) == "low" for p in effect.parameters]
    to_high = [dict(effect.limit).get(p.name) == "high" for p in effect.parameters]
    low[own] = np.where(to_low, np.maximum(low[own], ends), low[own])
    high[own] = np.where(to_high, np.minimum(high[own], ends), high[own])
    return replace(intervals, low=low, high=high)


def tightened_at_zero(
    comparison: ResidualModel, fitted: Fit, intervals: Intervals, effect: Effect
) -> Intervals:
    """Tighten the interval end of an effect beside stops to what the runs refute.

    All else is refitted without the effect. If that is significantly worse, by an improvement z of
    the fit with the effect, the parameter furthest from zero, in standard deviations, gets its
    interval end towards zero at no more than 2 / z of the distance: z grows about as the distance.
    """
    if effect.null_values is None or not have_stops(fitted.effects):
        return intervals
    without = fit_without(comparison, fitted, effect).residual
    improvement = residual_z(comparison, without, fitted.residual)
    if not improvement >= ACCEPTED_Z:
        return intervals
    own = fitted.structure.slice_of(effect)
    here, null = fitted.free[own], free_of(effect.parameters, np.array(effect.null_values))
    scatter = np.sqrt(np.maximum(np.diag(intervals.covariance)[own], 1e-30))
    furthest = int(np.argmax(np.abs(here - null) / scatter))
    ends = values_of(effect.parameters, here + REFUTED_Z / improvement * (null - here))
    number, end = own.start + furthest, float(ends[furthest])
    low, high = intervals.low.copy(), intervals.high.copy()
    if null[furthest] < here[furthest]:
        low[number] = max(low[number], end)
    else:
        high[number] = min(high[number], end)
    return replace(intervals, low=low, high=high)
