"""Agent `rhythm`: names the seat whose knocks explain when the accelerometer's top band rang."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import EpisodeAgent, Problem
from loose_agents.policies.classical import SeatSearch
from loose_env.diagnosis import fault_locations
from loose_env.errors import InvalidSetting
from loose_env.io import Checked, Positive
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class RhythmSettings(Checked):
    """Thresholds of the decisions."""

    loud: Positive = 6e-4
    """Power of the top band over that of the excited one from which a part has knocked [1]: more
    than healthy arms of the library ring by their noise and bending."""
    sure: Positive = 0.7
    """Probability of a place, among all places, at which it is named [1]."""


@dataclass
class Listening:
    """State of one episode; P seats by F frictions, as `SeatSearch` has them."""

    rng: np.random.Generator
    missed: Array
    """Weights of the seats that no record has shown (P, F)."""
    score: Array
    """Log likelihood of every seat by the records that rang (P,)."""
    rang: bool = False


class RhythmAgent(EpisodeAgent):
    """Searches until something rings, then adds up rhythms until one place is left.

    Raises
    ------
    InvalidSetting
        If the observation has no block `rhythm`.
    """

    def __init__(
        self, problem: Problem, settings: RhythmSettings | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(problem, seed=seed)
        if not problem.settings.rhythm:
            raise InvalidSetting(
                "the agent 'rhythm' reads a block that is off by default: make the environment "
                "with rhythm=True, on the command line --arguments '{\"rhythm\": true}'"
            )
        self.settings = RhythmSettings() if settings is None else settings
        self.search = SeatSearch(problem)
        n, axes = problem.arm.n, len(self.search.coverage.axes)
        self._first = np.r_[np.arange(n) * axes, n * axes + np.arange(n)]
        self._names = fault_locations(problem.arm)
        share = self.search.prior.sum(axis=1)
        with np.errstate(divide="ignore"):  # of a place that is no hypothesis
            self._prior = np.log(np.add.reduceat(share, self._first))

    def begin(self, rng: np.random.Generator) -> Listening:
        """Start with every seat in question."""
        prior = self.search.prior
        return Listening(rng=rng, missed=prior, score=np.zeros(len(prior)))

    def act(self, observation: NDArray[np.float32], memory: Listening) -> NDArray[np.int64]:
        """Take in the latest record, then move on or decide."""
        problem, layout = self.problem, self.problem.layout
        taken, pose = int(layout.records_of(observation)), layout.pose_of(observation)
        if taken == 0:
            return self._measure(memory, pose, problem.stay, memory.missed)
        self._listen(layout.groups_of(layout.slots_of(observation)[taken - 1]), memory)
        last, weights = taken >= problem.settings.max_records, memory.missed
        if memory.rang:
            places, weights = self._posterior(memory)
            if last or places.max() >= self.settings.sure:
                return problem.verdict(self._names[int(places.argmax())])
        seconds = max(problem.settings.durations)
        full = np.full(problem.arm.n, len(problem.arm.levels))
        moves, opened = self.search.next(memory.rng, pose, full, weights)
        if not memory.rang and (last or not self.search.pays(memory.missed, opened, seconds)):
            return problem.verdict("healthy")
        return self._measure(memory, pose, moves, weights)

    def _listen(self, record: dict[str, Array], memory: Listening) -> None:
        """Add up what a record says, if it rang."""
        if record["valid"][0] > 0 and record["loudness"][0] > self.settings.loud:
            memory.score = memory.score + record["rhythm"]
            memory.rang = True

    def _posterior(self, memory: Listening) -> tuple[Array, Array]:
        """Probabilities of places (2 n,), each by its best seat, and weights of seats (P, F)."""
        best = np.maximum.reduceat(memory.score, self._first) + self._prior
        places = np.exp(best - best.max())
        seats = np.exp(memory.score - memory.score.max())
        frictions = self.search.prior.shape[1]
        weights = np.repeat(seats[:, None] / (seats.sum() * frictions), frictions, axis=1)
        return places / places.sum(), weights

    def _measure(
        self, memory: Listening, pose: Array, moves: NDArray[np.intp], weights: Array
    ) -> NDArray[np.int64]:
        """The longest record at the top level, of the joints that open most of what is left."""
        arm = self.problem.arm
        there = pose + self.problem.actions.steps[np.arange(arm.n), moves]
        levels = self.search.excited(there, np.full(arm.n, len(arm.levels)), weights)
        memory.missed = memory.missed * (1.0 - self.search.shown(there, levels))
        return self.problem.actions.encode(moves=moves, levels=levels)
