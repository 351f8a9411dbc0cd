"""Policies that choose records without looking at what earlier ones showed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import BeliefAgent, Estimator, Situation
from loose_agents.core.estimators import tuned
from loose_agents.evaluation.evaluate import AfterRecords
from loose_agents.policies.information_policies import GreedySettings, ranked
from loose_env.diagnosis import Belief, RecordInformation
from loose_env.envs import EpisodeBatch
from loose_env.errors import InvalidSetting
from loose_env.wrappers import record_from

__all__ = [
    "FIXED_RECORDS",
    "FixedPolicy",
    "OpenLoopPolicy",
    "Records",
    "designed_sequences",
    "drawn_sequences",
    "tuned_sequence",
]

FIXED_RECORDS = 4
"""Longest sequence of the agents without stopping, `fixed_1` to `fixed_4`."""

Records = tuple[tuple[int, ...], ...]
"""Records one after the other, each as an action of the environment."""


class FixedPolicy:
    """Takes the same records on every arm, then begins again.

    The first pose is random and moves are relative, so a move may lead out of a joint's range: the
    joint then makes the opposite move if it can, and stays if not.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    sequence : sequence of sequence of int
        Actions that take a record.

    Raises
    ------
    InvalidSetting
        If there is none.
    """

    def __init__(self, problem: Problem, sequence: Sequence[Sequence[int]]) -> None:
        if not sequence:
            raise InvalidSetting("a fixed sequence has one record or more")
        self.problem = problem
        self.records = [problem.actions.decode(action) for action in sequence]
        moves = np.array(problem.settings.moves)
        self._opposite = np.abs(moves[:, None] + moves).argmin(axis=1)

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Take the next record of the sequence."""
        problem = self.problem
        record = self.records[situation.records % len(self.records)]
        allowed, joints = problem.actions.allowed_moves(situation.pose), np.arange(problem.arm.n)
        other = self._opposite[record.moves]
        moves = np.where(allowed[joints, other], other, problem.settings.stay)
        moves = np.where(allowed[joints, record.moves], record.moves, moves)
        return problem.actions.encode(
            moves=moves,
            levels=record.levels,
            duration=problem.settings.durations.index(record.duration),
        )


def drawn_sequences(
    problem: Problem, count: int, length: int, rng: np.random.Generator
) -> list[Records]:
    """Draw sequences of records to choose a fixed one from.

    Moves are uniform. Joints are excited at the top level for the longest time: every other
    sequence all of them in every record where the rules allow, else one at a time, each joint
    once before one comes again.
    """
    n, actions = problem.arm.n, problem.actions
    top, found = len(problem.arm.levels), []
    for k in range(count):
        order = np.concatenate([rng.permutation(n) for _ in range(-(-length // n))])
        moves = rng.integers(len(problem.settings.moves), size=(length, n))
        moves = actions.few_moves(moves.astype(np.intp), rng)
        together = actions.most_excited == n and k % 2 == 0
        found.append(
            tuple(
                tuple(
                    actions.encode(
                        moves=moves[r],
                        levels=top * (np.ones(n) if together else np.eye(n)[order[r]]).astype(int),
                    ).tolist()
                )
                for r in range(length)
            )
        )
    return found


def tuned_sequence(problem: Problem, records: int | None = None) -> Records:
    """Best sequence found on training episodes: of a number of records, or with its own stopping.

    Raises
    ------
    InvalidSetting
        If none was chosen for these rules.
    """
    chosen = tuned(problem).get("fixed", {}).get("stopping" if records is None else str(records))
    if chosen is None:
        raise InvalidSetting(
            f"no fixed sequence was chosen for arm {problem.arm.name!r} under these rules: "
            "python scripts/agents/tune_agents.py --agents amortised/fixed chooses one on "
            "training episodes"
        )
    return tuple(tuple(int(entry) for entry in action) for action in chosen)


class OpenLoopPolicy:
    """Maximises expected information over records whose results it does not look at.

    It knows where the arm is and which records were taken, and counts on what they will have
    shown on average over the prior.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    information : RecordInformation
        What weighs the records.
    estimator : Estimator
        Its prior is that of the policy.
    settings : GreedySettings, optional
        How many records are weighed.
    """

    def __init__(
        self,
        problem: Problem,
        information: RecordInformation,
        estimator: Estimator,
        settings: GreedySettings | None = None,
    ) -> None:
        self.problem, self.information = problem, information
        self.settings = GreedySettings() if settings is None else settings
        start = getattr(estimator.begin(), "belief", None)
        prior = getattr(start, "belief", start)
        if not isinstance(prior, Belief):
            raise InvalidSetting(
                "open_loop needs an estimator that keeps a posterior over places and frictions, "
                f"not {type(estimator).__name__}"
            )
        self._prior = prior

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Choose the best of the scored records, given which ones were taken."""
        faults = self.information.imagine(self._prior, situation.rng)
        planned = np.ones((len(faults.weight), len(faults.weight)))
        for slot in range(situation.records):
            record = record_from(self.problem.layout, situation.observation, slot)
            if record is not None:
                planned *= self.information.likelihood(
                    faults, record.pose, record.torque, record.duration
                )
        found = ranked(self.problem, self.information, self.settings, situation, faults, planned)
        return found[0].action


def designed_sequences(
    policy: OpenLoopPolicy, estimator: Estimator, count: int, length: int, *, seed: int
) -> list[Records]:
    """Sequences that the model chooses in open loop, each from another first pose.

    Parameters
    ----------
    policy : OpenLoopPolicy
        What chooses.
    estimator : Estimator
        Its own.
    count, length : int
        Number of sequences, and of records in each.
    seed : int
        Seed of the first poses.
    """
    problem, stopping = policy.problem, AfterRecords(records=length + 1)
    agent = BeliefAgent(problem, estimator, policy, stopping, surprising=0.0)
    batch = EpisodeBatch(problem.arm, problem.settings, threads=1)
    found = []
    for number in range(count):
        batch.start(0, seed=seed, number=number, options={"fault": "healthy"})
        state: Any = None
        sequence: list[tuple[int, ...]] = []
        for _ in range(length):
            action, state = agent.predict(batch.observe(0), state)
            sequence.append(tuple(action.tolist()))
            batch.step([0], [action])
        found.append(tuple(sequence))
    return found
