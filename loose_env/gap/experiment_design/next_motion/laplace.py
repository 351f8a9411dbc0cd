"""Laplace approximation of a fitted hypothesis, and the gain of a motion in its log evidence.

Nuisance parameters have the priors of the fit, effects a normal one as wide as their bounds. What
the fit leaves counts as noise, channel by channel, and autocorrelated rows count once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.model_structure import prior_of
from loose_env.gap.model.parameter import Parameter
from loose_env.gap.residuals.autocorrelation import independent_rows
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.inference import log_determinant
from loose_env.typing import Array, IndexArray

_WIDTH = float(np.sqrt(12.0))
"""Width of a uniform distribution over its standard deviation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Knowledge:
    """A fitted hypothesis and what the runs so far say of its parameters."""

    precision: Array
    """Inverse covariance of its free numbers but the initial states, with priors (P, P)."""
    log_evidence: float
    """Log evidence of the runs so far, up to a constant of the runs [nats]."""

    @classmethod
    def of(cls, fitted: Fit, weights: Array) -> Knowledge:
        """What some runs say."""
        parameters = fitted.structure.parameters
        prior = prior_precision(parameters)
        jacobian, residual = weights[:, None] * fitted.jacobian, weights * fitted.residual
        precision = jacobian.T @ jacobian + np.diag(prior)
        # Initial states belong to the runs so far: the others as far as these leave them free.
        first = fitted.structure.nuisance.initial_slice.stop
        centres, own = prior_of(parameters)
        deviations = own * (fitted.free - centres)
        squares = float(residual @ residual + deviations @ deviations)
        occam = log_determinant(precision) - float(np.sum(np.log(prior)))
        return cls(precision=_marginal(precision, first), log_evidence=-0.5 * (squares + occam))

    def of_some(self, kept: IndexArray) -> Knowledge:
        """What is known of some free numbers if the others are fixed."""
        return Knowledge(precision=self.precision[np.ix_(kept, kept)], log_evidence=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Separation:
    """Expected gain of a motion in the log evidence of one hypothesis over another."""

    misfit: float
    """Half the sum of squares that the other leaves, what is known of it included [nats]."""
    occam: float
    """What the other pays for its parameters beyond what the first one does [nats]."""
    shift: Array
    """Change of the other's free numbers that takes up most of the difference (Q,)."""

    @property
    def nats(self) -> float:
        """Gain in log evidence if the first is right [nats]."""
        return self.misfit + self.occam


def prior_precision(parameters: tuple[Parameter, ...]) -> Array:
    """Inverse variance of the priors of free numbers (P,)."""
    own = prior_of(parameters)[1] ** 2
    width = np.array([p.bounds[1] - p.bounds[0] for p in parameters])
    return np.asarray(np.where(own > 0, own, (_WIDTH / width) ** 2))


def weights_of(comparison: ResidualModel, residual: Array) -> tuple[Array, float]:
    """Weight of each channel (C,), and the share of rows that are independent."""
    rows = comparison.rows
    count = np.bincount(rows.channel, minlength=len(comparison.channels))
    squares = np.bincount(rows.channel, residual**2, minlength=len(comparison.channels))
    levels = np.sqrt(squares / np.maximum(count, 1))
    share = independent_rows(residual, rows.block, rows.channel) / max(len(residual), 1)
    return 1.0 / np.maximum(levels, 1.0), min(share, 1.0)


def separation(
    difference: Array,
    first: tuple[Knowledge, Array],
    other: tuple[Knowledge, Array],
    room: tuple[Array, Array] | None = None,
) -> Separation:
    """Expected gain of a motion in log evidence, if the first of two hypotheses is right.

    The other one is refitted, linearly, to the motion and to all runs so far: its parameters and
    the nuisances take up what they can. The terms of the determinants are what a hypothesis with
    more parameters pays for them, as they become known.

    Examples
    --------
    >>> flat = Knowledge(precision=np.eye(1), log_evidence=0.0)
    >>> along = np.ones((100, 1))
    >>> seen = separation(np.r_[np.ones(50), -np.ones(50)], (flat, along), (flat, along))
    >>> round(seen.nats, 6)  # half the sum of squares: no parameter takes up an alternating sign
    50.0
    >>> round(separation(np.ones(100), (flat, along), (flat, along)).nats, 3)
    0.495
    """
    (known, own), (there, jacobian) = first, other
    precision = there.precision + jacobian.T @ jacobian
    shift = bounded(precision, jacobian.T @ difference, room)
    left = difference - jacobian @ shift
    squares = float(left @ left + shift @ there.precision @ shift)
    occam = _grown(there, precision) - _grown(known, known.precision + own.T @ own)
    return Separation(misfit=0.5 * squares, occam=0.5 * occam, shift=shift)


def _grown(known: Knowledge, precision: Array) -> float:
    return log_determinant(precision) - log_determinant(known.precision)


def _marginal(precision: Array, first: int) -> Array:
    """Precision of all free numbers but some first ones."""
    if not first:
        return precision
    across = precision[:first, first:]
    return np.asarray(
        precision[first:, first:] - across.T @ np.linalg.solve(precision[:first, :first], across)
    )


def bounded(precision: Array, right: Array, room: tuple[Array, Array] | None) -> Array:
    """Solution of a positive definite system within bounds, by clamping what leaves them (P,).

    Examples
    --------
    >>> bounded(np.eye(2), np.array([2.0, -3.0]), (np.zeros(2), np.ones(2)))
    array([1., 0.])
    """
    found, free = np.zeros(len(right)), np.ones(len(right), dtype=bool)
    for _ in range(len(right) + 1):
        rest = right[free] - precision[np.ix_(free, ~free)] @ found[~free]
        own = precision[np.ix_(free, free)]
        scale = np.sqrt(np.diag(own))
        found[free] = np.linalg.solve(own / np.outer(scale, scale), rest / scale) / scale
        if room is None:
            break
        out = free & ((found < room[0]) | (found > room[1]))
        if not out.any():
            break
        found[out] = np.clip(found[out], room[0][out], room[1][out])
        free &= ~out
    return found
