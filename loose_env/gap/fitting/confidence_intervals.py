"""95 % intervals of fitted parameters by block bootstrap, widened to cover scatter of runs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.model_structure import prior_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import (
    NARROWEST_INTERVAL,
)
from loose_env.inference import block_counts
from loose_env.typing import Array

_MIN_CURVATURE = 1.0
"""Rise of the sum of squares [noise variances] with a step of one free number, about the least size
that matters, below which the data do not answer to it."""
_DRAWS = 500
"""Draws of the bootstrap."""
_UNINFORMED_VARIANCE = 1e6
"""Factor on the squared range of such a number, for its variance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Intervals:
    """95 % intervals of the values of all parameters."""

    low: Array
    """Lower ends, in the parameters' units (P,)."""
    high: Array
    """Upper ends (P,)."""
    free: Array
    """Free numbers of the fit (P,)."""
    covariance: Array
    """Covariance of the free numbers, over blocks (P, P)."""
    misfit: float = 1.0
    """Variance of the blocks' gradients over that of noise alone; at least 1."""

    def include_zero(self, effect: Effect, own: slice) -> bool:
        """Return whether the 95 % confidence region of an effect includes zero.

        `own` are the indices of its parameters. Components of a correlated vector may each be zero,
        but not all of them: the joint confidence ellipse decides.
        """
        if not effect.interval_includes_null(self.low[own], self.high[own]):
            return False
        if (
            effect.null_values is None
            or effect.proportional is not None
            or own.stop == own.start + 1
        ):
            return True
        off = self.free[own] - free_of(effect.parameters, np.array(effect.null_values))
        distance = off @ np.linalg.pinv(self.covariance[own, own]) @ off
        return bool(distance < stats.chi2.ppf(0.95, len(off)))


def bootstrap(comparison: ResidualModel, fitted: Fit, rng: np.random.Generator) -> Intervals:
    """Bootstrap blocks of time, with one Gauss-Newton step for each draw.

    The residual is nearly linear in the parameters, so that no draw needs a simulation. Blocks
    preserve autocorrelation. Where the model fits badly the data are down-weighted (a
    quasi-likelihood, Wedderburn, Biometrika 61, 1974), and priors weigh more: else a wrong model
    would move masses and gains, and parameters correlated with them, far beyond their tolerance.
    """
    parameters = fitted.structure.parameters
    _, weights = prior_of(parameters)
    count, blocks = len(parameters), int(comparison.rows.block.max()) + 1
    curvatures, slopes = np.zeros((blocks, count, count)), np.zeros((blocks, count))
    order = np.argsort(comparison.rows.block, kind="stable")
    edges = np.searchsorted(comparison.rows.block[order], np.arange(blocks + 1))
    for b in range(blocks):
        own = order[edges[b] : edges[b + 1]]
        jacobian = fitted.jacobian[own]
        curvatures[b], slopes[b] = jacobian.T @ jacobian, jacobian.T @ fitted.residual[own]
    misfit = _misfit(curvatures, slopes)
    curvatures, slopes = curvatures / misfit, slopes / misfit
    known = np.diag(weights**2 + 1e-9)
    inverse = np.linalg.inv(curvatures.sum(axis=0) + known)
    drawn = block_counts(blocks, _DRAWS, rng)
    curvature = np.tensordot(drawn, curvatures, 1) + known
    # Deviations from the whole sample's gradient, so that a fit at a bound is not pushed further.
    slope = (drawn - 1) @ slopes
    # Priors have their stated uncertainty: they determine the directions that the data leave open.
    slope += weights * rng.standard_normal(slope.shape)
    steps = -np.linalg.solve(curvature, slope[..., None])[..., 0]
    free = fitted.free + steps
    low, high = np.quantile(free, (0.025, 0.975), axis=0)
    covariance = inverse @ (slopes.T @ slopes + np.diag(weights**2)) @ inverse
    # Data that are insensitive to a parameter show no scatter in it: it may take any value.
    blind = (np.einsum("bpp->p", curvatures) < _MIN_CURVATURE) & (weights == 0)
    ends = np.array([p.bounds for p in parameters])
    low[blind], high[blind] = ends[blind].T
    covariance[blind], covariance[:, blind] = 0.0, 0.0
    covariance[blind, blind] = np.ptp(ends[blind], axis=1) ** 2 * _UNINFORMED_VARIANCE
    return Intervals(
        low=np.array([p.value(v) for p, v in zip(parameters, low, strict=True)]),
        high=np.array([p.value(v) for p, v in zip(parameters, high, strict=True)]),
        free=fitted.free,
        covariance=covariance,
        misfit=misfit,
    )


def _misfit(curvatures: Array, slopes: Array) -> float:
    """Ratio of the gradients' variance over blocks (B, P) to that of noise."""
    by_noise = np.einsum("bpp->p", curvatures)
    seen = by_noise > 0
    if not seen.any():
        return 1.0
    return max(1.0, float(np.mean(np.sum(slopes[:, seen] ** 2, axis=0) / by_noise[seen])))


def widened(comparison: ResidualModel, fitted: Fit, intervals: Intervals) -> Intervals:
    """Widen intervals to cover the disagreement between runs.

    A slightly wrong law fits every motion with other parameters. The gradient of each run at the
    common fit gives the direction; their scatter is that of a cluster-robust covariance (Liang and
    Zeger, Biometrika 73, 1986), with Student's t for as few runs as a recording has (Bell and
    McCaffrey, Survey Methodology 28, 2002). This is a rough estimate: by it alone no interval is
    widened to include zero where other runs have refuted that; the end on that side remains as it
    is. No interval is narrower than the uncertainty of the law itself.
    """
    intervals = _at_least_law_error(fitted, intervals)
    runs = np.unique(comparison.rows.trial)
    if len(runs) < 2:
        return intervals
    parameters = fitted.structure.parameters
    _, weights = prior_of(parameters)
    worth = 1 / intervals.misfit
    curvature = worth * fitted.jacobian.T @ fitted.jacobian + np.diag(weights**2 + 1e-9)
    slopes = np.zeros((len(runs), len(weights)))
    for k, run in enumerate(runs):
        own = comparison.rows.trial == run
        slopes[k] = worth * fitted.jacobian[own].T @ fitted.residual[own]
    asked = np.linalg.solve(curvature, (slopes - slopes.mean(axis=0)).T)
    room = stats.t.ppf(0.975, len(runs) - 1) * np.sqrt(
        (asked**2).sum(axis=1) * len(runs) / (len(runs) - 1)
    )
    ends = [
        [p.value(f + side) for p, f, side in zip(parameters, fitted.free, sides, strict=True)]
        for sides in (-room, room)
    ]
    low, high = np.minimum(intervals.low, ends[0]), np.maximum(intervals.high, ends[1])
    for effect, own in zip(fitted.effects, fitted.structure.slices, strict=True):
        if effect.interval_includes_null(low[own], high[own]):
            low[own], high[own] = _widened_excluding_zero(
                effect, intervals, own, low[own], high[own]
            )
    return replace(intervals, low=low, high=high)


def joined(first: Intervals, second: Intervals) -> Intervals:
    """Join the intervals of two sets of parameters fitted one after the other."""
    count = len(first.free)
    covariance = np.zeros((count + len(second.free),) * 2)
    covariance[:count, :count] = first.covariance
    covariance[count:, count:] = second.covariance
    return Intervals(
        low=np.concatenate([first.low, second.low]),
        high=np.concatenate([first.high, second.high]),
        free=np.concatenate([first.free, second.free]),
        covariance=covariance,
        misfit=max(first.misfit, second.misfit),
    )


def _at_least_law_error(fitted: Fit, intervals: Intervals) -> Intervals:
    """Limit the precision of intervals to `NARROWEST_INTERVAL`, of a value or its size."""
    parameters = fitted.structure.parameters
    values = values_of(parameters, fitted.free)
    null = np.concatenate(
        [
            np.zeros(len(fitted.structure.nuisance.parameters)),
            *(
                np.zeros(len(effect.parameters))
                if effect.null_values is None
                else effect.null_values
                for effect in fitted.effects
            ),
        ]
    )
    room = NARROWEST_INTERVAL * np.minimum(
        np.abs(values - null), np.where(null == 0, np.inf, abs(values))
    )
    low = np.maximum(values - room, [p.low for p in parameters])
    high = np.minimum(values + room, [p.high for p in parameters])
    return replace(
        intervals, low=np.minimum(intervals.low, low), high=np.maximum(intervals.high, high)
    )


def _widened_excluding_zero(
    effect: Effect, intervals: Intervals, own: slice, low: Array, high: Array
) -> tuple[Array, Array]:
    """Widen interval ends (P,), except those that would newly include zero."""
    before = intervals.low[own], intervals.high[own]
    if effect.null_values is None:
        ends = [dict(effect.limit).get(p.name) for p in effect.parameters]
        to_low = np.array([end == "low" for end in ends])
        to_high = np.array([end == "high" for end in ends])
    else:
        null = np.array(effect.null_values)
        to_low, to_high = null < before[0], null > before[1]
    return np.where(to_low, before[0], low), np.where(to_high, before[1], high)
