"""Scores of fits on training and held-out runs, and improvement (z) of one fit over another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.initial_state import InitialStates
from loose_env.gap.residuals.autocorrelation import LaggedProducts, largest
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import (
    IMPACT_DOMINATED,
    NOISE_RMS,
)
from loose_env.typing import Array

_FAR_BELOW = 0.1
"""Mean square of residuals [noise variances] below which they are no readings'."""
_NOISE_OF_GAIN = np.sqrt(1.5)
"""Standard deviation of the difference of roots of two sums of squares, noise alone and noise with
something large: that of the larger one is 1, of the smaller one the root of a half."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoredFit:
    """A fit with its residuals on the held-out runs."""

    fitted: Fit
    """The fit to the training runs."""
    held_out_residual: Array
    """Residual on the held-out runs, in noise standard deviations (M,)."""
    held_out_blocks: Array
    """Twice its negative log-likelihood by block of time (B,): sums of squares, except for
    torques behind springs, whose noise differs
    (`loose_env.gap.residuals.residual_model.ResidualModel.levels`)."""
    training_blocks: Array
    """The same on the training runs (A,)."""
    held_out_noise: Array
    """Expectation of the blocks of held-out runs if nothing but noise is left (B,)."""
    training_noise: Array
    """The same of the training runs (A,)."""
    held_out_products: Array
    """Sums of lagged products of the residual, by lag and block (3, B)."""
    training_products: Array
    """The same on the training runs (3, A)."""
    channel_products: Array
    """Largest lagged product of all runs by channel, and number of products (2, C)."""

    @property
    def bare(self) -> ScoredFit:
        """The same without the sensitivities of the fit."""
        return replace(self, fitted=self.fitted.bare)

    @property
    def held_out_rms(self) -> float:
        """Root mean square on held-out runs, in noise standard deviations."""
        return float(np.sqrt(np.mean(self.held_out_residual**2)))

    @property
    def free_count(self) -> int:
        """Number of free numbers."""
        return len(self.fitted.free)

    @property
    def total(self) -> float:
        """Twice the negative log-likelihood of all runs, priors included."""
        prior = self.fitted.cost - float(self.fitted.residual @ self.fitted.residual)
        return prior + float(self.training_blocks.sum() + self.held_out_blocks.sum())

    @property
    def autocorrelated(self) -> float:
        """Autocorrelated part of all residuals."""
        return float(
            largest(self.held_out_products.sum(axis=1) + self.training_products.sum(axis=1))
        )

    @property
    def excess(self) -> float:
        """Sum of squares over all runs beyond that of noise."""
        return max(self._training_excess + self._held_out_excess, 0.0)

    @property
    def above_noise(self) -> bool:
        """Return whether the residual on held-out or all runs exceeds the noise in size."""
        largest_noise = NOISE_RMS**2 - 1
        held, fitted = len(self.held_out_residual), len(self.fitted.residual)
        return self._held_out_excess > largest_noise * held or self.excess > largest_noise * (
            held + fitted
        )

    @property
    def impact_dominated(self) -> bool:
        """Return whether the residual is large but hardly autocorrelated: impacts."""
        return self.above_noise and self.autocorrelated < IMPACT_DOMINATED * self.excess

    @property
    def _held_out_excess(self) -> float:
        return float(self.held_out_blocks.sum() - self.held_out_noise.sum())

    @property
    def _training_excess(self) -> float:
        return float(self.training_blocks.sum() - self.training_noise.sum())

    @property
    def autocorrelation_z(self) -> float:
        """Significance (z) of the residual autocorrelation, against white noise.

        The larger of that of held-out runs and of all runs: one family of motions may show an
        effect that the others hardly do. An autocorrelation of white noise has a standard deviation
        of one over the root of the sample size (Bartlett, J. R. Stat. Soc. Suppl. 8, 1946, 27).
        Residuals far below the noise are rounding errors and count as no model error, however
        autocorrelated.
        """
        count, others = len(self.held_out_residual), len(self.fitted.residual)
        held = (count, count + self._held_out_excess, self.held_out_products)
        fitted = (others, others + self._training_excess, self.training_products)
        return max(_z(held), _z(held, fitted))


@dataclass(frozen=True, kw_only=True)
class Improvement:
    """Improvement of one fit over another."""

    held_out: float
    """Improvement (z) on held-out runs, over blocks."""
    training: float
    """Improvement (z) on the training runs, over blocks."""
    share: float
    """Share of the explainable sum of squares that is explained, 1: all of it."""


class Scorer:
    """Scores fits on training and held-out runs."""

    def __init__(self, comparison: ResidualModel, held_out: ResidualModel) -> None:
        self.comparison, self.held_out = comparison, held_out
        # Initial states of held-out runs are fitted separately, and credited to no hypothesis.
        self._start = InitialStates(held_out.machine, held_out.trials, held_out.channels)
        self._fitted, self._held = LaggedProducts(comparison.rows), LaggedProducts(held_out.rows)

    def score(self, fitted: Fit) -> ScoredFit:
        """Simulate the held-out runs and score the fit."""
        _, residual = self._start.fitted(self.held_out, fitted.hypothesis)
        level, held_level = (c.levels(fitted.hypothesis) for c in (self.comparison, self.held_out))
        own, held = fitted.residual / level, residual / held_level
        logs, held_logs = 2 * np.log(level), 2 * np.log(held_level)
        return ScoredFit(
            fitted=fitted,
            held_out_residual=residual,
            held_out_blocks=self.held_out.by_block(held**2 + held_logs),
            training_blocks=self.comparison.by_block(own**2 + logs),
            held_out_noise=self.held_out.by_block(1 + held_logs),
            training_noise=self.comparison.by_block(1 + logs),
            held_out_products=self._held.products(held),
            training_products=self._fitted.products(own),
            channel_products=_added(self._held.by_channel(held), self._fitted.by_channel(own)),
        )


def improvement_of(ahead: ScoredFit, behind: ScoredFit, *, by_rank: bool = False) -> Improvement:
    """Return the improvement of the first fit over the second; negative if worse.

    Blocks also count by rank (`z_score`) where an effect with stops is in one of the two only,
    or where ``by_rank`` says that the two differ by such an effect.
    """
    one, other = ({e.key: e for e in j.fitted.effects} for j in (ahead, behind))
    by_rank = by_rank or any((one | other)[key].has_stops for key in one.keys() ^ other.keys())
    held_out = np.stack([behind.held_out_noise, ahead.held_out_noise])
    training = np.stack([behind.training_noise, ahead.training_noise])
    return Improvement(
        held_out=z_score(behind.held_out_blocks, ahead.held_out_blocks, held_out, by_rank=by_rank),
        training=z_score(behind.training_blocks, ahead.training_blocks, training, by_rank=by_rank),
        share=explained_share(ahead, behind),
    )


def explained_share(ahead: ScoredFit, behind: ScoredFit) -> float:
    """Share of the explainable sum of squares that the first explains, 1: all of it.

    It is computed of the autocorrelated part; where that is close to zero, of the part above the
    noise.
    """
    if behind.impact_dominated:
        return 1.0 - ahead.excess / behind.excess
    return 1.0 - ahead.autocorrelated / behind.autocorrelated if behind.autocorrelated > 0 else 0.0


def residual_z(
    comparison: ResidualModel, behind: Array, ahead: Array, *, by_rank: bool = False
) -> float:
    """Improvement (z) of one residual (N,) over another, in the same runs (`z_score`)."""
    values = np.stack([behind**2, ahead**2, np.ones(len(comparison))])
    return z_score(*comparison.by_block(values), by_rank=by_rank)


def z_score(behind: Array, ahead: Array, noise: Array, *, by_rank: bool = False) -> float:
    """Improvement (z) of one fit over another, from sums by block (B,).

    Blocks are taken as independent, and roots are compared, so that one block of impacts does not
    outweigh all others. A gain is in doubt where the better model leaves something unexplained,
    which the next law may explain instead: its standard error is taken as what that model leaves
    above the noise in that block, noise at least, and the whole gain at most. So an effect that
    acts in a few blocks and leaves noise there is as sure as it is large, while z over a model that
    is wrong elsewhere counts the blocks that agree.

    Where a part with stops makes the difference (``by_rank``), that is not enough: a simulation
    with a slightly mistimed impact has twice the error of the impact there, however accurate it is
    elsewhere. The gains are therefore also compared by rank (the signed ranks of Wilcoxon,
    Biometrics Bull. 1, 1945, 80), and the larger of the two z-scores counts.

    Examples
    --------
    >>> before, after, noise = np.full(40, 400.0), np.full(40, 100.0), np.full(40, 50.0)
    >>> after[0] = 90000.0  # an impact that was missed
    >>> round(z_score(before, after, noise), 1)
    0.4
    >>> round(z_score(before, after, noise, by_rank=True), 1)
    5.6
    >>> before, after = np.full(40, 50.0), np.full(40, 50.0)
    >>> before[:4] = 400.0  # an effect that acts in four blocks
    >>> round(z_score(before, after, noise), 1)
    21.1
    """
    # twice a negative log-likelihood may be below zero, where noise is small
    least = min(0.0, *(float(sums.min(initial=0.0)) for sums in (behind, ahead, noise)))
    roots = np.sqrt(np.stack([behind, ahead]) - least)
    gains = roots[0] - roots[1]
    left = (roots - np.sqrt(noise - least))[int(gains.sum() > 0)]
    errors = np.minimum(np.maximum(left, _NOISE_OF_GAIN), np.abs(gains))
    z = _ratio(gains, errors)
    if not by_rank:
        return z
    ranks = np.sign(gains) * stats.rankdata(np.abs(gains))
    return max(z, _ratio(ranks, ranks))


def _ratio(gains: Array, errors: Array) -> float:
    """Sum of gains (B,) over the root of the sum of squares of their standard errors (B,)."""
    return float(gains.sum()) / max(float(np.sqrt(np.sum(errors**2))), 1e-12)


def _z(*parts: tuple[int, float, Array]) -> float:
    """Autocorrelation (z) of some runs, from counts, sums of squares and products."""
    count = sum(part[0] for part in parts)
    mean_square = sum(part[1] for part in parts) / count
    structure = float(largest(np.sum([products.sum(axis=1) for *_, products in parts], axis=0)))
    return structure / (max(mean_square, _FAR_BELOW) * float(np.sqrt(count)))


def _added(one: Array, other: Array) -> Array:
    """Largest sums of two tables over the lags by channel, and their number (2, C).

    One of the tables by lag and channel, whose last rows are counts, may have fewer channels.
    """
    found = np.zeros((len(one), max(one.shape[1], other.shape[1])))
    found[:, : one.shape[1]] += one
    found[:, : other.shape[1]] += other
    return np.stack([largest(found[:-1]), found[-1]])
