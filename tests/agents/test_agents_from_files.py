"""Learned policies, their weights, and agents from outside: classes, model files, folders."""

from __future__ import annotations

import io
import json
import shutil
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loose_agents.base import EpisodeAgent, Problem
from loose_agents.belief import Tracker
from loose_agents.evaluation import EpisodeRow, diagnosis_env, evaluate
from loose_agents.registry import content_of, describe, is_outside, make_agent
from loose_agents.rl.agents import CONFIGURATION, LearnedAgent, PolicyForm
from loose_agents.rl.model_files import TRAINED_ON
from loose_agents.rl.networks import FORMAT, load_network, network_of, save_network
from loose_agents.sharded_play import EvaluationTask, evaluate_shard
from loose_agents.stored import OWN_WEIGHTS, WEIGHTS, tuned, weights_digest, weights_path

from loose_env.arms import planar, vera
from loose_env.envs import DiagnosisEnv, DiagnosisSettings, DiagnosisVectorEnv
from loose_env.errors import InvalidData, UnknownName

pytest.importorskip("safetensors")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem.of(planar(2), DiagnosisSettings(engine="reduced"))


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


SETTINGS = DiagnosisSettings(durations=(0.1,), max_records=2)


class Healthy(EpisodeAgent):
    """Says healthy, a class as a user would write it."""

    def begin(self, rng: np.random.Generator) -> Any:
        return None

    def act(self, observation: Any, memory: Any) -> Any:
        return self.problem.verdict("healthy")


class Shaker:
    """Excites joint 1, a policy as a user would write it."""

    def __init__(self, problem: Problem, *, seed: int = 0) -> None:
        self.problem = problem

    def choose(self, situation: Any) -> Any:
        return self.problem.actions.encode(levels=np.eye(self.problem.arm.n, dtype=int)[0])


class Silent:
    """Predicts nothing."""

    def __init__(self, problem: Problem, *, seed: int = 0) -> None: ...


@pytest.fixture(scope="module")
def small() -> Problem:
    return Problem.of(planar(2), SETTINGS)


def trained(path: Path, name: str) -> Any:
    """Save an untrained model of the environment's own observation."""
    pytest.importorskip("stable_baselines3")
    from loose_agents.rl.hyperparameters import algorithm_named

    from loose_env.envs.sb3 import Sb3VecEnv

    vec = Sb3VecEnv(DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=2))
    model = algorithm_named(name)("MlpPolicy", vec, n_steps=4, batch_size=8, seed=3, device="cpu")
    model.save(path)
    return model


@pytest.mark.parametrize("name", ["ppo", "maskable_ppo"])
def test_a_model_file_plays_what_the_model_predicts(
    tmp_path: Path, small: Problem, name: str
) -> None:
    path = tmp_path / "model.zip"
    model = trained(path, name)
    agent = make_agent(str(path), small)
    env = DiagnosisEnv(planar(2), SETTINGS)
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        state, over = None, False
        while not over:
            action, state = agent.predict(observation, state)
            given: dict[str, Any] = {"deterministic": True}
            if name == "maskable_ppo":
                given["action_masks"] = info["action_mask"]
            wanted, _ = model.predict(observation, **given)
            np.testing.assert_array_equal(action, wanted)
            # An untrained policy may measure for ever: the last record ends it.
            observation, _, over, _, info = env.step(action)


def test_a_model_of_another_problem_is_refused(tmp_path: Path, small: Problem) -> None:
    path = tmp_path / "model.zip"
    model = trained(path, "ppo")
    with pytest.raises(InvalidData, match="another arm"):
        make_agent(str(path), Problem.of(planar(3), SETTINGS))
    # VERA's observation and action have the same sizes: what lies beside the model tells.
    (tmp_path / "configuration.json").write_text('{"arm": "planar2"}')
    make_agent(str(path), small)
    with pytest.raises(InvalidData, match="trained on 'planar2'"):
        make_agent(str(path), Problem.of(vera(), SETTINGS))
    (tmp_path / "configuration.json").unlink()
    # Or the model itself.
    setattr(model, TRAINED_ON, small.fingerprint)
    model.save(path)
    make_agent(str(path), small)
    with pytest.raises(InvalidData, match=small.fingerprint):
        make_agent(str(path), Problem.of(vera(), SETTINGS))
    for content in (b"", b"no zip"):
        path.write_bytes(content)
        with pytest.raises(InvalidData, match="no model"):
            make_agent(str(path), small)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("data", "{}")
    path.write_bytes(buffer.getvalue())
    with pytest.raises(InvalidData, match="no policy"):
        make_agent(str(path), small)


def test_a_class_is_made_by_its_name(small: Problem) -> None:
    name = f"{__name__}:Healthy"
    agent = make_agent(name, small)
    action, _ = agent.predict(np.zeros(small.layout.size, dtype=np.float32))
    np.testing.assert_array_equal(action, small.verdict("healthy"))
    assert is_outside(name) and name in describe(name)
    policy = make_agent(f"{__name__}:Shaker", small)
    action, _ = policy.predict(np.zeros(small.layout.size, dtype=np.float32))
    assert small.actions.decode(action).levels.tolist() == [1, 0]
    for wrong in (f"{__name__}:Nobody", "no_such_module:Agent", f"{__name__}:"):
        with pytest.raises(UnknownName, match="module:Class"):
            make_agent(wrong, small)
    with pytest.raises(UnknownName, match="predict"):
        make_agent(f"{__name__}:Silent", small)
    with pytest.raises(UnknownName, match=r"Class\(problem, seed=seed\)"):
        make_agent("pathlib:PurePath", small)


def test_a_folder_of_weights_is_an_agent_and_own_weights_go_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("safetensors")
    usual = Problem.of(vera(), DiagnosisSettings())
    shipped = WEIGHTS / "ppo-vera-default"
    from_folder = make_agent(str(shipped), usual)
    assert type(from_folder) is type(make_agent("ppo", usual))
    shutil.copytree(shipped, tmp_path / "ppo-vera-default")
    (tmp_path / "vera-default.json").write_text('{"stop": {"ppo": 0.6}}', encoding="utf-8")
    assert weights_path("ppo-vera-default") == shipped
    monkeypatch.setenv(OWN_WEIGHTS, str(tmp_path))
    assert weights_path("ppo-vera-default") == tmp_path / "ppo-vera-default"
    assert weights_path("ppo-planar4-default") == WEIGHTS / "ppo-planar4-default"
    assert tuned(usual) == {"stop": {"ppo": 0.6}}


def test_rows_depend_on_what_the_agent_is_made_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "model.zip"
    found = []
    for content in (b"one", b"two"):
        path.write_bytes(content)
        task = EvaluationTask(agent=str(path), env_id="loose_env/Vera-v0", count=1, seed=0)
        found.append(task.configuration)
    assert found[0] != found[1]
    named = EvaluationTask(agent="random", env_id="loose_env/Vera-v0", count=1, seed=0)
    with_shipped = named.configuration
    assert with_shipped["content"] == weights_digest()
    (tmp_path / "vera-default.json").write_text("{}", encoding="utf-8")
    monkeypatch.setenv(OWN_WEIGHTS, str(tmp_path))
    assert named.configuration != with_shipped
    module = tmp_path / "an_agent_of_mine.py"
    module.write_text("class Mine: ...", encoding="utf-8")
    monkeypatch.chdir(tmp_path)  # beside the command, as a user's own
    monkeypatch.setattr("sys.path", list(sys.path))
    outside = content_of("an_agent_of_mine:Mine")
    module.write_text("class Mine: one = 1", encoding="utf-8")
    assert content_of("an_agent_of_mine:Mine") != outside


def test_a_task_is_played_on_the_true_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []

    def play(*given: Any, **named: Any) -> list[Any]:
        seen.append((given[2].name, named["true_arm"].name))
        return []

    monkeypatch.setattr("loose_agents.sharded_play.evaluate", play)
    arguments = {"n_links": 2, "true_arm": replace(planar(2), name="another")}
    monkeypatch.setattr(
        "loose_agents.sharded_play.diagnosis_env",
        lambda env_id, given: diagnosis_env(env_id, arguments),
    )
    task = EvaluationTask(agent="random", env_id="loose_env/Planar-v0", count=1, seed=0)
    evaluate_shard(task, range(1))
    assert seen == [("planar2", "another")]
