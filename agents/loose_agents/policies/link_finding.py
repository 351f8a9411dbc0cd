"""The thesis's link finding to the letter, for arms in the plane: the agent `classical_literal`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import EpisodeAgent, Problem
from loose_env.diagnosis import (
    LinkFindingSettings,
    Sighting,
    backlash_joint,
    judge_turn,
    looks_healthy,
    next_joint,
)
from loose_env.errors import InvalidSetting


@dataclass
class _Search:
    """State of one search."""

    low: int
    high: int
    sightings: list[Sighting] = field(default_factory=list)
    moved: int | None = None
    tries: int = 0


class LinkFindingAgent(EpisodeAgent):
    """Excites one joint, moves the others one by one, tracks the direction (4.2.2)."""

    def __init__(
        self, problem: Problem, settings: LinkFindingSettings | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(problem, seed=seed)
        if len(problem.arm.axes) != 2:
            raise InvalidSetting(
                f"classical_literal follows directions in a plane, and the tool of "
                f"{problem.arm.name!r} senses three axes: take classical"
            )
        self.settings = LinkFindingSettings() if settings is None else settings

    def begin(self, rng: np.random.Generator) -> Any:
        """Start with every link as a candidate."""
        return _Search(low=1, high=self.problem.arm.n)

    def act(self, observation: NDArray[np.float32], memory: _Search) -> NDArray[np.int64]:
        """Process the latest record, then move on or decide."""
        problem, settings = self.problem, self.settings
        taken = problem.layout.records_of(observation)
        if taken == 0:
            return self._measure(memory, observation, None)
        seen = self._sighting(observation, taken - 1)
        self._judge(memory, seen)
        memory.sightings.append(seen)
        sightings = memory.sightings
        if len(sightings) == settings.healthy_poses and looks_healthy(sightings, settings):
            return problem.verdict("healthy")
        if memory.low == memory.high and len(sightings) >= settings.healthy_poses:
            return self._decide(memory)
        if taken >= problem.settings.max_records:
            return self._decide(memory)
        if memory.low == memory.high:  # one link only, but still too few poses for healthy
            return self._measure(memory, observation, problem.arm.n)
        joint = next_joint(settings.order, memory.low, memory.high)
        return self._measure(memory, observation, joint)

    def _judge(self, memory: _Search, seen: Sighting) -> None:
        """Narrow the candidate links by the result of the last move."""
        joint = memory.moved
        if joint is None or not memory.low < joint <= memory.high:
            return
        finding = judge_turn(memory.sightings[-1], seen, joint, self.settings)
        if finding == "unclear":
            memory.tries += 1
            if memory.tries <= self.settings.retries:
                return
            # Out of retries: the nearer of the two thresholds decides.
            wide = LinkFindingSettings(still=0.5, turned=np.finfo(float).max)
            finding = judge_turn(memory.sightings[-1], seen, joint, wide)
        memory.tries = 0
        if finding == "turned":
            memory.high = joint - 1
        else:
            memory.low = joint

    def _decide(self, memory: _Search) -> NDArray[np.int64]:
        problem = self.problem
        if looks_healthy(memory.sightings, self.settings):
            return problem.verdict("healthy")
        joint = backlash_joint(problem.linear, memory.sightings, self.settings)
        if joint is not None:
            return problem.verdict(f"backlash@joint{joint}")
        link = memory.high if self.settings.order == "inward" else memory.low
        return problem.verdict(f"structural_looseness@link{link}")

    def _measure(
        self, memory: _Search, observation: NDArray[np.float32], joint: int | None
    ) -> NDArray[np.int64]:
        """Move one joint to the end of its reach, then excite and measure."""
        problem = self.problem
        moves = problem.stay
        if joint is not None:
            pose = problem.layout.pose_of(observation)
            allowed = problem.actions.allowed_moves(pose)[joint - 1]
            turn = np.abs(np.sin(problem.actions.moves)) * allowed
            best = np.argsort(-turn, kind="stable")
            best = best[turn[best] > 1e-6]
            if len(best):  # a retry takes the next best one, not to repeat the first
                moves[joint - 1] = best[memory.tries % len(best)]
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[self.settings.joint - 1] = self.settings.level
        memory.moved = joint
        return problem.actions.encode(moves=moves, levels=levels)

    def _sighting(self, observation: NDArray[np.float32], slot: int) -> Sighting:
        read = self.problem.layout.physical

        def at(name: str) -> NDArray[np.float64]:
            return read(observation, name)[slot]  # type: ignore[no-any-return]

        return Sighting(
            pose=self.problem.layout.record_poses_of(observation)[slot],
            direction=_axial(at("lowest_direction")),
            correlation=float(at("correlation")[0]),
            kurtosis=float(at("lowest_kurtosis")[0]),
            nominal_direction=_axial(at("nominal_lowest_direction")),
            nominal_correlation=float(at("nominal_correlation")[0]),
        )


def _axial(products: NDArray[np.float64]) -> float:
    """Angle of a planar direction from its products xx, xy, yy."""
    xx, xy, yy = products
    return float(0.5 * np.arctan2(2 * xy, xx - yy))
