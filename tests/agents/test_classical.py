"""The classical method, link finding by predicted directions, and the constant baselines."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from loose_agents.base import EpisodeAgent, Problem
from loose_agents.evaluation import EpisodeRow, evaluate
from loose_agents.policies.classical import ClassicalAgent, ClassicalSettings
from loose_agents.registry import make_agent

from loose_env.arms import DESK_ARM, Arm, arm_from_file, planar, scara, six_axis, vera
from loose_env.envs import DiagnosisSettings, EnvBatch
from loose_env.errors import InvalidSetting
from loose_env.sensors import LinkAccelerometers, SensorSuite

SETTINGS = DiagnosisSettings(engine="reduced")
BLIND = ("always_healthy", "always_unsure")


def rows(
    arm: Arm, name: str, episodes: int, settings: DiagnosisSettings = SETTINGS
) -> list[EpisodeRow]:
    agent = make_agent(name, Problem.of(arm, settings))
    return evaluate(agent, name, arm, settings, episodes=episodes, seed=5, width=16, threads=1)


@pytest.mark.parametrize(
    ("arm", "margin", "episodes"),
    [
        (planar(4), 0.5, 32),
        (vera(), 0.35, 40),
        pytest.param(scara(), 0.15, 32, marks=pytest.mark.slow),
        pytest.param(six_axis(), 0.3, 24, marks=pytest.mark.slow),
        pytest.param(arm_from_file(DESK_ARM), 0.15, 20, marks=pytest.mark.slow),
    ],
    ids=("planar4", "vera", "scara", "six_axis", "desk"),
)
def test_classical_beats_the_blind_rows_by_a_wide_margin(
    arm: Arm, margin: float, episodes: int
) -> None:
    played = rows(arm, "classical", episodes)
    for name in BLIND:
        blind = rows(arm, name, episodes)
        assert mean(played, "reward") > mean(blind, "reward") + margin
        assert mean(played, "success") > mean(blind, "success") + 0.25


def mean(played: list[EpisodeRow], name: str) -> float:
    return float(np.mean([getattr(row, name) for row in played]))


def test_blind_rows_take_the_cheapest_record_and_say_one_thing() -> None:
    arm = vera()
    # "unsure" counts from the third record on
    for name, verdict, records in zip(BLIND, ("healthy", "unsure"), (1, 3), strict=True):
        for row in rows(arm, name, 8):
            assert (row.verdict, row.records) == (verdict, records)
            assert row.seconds == pytest.approx(records * min(SETTINGS.durations))


def steps(
    agent: EpisodeAgent, fault: str, number: int = 0
) -> Iterator[tuple[Any, Any, dict[str, Any]]]:
    """Action, state and info of every step of an episode."""
    problem = agent.problem
    batch = EnvBatch(problem.arm, problem.settings, threads=1)
    batch.start(0, seed=1, number=number, options={"fault": fault})
    state: Any = None
    info: dict[str, Any] = {}
    while "verdict" not in info:
        action, state = agent.predict(batch.observe(0), state)
        info = batch.step([0], [action]).info(0)
        yield action, state[0], info


@pytest.mark.parametrize("order", ["outward", "inward", "bisection"])
def test_once_something_is_seen_one_joint_moves_at_a_time(order: Any) -> None:
    arm, found = planar(4), 0
    agent = ClassicalAgent(Problem.of(arm, SETTINGS), ClassicalSettings(order=order))
    for action, state, info in steps(agent, "structural_looseness@link2", 3):
        if state.left and "verdict" not in info:
            found += 1
            moved = np.flatnonzero(action[: arm.n] != SETTINGS.stay)
            assert moved.tolist() == [state.moved - 1]
    assert found and info["is_success"]


def test_a_slide_that_may_be_play_is_told_by_driving_that_joint_alone() -> None:
    arm, driven = planar(4), []
    agent = ClassicalAgent(Problem.of(arm, SETTINGS), ClassicalSettings(driven=1e6))
    for action, state, info in steps(agent, "backlash@joint3"):
        if state.driven is not None:
            driven.append(np.flatnonzero(action[arm.n : 2 * arm.n]).tolist())
        success = info.get("is_success")
    assert driven[0] == [2] and success


def test_one_exciter_alone_rarely_alarms() -> None:
    arm, rules = planar(3), DiagnosisSettings(engine="reduced", max_excited=1, durations=(0.2,))
    agent = ClassicalAgent(Problem.of(arm, rules))
    row = evaluate(
        agent, "", arm, rules, episodes=40, seed=5, width=40, threads=1,
        options={"fault": "healthy"},
    )  # fmt: skip
    assert sum(r.verdict != "healthy" for r in row) <= 3


@pytest.mark.parametrize(
    "wrong",
    [
        {"order": "sideways"},
        {"significance": 0.0},
        {"significance": 1.0},
        {"driven": -1.0},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidSetting):
        ClassicalSettings(**wrong)  # type: ignore[arg-type]


ARM = planar(3)
SENSED = DiagnosisSettings(engine="reduced", sensors=SensorSuite(link_accelerometers=True))


def test_it_needs_fewer_records_than_by_the_tool_alone_and_earns_more() -> None:
    local, classical = (rows(ARM, name, 32, SENSED) for name in ("local", "classical"))
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


EASY = DiagnosisSettings(difficulty="easy")


@pytest.mark.parametrize(
    "arm", [scara(), pytest.param(six_axis(), marks=pytest.mark.slow)], ids=["scara", "six_axis"]
)
def test_orders_of_the_joints_play_arms_in_space_and_the_letter_does_not(arm: Arm) -> None:
    problem = Problem.of(arm, EASY)
    for row in rows(arm, "inward", 4, EASY):
        assert row.verdict in problem.hypotheses
        assert not row.truncated
        assert row.records <= EASY.max_records
    with pytest.raises(InvalidSetting, match="senses three axes: take classical"):
        make_agent("classical_literal", problem)
