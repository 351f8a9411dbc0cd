"""Train a PPO policy on an environment and save it.

Usage: python scripts/train.py --env loose_env/Vera-v0 --records 60000 --out agents/weights/vera
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import loose_env  # noqa: F401  (registers the ids)
from agents.base import Problem
from loose_env.errors import LooseEnvError

HYPERPARAMETERS: dict[str, Any] = {
    "n_steps": 8,
    "batch_size": 128,
    "n_epochs": 8,
    "learning_rate": 1e-3,
    "gamma": 1.0,
    "gae_lambda": 0.95,
    "clip_range": 0.2,
    "ent_coef": 0.003,
}


def configuration_of(options: argparse.Namespace, problem: Problem) -> dict[str, Any]:
    """Everything that the result depends on."""
    return {
        "format": "loose-policy/1",
        "algorithm": "ppo",
        "env": options.env,
        "arguments": json.loads(options.arguments),
        "arm": problem.arm.name,
        "seed": options.seed,
        "records": options.records,
        "num_envs": options.num_envs,
        "hyperparameters": HYPERPARAMETERS,
        "settings": json.loads(json.dumps(asdict(problem.settings), default=dict)),
        "versions": {
            name: __import__(name).__version__
            for name in ("loose_env", "gymnasium", "mujoco", "numpy", "stable_baselines3", "torch")
        },
    }


def train(options: argparse.Namespace) -> None:
    """Train, showing progress, and write weights with their configuration."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecMonitor

    from agents.network import save_network
    from agents.training import TrackedVecEnv

    torch.set_num_threads(1)
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    checkpoint = out / "checkpoint.zip"
    env = gymnasium.make_vec(
        options.env, num_envs=options.num_envs, **json.loads(options.arguments)
    )
    problem = Problem.of(env.arm, env.settings)  # type: ignore[attr-defined]
    configuration = configuration_of(options, problem)
    vec = VecMonitor(TrackedVecEnv(env, problem))  # type: ignore[arg-type]
    vec.seed(options.seed)

    class Progress(BaseCallback):
        """Says how far the training is, and keeps a checkpoint."""

        def __init__(self) -> None:
            super().__init__()
            self.begin = time.perf_counter()
            self.rewards: list[float] = []
            self.success: list[bool] = []

        def _on_step(self) -> bool:
            for info in self.locals["infos"]:
                if "is_success" in info:
                    self.success.append(bool(info["is_success"]))
                    self.rewards.append(float(info["episode"]["r"]))
            return True

        def _on_rollout_end(self) -> None:
            spent = time.perf_counter() - self.begin
            reward, success = np.mean(self.rewards[-500:]), np.mean(self.success[-500:])
            print(
                f"{self.num_timesteps:7d} of {options.records} steps  {spent:5.0f} s  "
                f"{len(self.success):6d} episodes  success {success:.3f}  return {reward:+.3f}",
                flush=True,
            )
            beside = checkpoint.with_suffix(".part.zip")
            self.model.save(beside)
            beside.replace(checkpoint)
            save_network(self.model, out)

    described = out / "configuration.json"
    if checkpoint.exists() and not options.restart:
        before = json.loads(described.read_text(encoding="utf-8"))
        differ = sorted(
            key for key in configuration if key != "records" and configuration[key] != before[key]
        )
        if differ:
            raise ValueError(
                f"{out} holds a run with other {', '.join(differ)}; choose another --out, or "
                "--restart to begin anew"
            )
        model = PPO.load(checkpoint, env=vec)
        print(f"resumed from {checkpoint} at {model.num_timesteps} steps")
        vec.seed(options.seed + 1000 * model.num_timesteps)  # faults it has not met
    else:
        model = PPO(
            "MlpPolicy",
            vec,
            seed=options.seed,
            policy_kwargs={"net_arch": [64, 64]},
            **HYPERPARAMETERS,
        )
        _prefer_measuring(model)
    _write(described, json.dumps(configuration, indent=1) + "\n")
    left = options.records - model.num_timesteps
    if left > 0:
        model.learn(left, callback=Progress(), reset_num_timesteps=False)
    save_network(model, out)
    env.close()


def _write(path: Path, text: str) -> None:
    """Write beside, then rename."""
    beside = path.with_suffix(".part")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)


def _prefer_measuring(model: Any) -> None:
    """Start with a policy that seldom stops: early verdicts are mostly wrong and teach little."""
    import torch

    with torch.no_grad():
        model.policy.action_net.bias[-1] -= 1.5


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the options and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="loose_env/Vera-v0", help="environment id")
    parser.add_argument("--arguments", default="{}", help="its arguments, as JSON")
    parser.add_argument("--records", type=int, default=60_000, help="environment steps in all")
    parser.add_argument("--num-envs", type=int, default=64, help="arms side by side")
    parser.add_argument("--seed", type=int, default=1, help="seed of policy and environments")
    parser.add_argument("--out", default="runs/ppo", help="folder of the result")
    parser.add_argument("--restart", action="store_true", help="ignore an earlier checkpoint")
    options = parser.parse_args(arguments)
    try:
        train(options)
    except (LooseEnvError, gymnasium.error.Error, ValueError, OSError) as error:
        sys.exit(f"train: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted; run the same command again to go on from the checkpoint")


if __name__ == "__main__":
    main()
