"""Times a step of loose_env/Gap-v0 under greedy: processor time, with its stopping.

Usage: python scripts/model_gap/step_time.py --episodes 20
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.execution.command import add_options, new_parser, option, options_of
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.policies.model_gap import make_gap_agent

from loose_env.io import Count
from scripts.model_gap.play import COUNTS, EVALUATION_SEED, made


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the timing."""

    episodes: Count = option(20, "episodes")
    seed: int = option(EVALUATION_SEED + 3, "seed of the machines")


def main() -> None:
    """Time by the options of the command line."""
    with errors_in_one_line("step_time"):
        parser = new_parser(__doc__)
        add_options(parser, Options)
        options = options_of(Options, parser.parse_args())
        took = times(options)
    every = [t for own in took for t in own]
    print(
        f"{len(every)} motions of {len(took)} episodes: median {np.median(every):.2f} s, "
        f"mean {np.mean(every):.2f} s, largest {max(every):.2f} s of one core"
    )
    for number in range(max(map(len, took))):
        own = [each[number] for each in took if len(each) > number]
        print(f"motion {number + 1}: median {np.median(own):.2f} s of {len(own)}")


def times(options: Options) -> list[list[float]]:
    """Processor time of each motion of each episode [s]."""
    env, took = made(), []
    agent = make_gap_agent("greedy", env)
    env.reset(seed=options.seed)
    env.step(0)  # what is computed once
    for number in range(options.episodes):
        hidden = {"count": COUNTS[number % len(COUNTS)]}
        observation, _ = env.reset(seed=options.seed + 1000 * number, options=hidden)
        state, over = None, False
        own: list[float] = []
        while not over:
            action, state = agent.predict(observation, state, np.array([not own]))
            begun = time.process_time()
            observation, _, ended, cut, _ = env.step(action)
            over = ended or cut
            if int(action) < len(env.motions):
                own.append(time.process_time() - begun)
        took.append(own)
    return took


if __name__ == "__main__":
    main()
