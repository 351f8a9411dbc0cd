"""The local method: accelerometers on both sides of every joint show where motion is lost (7.1.3).

It goes the way of the classical method, with the accelerometers on links beside the tool's. Since
these tell the places apart in one pose, joints hardly move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.estimators import links_from
from loose_agents.policies.classical import ClassicalAgent, ClassicalSettings, Search
from loose_env.diagnosis import RecordScatter, RecordStatistics, SensedPlaces
from loose_env.envs import difficulty_named

__all__ = ["LocalAgent"]


class LocalAgent(ClassicalAgent):
    """Link finding by the change of motion at the tool and on the links.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules, accelerometers on links among the sensors.
    settings : ClassicalSettings
        Order, excitation and thresholds.

    Raises
    ------
    InvalidSetting
        If there are no accelerometers on links, or none of the hypotheses is structural looseness
        or backlash.
    """

    places: SensedPlaces

    def __init__(
        self, problem: Problem, settings: ClassicalSettings | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(problem, settings, seed=seed)
        rules = problem.settings
        mismatch = difficulty_named(rules.difficulty).mismatch
        self.places = SensedPlaces(problem.linear, rules.sensors, mismatch)

    def _scatter(
        self, observation: NDArray[np.float32], slot: int, record: RecordStatistics
    ) -> RecordScatter:
        return self.places.with_links(record, links_from(self.problem.layout, observation, slot))

    def _as_play(self, memory: Search, best: int) -> int:
        """The best place itself: play turns all beyond its joint, a slide shifts it."""
        return best
