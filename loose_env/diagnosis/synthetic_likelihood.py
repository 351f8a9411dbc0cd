"""A synthetic likelihood: measured summaries against simulated ones, with their scatter.

References
----------
S. N. Wood, "Statistical inference for noisy nonlinear ecological dynamic systems", Nature 466,
2010. E. Sellentin, A. F. Heavens, "Parameter inference with estimated covariance matrices",
MNRAS Letters 456, 2016: Student's law where the covariance is an estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from loose_env.diagnosis.record import RecordStatistics
from loose_env.errors import InvalidData

__all__ = ["ParticleModel", "Repeated", "SyntheticLikelihood", "summaries_of"]

Array = NDArray[np.float64]
_TINY = 1e-12
_HIGHEST = 1 - 1e-7
"""Correlations above are taken as this; readings rounded to seven digits cannot tell them."""


class ParticleModel(Protocol):
    """What can be simulated under every hypothesis."""

    prior: Array
    """Probability of each hypothesis (H,)."""
    variates: Sequence[int]
    """Number of standard normal variates that make a particle of each hypothesis (H,)."""
    measured: Array
    """Summaries of what was measured (D,)."""
    blocks: Array
    """Number of the record that each summary is of (D,)."""

    def simulate(self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]) -> Array:
        """Simulate particles (N, V) with numbered realisations (N,) of excitation and noise.

        Returns their summaries (N, D), not finite where a simulation failed.
        """
        ...


def summaries_of(record: RecordStatistics) -> Array:
    """Put what one record says into numbers that scatter nearly normally.

    Per excited joint: its in-step share of the tool's motion along every axis (transmission times
    the joint's rms over the tool's), the logs of its rms and of its apparent inertia. Of the tool:
    logs of its variances, Fisher's z of their correlations. Then the kurtosis along every axis
    and along the lowest coherence, by asinh.

    Returns
    -------
    ndarray (m (d + 2) + d (d + 1) / 2 + d + 1,)
        Summaries [1, logs of rad/s², kg·m² and m²/s⁴].
    """
    on = np.flatnonzero(record.excited)
    variance = np.maximum(np.diag(record.tool_covariance), _TINY)
    upper = np.triu_indices(len(variance), 1)
    scale = np.sqrt(variance)
    correlation = record.tool_covariance[upper] / (scale[upper[0]] * scale[upper[1]])
    motion = record.transmission_by_instrument[:, on] * record.joint_rms[on]
    return np.concatenate(
        [
            (motion / np.sqrt(variance.sum())).ravel(),
            np.log(np.maximum(record.joint_rms[on], _TINY)),
            np.log(np.maximum(np.abs(record.inertia[on]), _TINY)),
            np.log(variance),
            np.arctanh(np.clip(correlation, -_HIGHEST, _HIGHEST)),
            np.arcsinh(record.kurtosis),
            [np.arcsinh(record.lowest_kurtosis)],
        ]
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Repeated:
    """One particle, simulated again and again."""

    common: Array
    """Summaries under the realisation that all particles share (D,)."""
    again: Array
    """Summaries under others, a row each (R, D)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticLikelihood:
    """Likelihood of what was measured, given what a particle shows.

    Examples
    --------
    >>> import numpy as np
    >>> measured, shown = np.zeros(1), np.array([[0.0], [2.0], [np.nan]])
    >>> SyntheticLikelihood.by_spread(measured, shown).log(shown).round(6).tolist()
    [0.0, -2.0, -inf]
    """

    centre: Array
    """What was measured, plus what the common realisation adds to a particle (D,)."""
    white: Array
    """Matrix that brings summaries to standard deviations (D, D)."""
    freedom: float
    """Degrees of freedom; infinite ones make it normal."""
    interaction: float = 0.0
    """Variance that a realisation adds beyond what it adds to all particles alike, over the
    sampling variance, mean over the summaries."""

    @classmethod
    def by_spread(cls, measured: Array, summaries: Array) -> SyntheticLikelihood:
        """Take distances in units of the particles' own spread.

        Parameters
        ----------
        measured : ndarray (D,)
            What was measured.
        summaries : ndarray (N, D)
            What the particles show.

        Raises
        ------
        InvalidData
            If all simulations failed.
        """
        whole = np.isfinite(summaries).all(axis=1)
        if not whole.any():
            raise InvalidData(
                "all particles failed in simulation: look at the arm and at the excitation of the "
                "records, whose simulation diverges"
            )
        shown = summaries[whole]
        spread = np.median(np.abs(shown - np.median(shown, axis=0)), axis=0)
        white = np.diag(1 / np.maximum(spread, 1e-6))
        return cls(centre=measured, white=white, freedom=np.inf)

    @classmethod
    def by_repeats(
        cls, measured: Array, repeated: Sequence[Repeated], blocks: Array, *, freedom: float
    ) -> SyntheticLikelihood:
        """Take the sampling covariance, and what the common realisation adds, from repeats.

        Parameters
        ----------
        measured : ndarray (D,)
            What was measured.
        repeated : sequence of Repeated
            Particles near to it.
        blocks : ndarray (D,)
            Number of the record that each summary is of: records are sampled apart.
        freedom : float
            Degrees of freedom of the likelihood.

        Raises
        ------
        InvalidData
            If less than two of the particles could be repeated.
        """
        size, count = len(measured), 0
        scatter, inverse = np.zeros((size, size)), []
        away: list[Array] = []
        for one in repeated:
            again = one.again[np.isfinite(one.again).all(axis=1)]
            if len(again) < 2:
                continue
            deviations = again - again.mean(axis=0)
            scatter += deviations.T @ deviations
            away.append(one.common - again.mean(axis=0))
            inverse.append(1 / len(again))
            count += len(again) - 1
        if len(away) < 2:
            raise InvalidData(
                f"of {len(repeated)} particles near the records {len(away)} could be simulated "
                "again; at least 2 are needed: take more particles or more repeats"
            )
        covariance = scatter / count
        covariance[blocks[:, None] != blocks] = 0.0
        # What few repeats show of covariances is damped; variances stay.
        variance = np.maximum(np.diag(covariance), _TINY)
        covariance *= count / (count + size)
        np.fill_diagonal(covariance, variance)
        between = np.var(away, axis=0, ddof=1) - np.mean(inverse) * variance
        return cls(
            centre=measured + np.mean(away, axis=0),
            white=np.linalg.inv(np.linalg.cholesky(covariance)),
            freedom=freedom,
            interaction=float(np.mean(np.maximum(between, 0.0) / variance)),
        )

    def _distance(self, summaries: Array) -> Array:
        """Squared distance in standard deviations, infinite for what failed (N,)."""
        squares = (((summaries - self.centre) @ self.white.T) ** 2).sum(axis=1)
        return np.where(np.isfinite(squares), squares, np.inf)

    def nearest(self, summaries: Array, count: int) -> NDArray[np.intp]:
        """Indices of the particles nearest to what was measured, failed ones left out."""
        distance = self._distance(summaries)
        order = np.argsort(distance, kind="stable")[:count]
        return order[np.isfinite(distance[order])]

    def log(self, summaries: Array) -> Array:
        """Log likelihood of particles, up to one constant; -inf for those that failed (N,)."""
        distance = self._distance(summaries)
        if np.isinf(self.freedom):
            return -0.5 * distance
        size = self.freedom + summaries.shape[1]
        return np.asarray(-0.5 * size * np.log1p(distance / self.freedom))
