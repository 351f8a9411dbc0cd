"""The local method: accelerometers on links name the place in fewer records."""

from __future__ import annotations

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.belief import links_from
from loose_agents.evaluation import EpisodeRow, evaluate
from loose_agents.registry import make_agent

from loose_env.arms import planar
from loose_env.envs import DiagnosisSettings
from loose_env.errors import InvalidSetting
from loose_env.sensors import LinkAccelerometers, SensorSuite

ARM = planar(3)
SENSED = DiagnosisSettings(engine="reduced", sensors=SensorSuite(link_accelerometers=True))


def rows(name: str) -> list[EpisodeRow]:
    agent = make_agent(name, Problem.of(ARM, SENSED))
    return evaluate(agent, name, ARM, SENSED, episodes=32, seed=5, width=16, threads=1)


def test_it_needs_fewer_records_than_by_the_tool_alone_and_earns_more() -> None:
    local, classical = rows("local"), rows("classical")
    assert np.mean([row.success for row in local]) > 0.9
    assert np.mean([row.reward for row in local]) > np.mean([row.reward for row in classical])
    assert np.mean([row.records for row in local]) < 0.7 * np.mean(
        [row.records for row in classical]
    )


@pytest.mark.parametrize(
    ("links", "says"),
    [
        (False, "needs accelerometers on links and the sensors have none; set link_accelerometers"),
        (LinkAccelerometers(tangential=True), "tangential ones measure one; set tangential=False"),
    ],
)
def test_sensors_that_do_not_do_are_refused(links: bool | LinkAccelerometers, says: str) -> None:
    suite = SensorSuite(link_accelerometers=links)
    problem = Problem.of(ARM, DiagnosisSettings(engine="reduced", sensors=suite))
    with pytest.raises(InvalidSetting, match=says):
        make_agent("local", problem)


def test_an_observation_without_them_holds_no_readings_of_links() -> None:
    layout = Problem.of(ARM, DiagnosisSettings()).layout
    with pytest.raises(InvalidSetting, match="no accelerometers on links"):
        links_from(layout, np.zeros(layout.space.shape, dtype=np.float32), 0)
