"""Out-of-distribution episodes: a test of whether agents abstain when they should.

Two faults at once, a mismatch three times as large, an arm of other lengths and masses, a load
that presses every loose seat against its stop. None of them is used in any training.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

import loose_env
from loose_agents.benchmark.sharded import problem_of
from loose_agents.core.base import Problem
from loose_agents.evaluation.evaluate import evaluate
from loose_agents.execution.shards import Shard
from loose_agents.registry import make_agent
from loose_env.arms import MismatchDraw
from loose_env.envs import BatchRig
from loose_env.errors import UnknownName
from loose_env.faults import SEVERAL_FAULTS, Fault
from loose_env.rig import Job, Measurement, ReducedRig, SimulatedRig

__all__ = ["UNLIKE", "OtherArmRig", "UnlikeTask", "play_unlike"]

UNLIKE: dict[str, tuple[str, Mapping[str, Any]]] = {
    "trained": ("as trained", {}),
    "several": ("two faults at once", {"fault": SEVERAL_FAULTS}),
    "mismatch": ("three times the mismatch", {"mismatch_scale": 3.0}),
    "other": ("lengths and masses 15 % off", {}),
    "preload": ("1 g of preload", {"preload_g": 1.0}),
}
"""Kinds of episodes: what each is in a few words, and its options."""

OFF = 0.15
"""Relative deviation of each length and mass of another arm, up or down."""


class OtherArmRig:
    """Rig whose arms deviate from nominal in lengths and masses beyond the mismatch.

    Each body is longer or shorter, and heavier or lighter, by one share. Which of the two is
    drawn from the mismatch of the arm, so it takes nothing from any other draw.

    Parameters
    ----------
    rig : BatchRig
        What measures.
    off : float
        The share.
    """

    def __init__(self, rig: BatchRig, off: float = OFF) -> None:
        self.rig, self.off = rig, off
        self._arm = rig.arm  # type: ignore[attr-defined]

    def mount(self, slot: int, fault: Fault, mismatch: MismatchDraw | None = None) -> None:
        """Put a new arm into a slot."""
        draw = MismatchDraw.none(self._arm) if mismatch is None else mismatch
        own = np.random.default_rng(draw.sensor.ravel().view(np.uint64))
        length, mass = 1 + self.off * own.choice([-1.0, 1.0], (2, len(draw.length)))
        self.rig.mount(
            slot, fault, replace(draw, length=draw.length * length, mass=draw.mass * mass)
        )

    def measure_many(self, jobs: Sequence[Job]) -> list[Measurement]:
        """Take one measurement on each of several slots."""
        return self.rig.measure_many(jobs)


@dataclass(frozen=True, kw_only=True)
class UnlikeTask:
    """Serialisable description of out-of-distribution episodes for one agent."""

    kind: str
    """One of `UNLIKE`."""
    agent: str
    """Name of the agent."""
    env_id: str
    """Id of the environment."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment."""
    seed: int
    """Seed of the episodes."""
    width: int = 32
    """Arms side by side; no row depends on it."""

    def __post_init__(self) -> None:
        """Check the kind."""
        if self.kind not in UNLIKE:
            raise UnknownName(f"unknown kind of episode {self.kind!r}; kinds are {list(UNLIKE)}")

    @property
    def configuration(self) -> dict[str, Any]:
        """Return every setting that determines the rows."""
        named = asdict(self)
        del named["width"]
        return {**named, "version": loose_env.__version__}

    def problem(self) -> Problem:
        """Build the problem; the reduced engine is used only for faults it supports."""
        arguments = dict(self.arguments)
        if self.kind == "several":
            arguments["engine"] = "mujoco"
        return problem_of(self.env_id, arguments)


def play_unlike(task: UnlikeTask, shard: Shard) -> list[dict[str, Any]]:
    """Play the episodes of a shard; return their rows as dictionaries."""
    problem = task.problem()
    width = min(task.width, len(shard))
    rows = evaluate(
        make_agent(task.agent, problem),
        task.agent,
        problem.arm,
        problem.settings,
        episodes=len(shard),
        first=shard.start,
        seed=task.seed,
        width=width,
        threads=1,
        rig=_rig(problem, width) if task.kind == "other" else None,
        options=UNLIKE[task.kind][1],
    )
    return [{"kind": task.kind, **asdict(row)} for row in rows]


def _rig(problem: Problem, slots: int) -> OtherArmRig:
    sensors = problem.settings.sensors
    if problem.settings.engine == "reduced":
        return OtherArmRig(ReducedRig(problem.arm, slots=slots, sensors=sensors))
    return OtherArmRig(SimulatedRig(problem.arm, slots=slots, sensors=sensors, threads=1))
