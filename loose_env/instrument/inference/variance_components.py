"""Variance components of the model error by kind and joint, priors, and the step fitting them.

What a model cannot have is an unknown motion at a known location, correlated over channels: of a
joint beside what its drive makes of it (friction, servo, saturation), a turn between a joint's
sensor and its link (gear elasticity), a bending or a slide of a link at its seat (tight connections
give a little too), and an error of the readings themselves. Each enters the covariance of a run's
lines as variance times a known pattern. The variances are those of highest posterior density, found
by multiplicative minorise-maximise steps (Zhou, Hu, Zhou and Lange, J. Comput. Graph. Stat. 28,
2019).

Two groups are told apart: errors of the model, and what changes between a run and the same run of
the healthy arm. How wrong a model is nobody knows: standard deviations of the first have
half-Cauchy priors. The arm is the same one in both runs: those of the second have exponential
priors (penalised complexity; Simpson et al., Stat. Sci. 32, 2017), but for the joints, whose
friction changes.

What a joint does beside the model is stated as its motion, not as a force. Friction that locks a
joint decides how it moves and takes whatever force that needs: as a force, the likelihood would
hold the arm's mobility at that joint for evidence of its stiffness and masses.

How much of an error shows differs over the band, with modes that the model lacks: all variances of
a run have a factor in each of its bands, with an inverse-gamma prior. That makes the likelihood of
a band one of Student's t, as robust as that of a seat, whose motion is free in every band too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.settings.thresholds import (
    BAND_SHAPE,
    BENDING_CHANGE_SD,
    BENDING_SD,
    DRIVE_CHANGE_SD,
    DRIVE_SD,
    GEAR_TURN_CHANGE_SD,
    GEAR_TURN_SD,
    READING_CHANGE_SD,
    READING_SD,
    SEAT_SLIDE_CHANGE_SD,
    SEAT_SLIDE_SD,
)
from loose_env.typing import Array

BANDS = 8
"""Bands of a run."""
_MOST = 10.0
"""Largest standard deviation of a component [1]: nothing of the pattern is known then."""
_LEAST = 1e-2
"""Smallest standard deviation of a component over the scale of its prior [1]: a variance of zero
would stay zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ComponentIndex:
    """Position of each variance component among all, with the scale of its prior."""

    uncertain: UncertainArm
    runs: int

    @property
    def _joints(self) -> int:
        return self.uncertain.arm.n

    @cached_property
    def scales(self) -> Array:
        """Scale of each standard deviation's prior (C,) [1]."""
        n = self._joints
        count = [n * self.runs, n, n, n, 1]
        model = [DRIVE_SD, GEAR_TURN_SD, BENDING_SD, SEAT_SLIDE_SD, READING_SD]
        change = [
            DRIVE_CHANGE_SD,
            GEAR_TURN_CHANGE_SD,
            BENDING_CHANGE_SD,
            SEAT_SLIDE_CHANGE_SD,
            READING_CHANGE_SD,
        ]
        bands = np.ones(BANDS * self.runs)
        return np.concatenate([np.repeat(model, count), np.repeat(change, count), bands])

    @cached_property
    def _group(self) -> int:
        """Number of components of one group."""
        return self._joints * (self.runs + 3) + 1

    @cached_property
    def heavy(self) -> NDArray[np.bool_]:
        """True for a half-Cauchy prior, False for an exponential one (C - bands,)."""
        return np.arange(2 * self._group) < self._group + self._joints * self.runs

    @cached_property
    def shared(self) -> slice:
        """Components of the model's error that all runs share."""
        return slice(self._joints * self.runs, self._group)

    def columns(self, run: int, *, change: bool) -> NDArray[np.intp]:
        """Component of each pattern of a run (8 n,): joints, 3 n slides, turns, 3 n bendings."""
        n = self._joints
        first = self._group if change else 0
        turns = first + n * self.runs + np.arange(n)
        return np.concatenate(
            [
                first + n * run + np.arange(n),
                np.repeat(turns + 2 * n, 3),
                turns,
                np.repeat(turns + n, 3),
            ]
        ).astype(np.intp)

    def reading(self, *, change: bool) -> int:
        """Component of the readings' relative error."""
        return (2 if change else 1) * self._group - 1

    def bands(self, run: int) -> NDArray[np.intp]:
        """Factors on all variances of a run by band (bands,)."""
        return np.arange(BANDS, dtype=np.intp) + 2 * self._group + BANDS * run

    def start(self, factor: float) -> Array:
        """Variances to start with: so many standard deviations of the priors' scales (C,)."""
        found = (factor * self.scales) ** 2
        found[2 * self._group :] = 1.0
        return found

    def within_bounds(self, variances: Array) -> Array:
        """Variances not below the smallest and not above the largest that are used (C,).

        No reading is known better than a third of its scale: clocks, filters and sampling see to
        that, however low its noise.
        """
        least = _LEAST * self.scales
        for change in (False, True):
            at = self.reading(change=change)
            least[at] = self.scales[at] / (1 if change else 3)
        return np.asarray(np.clip(variances, least**2, _MOST**2))

    def log_prior(self, variances: Array) -> float:
        """Log density of the priors, but for a constant."""
        own, scales = variances[: 2 * self._group], self.scales[: 2 * self._group]
        cost = np.where(self.heavy, np.log1p(own / scales**2), np.sqrt(own) / scales)
        factors = variances[2 * self._group :]
        shape = BAND_SHAPE
        return -float(np.sum(cost)) - float(
            np.sum((shape + 1) * np.log(factors) + shape / factors - shape)
        )

    def updated(self, variances: Array, explained: Array, expected: Array) -> Array:
        """One minorise-maximise step of all variances; see `updated`."""
        own, scales = variances[: 2 * self._group], self.scales[: 2 * self._group]
        slope = np.where(self.heavy, 1 / (scales**2 + own), 0.5 / (scales * np.sqrt(own)))
        factors = variances[2 * self._group :]
        pull = np.concatenate([np.zeros_like(own), BAND_SHAPE / factors**2])
        push = np.concatenate([slope, (BAND_SHAPE + 1) / factors])
        return updated(variances, explained + pull, expected + push)


def updated(variances: Array, explained: Array, expected: Array) -> Array:
    """One minorise-maximise step of all variances.

    Examples
    --------
    A component that shows four times the expected power grows:

    >>> one = np.ones(1)
    >>> float(updated(one, 4 * one, one)[0])
    2.0
    """
    return np.asarray(variances * np.sqrt(explained / expected))
