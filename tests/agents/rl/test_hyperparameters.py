"""Hyperparameter files and words as the rl-zoo writes them."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("sb3_contrib")
pytest.importorskip("yaml")

from loose_agents.rl.end_to_end.training import LEARNERS
from loose_agents.rl.hyperparameters import (
    HYPERPARAMETERS,
    LinearSchedule,
    key_values,
    model_arguments,
    read_hyperparameters,
)

from loose_env.errors import InvalidSetting, LooseEnvError, UnknownName
from loose_env.registration import IDS


@pytest.mark.parametrize("algorithm", ["ppo", "ppo_lstm", "maskable_ppo"])
@pytest.mark.parametrize("env_id", [*IDS, "somebody/Else-v0"])
def test_hyperparameters_ship_for_every_environment(algorithm: str, env_id: str) -> None:
    given = read_hyperparameters(HYPERPARAMETERS / f"{algorithm}.yml", env_id)
    found = model_arguments(given, algorithm)
    assert isinstance(found["learning_rate"], LinearSchedule)
    assert "n_timesteps" not in found
    assert isinstance(found["policy_kwargs"], dict)


@pytest.mark.parametrize("name", list(LEARNERS))
def test_the_files_of_the_learners_fit_their_algorithms(name: str) -> None:
    learner = LEARNERS[name]
    given = read_hyperparameters(HYPERPARAMETERS / f"{learner.file}.yml", "loose_env/Planar-v0")
    found = model_arguments(given, learner.algorithm)
    assert found["gamma"] == 1.0
    assert given["n_timesteps"] >= 6e4
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
    assert found["policy_kwargs"] == {
        "activation_fn": nn.ReLU,
        "net_arch": {"pi": [32], "vf": [64]},
    }
    with pytest.raises(UnknownName, match="no entry"):
        read_hyperparameters(path, "loose_env/Planar-v0")


@pytest.mark.parametrize("content", ["a: [1", "- 1", "default: 3"])
def test_broken_hyperparameter_files_are_refused_in_one_line(tmp_path: Path, content: str) -> None:
    path = tmp_path / "ppo.yml"
    path.write_text(content)
    with pytest.raises(LooseEnvError) as caught:
        read_hyperparameters(path, "loose_env/Vera-v0")
    assert "\n" not in str(caught.value)


def test_words_of_the_command_line_are_read_and_not_run(tmp_path: Path) -> None:
    found = key_values(
        ["a:1e-3", "b:[1, 2]", "c:dict(d='e:f')", 'engine:"reduced"', "hold:brake", "f:-1"], "-p"
    )
    assert found == {
        "a": 1e-3,
        "b": [1, 2],
        "c": {"d": "e:f"},
        "engine": "reduced",
        "hold": "brake",
        "f": -1,
    }
    mark = tmp_path / "mark"
    with pytest.raises(InvalidSetting):
        key_values([f"a:open({str(mark)!r}, 'w')"], "-p")
    assert not mark.exists()
