"""Tune the classical method, or its letter, on training episodes.

Random search: every candidate plays the same training episodes; the best tenth play more.
The seed of the training episodes is never one of the evaluation's.

Usage: python scripts/agents/tune_link_finding.py --env loose_env/Vera-v0 --out
agents/loose_agents/weights
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from loose_agents.benchmark.sharded import problem_of
from loose_agents.core.base import Agent, Problem
from loose_agents.evaluation.env_arguments import arguments_of
from loose_agents.evaluation.evaluate import evaluate
from loose_agents.execution.command import command, option
from loose_agents.execution.progress import ProgressLine
from loose_agents.policies.classical import ClassicalAgent, ClassicalSettings
from loose_agents.policies.link_finding import LinkFindingAgent

from loose_env.arms import MismatchDraw
from loose_env.diagnosis import LinkFindingSettings, Order
from loose_env.envs import BatchRig, EpisodeBatch
from loose_env.faults import Fault
from loose_env.io import Count, write_text
from loose_env.rig import Job, Measurement

TRAINING_SEED = 1
WIDTH = 64


class RememberingRig:
    """A simulated rig that does not simulate the same record twice.

    Candidates that excite the same joint take the same first steps on the same arms; a record
    depends on its arm, pose, excitation and generator alone.
    """

    def __init__(self, rig: BatchRig) -> None:
        self.rig = rig
        self._arms: dict[int, tuple[str, bytes]] = {}
        self._pending: dict[int, tuple[Fault, MismatchDraw | None]] = {}
        self._known: dict[tuple[object, ...], Measurement] = {}

    def mount(self, slot: int, fault: Fault, mismatch: MismatchDraw | None = None) -> None:
        """Remember the arm; it is built when something new is asked of it."""
        zero = b"" if mismatch is None else mismatch.joint_zero.tobytes()
        self._arms[slot] = (repr(fault), zero)
        self._pending[slot] = (fault, mismatch)

    def measure_many(self, jobs: Sequence[Job]) -> list[Measurement]:
        """Look records up; simulate the rest."""
        keys = [self._key(job) for job in jobs]
        new = [k for k, key in enumerate(keys) if key not in self._known]
        for k in new:
            slot = jobs[k].slot
            if slot in self._pending:
                self.rig.mount(slot, *self._pending.pop(slot))
        if new:
            measured = self.rig.measure_many([jobs[k] for k in new])
            self._known.update(zip((keys[k] for k in new), measured, strict=True))
        return [self._known[key] for key in keys]

    def _key(self, job: Job) -> tuple[object, ...]:
        shake = job.excitation
        state = repr(job.rng.bit_generator.state)
        return (
            *self._arms[job.slot],
            job.pose.tobytes(),
            shake.torque_rms,
            shake.duration,
            state,
        )


Method = Literal["classical", "classical_literal"]


def candidate(joints: int, levels: int, rng: np.random.Generator) -> ClassicalSettings:
    """Draw settings of the classical method, the untuned defaults among the ranges."""
    orders = get_args(Order)
    return ClassicalSettings(
        order=orders[int(rng.integers(len(orders)))],
        in_turn=bool(rng.random() < 0.1),
        falling_level=bool(rng.random() < 0.4),
        duration=2 if rng.random() < 0.8 else 1,
        seen=round(float(np.exp(rng.uniform(np.log(0.3), np.log(6.0)))), 2),
        healthy_poses=int(rng.integers(1, 6)),
        clear=round(float(rng.uniform(2.5, 8.0)), 1),
        outlier=round(float(np.exp(rng.uniform(np.log(8.0), np.log(60.0)))), 1),
        line=round(float(rng.uniform(4.0, 14.0)), 1),
    )


def literal_candidate(joints: int, levels: int, rng: np.random.Generator) -> LinkFindingSettings:
    """Draw settings of the method's letter, the untuned defaults in the middle of the ranges."""
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


Draw = Callable[[int, int, np.random.Generator], Any]
METHODS: Mapping[Method, tuple[Draw, Callable[[Problem, Any], Agent]]] = {
    "classical": (candidate, ClassicalAgent),
    "classical_literal": (literal_candidate, LinkFindingAgent),
}
"""How settings of each method are drawn, and the agent that plays them."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the search."""

    env: str = option("loose_env/Vera-v0", "environment id")
    arguments: str = option("{}", "its arguments, as JSON")
    methods: tuple[Method, ...] = option(get_args(Method), "methods to tune")
    candidates: Count = option(300, "settings to try a method")
    episodes: Count = option(96, "episodes each")
    out: str = option("agents/loose_agents/weights", "folder of the results")


def tune(options: Options) -> None:
    """Search, print the best settings of each method and write them."""
    problem = problem_of(options.env, arguments_of(options.arguments))
    arm = problem.arm
    # The rig of the engine that the arguments name.
    rig = RememberingRig(EpisodeBatch(arm, problem.settings, num=WIDTH).rig)
    for method in options.methods:
        draw, agent = METHODS[method]
        rng = np.random.default_rng([TRAINING_SEED, len(method)])
        tried: list[tuple[float, Any]] = []
        print(method, file=sys.stderr, flush=True)
        with ProgressLine(options.candidates, unit="candidates") as line:
            for _ in range(options.candidates):
                found = draw(arm.n, len(arm.levels), rng)
                score = _score(problem, agent(problem, found), options.episodes, rig)
                tried.append((score, found))
                line.advance(1, f"best return {max(t[0] for t in tried):+.3f}")
        finalists = sorted(tried, key=lambda t: -t[0])[: max(options.candidates // 10, 2)]
        score, winner = max(
            (
                (_score(problem, agent(problem, f), 4 * options.episodes, rig), f)
                for _, f in finalists
            ),
            key=lambda t: t[0],
        )
        print(
            f"{arm.name} {method}: return {score:+.3f} on {4 * options.episodes} training episodes"
        )
        path = Path(options.out) / f"{arm.name}-{method}.json"
        write_text(path, json.dumps(asdict(winner), indent=1) + "\n")


def _score(problem: Problem, agent: Agent, episodes: int, rig: RememberingRig) -> float:
    rows = evaluate(
        agent,
        "",
        problem.arm,
        problem.settings,
        episodes=episodes,
        seed=TRAINING_SEED,
        width=WIDTH,
        rig=rig,
    )
    return float(np.mean([row.reward for row in rows]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Tune, with errors in one line."""
    command("tune_link_finding", __doc__, Options, tune, arguments)


if __name__ == "__main__":
    main()
