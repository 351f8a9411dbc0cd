"""Registry of estimators, which map records to hypothesis probabilities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Estimator
from loose_env.envs import difficulty_named
from loose_env.errors import UnknownName

__all__ = ["ESTIMATORS", "feature_size", "further_features", "make_estimator"]


def _posterior(problem: Problem) -> Estimator:
    from loose_agents.core.belief_tracker import Tracker

    return Tracker(problem)


def _amortised(problem: Problem) -> Estimator:
    from loose_agents.core.belief_tracker import Tracker
    from loose_agents.core.shipped_weights import WEIGHTS, setting_name
    from loose_env.diagnosis import AmortisedPosterior

    difficulty = difficulty_named(problem.settings.difficulty)
    posterior = AmortisedPosterior.load(
        WEIGHTS / f"posterior-{setting_name(problem)}",
        problem.linear,
        problem.settings.sensors,
        difficulty.mismatch,
        kinds=difficulty.probabilities(problem.settings.kinds),
    )
    return Tracker(problem, posterior)


ESTIMATORS: dict[str, tuple[Callable[[Problem], Estimator], str]] = {
    "posterior": (_posterior, "the analytic posterior over the faults"),
    "amortised": (_amortised, "the posterior with a learned likelihood"),
}
"""How each estimator is made, and what it is in a few words."""


def make_estimator(name: str, problem: Problem) -> Estimator:
    """Make an estimator for a problem.

    Raises
    ------
    UnknownName
        If there is no estimator of that name.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.envs import DiagnosisSettings
    >>> make_estimator("posterior", Problem.of(planar(2), DiagnosisSettings())).problem.arm.name
    'planar2'
    """
    if name not in ESTIMATORS:
        raise UnknownName(f"unknown estimator {name!r}; estimators are {list(ESTIMATORS)}")
    return ESTIMATORS[name][0](problem)


def feature_size(estimator: Estimator) -> int:
    """Number of an estimator's features beyond its probabilities; 0 by default.

    An estimator that has more to say, such as what the next record could show under each
    hypothesis, has an attribute ``feature_size`` and a method
    ``features(observation, memory)`` that returns so many numbers of the order of one.
    """
    return int(getattr(estimator, "feature_size", 0))


def further_features(
    estimator: Estimator, observation: NDArray[np.float32], memory: Any
) -> NDArray[np.float32]:
    """Features of an estimator beyond its probabilities (feature_size,)."""
    if not feature_size(estimator):
        return np.zeros(0, dtype=np.float32)
    return np.asarray(
        estimator.features(observation, memory),  # type: ignore[attr-defined]
        dtype=np.float32,
    )
