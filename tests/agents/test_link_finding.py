"""The agents that find links by directions, on arms in the plane and in space."""

from __future__ import annotations

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.evaluation import EpisodeRow, evaluate
from loose_agents.policies.link_finding import (
    LinkFindingAgent,
    SpaceLinkFindingAgent,
    SpaceLinkFindingSettings,
)
from loose_agents.registry import make_agent

from loose_env.arms import Arm, planar, scara, six_axis
from loose_env.envs import DiagnosisSettings, EpisodeBatch
from loose_env.errors import InvalidSetting

EASY = DiagnosisSettings(difficulty="easy")


def rows(arm: Arm, name: str, episodes: int, *, width: int = 16) -> list[EpisodeRow]:
    agent = make_agent(name, Problem.of(arm, EASY))
    return evaluate(agent, name, arm, EASY, episodes=episodes, seed=5, width=width, threads=1)


def test_predicted_images_find_most_easy_faults_of_a_planar_arm() -> None:
    played = rows(planar(4), "images", 24)
    assert np.mean([r.success for r in played]) > 0.75
    assert np.mean([r.records for r in played]) < 7


@pytest.mark.parametrize("name", ["classical", "inward", "classical_literal", "images"])
@pytest.mark.parametrize("arm", [six_axis(), scara()], ids=lambda a: a.name)
def test_every_link_finding_agent_plays_arms_in_space(arm: Arm, name: str) -> None:
    problem = Problem.of(arm, EASY)
    for row in rows(arm, name, 6):
        assert row.verdict in problem.hypotheses
        assert not row.truncated
        assert row.records <= EASY.max_records


def test_the_registry_keeps_the_planar_method_for_planar_arms() -> None:
    arm = planar(4)
    assert isinstance(make_agent("classical_literal", Problem.of(arm, EASY)), LinkFindingAgent)
    assert isinstance(make_agent("images", Problem.of(arm, EASY)), SpaceLinkFindingAgent)
    arm = six_axis()
    agent = make_agent("classical_literal", Problem.of(arm, EASY))
    assert isinstance(agent, SpaceLinkFindingAgent)
    assert agent.settings.policy == "turns"


def test_turns_move_one_joint_and_images_move_several() -> None:
    arm = six_axis()
    problem = Problem.of(arm, EASY)
    most = {}
    for name in ("classical_literal", "images"):
        agent = make_agent(name, problem)
        batch = EpisodeBatch(arm, EASY, num=1, threads=1)
        # The seat at link 6 carries little weight: it opens.
        batch.start(0, seed=1, number=3, options={"fault": "structural_looseness@link6"})
        state, moved = None, []
        for _ in range(EASY.max_records + 1):
            action, state = agent.predict(batch.observe(0), state)
            search = state[0]
            loose = search.pool.stands_out(agent.settings.significance, np.random.default_rng(0))
            seen = loose if name == "images" else bool(search.sightings)
            outcome = batch.step([0], [action])[0]
            if outcome.terminated:
                break
            if seen:
                moved.append(int(np.sum(action[: arm.n] != EASY.stay)))
        most[name] = max(moved, default=0)
    assert most["classical_literal"] <= 1
    assert most["images"] > 1


@pytest.mark.parametrize(
    "wrong",
    [{"policy": "guess"}, {"sure": 1.0}, {"seen": 0.0}, {"healthy_poses": 0}, {"shortlist": 0}],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidSetting):
        SpaceLinkFindingSettings(**wrong)  # type: ignore[arg-type]
