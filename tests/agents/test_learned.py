"""The learned policy: what it sees and chooses, its weights without code, its training."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.base import Problem
from agents.belief import Tracker, record_from
from agents.evaluation import evaluate
from agents.learned import LearnedAgent, PolicyForm
from agents.network import load_network, save_network
from agents.random_agent import RandomAgent
from agents.registry import WEIGHTS, make_agent
from loose_env.arms import planar, vera
from loose_env.diagnosis.record import statistics_of
from loose_env.envs.diagnosis import DiagnosisEnv
from loose_env.envs.settings import DiagnosisSettings

pytest.importorskip("safetensors")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.of(planar(2), DiagnosisSettings())


def test_an_observation_gives_back_the_statistics_of_its_records(problem: Problem) -> None:
    env = DiagnosisEnv(planar(2), DiagnosisSettings(raw=True))
    env.reset(seed=4)
    shake = env.actions.encode(levels=np.array([2, 0]), duration=1)
    observation, _, _, _, _ = env.step(shake)
    episode = env.batch.episode(0)
    assert episode is not None
    assert episode.last is not None
    expected = statistics_of(episode.last)
    found = record_from(problem.layout, observation["statistics"], 0)
    assert found is not None
    for name in ("pose", "torque", "transmission_by_instrument", "joint_rms", "inertia"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-4, atol=1e-6, err_msg=name
        )
    np.testing.assert_allclose(found.tool_covariance, expected.tool_covariance, rtol=1e-3)
    assert abs(float(found.lowest_direction @ expected.lowest_direction)) == pytest.approx(1)
    assert record_from(problem.layout, observation["statistics"], 1) is None


def test_a_tracker_takes_each_record_in_once(problem: Problem) -> None:
    env = DiagnosisEnv(planar(2), DiagnosisSettings())
    first, _ = env.reset(seed=4)
    tracker = Tracker(problem)
    memory = tracker.begin()
    prior = tracker.follow(first, memory)
    assert prior == pytest.approx(tracker.posterior.start().probabilities)
    observation, _, _, _, _ = env.step(env.actions.encode(levels=np.array([3, 0])))
    once = tracker.follow(observation, memory)
    assert not np.allclose(once, prior)
    assert np.array_equal(tracker.follow(observation, memory), once)


def test_the_random_agent_names_what_its_posterior_holds_most_probable(problem: Problem) -> None:
    agent = RandomAgent(problem, sure=0.9)
    rows = evaluate(agent, "random", problem.arm, problem.settings, episodes=24, seed=9)
    assert rows == evaluate(
        RandomAgent(problem, sure=0.9),
        "random",
        problem.arm,
        problem.settings,
        episodes=24,
        seed=9,
        width=5,
    )
    # Blind guessing is right on a third.
    assert sum(r.success for r in rows) >= 15
    assert all(1 <= r.records <= problem.settings.max_records for r in rows)


def test_weights_written_from_a_trained_model_choose_as_it_does(
    problem: Problem, tmp_path: Path
) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    from agents.training import TrackedVecEnv
    from loose_env.envs.vector import DiagnosisVectorEnv

    vec = TrackedVecEnv(DiagnosisVectorEnv(planar(2), problem.settings, num_envs=4), problem)
    model = sb3.PPO(
        "MlpPolicy",
        vec,
        n_steps=4,
        batch_size=8,
        n_epochs=1,
        seed=0,
        policy_kwargs={"net_arch": [64, 64]},
    )
    model.learn(16)
    save_network(model, tmp_path)
    form = PolicyForm(problem)
    network = load_network(tmp_path, form)
    rng = np.random.default_rng(0)
    for _ in range(20):
        features = rng.normal(size=form.observation_space.shape).astype(np.float32)
        wanted, _ = model.predict(features, deterministic=True)
        assert np.array_equal(network.predict(features)[0], wanted)


def test_weights_for_another_arm_are_refused(problem: Problem) -> None:
    if not (WEIGHTS / "vera" / "configuration.json").is_file():
        pytest.skip("no trained policy ships for VERA")
    with pytest.raises(ValueError, match="vera"):
        LearnedAgent.load(problem, WEIGHTS / "vera")


def test_a_missing_policy_is_named_with_the_way_to_make_one(
    problem: Problem, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=r"scripts/train\.py"):
        load_network(tmp_path, PolicyForm(problem))


def test_the_shipped_policy_beats_the_random_agent() -> None:
    settings = DiagnosisSettings()
    problem = Problem.of(vera(), settings)
    returns = {}
    for name in ("random", "ppo"):
        agent = make_agent(name, problem)
        rows = evaluate(agent, name, problem.arm, settings, episodes=96, seed=77)
        returns[name] = float(np.mean([r.reward for r in rows]))
    assert returns["ppo"] > returns["random"]


def test_training_writes_weights_and_configuration_and_resumes(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    out = tmp_path / "run"

    def train(records: int) -> str:
        command = [
            sys.executable,
            str(ROOT / "scripts" / "train.py"),
            "--env",
            "loose_env/Planar-v0",
            "--arguments",
            json.dumps({"n_links": 2, "durations": [0.2]}),
            "--num-envs",
            "8",
            "--records",
            str(records),
            "--out",
            str(out),
        ]
        return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout

    first = train(64)
    assert "64 of 64 steps" in first
    configuration = json.loads((out / "configuration.json").read_text())
    assert configuration["arm"] == "planar2"
    assert (out / "policy.safetensors").is_file()
    second = train(128)
    assert "resumed" in second
    assert "128 of 128 steps" in second
