"""Probability that an effect of an answer is one that the machine has, from its deletion test.

Differences of log-likelihood are thousands of nats, for no model is exact to the noise: model
averaging gives 0 or 1 for anything. The probability is therefore calibrated: a logistic map of what
the tests measured, fitted to blind recordings whose truth is known
(`python -m scripts.suites.gap.calibrate`), and judged on others.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from loose_env.gap.output.result import DeletionTest, Gap
from loose_env.io import restored
from loose_env.typing import Array

__all__ = [
    "PROBABILITY_FEATURES",
    "ProbabilityMap",
    "probability_features",
    "probability_of",
    "stored_map",
]

PROBABILITY_FEATURES = (
    ("smaller z of the two sets of runs, logarithm", 1),
    ("share of the error without it that it explains, logit", 1),
    ("share of the error that the whole answer explains, logit", 1),
    ("rivals that held-out runs do not tell from it, logarithm", -1),
)
"""What the map reads, and the sign of its weight."""
_FILE = "probability_map.json"
_SURE = 0.99
"""Largest probability that is given, and one less the smallest: some hundreds of cases say no
more."""
_LEAST_Z, _LEAST_SHARE = 0.1, 0.005
"""Smallest z, and distance of a share from 0 and 1, of which the logarithm is taken."""


@dataclass(frozen=True, kw_only=True)
class ProbabilityMap:
    """A logistic map, as stored."""

    offset: float
    """Log-odds where all features are zero."""
    weights: tuple[float, ...]
    """Of `PROBABILITY_FEATURES`."""
    effects: int
    """Effects it was fitted to."""
    right: int
    """How many of these were right."""

    def probability(self, values: Array) -> Array:
        """Probabilities (...,) of features (..., F)."""
        odds = self.offset + values @ np.array(self.weights)
        return np.asarray(np.clip(1 / (1 + np.exp(-odds)), 1 - _SURE, _SURE))


def probability_features(test: DeletionTest, *, rivals: int, gap: Gap) -> Array:
    """What the map reads of an effect (F,).

    Parameters
    ----------
    test : DeletionTest
        Its deletion test.
    rivals : int
        Effects that the held-out runs do not tell from it.
    gap : Gap
        Residual before and after the whole answer.
    """
    smaller = max(min(test.held_out_z, test.training_z), _LEAST_Z)
    beyond = [max(each**2 - 1.0, 0.0) for each in (gap.before, gap.after)]
    left = beyond[1] / beyond[0] if beyond[0] > 0 else 0.0
    return np.array(
        [
            np.log(smaller),
            _logit(max(test.share_without, test.share_in_channel)),
            _logit(1.0 - left),
            np.log1p(rivals),
        ]
    )


def probability_of(test: DeletionTest, *, rivals: int, gap: Gap) -> float:
    """Probability that an effect is one that the machine has.

    Parameters
    ----------
    test, rivals, gap
        As of `probability_features`.

    Examples
    --------
    >>> clear, weak = (
    ...     DeletionTest(
    ...         held_out_z=z, training_z=z, share_of_error=s, share_without=s, share_in_channel=s
    ...     )
    ...     for z, s in ((8.0, 0.99), (3.0, 0.5))
    ... )
    >>> gap = Gap(before=5.0, after=1.0)
    >>> probability_of(clear, rivals=0, gap=gap) > probability_of(weak, rivals=2, gap=gap)
    True
    """
    return float(stored_map().probability(probability_features(test, rivals=rivals, gap=gap)))


def _logit(share: float) -> float:
    within = float(np.clip(share, _LEAST_SHARE, 1 - _LEAST_SHARE))
    return float(np.log(within / (1 - within)))


@cache
def stored_map() -> ProbabilityMap:
    """The map in the package."""
    file = files("loose_env.gap.output").joinpath(_FILE)
    return restored(ProbabilityMap, json.loads(file.read_text(encoding="utf-8")), _FILE)
