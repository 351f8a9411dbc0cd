"""Records in search of a loose seat: poses and joints that open what no record has opened yet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem, hypothesis_prior
from loose_env.diagnosis import SeatCoverage, fault_locations
from loose_env.envs import difficulty_named
from loose_env.typing import Array

__all__ = ["SeatSearch"]

_TRIED = 8
"""Random moves of which the best is taken."""

Levels = Callable[[Array], NDArray[np.intp]]
"""Levels of all joints, from 1, in a pose."""


class SeatSearch:
    """Chooses records while nothing is seen, and says when to stop searching.

    Weights (P, F) are probabilities of places of the coverage and of their frictions.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    """

    def __init__(self, problem: Problem) -> None:
        rules = problem.settings
        usual = difficulty_named(rules.difficulty)
        self.problem = problem
        self.coverage = SeatCoverage(problem.linear, usual.friction, usual.friction_over)
        prior = hypothesis_prior(problem.hypotheses, usual.probabilities(rules.kinds))
        known = dict(zip(problem.hypotheses, prior, strict=True))
        self.prior = self.spread([known.get(name, 0.0) for name in fault_locations(problem.arm)])
        """Weights before any record (P, F)."""
        self._healthy = known.get("healthy", 0.0)

    def spread(self, weights: Array | list[float]) -> Array:
        """Spread weights of a slide of each link and play in each joint (2 n,) over (P, F)."""
        n, count, frictions = self.problem.arm.n, len(self.coverage.axes), self.coverage.frictions
        given = np.asarray(weights, dtype=float)
        places = np.concatenate([np.repeat(given[:n] / count, count), given[n:]])
        return np.repeat(places[:, None] / frictions, frictions, axis=1)

    def next(
        self, rng: np.random.Generator, pose: Array, levels: Levels, weights: Array
    ) -> tuple[NDArray[np.intp], float]:
        """Moves (n,) to the pose, of some at random, in which most seats open, and how many do.

        Parameters
        ----------
        rng : numpy.random.Generator
            Draws the moves.
        pose : ndarray (n,)
            Where the arm is.
        levels : callable
            Levels at which joints are excited.
        weights : ndarray (P, F)
            Weights of the seats.
        """
        actions, n = self.problem.actions, self.problem.arm.n
        allowed = [np.flatnonzero(row) for row in actions.allowed_moves(pose)]
        tried = [np.array([rng.choice(own) for own in allowed]) for _ in range(_TRIED)]
        poses = [pose + actions.steps[np.arange(n), moves] for moves in tried]
        opened = [
            float(np.sum(weights * self.shown(there, self.excited(there, levels(there), weights))))
            for there in poses
        ]
        best = int(np.argmax(opened))
        return tried[best], opened[best]

    def excited(self, pose: Array, levels: NDArray[np.intp], weights: Array) -> NDArray[np.intp]:
        """Levels (n,) with as many joints on as the rules allow, those that open most seats."""
        most, n = self.problem.actions.most_excited, len(levels)
        if most >= n:
            return levels
        alone = [np.where(np.arange(n) == joint, levels, 0) for joint in range(n)]
        opened = [float(np.sum(weights * self.shown(pose, one))) for one in alone]
        chosen = np.argsort(-np.array(opened), kind="stable")[:most]
        return np.where(np.isin(np.arange(n), chosen), levels, 0)

    def shown(self, pose: Array, levels: NDArray[np.intp]) -> Array:
        """Probability that a record shows each seat (P, F)."""
        return self.coverage.shown(pose, np.array([0.0, *self.problem.arm.levels])[levels])

    def pays(self, missed: Array, opened: float, duration: float) -> bool:
        """Tell whether a further record is worth its price.

        Parameters
        ----------
        missed : ndarray (P, F)
            Weights of the seats that no record has shown.
        opened : float
            Part of them that the record would show.
        duration : float
            Length of the record [s].
        """
        prices = self.problem.settings.prices
        named = next(name for name in self.problem.hypotheses if name != "healthy")
        better = prices.correct - prices.verdict("healthy", named)
        most = min(self.problem.actions.most_excited, self.problem.arm.n)
        price = prices.record + prices.second * duration
        price += prices.level * most * len(self.problem.arm.levels)
        found = opened / (self._healthy + float(missed.sum()))
        return bool(found * better > price)
