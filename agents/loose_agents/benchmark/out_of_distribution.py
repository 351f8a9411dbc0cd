"""Out-of-distribution episodes: a test of whether agents abstain when they should.

Two faults at once, a mismatch three times as large, an arm of other lengths and masses, a load
that presses every loose seat against its stop, friction beyond the range. None of them is used in
any training.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

import loose_env
from loose_agents.benchmark.sharded import problem_of
from loose_agents.core.base import Agent, Problem
from loose_agents.evaluation.evaluate import EpisodeRow, evaluate
from loose_agents.execution.shards import Shard
from loose_agents.registry import make_agent
from loose_env.arms import MismatchDraw
from loose_env.envs import BatchRig, DiagnosisSettings, difficulty_named
from loose_env.errors import UnknownName
from loose_env.faults import SEVERAL_FAULTS, Fault
from loose_env.rig import Job, Measurement, ReducedRig, SimulatedRig

__all__ = [
    "UNLIKE",
    "OtherArmRig",
    "UnlikeTask",
    "arguments_for",
    "evaluate_kind",
    "play_unlike",
    "rig_for",
    "settings_for",
]

UNLIKE: dict[str, tuple[str, Mapping[str, Any]]] = {
    "trained": ("as trained", {}),
    "several": ("two faults at once", {"fault": SEVERAL_FAULTS}),
    "mismatch": ("three times the mismatch", {"mismatch_scale": 3.0}),
    "other": ("lengths and masses 15 % off", {}),
    "preload": ("1 g of preload", {"preload_g": 1.0}),
    "friction": ("friction of 1 to 3 times the highest", {}),
}
"""Kinds of episodes: what each is in a few words, and its options."""

STICKIER = 3.0
"""Highest friction of the kind "friction", over the highest that the difficulty draws."""

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
        return problem_of(self.env_id, arguments_for(self.kind, self.arguments))


def arguments_for(kind: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of the environment for episodes of a kind: MuJoCo where two faults are hidden."""
    return {**arguments, "engine": "mujoco"} if kind == "several" else dict(arguments)


def play_unlike(task: UnlikeTask, shard: Shard) -> list[dict[str, Any]]:
    """Play the episodes of a shard; return their rows as dictionaries."""
    problem = task.problem()
    agent = make_agent(task.agent, problem)
    rows = evaluate_kind(
        agent, task.agent, problem, task.kind,
        episodes=len(shard), first=shard.start, seed=task.seed, width=task.width,
    )  # fmt: skip
    return [{"kind": task.kind, **asdict(row)} for row in rows]


def evaluate_kind(
    agent: Agent,
    name: str,
    problem: Problem,
    kind: str,
    *,
    episodes: int,
    seed: int,
    first: int = 0,
    width: int = 32,
) -> list[EpisodeRow]:
    """Play episodes of a kind: `loose_agents.evaluation.evaluate.evaluate` with its options."""
    width = min(width, episodes)
    return evaluate(
        agent,
        name,
        problem.arm,
        settings_for(kind, problem),
        episodes=episodes,
        first=first,
        seed=seed,
        width=width,
        threads=1,
        rig=rig_for(kind, problem, width),
        options=UNLIKE[kind][1],
    )


def settings_for(kind: str, problem: Problem) -> DiagnosisSettings:
    """Rules by which episodes of a kind are drawn; the agent's problem keeps its own."""
    if kind != "friction":
        return problem.settings
    usual = difficulty_named(problem.settings.difficulty)
    highest = usual.friction[1]
    return replace(
        problem.settings, difficulty=replace(usual, friction=(highest, STICKIER * highest))
    )


def rig_for(kind: str, problem: Problem, slots: int) -> OtherArmRig | None:
    """Rig of episodes of a kind; None for the environment's own."""
    if kind != "other":
        return None
    sensors = problem.settings.sensors
    if problem.settings.engine == "reduced":
        return OtherArmRig(ReducedRig(problem.arm, slots=slots, sensors=sensors))
    return OtherArmRig(SimulatedRig(problem.arm, slots=slots, sensors=sensors, threads=1))
