"""Registry of policies, which choose the next record."""

from __future__ import annotations

from collections.abc import Callable

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Estimator, Policy
from loose_agents.core.shipped_weights import tuned
from loose_env.diagnosis import (
    AmortisedPosterior,
    FaultPosterior,
    InformationFactors,
    RecordInformation,
    SeatFeatures,
)
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting, UnknownName

__all__ = ["POLICIES", "information_of", "make_policy"]


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
        mismatch = difficulty_named(problem.settings.difficulty).mismatch
        features = SeatFeatures(
            problem.linear,
            problem.settings.sensors,
            mismatch,
            directions=len(posterior.directions),
        )
        return RecordInformation(features, posterior.frictions, factors=factors)
    raise InvalidSetting(
        "choosing records by information needs an estimator with a posterior over places and "
        f"frictions, not {type(estimator).__name__}"
    )


def _random(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.random_and_constant import RandomPolicy

    return RandomPolicy(problem)


def _constant(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.random_and_constant import ConstantPolicy

    best = tuned(problem).get("constant")
    levels = [0] * problem.arm.n
    levels[0] = len(problem.arm.levels)  # joint 1 moves everything behind it
    return ConstantPolicy(problem, tuple(levels if best is None else best))


def _together(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.random_and_constant import ConstantPolicy

    return ConstantPolicy(problem, (len(problem.arm.levels),) * problem.arm.n)


def _greedy(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.greedy import GreedyPolicy

    return GreedyPolicy(problem, information_of(problem, estimator))


def _look_ahead(problem: Problem, estimator: Estimator) -> Policy:
    from loose_agents.policies.look_ahead import LookAheadPolicy

    return LookAheadPolicy(problem, information_of(problem, estimator))


POLICIES: dict[str, tuple[Callable[[Problem, Estimator], Policy], str]] = {
    "random": (_random, "random poses, joint, level and length"),
    "constant": (_constant, "the best single joint and level, random poses"),
    "together": (_together, "all joints at the top level, random poses"),
    "greedy": (_greedy, "the record that is expected to say most"),
    "look_ahead": (_look_ahead, "the record that is worth most with the next one in view"),
}
"""How each policy is made, and what it is in a few words."""


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
