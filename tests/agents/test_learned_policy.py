"""The learned policy: what it sees and chooses, and its weights without code."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.belief import Tracker, setting_name
from loose_agents.evaluation import EpisodeRow, evaluate
from loose_agents.registry import make_agent
from loose_agents.rl.agents import CONFIGURATION, LearnedAgent, PolicyForm
from loose_agents.rl.networks import FORMAT, load_network, network_of, save_network

from loose_env.arms import planar, scara, vera
from loose_env.diagnosis import statistics_of
from loose_env.envs import DiagnosisEnv, DiagnosisSettings, DiagnosisVectorEnv
from loose_env.errors import InvalidData
from loose_env.wrappers import record_from

pytest.importorskip("safetensors")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.of(planar(2), DiagnosisSettings(engine="reduced"))


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
    agent = make_agent("posterior/random", problem)
    rows = evaluate(agent, "random", problem.arm, problem.settings, episodes=24, seed=9)
    # Blind guessing is right on a third.
    assert sum(r.success for r in rows) >= 15
    assert all(1 <= r.records <= problem.settings.max_records for r in rows)


ALGORITHMS = ["ppo", "maskable_ppo"]


def untrained(problem: Problem, algorithm: str) -> Any:
    """A model whose every weight is random, so that no two options are alike."""
    pytest.importorskip("sb3_contrib")
    import torch
    from loose_agents.rl.hyperparameters import algorithm_named
    from loose_agents.rl.training_env import TrackedVecEnv

    vec = TrackedVecEnv(DiagnosisVectorEnv(problem.arm, problem.settings, num_envs=2), problem)
    model = algorithm_named(algorithm)(
        "MlpPolicy", vec, n_steps=4, batch_size=8, seed=0, device="cpu",
        policy_kwargs={"net_arch": [16, 8]},
    )  # fmt: skip
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.normal_(0.0, 0.1 if parameter.ndim == 1 else 1.0)
    return model


def write_policy(problem: Problem, folder: Path, algorithm: str = "ppo") -> Any:
    """Write a policy as the training does."""
    model = untrained(problem, algorithm)
    folder.mkdir(parents=True, exist_ok=True)
    save_network(network_of(model), folder)
    described = {"format": FORMAT, "arm": problem.arm.name, "estimator": "posterior"}
    (folder / CONFIGURATION).write_text(json.dumps(described))
    return model


def test_it_stops_neither_before_the_first_record_nor_after_the_last(problem: Problem) -> None:
    form = PolicyForm(problem)
    p, most = np.array([0.1, 0.1, 0.6, 0.1, 0.1]), problem.settings.max_records

    def names(stop: int, records: int, least: int = 1) -> bool:
        choice = np.array([2, 2, 1, 0, 0, stop])
        k = problem.actions.decode(form.action(choice, p, records, least=least)).verdict
        assert k in (0, 1 + 2)  # the most probable hypothesis is named
        return bool(k)

    assert [names(1, 0), names(1, 1), names(1, 2, 3), names(1, 3, 3)] == [False, True, False, True]
    assert [names(0, most - 1), names(0, most), names(0, most, most + 5)] == [False, True, True]


def test_masks_leave_the_moves_and_stops_that_make_sense() -> None:
    problem = Problem.of(scara(), DiagnosisSettings())
    form = PolicyForm(problem)
    n, moves = problem.arm.n, len(problem.settings.moves)
    pose = np.array([0.0 if r is None else r[1] for r in problem.arm.joint_ranges])
    mask = form.mask(pose, records=0)
    assert mask.shape == (form.nvec.sum(),)
    allowed = mask[: n * moves].reshape(n, moves)
    assert np.array_equal(allowed, problem.actions.allowed_moves(pose)) and not allowed.all()
    assert mask[n * moves : -2].all() and mask[-2:].tolist() == [True, False]
    most = problem.settings.max_records
    for records, least, ends in ((2, 3, [1, 0]), (3, 3, [1, 1]), (most, 99, [0, 1])):
        assert form.mask(pose, records=records, least=least)[-2:].tolist() == ends
    limited = Problem.of(planar(3), DiagnosisSettings(max_moved=1, max_excited=1))
    form = PolicyForm(limited)
    assert form.nvec.tolist() == [*limited.actions.nvec[:-1].tolist(), 2]
    mask = form.mask(np.zeros(3), records=0)
    # One move of one joint, then one level of one joint, which is never none.
    assert mask[: form.nvec[0]].all() and not mask[form.nvec[0]]


def test_what_it_sees_lies_in_its_space(problem: Problem) -> None:
    form = PolicyForm(problem, further=2)
    env = DiagnosisEnv(planar(2), DiagnosisSettings())
    observation, _ = env.reset(seed=3)
    for p in (np.eye(5)[1], np.full(5, 0.2)):
        seen = form.features(observation, p, np.array([99.0, -0.5]))
        assert form.observation_space.contains(seen)
        assert seen[:5] == pytest.approx(p)
        assert seen[-2:] == pytest.approx([5.0, -0.5])
    with pytest.raises(InvalidData, match="shows 2 numbers"):
        form.features(observation, np.full(5, 0.2))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_weights_choose_as_the_model_that_they_were_written_from(
    problem: Problem, tmp_path: Path, algorithm: str
) -> None:
    model = write_policy(problem, tmp_path, algorithm)
    form = PolicyForm(problem, Tracker(problem).feature_size)
    network = load_network(tmp_path, form)
    rng = np.random.default_rng(0)
    chosen = set()
    for k in range(30):
        seen = rng.normal(size=form.observation_space.shape).astype(np.float32)
        pose = rng.uniform(-3.0, 3.0, problem.arm.n)
        mask = form.mask(pose, records=k % 13)
        choice = network.choose(seen, mask)
        masks = {"action_masks": mask} if algorithm == "maskable_ppo" else {}
        wanted, _ = model.predict(seen, deterministic=True, **masks)
        assert np.array_equal(choice, np.ravel(wanted))
        chosen.add(tuple(choice))
    assert len(chosen) > 5


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_loaded_policy_plays_and_shows_its_probabilities(
    problem: Problem, tmp_path: Path, algorithm: str
) -> None:
    write_policy(problem, tmp_path, algorithm)
    agent = LearnedAgent.load(problem, tmp_path)

    def rows(width: int, records: int | None = None) -> list[EpisodeRow]:
        given: dict[str, Any] = {"episodes": 4, "seed": 3, "width": width, "records": records}
        return evaluate(agent, "learned", problem.arm, problem.settings, **given)

    first = rows(4)
    assert first == rows(1)
    assert all(row.verdict in problem.verdicts for row in first)
    assert all(len(row.trail_truth) == row.records for row in first)
    assert {row.records for row in rows(4, records=2)} == {2}


def test_weights_for_another_arm_are_refused(problem: Problem, tmp_path: Path) -> None:
    write_policy(problem, tmp_path)
    with pytest.raises(InvalidData, match="trained for arm 'planar2', not 'vera'"):
        LearnedAgent.load(Problem.of(vera(), DiagnosisSettings()), tmp_path)
    other = Problem.of(planar(2), DiagnosisSettings(durations=(0.2,)))
    with pytest.raises(InvalidData, match=r"it has \d+ options, the problem"):
        LearnedAgent.load(other, tmp_path)


def test_missing_and_broken_weights_are_refused(problem: Problem, tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match=r"scripts/agents/train\.py"):
        load_network(tmp_path, PolicyForm(problem))
    with pytest.raises(InvalidData, match=r"scripts/agents/train\.py --export"):
        LearnedAgent.load(problem, tmp_path)
    write_policy(problem, tmp_path)
    path = tmp_path / "policy.safetensors"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InvalidData, match="no safetensors file"):
        LearnedAgent.load(problem, tmp_path)


def test_the_registry_plays_the_weights_of_the_arm(
    problem: Problem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_policy(problem, tmp_path / f"ppo-{setting_name(problem)}")
    monkeypatch.setenv("LOOSE_ENV_WEIGHTS", str(tmp_path))
    assert isinstance(make_agent("ppo", problem), LearnedAgent)
