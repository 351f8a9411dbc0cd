"""Variance components of the model error, with sizes learned from the data.

What a model cannot have is an unknown force or motion at a known location, correlated over
channels: a force at a joint (friction, servo, saturation), a turn between a joint's sensor and its
link (gear elasticity), a bending or a slide of a link at its seat (tight connections give a little
too), and an error of the readings themselves. Each enters the covariance of a run's lines as
variance times a known pattern. The variances are those of highest posterior density under
half-Cauchy priors of their standard deviations, found by multiplicative minorise-maximise steps
(Zhou, Hu, Zhou and Lange, J. Comput. Graph. Stat. 28, 2019).

Two groups are told apart: errors of the model, and what changes between a run and the same run of
the healthy arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.settings.thresholds import (
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

__all__ = ["ComponentIndex", "updated", "within_bounds"]

_MOST = 10.0
"""Largest standard deviation of a component [1]: nothing of the pattern is known then."""
_LEAST = 1e-2
"""Smallest standard deviation of a component over the scale of its prior [1]: a variance of zero
would stay zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ComponentIndex:
    """Position of each variance component among all, with the scale of its prior.

    Parameters
    ----------
    uncertain : UncertainArm
        The arm.
    runs : int
        Number of runs, references too: a joint's force error is drawn anew for every run.
    """

    uncertain: UncertainArm
    runs: int

    @property
    def _joints(self) -> int:
        return self.uncertain.arm.n

    @cached_property
    def scales(self) -> Array:
        """Scale of each standard deviation's half-Cauchy prior (C,) [1]."""
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
        return np.concatenate([np.repeat(model, count), np.repeat(change, count)])

    def columns(self, run: int, *, change: bool) -> NDArray[np.intp]:
        """Component of each pattern of a run (8 n,): forces, 3 n slides, turns, 3 n bendings."""
        n = self._joints
        first = len(self.scales) // 2 if change else 0
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
        return len(self.scales) - 1 if change else len(self.scales) // 2 - 1

    def log_prior(self, variances: Array) -> float:
        """Log density of the half-Cauchy priors, but for a constant."""
        return -float(np.sum(np.log1p(variances / self.scales**2)))


def within_bounds(variances: Array, scales: Array) -> Array:
    """Variances not below the smallest and not above the largest that are used (C,)."""
    return np.asarray(np.clip(variances, (_LEAST * scales) ** 2, _MOST**2))


def updated(variances: Array, scales: Array, explained: Array, expected: Array) -> Array:
    """One minorise-maximise step of all variances.

    Parameters
    ----------
    variances, scales : ndarray (C,)
        Of the components, and the scales of their standard deviations' priors.
    explained : ndarray (C,)
        Weighted power of the residual along each component's pattern.
    expected : ndarray (C,)
        What the covariance expects of it.

    Returns
    -------
    ndarray (C,)

    Examples
    --------
    A component that shows four times the expected power grows:

    >>> one = np.ones(1)
    >>> float(updated(one, 1e6 * one, 4 * one, one)[0])
    2.0
    """
    step = np.sqrt(explained / (expected + 1 / (scales**2 + variances)))
    return np.asarray(variances * step)
