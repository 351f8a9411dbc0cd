"""Two-step look-ahead policy on the expected reward of the best verdict."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Situation
from loose_agents.core.belief_tracker import belief_of
from loose_agents.policies.candidate_records import Candidate, candidate_at, excitations, poses
from loose_agents.policies.greedy import GreedySettings, ranked
from loose_env.diagnosis import ImaginedFaults, RecordInformation
from loose_env.typing import Array

__all__ = ["LookAheadPolicy", "LookAheadSettings"]


@dataclass(frozen=True, kw_only=True)
class LookAheadSettings:
    """Depth and width of the look-ahead."""

    first: int = 4
    """First records that are looked at, the best by information."""
    outcomes: int = 24
    """Outcomes of each that are imagined."""
    second: int = 4
    """Second records weighed after each outcome."""
    greedy: GreedySettings = field(default_factory=GreedySettings)
    """How first records are found."""


class LookAheadPolicy:
    """Scores records by the expected reward after them, or after one more.

    Values are those of the environment's prices: the expected reward of the best name, less
    what the records cost.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    information : RecordInformation
        What imagines the records.
    settings : LookAheadSettings, optional
        How far and how widely it looks.
    """

    def __init__(
        self,
        problem: Problem,
        information: RecordInformation,
        settings: LookAheadSettings | None = None,
    ) -> None:
        self.problem, self.information = problem, information
        self.settings = LookAheadSettings() if settings is None else settings

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Choose the record of the highest value."""
        faults = self.information.imagine(belief_of(situation), situation.rng)
        firsts = ranked(self.problem, self.information, self.settings.greedy, situation, faults)[
            : self.settings.first
        ]
        values = [self._value(candidate, faults, situation) for candidate in firsts]
        return firsts[int(np.argmax(values))].action

    def _value(self, candidate: Candidate, faults: ImaginedFaults, situation: Situation) -> float:
        """Expected reward after taking this record."""
        if not candidate.torque.any():
            return -np.inf
        likely = self.information.likelihood(
            faults, candidate.pose, candidate.torque, candidate.duration
        )
        after = Situation(**{**vars(situation), "pose": candidate.pose})
        every = excitations(self.problem)
        moves, where = poses(self.problem, after, self.settings.second)
        seconds = [
            candidate_at(self.problem, m, p, *every[0]) for m, p in zip(moves, where, strict=True)
        ]
        next_likely = [
            (self.information.likelihood(faults, c.pose, c.torque, c.duration), c.price)
            for c in seconds
            if c.torque.any()
        ]
        prices = self.problem.settings.prices
        stake = prices.correct - prices.wrong
        ticks = (np.arange(self.settings.outcomes) + 0.5) / self.settings.outcomes
        drawn = np.searchsorted(np.cumsum(faults.weight), ticks * faults.weight.sum())
        total = 0.0
        for k in np.minimum(drawn, len(faults.weight) - 1):
            weight = faults.weight * likely[k]
            weight = weight / weight.sum()
            worth = float(self._sures(weight[None], faults)[0])  # of a verdict now
            for more, price in next_likely:
                after_both = weight[None] * more
                after_both /= after_both.sum(1, keepdims=True)
                then = float(weight @ self._sures(after_both, faults))
                worth = max(worth, then - price / stake)
            total += worth / len(drawn)
        return prices.wrong + stake * total - candidate.price

    def _sures(self, weights: Array, faults: ImaginedFaults) -> Array:
        """Maximum posterior probability (K,) for weights (K, M)."""
        labels = np.zeros((weights.shape[1], int(faults.hypothesis.max()) + 1))
        labels[np.arange(len(labels)), faults.hypothesis] = 1.0
        return np.asarray((weights @ labels).max(1))
