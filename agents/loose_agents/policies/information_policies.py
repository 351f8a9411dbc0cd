"""Policies by expected information: greedy, and looking two records ahead."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Situation
from loose_agents.core.estimators import belief_of
from loose_env.diagnosis import ImaginedFaults, RecordInformation
from loose_env.excitation import at_levels
from loose_env.typing import Array

__all__ = [
    "Candidate",
    "GreedyPolicy",
    "GreedySettings",
    "LookAheadPolicy",
    "LookAheadSettings",
    "candidate_at",
    "excitations",
    "poses",
    "ranked",
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A record that could be taken next."""

    action: NDArray[np.int64]
    """The action that takes it."""
    pose: NDArray[np.float64]
    """Joint positions of the record (n,) [rad or m]."""
    torque: NDArray[np.float64]
    """Rms torque of every joint, within the drives' limits (n,) [N·m or N]."""
    duration: float
    """Its length [s]."""
    price: float
    """Cost of the record."""


def poses(
    problem: Problem, situation: Situation, count: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Sample moves uniformly from the allowed ranges, with the resulting poses.

    Returns
    -------
    moves : ndarray of int (K, n)
        Without repetition, at most ``count``.
    poses : ndarray (K, n)
        Where they lead [rad or m].
    """
    allowed = problem.actions.allowed_moves(situation.pose)
    options = [np.flatnonzero(row) for row in allowed]
    total = int(np.prod([len(o) for o in options], dtype=np.int64))
    if total <= count and problem.actions.most_moved == problem.arm.n:
        moves = np.stack(np.meshgrid(*options, indexing="ij"), -1).reshape(-1, len(options))
    else:
        drawn = [situation.rng.choice(o, 2 * count) for o in options]
        moves = np.unique(problem.actions.few_moves(np.stack(drawn, 1), situation.rng), axis=0)
        moves = situation.rng.permutation(moves)[:count]
    steps = problem.actions.steps[np.arange(problem.arm.n), moves]
    where = np.array([problem.arm.wrap(situation.pose + step) for step in steps])
    return moves.astype(np.intp), np.round(where, 9)


Excitations = list[tuple[NDArray[np.intp], int]]
"""Levels of the joints (n,) and index of the duration."""


def excitations(problem: Problem) -> tuple[Excitations, Excitations]:
    """Enumerate excitations: those weighed in every pose, then those weighed in the best ones.

    The first is all joints together at the top level for the longest time; the further ones are
    lower levels, shorter times, and each joint alone at the two highest levels. Where not all
    joints may be excited at once, the first are each joint alone at the top level.
    """
    n, top = problem.arm.n, len(problem.arm.levels)
    durations = problem.settings.durations
    longest = int(np.argmax(durations))
    alone = list(np.eye(n, dtype=np.intp))
    first = [np.ones(n, dtype=np.intp)] if problem.actions.most_excited == n else alone
    found = [(level * one, longest) for level in range(top, 0, -1) for one in first]
    found += [(top * one, k) for k in range(len(durations)) if k != longest for one in first]
    if len(first) == 1:
        for level in range(top, max(top - 2, 0), -1):
            found += [(level * one, longest) for one in alone]
    return found[: len(first)], found[len(first) :]


def candidate_at(
    problem: Problem,
    moves: NDArray[np.intp],
    pose: NDArray[np.float64],
    levels: NDArray[np.intp],
    duration: int,
) -> Candidate:
    """Build a candidate: the torque of the levels in a pose, and its cost."""
    seconds = problem.settings.durations[duration]
    wanted = np.array([0.0, *problem.arm.levels])[levels]
    excitation, _ = at_levels(problem.linear.at(pose), wanted, duration=seconds)
    prices = problem.settings.prices
    moved = int(np.count_nonzero(moves != problem.settings.stay))
    price = prices.record + prices.second * seconds + prices.level * int(levels.sum())
    return Candidate(
        action=problem.actions.encode(moves=moves, levels=levels, duration=duration),
        pose=pose,
        torque=np.array(excitation.torque_rms),
        duration=seconds,
        price=price + prices.move * moved,
    )


@dataclass(frozen=True, kw_only=True)
class GreedySettings:
    """Number of candidate records and value of information."""

    poses: int = 16
    """Poses weighed with all joints shaken at the top level."""
    single_poses: int = 6
    """Poses weighed where joints are shaken one at a time, each joint in each."""
    shortlist: int = 1
    """The best of these, weighed with every other excitation too."""
    worth: float = 0.5
    """Value of a nat of information, in the environment's reward."""


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
    planned: Array | None = None,
) -> list[Candidate]:
    """Score candidate records and sort them, best first.

    After records with the likelihood ``planned`` where it is given, as
    `loose_env.diagnosis.RecordInformation.of` takes it.
    """

    def value(candidate: Candidate) -> float:
        if not candidate.torque.any():  # gravity leaves the drives nothing
            return -np.inf
        found = information.of(
            faults, candidate.pose, candidate.torque, candidate.duration, planned
        )
        return settings.worth * found.information - candidate.price

    first, further = excitations(problem)
    together = len(first) == 1
    moves, where = poses(problem, situation, settings.poses if together else settings.single_poses)
    begun = [(k, how) for k in range(len(moves)) for how in first]
    candidates = [candidate_at(problem, moves[k], where[k], *how) for k, how in begun]
    found = [(value(candidate), candidate) for candidate in candidates]
    order = np.argsort([-v for v, _ in found], kind="stable")
    for k in (begun[i][0] for i in order[: settings.shortlist]):
        for levels, duration in further:
            candidate = candidate_at(problem, moves[k], where[k], levels, duration)
            found.append((value(candidate), candidate))
    found.sort(key=lambda pair: -pair[0])
    return [candidate for _, candidate in found]


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
    """Search for first records."""


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
        every, _ = excitations(self.problem)
        moves, where = poses(self.problem, after, self.settings.second)
        seconds = [
            candidate_at(self.problem, m, p, *how)
            for m, p in zip(moves, where, strict=True)
            for how in every
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
