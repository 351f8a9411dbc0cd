"""The classical method and the blind rows."""

from __future__ import annotations

import numpy as np
import pytest
from loose_agents.core.base import Problem
from loose_agents.evaluation.evaluate import EpisodeRow, evaluate
from loose_agents.policies.classical import ClassicalAgent, ClassicalSettings
from loose_agents.registry import make_agent

from loose_env.arms import Arm, planar, six_axis, vera
from loose_env.envs import DiagnosisSettings, EpisodeBatch
from loose_env.errors import InvalidSetting

SETTINGS = DiagnosisSettings(engine="reduced")
BLIND = ("always_healthy", "always_unsure")


def rows(arm: Arm, name: str, episodes: int, *, width: int = 16) -> list[EpisodeRow]:
    agent = make_agent(name, Problem.of(arm, SETTINGS))
    return evaluate(agent, name, arm, SETTINGS, episodes=episodes, seed=5, width=width, threads=1)


@pytest.mark.parametrize(
    ("arm", "right", "margin", "episodes"),
    [(planar(4), 0.8, 0.5, 48), (vera(), 0.65, 0.35, 48), (six_axis(), 0.6, 0.15, 32)],
    ids=lambda value: getattr(value, "name", None),
)
def test_classical_beats_the_blind_rows_by_a_wide_margin(
    arm: Arm, right: float, margin: float, episodes: int
) -> None:
    played = rows(arm, "classical", episodes)
    mean = np.mean([r.reward for r in played])
    assert np.mean([r.success for r in played]) > right
    for name in BLIND:
        assert mean > margin + np.mean([r.reward for r in rows(arm, name, episodes)])


def test_blind_rows_take_the_cheapest_record_and_say_one_thing() -> None:
    arm = vera()
    # "unsure" counts from the third record on
    for name, verdict, records in zip(BLIND, ("healthy", "unsure"), (1, 3), strict=True):
        for row in rows(arm, name, 8):
            assert (row.verdict, row.records) == (verdict, records)
            assert row.seconds == pytest.approx(records * min(SETTINGS.durations))


def test_rows_do_not_depend_on_how_many_arms_run_side_by_side() -> None:
    assert rows(planar(3), "bisection", 5, width=1) == rows(planar(3), "bisection", 5, width=5)


@pytest.mark.parametrize("order", ["outward", "inward", "bisection"])
def test_once_something_is_seen_one_joint_moves_at_a_time(order: str) -> None:
    arm = planar(4)
    agent = ClassicalAgent(Problem.of(arm, SETTINGS), ClassicalSettings(order=order))  # type: ignore[arg-type]
    batch = EpisodeBatch(arm, SETTINGS, num=1, threads=1)
    batch.start(0, seed=1, number=3, options={"fault": "structural_looseness@link2"})
    state, found = None, 0
    while True:
        action, state = agent.predict(batch.observe(0), state)
        outcome = batch.step([0], [action])[0]
        if outcome.terminated:
            break
        if state[0].left:
            found += 1
            moved = np.flatnonzero(action[: arm.n] != SETTINGS.stay)
            assert moved.tolist() == [state[0].moved - 1]
    assert found
    assert outcome.info["is_success"]


@pytest.mark.parametrize(
    "wrong", [{"order": "sideways"}, {"seen": 0.0}, {"healthy_poses": 0}, {"line": -1.0}]
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidSetting):
        ClassicalSettings(**wrong)  # type: ignore[arg-type]
