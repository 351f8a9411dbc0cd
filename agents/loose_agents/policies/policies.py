"""Registry of policies, which choose the next record; the random and constant baselines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Estimator, Policy, Situation
from loose_agents.core.estimators import tuned
from loose_env.diagnosis import (
    AmortisedPosterior,
    FaultPosterior,
    InformationFactors,
    RecordInformation,
    SeatFeatures,
)
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting, UnknownName

__all__ = [
    "POLICIES",
    "ConstantPolicy",
    "RandomPolicy",
    "information_of",
    "make_policy",
    "random_moves",
]


class RandomPolicy:
    """Excites one random joint at a random level and duration, in random poses.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Sample an action from the episode's generator."""
        problem, rng = self.problem, situation.rng
        moves = random_moves(problem, situation)
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[rng.integers(problem.arm.n)] = rng.integers(1, 1 + len(problem.arm.levels))
        duration = int(rng.integers(len(problem.settings.durations)))
        return problem.actions.encode(moves=moves, levels=levels, duration=duration)


def random_moves(problem: Problem, situation: Situation) -> NDArray[np.intp]:
    """Sample an allowed move for every joint (n,)."""
    allowed = problem.actions.allowed_moves(situation.pose)
    drawn = np.array([situation.rng.choice(np.flatnonzero(row)) for row in allowed])
    return problem.actions.few_moves(drawn, situation.rng)


class ConstantPolicy:
    """Applies a constant excitation in random poses.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    levels : sequence of int
        Level of every joint, 0 for off.
    duration : int, optional
        Index of the record length; the longest by default.
    """

    def __init__(
        self, problem: Problem, levels: tuple[int, ...], *, duration: int | None = None
    ) -> None:
        if len(levels) != problem.arm.n or not any(levels):
            raise InvalidSetting(
                f"a constant policy needs a level for each of {problem.arm.n} joints, at least one "
                f"of them above 0; got {levels}"
            )
        self.problem, self.levels, self.duration = problem, np.array(levels), duration

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Move at random and apply the constant excitation."""
        return self.problem.actions.encode(
            moves=random_moves(self.problem, situation), levels=self.levels, duration=self.duration
        )


def information_of(problem: Problem, estimator: Estimator) -> RecordInformation:
    """Build the information criterion for the beliefs of an estimator.

    Raises
    ------
    InvalidSetting
        If the estimator keeps no posterior over places and frictions.
    """
    posterior = getattr(estimator, "posterior", None)
    fitted = tuned(problem).get("information")
    factors = None
    if fitted is not None:
        factors = InformationFactors(**fitted | {"joints": tuple(fitted["joints"])})
    if isinstance(posterior, AmortisedPosterior):
        return RecordInformation(posterior.features, posterior.frictions, factors=factors)
    if isinstance(posterior, FaultPosterior):
        difficulty = difficulty_named(problem.settings.difficulty)
        features = SeatFeatures(
            problem.linear,
            problem.settings.sensors,
            difficulty.mismatch,
            directions=len(posterior.directions),
            over=difficulty.friction_over,
        )
        return RecordInformation(features, posterior.frictions, factors=factors)
    raise InvalidSetting(
        "choosing records by information needs an estimator with a posterior over places and "
        f"frictions, not {type(estimator).__name__}"
    )


def _random(problem: Problem, estimator: Estimator) -> Policy:
    return RandomPolicy(problem)


def _constant(problem: Problem, estimator: Estimator) -> Policy:
    best = tuned(problem).get("constant")
    levels = [0] * problem.arm.n
    levels[0] = len(problem.arm.levels)  # joint 1 moves everything behind it
    top = len(problem.arm.levels)
    return ConstantPolicy(problem, tuple(levels if best is None else [min(b, top) for b in best]))


def _together(problem: Problem, estimator: Estimator) -> Policy:
    return ConstantPolicy(problem, (len(problem.arm.levels),) * problem.arm.n)


def _greedy(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.information_policies import GreedyPolicy

    return GreedyPolicy(problem, information_of(problem, estimator))


def _look_ahead(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.information_policies import LookAheadPolicy

    return LookAheadPolicy(problem, information_of(problem, estimator))


def _fixed(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.non_adaptive import FixedPolicy, tuned_sequence

    return FixedPolicy(problem, tuned_sequence(problem))


def _open_loop(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.non_adaptive import OpenLoopPolicy

    return OpenLoopPolicy(problem, information_of(problem, estimator), estimator)


POLICIES: dict[str, tuple[Callable[[Problem, Estimator], Policy], str]] = {
    "random": (_random, "random poses, joint, level and length"),
    "constant": (_constant, "the best single joint and level, random poses"),
    "together": (_together, "all joints at the top level, random poses"),
    "fixed": (_fixed, "the same records on every arm, the best of many sequences"),
    "open_loop": (_open_loop, "records that the model chooses without looking at any result"),
    "greedy": (_greedy, "the record that is expected to say most"),
    "look_ahead": (_look_ahead, "the record that is worth most with the next one in view"),
}
"""Constructor and short description of each policy."""


def make_policy(name: str, problem: Problem, estimator: Estimator) -> Policy:
    """Make a policy for a problem and its estimator.

    Raises
    ------
    UnknownName
        If there is no policy of that name.
    """
    if name not in POLICIES:
        raise UnknownName(f"unknown policy {name!r}; policies are {list(POLICIES)}")
    return POLICIES[name][0](problem, estimator)
