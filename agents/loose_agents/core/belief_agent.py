"""Agents composed of an estimator, a measurement policy and a stopping rule.

So that what the estimator gives and what the choice of poses gives can be told apart, any
estimator plays with any policy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import EpisodeAgent, Problem
from loose_env.faults import UNSURE

__all__ = [
    "BeliefAgent",
    "Estimator",
    "Policy",
    "Situation",
    "StoppingRule",
    "Sure",
    "best_verdict",
    "records_measured",
    "records_taken",
    "surprise_of",
    "verdict_of",
]

SURPRISING = 0.003
"""p-value of an episode among those of the trained kind, below which nothing is named."""
DECISIVE = 0.3
"""Share of that p-value below which further records are not waited for."""


class Estimator(Protocol):
    """Maps the records of an episode to probabilities of the hypotheses."""

    problem: Problem
    """The nominal arm and the rules."""

    def begin(self) -> Any:
        """Return the initial state of an episode."""
        ...

    def follow(self, observation: NDArray[np.float32], memory: Any) -> NDArray[np.float64]:
        """Update with the new records; return the probabilities (hypotheses,).

        May change the memory. They stand in the order of ``problem.hypotheses``.
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Situation:
    """Information available when the next record is chosen."""

    observation: NDArray[np.float32]
    """The environment's flat observation."""
    pose: NDArray[np.float64]
    """Joint positions [rad, m where one slides] (n,)."""
    records: int
    """Records taken so far."""
    probabilities: NDArray[np.float64]
    """Of the hypotheses, by the estimator (hypotheses,)."""
    memory: Any
    """The estimator's memory, for policies that know what is in it."""
    rng: np.random.Generator
    """The episode's own generator."""


class Policy(Protocol):
    """Chooses the next record."""

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Return a measurement action, never a verdict."""
        ...


class StoppingRule(Protocol):
    """Decides when to stop measuring."""

    def stop(self, situation: Situation) -> bool:
        """Return True to stop and give a verdict; called after at least one record."""
        ...


@dataclass(frozen=True, kw_only=True)
class Sure:
    """Stops once the maximum posterior probability reaches a threshold."""

    probability: float = 0.9
    """From which probability on."""

    def stop(self, situation: Situation) -> bool:
        """Return True once the maximum probability reaches the threshold."""
        return bool(situation.probabilities.max() >= self.probability)


@dataclass
class _Memory:
    """State of one episode: its generator and the estimator's state."""

    rng: np.random.Generator
    estimate: Any
    probabilities: NDArray[np.float64] | None = None
    """Of the hypotheses, after the latest record (hypotheses,); read by the evaluator."""


class BeliefAgent(EpisodeAgent):
    """Measures by its policy until the stopping rule fires, then gives a verdict.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    estimator : Estimator
        What the records say.
    policy : Policy
        What to measure next.
    stopping : StoppingRule
        When to stop. When the records have run out it is not asked.
    surprising : float
        Below which p-value an episode is so unlike all that the estimator knows that the verdict
        is "unsure"; 0: never. See `surprise_of`.
    """

    def __init__(
        self,
        problem: Problem,
        estimator: Estimator,
        policy: Policy,
        stopping: StoppingRule,
        *,
        seed: int = 0,
        surprising: float = SURPRISING,
    ) -> None:
        super().__init__(problem, seed=seed)
        self.estimator, self.policy, self.stopping = estimator, policy, stopping
        self.surprising = surprising

    def begin(self, rng: np.random.Generator) -> Any:
        """Start from the prior."""
        return _Memory(rng=rng, estimate=self.estimator.begin())

    def act(self, observation: NDArray[np.float32], memory: _Memory) -> NDArray[np.int64]:
        """Take a measurement, or give the verdict of highest expected reward."""
        problem = self.problem
        probabilities = self.estimator.follow(observation, memory.estimate)
        memory.probabilities = probabilities
        situation = Situation(
            observation=observation,
            pose=problem.layout.pose_of(observation),
            records=records_taken(problem, observation),
            probabilities=probabilities,
            memory=memory.estimate,
            rng=memory.rng,
        )
        done = situation.records >= problem.settings.max_records
        if situation.records > 0 and (
            done
            or self.stopping.stop(situation)
            or surprise_of(situation.memory) < DECISIVE * self.surprising
        ):
            named = verdict_of(problem, situation, self.surprising)
            if named is not None:
                return problem.verdict(named)
        return self.policy.choose(situation)


def records_taken(problem: Problem, observation: NDArray[np.float32]) -> int:
    """Number of records in an observation."""
    share = float(problem.layout.physical(observation, "spent")[0])
    return round(share * problem.settings.max_records)


def records_measured(problem: Problem, observation: NDArray[np.float32]) -> int:
    """Number of records in an observation that are not empty."""
    return int(np.count_nonzero(problem.layout.slots_of(observation)[:, 0]))


def surprise_of(memory: Any) -> float:
    """p-value of an episode under the estimator's training distribution.

    Estimators say it in ``surprise`` of the belief that their memory holds; one for those that
    say nothing.
    """
    return float(getattr(getattr(memory, "belief", None), "surprise", 1.0))


def verdict_of(
    problem: Problem, situation: Situation, surprising: float = SURPRISING
) -> str | None:
    """Verdict of highest expected reward; "unsure" for out-of-distribution episodes.

    None where it would be "unsure" and may not be yet: then more is to be measured.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    situation : Situation
        What is known.
    surprising : float
        p-value below which nothing is named, see `surprise_of`.
    """
    measured = records_measured(problem, situation.observation)
    unsure = problem.actions.allows_unsure(situation.records, measured)
    if surprise_of(situation.memory) < surprising:
        if unsure:
            return UNSURE
        if situation.records < problem.settings.max_records:
            return None
    return best_verdict(problem, situation.probabilities, unsure=unsure)


def best_verdict(
    problem: Problem, probabilities: NDArray[np.float64], *, unsure: bool = True
) -> str:
    """Verdict of the highest expected reward under the environment's rewards.

    "unsure" only where it may be said and is worth more than every name.
    """
    prices = problem.settings.prices
    worth = [
        sum(
            p * prices.verdict(named, truth)
            for p, truth in zip(probabilities, problem.hypotheses, strict=True)
        )
        for named in (problem.verdicts if unsure else problem.hypotheses)
    ]
    return problem.verdicts[int(np.argmax(worth))]
