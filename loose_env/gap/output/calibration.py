"""Calibrated probability of an identified effect, and calibrated width of its intervals.

No model is exact to the noise: differences of log-likelihood are thousands of nats, and intervals
from the noise and the scatter of runs alone miss what the law of an effect leaves out. Both are
therefore calibrated on blind recordings whose truth is known (docs/gap_evidence.jsonl), and judged
on others: the probability as a logistic map of what the
tests measured, the intervals by split-conformal prediction (Lei et al., J. Am. Stat. Assoc. 113,
2018).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.output.result import Gap, NamedEffect
from loose_env.gap.settings import NAMED_PROBABILITY
from loose_env.io import restored
from loose_env.typing import Array

PROBABILITY_FEATURES = (
    ("smaller z of the two sets of runs, logarithm", 1),
    ("share of the error without it that it explains, logit", 1),
    ("share of the error that the whole answer explains, logit", 1),
    ("effects that held-out runs do not tell from it, logarithm", -1),
)
"""What the map reads, and the sign of its weight."""
_FILE = "calibration.json"
_SURE = 0.99
"""Largest probability that is given, and one less the smallest: some hundreds of cases say no
more."""
_LEAST_Z, _LEAST_SHARE = 0.1, 0.005
"""Smallest z, and distance of a share from 0 and 1, of which the logarithm is taken."""


@dataclass(frozen=True, kw_only=True)
class GapCalibration:
    """What calibration found, as stored with the package."""

    offset: float
    """Log-odds of an effect with mean features."""
    weights: tuple[float, ...]
    """Of `PROBABILITY_FEATURES`, in their standard deviations."""
    mean: tuple[float, ...]
    """Mean of each feature."""
    deviation: tuple[float, ...]
    """Standard deviation of each feature."""
    effects: int
    """Effects that the map was fitted to."""
    right: int
    """How many of these were right."""
    size_factor: float
    """Factor on the half widths of 95 % intervals of parameters that size an effect."""
    shape_factor: float
    """The same of parameters that shape it, such as a Stribeck speed or a payload's centre."""
    sizes: int
    """Parameters that size an effect, from which the factor was found."""
    shapes: int
    """The same of those that shape it."""

    def factor_of(self, effect: Effect, parameter: str) -> float:
        """Factor on the half widths of a parameter's interval.

        One for parts with stops: their fits have many local optima, of which an interval says
        nothing.
        """
        if effect.has_stops:
            return 1.0
        return self.shape_factor if effect.shaped_by(parameter) else self.size_factor

    def probability(self, features: Array) -> Array:
        """Probabilities (...,) of features (..., F); one that is NaN counts as the mean."""
        standard = (features - np.array(self.mean)) / np.array(self.deviation)
        odds = self.offset + np.nan_to_num(standard) @ np.array(self.weights)
        return np.asarray(np.clip(1 / (1 + np.exp(-odds)), 1 - _SURE, _SURE))


@cache
def stored_calibration() -> GapCalibration:
    """The calibration in the package."""
    file = files("loose_env.gap.output").joinpath(_FILE)
    return restored(GapCalibration, json.loads(file.read_text(encoding="utf-8")), _FILE)


def probability_features(effect: NamedEffect, gap: Gap, *, rivals: int | None = None) -> Array:
    """What the map reads of an effect (F,); NaN where a part found by impacts has no such test.

    Parameters
    ----------
    effect : NamedEffect
        The effect with its tests.
    gap : Gap
        Residual before and after the whole answer.
    rivals : int, optional
        Effects that held-out runs do not tell from it; by default those it lists.
    """
    test = effect.deletion
    z, share = np.nan, effect.impact_power_explained
    if test is not None:
        z = np.log(max(min(test.held_out_z, test.training_z), _LEAST_Z))
        share = max(test.share_without, test.share_in_channel)
    beyond = [max(each**2 - gap.noise_floor**2, 0.0) for each in (gap.before, gap.after)]
    left = beyond[1] / beyond[0] if beyond[0] > 0 else 0.0
    alike = len(effect.ambiguous_with) if rivals is None else rivals
    return np.array(
        [z, np.nan if share is None else _logit(share), _logit(1.0 - left), np.log1p(alike)]
    )


def with_probability(
    effect: NamedEffect, gap: Gap, calibration: GapCalibration | None = None
) -> NamedEffect:
    """Add the probability of an effect, and of each one that cannot be told from it.

    These share what they take from it: the probability it would have without them, less its own.

    Examples
    --------
    >>> from loose_env.gap.output.result import DeletionTest, EffectLocation
    >>> test = DeletionTest(
    ...     held_out_z=8.0,
    ...     training_z=9.0,
    ...     share_of_error=0.9,
    ...     share_without=0.9,
    ...     share_in_channel=0.9,
    ... )
    >>> alone = NamedEffect(kind="payload", where="tool", parameters={}, deletion=test)
    >>> rival = EffectLocation(kind="link_mass", where="link6")
    >>> gap = Gap(before=5.0, after=1.0)
    >>> one = with_probability(alone, gap)
    >>> two = with_probability(replace(alone, ambiguous_with=(rival,)), gap)
    >>> one.probability >= two.probability, one.rival_probability is None
    (True, True)
    """
    found = calibration or stored_calibration()
    own = float(found.probability(probability_features(effect, gap)))
    if not effect.ambiguous_with:
        return replace(effect, probability=own)
    together = float(found.probability(probability_features(effect, gap, rivals=0)))
    shared = max(together - own, 0.0) / len(effect.ambiguous_with)
    return replace(effect, probability=own, rival_probability=shared)


def more_likely_than_not(effect: NamedEffect) -> bool:
    """Return whether the machine rather has an effect, or one that cannot be told from it.

    An effect without a probability counts as one that it has.

    Examples
    --------
    >>> unsure = NamedEffect(kind="payload", where="tool", parameters={}, probability=0.3)
    >>> more_likely_than_not(unsure)
    False
    """
    if effect.probability is None:
        return True
    rivals = len(effect.ambiguous_with) * (effect.rival_probability or 0.0)
    return effect.probability + rivals >= NAMED_PROBABILITY


def widened_interval(
    value: float, interval: tuple[float, float], factor: float
) -> tuple[float, float]:
    """Interval with its half widths times a factor.

    Examples
    --------
    >>> widened_interval(1.0, (0.5, 2.0), 2.0)
    (0.0, 3.0)
    """
    low, high = interval
    return value + factor * (low - value), value + factor * (high - value)


def interval_score(value: float, interval: tuple[float, float], truth: float) -> float:
    """Smallest factor of `widened_interval` with which an interval holds the truth.

    Infinite where the estimate lies at the end beyond which the truth is.

    Examples
    --------
    >>> interval_score(1.0, (0.5, 2.0), 3.0), interval_score(1.0, (0.5, 1.0), 1.2)
    (2.0, inf)
    """
    if truth == value:
        return 0.0
    end = interval[truth > value]
    return float("inf") if end == value else (truth - value) / (end - value)


def _logit(share: float) -> float:
    within = float(np.clip(share, _LEAST_SHARE, 1 - _LEAST_SHARE))
    return float(np.log(within / (1 - within)))
