"""Trains maskable PPO on loose_env/Gap-v0, on the belief as observation.

Usage: python -m scripts.model_gap.train --steps 100000 --out out/gap_ppo

The weights, `model.zip`, play with `python -m scripts.model_gap.train --out out/gap_ppo --play 40`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.execution.command import add_options, new_parser, option, options_of
from loose_agents.execution.script_errors import errors_in_one_line

from loose_env.errors import InvalidData
from loose_env.io import Count, NonNegativeCount
from scripts.model_gap.play import COUNTS, EVALUATION_SEED, made


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a training."""

    out: Path = option(Path("out/gap_ppo"), "folder of the weights")
    steps: Count = option(100_000, "motions and verdicts to train on")
    seed: int = option(1, "seed of the training")
    play: NonNegativeCount = option(0, "judging episodes to play stored weights on instead")


def main() -> None:
    """Train, or play what was trained."""
    with errors_in_one_line("train"):
        parser = new_parser(__doc__)
        add_options(parser, Options)
        options = options_of(Options, parser.parse_args())
        if options.play:
            play(options)
        else:
            train(options)


def train(options: Options) -> None:
    """Train and store the weights."""
    from sb3_contrib import MaskablePPO

    model = MaskablePPO(
        "MlpPolicy", made(), n_steps=256, batch_size=64, gamma=1.0, ent_coef=0.01,
        learning_rate=1e-3, seed=options.seed, verbose=1,
    )  # fmt: skip
    model.learn(options.steps)
    options.out.mkdir(parents=True, exist_ok=True)
    model.save(options.out / "model.zip")
    print(f"written: {options.out / 'model.zip'}")


def play(options: Options) -> None:
    """Play judging episodes and print accuracy, machine time and reward."""
    from sb3_contrib import MaskablePPO

    file = options.out / "model.zip"
    if not file.is_file():
        raise InvalidData(f"no weights at {file}: train first, without --play")
    env, model = made(), MaskablePPO.load(file)
    right, seconds, rewards = [], [], []
    for number in range(options.play):
        count = COUNTS[number % len(COUNTS)]
        observation, info = env.reset(
            seed=EVALUATION_SEED + 1000 * number, options={"count": count}
        )
        total, over = 0.0, False
        while not over:
            action, _ = model.predict(
                observation, action_masks=env.action_masks(), deterministic=True
            )
            observation, reward, terminated, truncated, info = env.step(int(action))
            total, over = total + reward, terminated or truncated
        right.append(info.get("success", False))
        seconds.append(info["seconds"])
        rewards.append(total)
    print(
        f"{sum(right)} of {len(right)} right, {np.mean(seconds):.1f} s, "
        f"reward {np.mean(rewards):+.2f}"
    )


if __name__ == "__main__":
    main()
