"""Synthetic likelihood of measured summaries from simulated ones.

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

from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.errors import InvalidData
from loose_env.typing import Array

__all__ = [
    "ParticleModel",
    "Repeated",
    "SyntheticLikelihood",
    "nearness",
    "summaries_of",
]

_TINY = 1e-12
_AT_ONCE = 256
"""Particles whose likelihood is worked out together; bounds the memory."""
_HIGHEST = 1 - 1e-7
"""Correlations above are taken as this; readings rounded to seven digits cannot tell them."""


class ParticleModel(Protocol):
    """Simulator of summaries under every hypothesis."""

    prior: Array
    """Probability of each hypothesis (H,)."""
    variates: Sequence[int]
    """Number of standard normal variates that make a particle of each hypothesis (H,)."""
    measured: Array
    """Summaries of what was measured (D,)."""

    def simulate(self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]) -> Array:
        """Simulate particles (N, V) with numbered realisations (N,) of all that is left to chance.

        Returns their summaries (N, D), not finite where a simulation failed.
        """
        ...


def summaries_of(record: RecordStatistics) -> Array:
    """Summaries of one record, nearly normally distributed.

    Per excited joint: its correlation with the tool's motion along every axis, by Fisher's z
    where it is excited alone; the command's correlation with that motion and with the joint's
    own; the log of its rms. Of the tool: logs of its variances, Fisher's z of their
    correlations. Then skewness and kurtosis along every axis and kurtosis along the lowest
    coherence, by asinh.

    The transmission by instrument and the apparent inertia are ratios over the covariance of
    command and joint, which goes through zero near a resonance: there their scatter has no
    variance. Both are shown over the inertia instead, as correlations, which have one.

    Returns
    -------
    ndarray (m (2 d + 2) + d (d + 1) / 2 + 2 d + 1,)
        Summaries [1, logs of rad/s² and m²/s⁴].
    """
    on = np.flatnonzero(record.excited)
    variance = np.maximum(np.diag(record.tool_covariance), _TINY)
    upper = np.triu_indices(len(variance), 1)
    scale = np.sqrt(variance)
    correlation = record.tool_covariance[upper] / (scale[upper[0]] * scale[upper[1]])
    rms = np.maximum(record.joint_rms[on], _TINY)
    followed = record.transmission[:, on] * rms / scale[:, None]
    if len(on) == 1:
        followed = np.arctanh(np.clip(followed, -_HIGHEST, _HIGHEST))
    sign = np.where(record.inertia[on] < 0, -1.0, 1.0)
    per_torque = sign * record.torque[on] / np.maximum(np.abs(record.inertia[on]), _TINY)
    commanded = record.transmission_by_instrument[:, on] * per_torque / scale[:, None]
    return np.concatenate(
        [
            followed.ravel(),
            commanded.ravel(),
            per_torque / rms,
            np.log(rms),
            np.log(variance),
            np.arctanh(np.clip(correlation, -_HIGHEST, _HIGHEST)),
            np.arcsinh(record.skewness),
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
    """Likelihood of the measured summaries given a particle.

    Some particles of all hypotheses are anchors: they are repeated, which shows how their
    summaries scatter and what the common realisation adds to them. A particle takes both from
    the anchors that show nearly the same as it does. So a seat that sticks scatters as a sound
    arm does and one with impacts on its stops as others that do, whatever their hypothesis.
    """

    measured: Array
    """Measured summaries (D,)."""
    anchors: Array
    """Summaries of the anchors under the common realisation (A, D)."""
    away: Array
    """That, less their mean under others (A, D)."""
    scatter: Array
    """Sums of squares and products about that mean (A, D, D)."""
    count: Array
    """Degrees of freedom of the scatter (A,)."""
    correlation: Array
    """Correlations towards which those of few repeats are drawn (D, D)."""
    white: Array
    """Matrix that brings summaries to standard deviations, mean of all anchors (D, D)."""
    freedom: float
    """Degrees of freedom of Student's law; infinite ones make it normal."""
    neighbours: int
    """Anchors that a particle looks to, half of them at most."""
    interaction: float
    """Variance over anchors of what the common realisation adds, beyond that by chance, over the
    scatter [1]: how little one number for all particles would do."""

    @classmethod
    def by_repeats(
        cls,
        measured: Array,
        repeated: Sequence[Repeated],
        *,
        freedom: float,
        neighbours: int = 8,
    ) -> SyntheticLikelihood:
        """Take the scatter from repeats.

        Parameters
        ----------
        measured : ndarray (D,)
            Measured summaries.
        repeated : sequence of Repeated
            The anchors.
        freedom : float
            Degrees of freedom of the likelihood.
        neighbours : int
            Anchors that a particle looks to, half of them at most.

        Raises
        ------
        InvalidData
            If less than two of the anchors could be repeated.
        """
        usable = [(one.common, one.again[np.isfinite(one.again).all(axis=1)]) for one in repeated]
        usable = [(common, again) for common, again in usable if len(again) > 1]
        if len(usable) < 2:
            raise InvalidData(
                f"of {len(repeated)} particles near the records {len(usable)} could be simulated "
                "again; at least 2 are needed: take more particles or more repeats"
            )
        size = len(measured)
        deviations = [again - again.mean(axis=0) for _, again in usable]
        scatter = np.array([d.T @ d for d in deviations])
        count = np.array([len(d) - 1.0 for d in deviations])
        # Correlations of all anchors, each in its own units; what few repeats show is damped.
        own = np.sqrt(np.maximum(np.einsum("add->ad", scatter) / count[:, None], _TINY))
        total = (scatter / (own[:, :, None] * own[:, None, :])).sum(axis=0)
        correlation = total / count.sum() * (count.sum() / (count.sum() + size))
        np.fill_diagonal(correlation, 1.0)
        variance = np.einsum("add->d", scatter) / count.sum()
        root = np.sqrt(np.maximum(variance, _TINY))
        away = np.array([common - again.mean(axis=0) for common, again in usable])
        by_chance = np.mean([1 / len(again) for _, again in usable])
        between = np.maximum(np.var(away, axis=0, ddof=1) / root**2 - by_chance, 0.0)
        return cls(
            measured=measured,
            anchors=np.array([common for common, _ in usable]),
            away=away,
            scatter=scatter,
            count=count,
            correlation=correlation,
            white=np.linalg.inv(np.linalg.cholesky(correlation)) / root,
            freedom=freedom,
            neighbours=neighbours,
            interaction=float(between.mean()),
        )

    def _weights(self, summaries: Array) -> Array:
        """Weight of each anchor for each particle, the largest 1 (N, A)."""
        ours, theirs = summaries @ self.white.T, self.anchors @ self.white.T
        square = ((ours[:, None] - theirs) ** 2).sum(axis=2)
        last = max(1, min(self.neighbours, len(theirs) // 2)) - 1
        # As far as the last neighbour, at least a standard deviation.
        width = np.maximum(np.partition(square, last, axis=1)[:, last], 1.0)
        nearest = square.min(axis=1)
        return np.asarray(np.exp(-2 * (square - nearest[:, None]) / width[:, None]))

    def log(self, summaries: Array) -> Array:
        """Log density of particles, -inf for those that failed (N,)."""
        values = np.full(len(summaries), -np.inf)
        whole = np.flatnonzero(np.isfinite(summaries).all(axis=1))
        for part in np.array_split(whole, max(1, len(whole) // _AT_ONCE)):
            if len(part):
                values[part] = self._log(summaries[part])
        return values

    def _log(self, summaries: Array) -> Array:
        size = summaries.shape[1]
        weights = self._weights(summaries)
        share = weights / weights.sum(axis=1, keepdims=True)
        means = summaries - share @ self.away
        count = weights @ self.count
        covariance = np.einsum("na,ade->nde", weights, self.scatter) / count[:, None, None]
        root = np.sqrt(np.maximum(np.einsum("ndd->nd", covariance), _TINY))
        own = covariance / (root[:, :, None] * root[:, None, :])
        part = (count / (count + size))[:, None, None]
        mixed = part * own + (1 - part) * self.correlation
        diagonal = np.arange(size)
        mixed[:, diagonal, diagonal] = 1.0
        factor = np.linalg.cholesky(mixed)
        off = (self.measured - means) / root
        square = (np.linalg.solve(factor, off[..., None])[..., 0] ** 2).sum(axis=1)
        density = -np.log(root).sum(axis=1)
        density -= np.log(factor[:, diagonal, diagonal]).sum(axis=1)
        if np.isinf(self.freedom):
            return np.asarray(density - 0.5 * square)
        reach = 0.5 * (self.freedom + size)
        return np.asarray(density - reach * np.log1p(square / self.freedom))

    @property
    def highest(self) -> float:
        """Log density that no particle exceeds much: that of the narrowest anchor."""
        return float(self.log(self.measured[None] + self.away).max())


def nearness(measured: Array, summaries: Array) -> Array:
    """Minus half the squared distance to the measured summaries, in their spread.

    Parameters
    ----------
    measured : ndarray (D,)
        Measured summaries.
    summaries : ndarray (N, D)
        Summaries of particles, not finite for those that failed.

    Returns
    -------
    ndarray (N,)
        The spread is the median distance to the median; -inf for particles that failed.

    Raises
    ------
    InvalidData
        If all simulations failed.

    Examples
    --------
    >>> import numpy as np
    >>> nearness(np.zeros(1), np.array([[0.0], [2.0], [4.0], [np.nan]])).tolist()
    [-0.0, -0.5, -2.0, -inf]
    """
    whole = np.isfinite(summaries).all(axis=1)
    if not whole.any():
        raise InvalidData(
            "all particles failed in simulation: look at the arm and at the excitation of the "
            "records, whose simulation diverges"
        )
    shown = summaries[whole]
    spread = np.median(np.abs(shown - np.median(shown, axis=0)), axis=0)
    values = np.full(len(summaries), -np.inf)
    values[whole] = -0.5 * (((shown - measured) / np.maximum(spread, 1e-6)) ** 2).sum(axis=1)
    return values
