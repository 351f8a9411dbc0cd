"""Observation of the model-gap environment: the belief in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.gap import Belief, Outlook

__all__ = ["GapObservation"]

_FLOOR = 1e-6
"""Probabilities below count as this in logarithms."""
_MOST = 20.0
"""Bound of every element."""


@dataclass(frozen=True, kw_only=True)
class GapObservation:
    """Layout of the observation; each slice is an attribute.

    Examples
    --------
    >>> layout = GapObservation(candidates=3, motions=2, ranks=5)
    >>> layout.size, layout.information
    (34, slice(26, 28, None))
    """

    candidates: int
    """Candidate effects, kind and location (N)."""
    motions: int
    """Motions of the library (M)."""
    ranks: int
    """Sets that a verdict can name (R)."""

    @property
    def probability(self) -> slice:
        """Log10 of the probability that each candidate is missing, at least 10⁻⁶ (N)."""
        return slice(0, self.candidates)

    @property
    def evidence(self) -> slice:
        """Log evidence x [nats] of each candidate alone, as sign(x) ln(1 + |x|) (N)."""
        return slice(self.candidates, 2 * self.candidates)

    @property
    def parameter(self) -> slice:
        """Log10 of each candidate's visibility on the battery, were it alone (N)."""
        return slice(2 * self.candidates, 3 * self.candidates)

    @property
    def interval(self) -> slice:
        """Standard deviation of that (N)."""
        return slice(3 * self.candidates, 4 * self.candidates)

    @property
    def sets(self) -> slice:
        """Log10 of the probabilities of the R most probable sets (R)."""
        return slice(4 * self.candidates, 4 * self.candidates + self.ranks)

    @property
    def members(self) -> slice:
        """Number of effects in each of them (R)."""
        return slice(self.sets.stop, self.sets.stop + self.ranks)

    @property
    def taken(self) -> slice:
        """Repetitions of each motion so far (M)."""
        return slice(self.members.stop, self.members.stop + self.motions)

    @property
    def information(self) -> slice:
        """Expected information of each motion about the missing set [nats] (M)."""
        start = self.taken.stop + self.motions
        return slice(start, start + self.motions)

    @property
    def rest(self) -> slice:
        """Rms of each motion's latest residual that no candidate spans, less 1 [noise sd] (M)."""
        return slice(self.taken.stop, self.taken.stop + self.motions)

    @property
    def gain(self) -> slice:
        """Expected gain in the reward of the best verdict by each motion (M)."""
        return slice(self.information.stop, self.information.stop + self.motions)

    @property
    def spent(self) -> slice:
        """Minutes of machine time, wear [s], motions over the most, log10 of the misfit (4)."""
        return slice(self.gain.stop, self.gain.stop + 4)

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(self.spent.stop)

    @property
    def space(self) -> spaces.Box:
        """The space."""
        return spaces.Box(-_MOST, _MOST, (self.size,), np.float32)

    def of(
        self, belief: Belief, ahead: Outlook, spent: tuple[float, float, float]
    ) -> NDArray[np.float32]:
        """Observation of a belief, the outlook of the motions, and what was spent."""
        found = np.zeros(self.size)
        posterior = belief.posterior
        found[self.probability] = np.log10(np.maximum(posterior.marginal, _FLOOR))
        evidence = posterior.log_evidence
        found[self.evidence] = np.sign(evidence) * np.log1p(np.abs(evidence))
        found[self.parameter], found[self.interval] = posterior.size, posterior.size_sd
        shares = np.full(self.ranks, _FLOOR)
        members = np.zeros(self.ranks)
        for k, each in enumerate(posterior.sets[: self.ranks]):
            shares[k], members[k] = max(each.probability, _FLOOR), len(each.names)
        found[self.sets], found[self.members] = np.log10(shares), members
        for motion, count in belief.counts.items():
            found[self.taken.start + motion] = count
            found[self.rest.start + motion] = belief.rest[motion] - 1.0
        found[self.information], found[self.gain] = ahead.information, ahead.gain
        found[self.spent] = (*spent, np.log10(posterior.misfit))
        return np.clip(found, -_MOST, _MOST).astype(np.float32)
