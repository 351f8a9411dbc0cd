"""Trains maskable PPO on loose_env/Gap-v0, on the belief as observation.

Weights and the learning curve are written every `--every` steps; the same command goes on where it
was stopped.

Usage: python scripts/model_gap/train.py --steps 100000 --out out/gap_ppo
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from loose_env.cli.command import command
from loose_env.envs import ModelGapEnv
from loose_env.io import Count, written_beside
from scripts.model_gap.evaluate import made

CURVE = ("steps", "episodes", "reward", "success", "seconds")
"""Columns of the learning curve: means since the row before."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a training."""

    out: Path = Path("out/gap_ppo")
    """Folder of the weights."""
    steps: Count = 100_000
    """Motions and verdicts to train on, earlier ones included."""
    every: Count = 2_048
    """Steps between two states that are kept."""
    seed: int = 1
    """Seed of the training."""


def train(options: Options, env: ModelGapEnv) -> None:
    """Train from the stored weights on, and store weights and learning curve."""
    import torch
    from loose_agents.rl.gap_policy import MotionPolicy, load_policy
    from sb3_contrib import MaskablePPO

    weights = options.out / "policy.pt"
    model = MaskablePPO(
        MotionPolicy, env, n_steps=min(512, options.every), batch_size=128, n_epochs=8, gamma=1.0,
        ent_coef=0.003, learning_rate=5e-4, seed=options.seed, device="cpu",
        policy_kwargs={
            "layout": env.layout,
            "seconds": env.bank.seconds,
            "prices": env.motion_prices,
        },
    )  # fmt: skip
    if weights.is_file():
        stored = load_policy(weights, model.policy)
        model.policy.optimizer.load_state_dict(stored["optimizer"])
        model.num_timesteps = stored["steps"]
    options.out.mkdir(parents=True, exist_ok=True)
    while model.num_timesteps < options.steps:
        done = model.num_timesteps
        ends = _Ends()
        ahead = min(options.every, options.steps - done)
        model.learn(ahead, reset_num_timesteps=done == 0, callback=ends)
        state = {
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
            "steps": model.num_timesteps,
        }
        written_beside(weights, partial(torch.save, state))
        ends.append(options.out / "curve.csv", model.num_timesteps)
    print(f"written: {weights}")


class _Ends:
    """Results of the episodes that ended, kept by a callback."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float, float]] = []

    def __call__(self, local: dict[str, Any], _: dict[str, Any]) -> bool:
        """Keep the episodes that ended at a step."""
        self.rows += [
            (float(info["episode"]["r"]), float(info.get("is_success", False)), info["seconds"])
            for info in local["infos"]
            if "episode" in info
        ]
        return True

    def append(self, path: Path, steps: int) -> None:
        """Append their means to the learning curve, and print them."""
        means = np.round(np.mean(self.rows, axis=0) if self.rows else np.full(3, np.nan), 4)
        row = list(map(str, (steps, len(self.rows), *means.tolist())))
        begun = path.is_file()
        with path.open("a", encoding="utf-8") as out:
            out.writelines(",".join(line) + "\n" for line in (CURVE, row)[begun:])
        print(*(f"{name} {value}" for name, value in zip(CURVE, row, strict=True)), flush=True)


def run(options: Options) -> None:
    """Train in the environment of the package's arm."""
    train(options, made())


if __name__ == "__main__":
    command("train", __doc__, Options, run, interrupted="the same command goes on")
