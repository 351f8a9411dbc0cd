"""Greedy policy: maximum expected information gain net of cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Situation
from loose_agents.core.belief_tracker import belief_of
from loose_agents.policies.candidate_records import Candidate, candidate_at, excitations, poses
from loose_env.diagnosis import ImaginedFaults, RecordInformation

__all__ = ["GreedyPolicy", "GreedySettings", "ranked"]


@dataclass(frozen=True, kw_only=True)
class GreedySettings:
    """Number of candidate records and value of information."""

    poses: int = 16
    """Poses weighed with all joints shaken at the top level."""
    shortlist: int = 1
    """The best of these, weighed with every other excitation too."""
    worth: float = 0.5
    """What a nat of information is worth, in the environment's reward."""


class GreedyPolicy:
    """Maximises expected information over pose, joints, level and duration.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    information : RecordInformation
        What weighs the records.
    settings : GreedySettings, optional
        How many records are weighed.
    """

    def __init__(
        self,
        problem: Problem,
        information: RecordInformation,
        settings: GreedySettings | None = None,
    ) -> None:
        self.problem, self.information = problem, information
        self.settings = GreedySettings() if settings is None else settings

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Choose the best of the scored records."""
        faults = self.information.imagine(belief_of(situation), situation.rng)
        return ranked(self.problem, self.information, self.settings, situation, faults)[0].action


def ranked(
    problem: Problem,
    information: RecordInformation,
    settings: GreedySettings,
    situation: Situation,
    faults: ImaginedFaults,
) -> list[Candidate]:
    """Score candidate records and sort them, best first."""

    def value(candidate: Candidate) -> float:
        if not candidate.torque.any():  # gravity leaves the drives nothing
            return -np.inf
        found = information.of(faults, candidate.pose, candidate.torque, candidate.duration)
        return settings.worth * found.information - candidate.price

    moves, where = poses(problem, situation, settings.poses)
    every = excitations(problem)
    first = [candidate_at(problem, m, p, *every[0]) for m, p in zip(moves, where, strict=True)]
    found = [(value(candidate), candidate) for candidate in first]
    order = np.argsort([-v for v, _ in found], kind="stable")
    for k in order[: settings.shortlist]:
        for levels, duration in every[1:]:
            candidate = candidate_at(problem, moves[k], where[k], levels, duration)
            found.append((value(candidate), candidate))
    found.sort(key=lambda pair: -pair[0])
    return [candidate for _, candidate in found]
