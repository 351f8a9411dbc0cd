"""Tune the classical and the literal link-finding method on training episodes of arms.

Random search by successive halving (Jamieson and Talwalkar 2016): every candidate plays the same
training episodes, and the better third plays on, on as many further ones as doubles what it has
played twice over, until a handful is left. With several arms the return is averaged over them, and
what is found serves arms that were never tuned: the table shows each arm under the settings chosen
without it. The seed of the training episodes is never one of the evaluation's.

Usage: python scripts/agents/tune_link_finding.py --env loose_env/Planar-v0 loose_env/Scara-v1
--methods classical --out agents/loose_agents/weights
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from loose_agents.base import Agent, Problem
from loose_agents.evaluation import arguments_of, evaluate, problem_of
from loose_agents.jobs import ProgressLine
from loose_agents.policies.classical import ClassicalAgent, ClassicalSettings, Level, arm_class
from loose_agents.policies.link_finding import LinkFindingAgent
from loose_agents.registry import classical_settings

from loose_env.cli.command import command
from loose_env.diagnosis import LinkFindingSettings, Order
from loose_env.errors import InvalidSetting
from loose_env.io import Count, write_text
from loose_env.typing import Array

TRAINING_SEED = 1
WIDTH = 64
KEPT = 3
"""One in so many candidates plays on."""
FEW = 8
"""Number of candidates that are all played to the end."""
ANEW = 0.35
"""Probability that a candidate of the classical method has a field drawn anew."""


def play(problem: Problem, agents: Sequence[Agent], first: int, count: int) -> tuple[Array, Array]:
    """Returns and successes (agents, count) of so many training episodes."""
    arm, settings = problem.arm, problem.settings
    played = [
        evaluate(agent, "", arm, settings, episodes=count, seed=TRAINING_SEED, first=first)
        for agent in agents
    ]
    told = np.array([[(row.reward, row.success) for row in rows] for rows in played])
    return told[..., 0], told[..., 1]


Method = Literal["classical", "classical_literal"]


def candidate(problem: Problem, rng: np.random.Generator) -> ClassicalSettings:
    """Draw settings of the classical method: those that ship, with some fields drawn anew."""
    orders, known = get_args(Order), get_args(Level)
    drawn = {
        "order": orders[int(rng.integers(len(orders)))],
        "level": known[int(rng.integers(len(known)))],
        "duration": 2 if rng.random() < 0.8 else 1,
        "significance": round(float(np.exp(rng.uniform(np.log(0.001), np.log(0.05)))), 4),
        "clear": round(float(rng.uniform(2.5, 8.0)), 1),
        "outlier": round(float(np.exp(rng.uniform(np.log(8.0), np.log(60.0)))), 1),
        "line": round(float(rng.uniform(4.0, 14.0)), 1),
        "driven": 0.0 if rng.random() < 0.3 else round(float(rng.uniform(1.0, 12.0)), 1),
    }
    shipped = classical_settings(problem)
    return replace(shipped, **{name: v for name, v in drawn.items() if rng.random() < ANEW})


def literal_candidate(problem: Problem, rng: np.random.Generator) -> LinkFindingSettings:
    """Draw settings of the method's letter, the untuned defaults in the middle of the ranges."""
    joints, levels = problem.arm.n, len(problem.arm.levels)
    return LinkFindingSettings(
        order="outward",
        joint=int(rng.integers(1, joints + 1)),
        level=levels if rng.random() < 0.8 else levels - 1,
        still=float(rng.uniform(0.05, 0.7)),
        turned=float(rng.uniform(0.1, 0.7)),
        retries=int(rng.integers(0, 3)),
        index="e" if rng.random() < 0.5 else "d",
        healthy_index=float(np.exp(rng.uniform(np.log(0.002), np.log(0.5)))),
        healthy_poses=int(rng.integers(1, 4)),
        backlash_angle=float(rng.uniform(2.0, 45.0)),
        backlash_kurtosis=float(rng.uniform(-0.2, 2.0)),
    )


Draw = Callable[[Problem, np.random.Generator], Any]
METHODS: Mapping[Method, tuple[Draw, Callable[[Problem, Any], Agent]]] = {
    "classical": (candidate, ClassicalAgent),
    "classical_literal": (literal_candidate, LinkFindingAgent),
}
"""How settings of each method are drawn, and the agent that plays them."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the search."""

    env: tuple[str, ...] = ("loose_env/Vera-v0",)
    """Environment ids."""
    arguments: str = "{}"
    """Their arguments, as JSON."""
    methods: tuple[Method, ...] = get_args(Method)
    """Methods to tune."""
    candidates: Count = 72
    """Settings to try a method."""
    episodes: Count = 32
    """Episodes that each plays on every arm; the better ones play on."""
    out: str = "agents/loose_agents/weights"
    """Folder of the results."""


def tune(options: Options) -> None:
    """Search, print the best settings of each method and write them."""
    problems = [problem_of(env, arguments_of(options.arguments)) for env in options.env]
    for method in options.methods:
        shared_by(method, problems)  # what is wrong shows now, not after the search
    for method in options.methods:
        print(method, file=sys.stderr, flush=True)
        found, returns, right = halving(method, problems, options)
        chosen = choose(returns, right)
        print(f"{method}: {returns.shape[2]} training episodes an arm")
        print(f"{'arm':10s} {'right %':>8s} {'return':>7s}  {'chosen without it':>17s}")
        for k, problem in enumerate(problems):
            line = f"{100 * right[chosen, k].mean():8.1f} {returns[chosen, k].mean():+7.3f}"
            if len(problems) > 1:
                without = choose(np.delete(returns, k, axis=1), np.delete(right, k, axis=1))
                line += f"  {returns[without, k].mean():+17.3f}"
            print(f"{problem.arm.name:10s} {line}")
        path = Path(options.out) / f"{shared_by(method, problems)}-{method}.json"
        write_text(path, json.dumps(asdict(found[chosen]), indent=1) + "\n")


def shared_by(method: Method, problems: Sequence[Problem]) -> str:
    """Name of what the settings are for: one arm, or classes of arms."""
    if method == "classical":
        return "-".join(sorted({arm_class(problem) for problem in problems}))
    names = sorted({problem.arm.name for problem in problems})
    if len(names) > 1:
        raise InvalidSetting(f"settings of {method} belong to one arm: tune {names} one by one")
    return names[0]


def halving(
    method: Method, problems: Sequence[Problem], options: Options
) -> tuple[list[Any], Array, Array]:
    """Settings that played to the end, their returns and successes (settings, arms, episodes)."""
    draw, make = METHODS[method]
    rng = np.random.default_rng([TRAINING_SEED, len(method)])
    left = [draw(problems[0], rng) for _ in range(options.candidates)]
    if method == "classical":  # nothing is found that is worse than what ships
        left[0] = classical_settings(problems[0])
    returns, right = (np.zeros((len(left), len(problems), 0)) for _ in range(2))
    played, further = 0, options.episodes
    while True:
        parts = []
        with ProgressLine(len(problems), unit="arms") as line:
            for problem in problems:
                agents = [make(problem, settings) for settings in left]
                parts.append(play(problem, agents, played, further))
                line.advance(1, f"{len(left)} candidates, {played + further} episodes")
        more, correct = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
        returns = np.concatenate([returns, more], axis=2)
        right = np.concatenate([right, correct], axis=2)
        played += further
        if len(left) <= FEW:
            return left, returns, right
        best = np.argsort(-returns.mean(axis=(1, 2)), kind="stable")
        best = best[: max(len(left) // KEPT, 2)]
        left, returns, right = [left[k] for k in best], returns[best], right[best]
        further = (KEPT - 1) * played


def choose(returns: Array, right: Array) -> int:
    """Settings most often right among those within a standard error of the best return."""
    best = int(returns.mean(axis=(1, 2)).argmax())
    # Paired, the same episodes; the error of the mean over arms of means over episodes.
    less = returns[best] - returns
    arms, episodes = less.shape[1:]
    error = np.sqrt(less.var(axis=2).sum(axis=1) / episodes) / arms
    near = less.mean(axis=(1, 2)) <= error
    return int(np.argmax(np.where(near, right.mean(axis=(1, 2)), -1.0)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Tune, with errors in one line."""
    command("tune_link_finding", __doc__, Options, tune, arguments)


if __name__ == "__main__":
    main()
