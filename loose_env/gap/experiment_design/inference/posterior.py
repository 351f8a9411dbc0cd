"""Posterior over sets of missing effects with their estimates, and settings of its inference."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class BeliefSettings:
    """Priors and errors of the belief.

    Examples
    --------
    >>> BeliefSettings(none=0.9, single=0.2)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: none and single are probabilities of at most 1 in all, ...
    """

    none: float = 0.2
    """Prior probability that no effect is missing."""
    single: float = 0.5
    """Prior probability that one is; two otherwise."""
    linearisation: float = 0.04
    """Error of a linearisation over the length of the residual about its centre [1]."""
    size_sd: float = 1.3
    """Prior standard deviation of the logarithm of a size, about the middle of the bank's."""
    simulations: int = 30
    """Simulated motions for exact fits after a measured one; 0 for the bank's signatures alone."""
    first: int = 24
    """Candidates beside which every other one is tried as the second of a pair."""
    swaps: int = 10
    """Members of good pairs beside which every other one is tried again."""
    kept: int = 3000
    """Hypotheses that are kept of all."""

    def __post_init__(self) -> None:
        """Check the values."""
        if not (self.none > 0 and self.single > 0 and self.none + self.single <= 1):
            raise InvalidSetting(
                "none and single are probabilities of at most 1 in all, above 0 each, got "
                f"{self.none!r} and {self.single!r}"
            )
        if not 0 <= self.linearisation < 1:
            raise InvalidSetting(f"linearisation is a share below 1, got {self.linearisation!r}")
        if not self.size_sd > 0:
            raise InvalidSetting(f"size_sd is above 0, got {self.size_sd!r}")
        if self.simulations < 0:
            raise InvalidSetting(f"simulations are 0 or more, got {self.simulations!r}")


@dataclass(frozen=True)
class EffectEstimate:
    """An effect with the parameter by which its size is stated."""

    name: str
    """Kind and location."""
    parameter: str
    """Name of the parameter."""
    unit: str
    value: float
    """Posterior mean."""
    low: float
    """Lower end of the 95 % interval."""
    high: float
    """Upper end."""
    size: float
    """Size over that of the linearisation ray's start."""


@dataclass(frozen=True)
class HypothesisSet:
    """A set of missing effects with its probability."""

    names: tuple[str, ...]
    """Kinds and locations, sorted; empty for none."""
    probability: float
    effects: tuple[EffectEstimate, ...]
    """Estimates of its effects; of the most probable sets alone."""
    exact: bool = False
    """Whether it was fitted with simulations of its own."""
    models: tuple[int, ...] = field(default=(), repr=False)
    """Indices of its best local models."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior over sets of effects."""

    sets: tuple[HypothesisSet, ...]
    """By decreasing probability."""
    names: tuple[str, ...]
    """All candidates."""
    marginal: Array
    """Probability that each candidate is among the missing effects (names,)."""
    log_evidence: Array
    """Log evidence of each candidate alone against none, its best local model [nats] (names,)."""
    size: Array
    """Posterior mean of the log10 of each candidate's visibility, alone (names,)."""
    size_sd: Array
    """Its standard deviation (names,)."""
    misfit: float
    """χ² of the best hypothesis over its degrees of freedom, 1 where that is no more than chance;
    variances of the parameters are multiplied by it (Birge ratio)."""

    @property
    def best(self) -> HypothesisSet:
        """The most probable set."""
        return self.sets[0]

    @property
    def entropy(self) -> float:
        """Entropy of the sets [nats]."""
        p = np.array([s.probability for s in self.sets])
        return float(-np.sum(p * np.log(np.maximum(p, 1e-300))))
