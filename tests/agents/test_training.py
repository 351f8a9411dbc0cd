"""The environment of the training: shaping, forced records, masks, what is seen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from loose_agents.base import EVALUATION_SEEDS, Problem
from loose_agents.rl.hyperparameters import (
    HYPERPARAMETERS,
    LinearSchedule,
    key_values,
    model_arguments,
    read_hyperparameters,
)
from loose_agents.rl.networks import RecordSetExtractor, record_set_arguments
from loose_agents.rl.training_env import (
    TrackedVecEnv,
    evaluation_seed,
    log_posterior,
    training_seed,
)
from numpy.typing import NDArray

from loose_env.arms import Arm, planar, scara
from loose_env.envs import DiagnosisSettings, DiagnosisVectorEnv
from loose_env.errors import InvalidSetting, LooseEnvError, UnknownName
from loose_env.registration import IDS

SETTINGS = DiagnosisSettings(durations=(0.2,), max_records=4)


def make(arm: Arm | None = None, *, num: int = 3, **options: Any) -> TrackedVecEnv:
    arm = planar(2) if arm is None else arm
    env = DiagnosisVectorEnv(arm, SETTINGS, num_envs=num)
    vec = TrackedVecEnv(env, Problem.of(arm, SETTINGS), **options)
    vec.seed(5)
    return vec


def choices(vec: TrackedVecEnv, rng: np.random.Generator, stop: bool) -> NDArray[np.int64]:
    drawn = rng.integers(0, vec.form.nvec, size=(vec.num_envs, len(vec.form.nvec)))
    drawn[:, -1] = stop
    return drawn


def test_the_shaping_sums_to_what_the_episode_added_to_the_log_posterior() -> None:
    weight = 0.3
    vec = make(shaping=weight)
    kinds = len(vec.problem.hypotheses)
    seen = vec.reset()
    rng = np.random.default_rng(0)
    sums = np.zeros(3)
    start = seen[:, :kinds].copy()
    ended = 0
    for step in range(12):
        seen, rewards, dones, infos = vec.step(choices(vec, rng, stop=step % 4 == 3))
        sums += rewards
        for i in np.flatnonzero(dones):
            truth = vec.problem.hypotheses.index(infos[i]["fault"])
            last = infos[i]["terminal_observation"][truth]
            gain = log_posterior(last) - log_posterior(start[i, truth])
            unshaped = infos[i]["episode"]["r"]
            assert sums[i] == pytest.approx(unshaped + weight * gain, abs=1e-5)
            sums[i], start[i] = 0.0, seen[i, :kinds]
            ended += 1
    assert ended >= 6


def test_forced_records_forbid_early_stops() -> None:
    vec = make()
    vec.reset()
    vec.least_records = 3
    rng = np.random.default_rng(2)
    lengths = []
    for step in range(12):
        # Later on any number of records will do.
        vec.least_records = 3 if step < 8 else 1
        masks = vec.action_masks()
        _, _, dones, infos = vec.step(choices(vec, rng, stop=True))
        assert np.array_equal(dones, masks[:, -1])
        lengths += [infos[i]["records"] for i in np.flatnonzero(dones)]
    assert lengths == [3] * 6 + [1] * 6


def test_masks_are_those_of_the_policys_choices() -> None:
    vec = make(scara(), num=2)
    vec.reset()
    rng = np.random.default_rng(4)
    n, moves = vec.problem.arm.n, len(SETTINGS.moves)
    ignored = 0
    for _ in range(3):
        masks = np.stack(vec.env_method("action_masks"))
        assert masks.shape == (2, vec.form.nvec.sum())
        for i in range(2):
            episode = vec.diagnosis.batch.episode(i)
            assert episode is not None
            wanted = vec.form.mask(episode.pose, episode.records)
            assert np.array_equal(masks[i], wanted)
            assert np.array_equal(vec.env_method("action_masks", indices=i)[0], masks[i])
        # A masked move is one that the joint would not make.
        drawn = choices(vec, rng, stop=False)
        _, _, dones, infos = vec.step(drawn)
        for i in np.flatnonzero(~dones):
            allowed = masks[i, : n * moves].reshape(n, moves)[np.arange(n), drawn[i, :n]]
            assert np.array_equal(infos[i]["move_ignored"], ~allowed)
            ignored += int((~allowed).sum())
    assert ignored > 0


def test_seeds_of_training_meet_neither_each_other_nor_those_of_evaluation() -> None:
    seeds = [training_seed(seed, steps) for seed in range(20) for steps in range(0, 5120, 512)]
    seeds += [evaluation_seed(seed) for seed in range(20)]
    # Environments count up from a seed; compare's episodes have small seeds.
    assert np.diff(np.sort(seeds)).min() > 10_000
    assert min(seeds) > EVALUATION_SEEDS[-1]
    assert training_seed(1, 512) == training_seed(1, 512)


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    made = gymnasium.make("loose_env/Vera-v0").unwrapped
    yield made
    made.close()


def observations(layout: Any, records: int, *, seed: int = 0, batch: int = 5) -> Any:
    """Observations with so many measured records, of random elements."""
    rng = np.random.default_rng(seed)
    found = rng.normal(size=(batch, layout.size)).astype(np.float32)
    slots = found[:, len(layout.global_elements) :].reshape(batch, layout.slots, -1)
    slots[:, :records, 0] = 1.0
    slots[:, records:] = 0.0
    return torch.from_numpy(found)


def test_order_of_records_and_empty_slots_do_not_matter(env: Any) -> None:
    layout, start = env.layout, len(env.layout.global_elements)
    seen = observations(layout, records=4)
    slots = seen[:, start:].reshape(len(seen), layout.slots, -1)
    order = torch.tensor([7, 2, 0, 9, 3, 1, 4, 5, 6, 8, 10, 11])
    mixed = torch.cat([seen[:, :start], slots[:, order].flatten(1)], 1)
    filled = slots.clone()
    filled[:, 4:, 1:] = 3.0  # elements of slots that are marked empty
    noise = torch.cat([seen[:, :start], filled.flatten(1)], 1)
    torch.manual_seed(0)
    arguments = record_set_arguments(layout)
    names = [each.name for each in layout.slot_elements]
    assert all(names[b] == f"nominal_{names[a]}" for a, b in arguments["pairs"])
    network = RecordSetExtractor(env.observation_space, **arguments)
    network.standardise(seen.numpy())
    wanted = network(seen)
    assert wanted.shape == (5, network.features_dim)
    torch.testing.assert_close(network(mixed), wanted)
    torch.testing.assert_close(network(noise), wanted)
    fewer = observations(layout, records=3)
    assert not torch.allclose(network(fewer), wanted)


@pytest.mark.parametrize(
    ("algorithm", "file"), [("ppo", "ppo"), ("maskable_ppo", "maskable_ppo"), ("ppo", "ppo_set")]
)
def test_hyperparameters_ship_for_every_environment(algorithm: str, file: str) -> None:
    for env_id in (*IDS, "somebody/Else-v0"):
        given = read_hyperparameters(HYPERPARAMETERS / f"{file}.yml", env_id)
        found = model_arguments(given, algorithm)
        assert isinstance(found["learning_rate"], LinearSchedule)
        assert "n_timesteps" not in found and isinstance(found["policy_kwargs"], dict)
        assert found["gamma"] == 1.0 and given["n_timesteps"] >= 4e4
        assert given["n_envs"] * found["n_steps"] % found["batch_size"] == 0


def test_hyperparameter_files_are_read_as_the_zoo_writes_them(tmp_path: Path) -> None:
    from torch import nn

    path = tmp_path / "ppo.yml"
    path.write_text(
        """
loose_env/Vera-v0:
  normalize: False
  n_timesteps: !!float 1e4
  policy: 'MlpPolicy'
  learning_rate: lin_3e-4
  clip_range: 0.1
  ent_coef: 1e-3
  policy_kwargs: "dict(activation_fn=nn.ReLU,
                       net_arch=dict(pi=[32], vf=[64]))"
"""
    )
    given = read_hyperparameters(path, "loose_env/Vera-v0")
    found = model_arguments(given, "ppo")
    assert given["n_timesteps"] == 1e4
    assert found["learning_rate"](0.5) == pytest.approx(1.5e-4)
    assert found["clip_range"] == 0.1
    assert found["ent_coef"] == 0.001
    network = {"activation_fn": nn.ReLU, "net_arch": {"pi": [32], "vf": [64]}}
    assert found["policy_kwargs"] == network
    with pytest.raises(UnknownName, match="no entry"):
        read_hyperparameters(path, "loose_env/Planar-v0")


@pytest.mark.parametrize("content", ["a: [1", "- 1", "default: 3"])
def test_broken_hyperparameter_files_are_refused_in_one_line(tmp_path: Path, content: str) -> None:
    path = tmp_path / "ppo.yml"
    path.write_text(content)
    with pytest.raises(LooseEnvError) as caught:
        read_hyperparameters(path, "loose_env/Vera-v0")
    assert "\n" not in str(caught.value)


def test_words_of_the_command_line_are_read() -> None:
    words = ["a:1e-3", "b:[1, 2]", "c:dict(d='e:f')", 'engine:"reduced"', "hold:brake", "f:-1"]
    found = {"a": 1e-3, "b": [1, 2], "c": {"d": "e:f"}, "engine": "reduced", "hold": "brake"}
    assert key_values(words, "-p") == {**found, "f": -1}
    with pytest.raises(InvalidSetting):
        key_values(["a:open('mark', 'w')"], "-p")
