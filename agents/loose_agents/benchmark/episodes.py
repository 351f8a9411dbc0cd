"""Tasks and frozen episode sets of the benchmark, in and out of distribution, and play on them.

The hidden set is drawn from the salt of a round, which is committed to by its hash and published
when the round closes: an agent cannot know its arms by heart, as it could those of `SETS` "test".

Out of distribution: two faults at once, a mismatch three times as large, an arm of other lengths
and masses, a load that presses every loose seat against its stop, friction beyond the range,
noisier sensors, less play than drawn, an arm that drifts between records. None is used in any
training.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from loose_agents.base import BENCHMARK_SEED, Agent, Problem
from loose_agents.evaluation import EpisodeRow, evaluate, problem_of
from loose_env.arms import Drift, MismatchDraw
from loose_env.envs import BatchRig, DiagnosisSettings, difficulty_named
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.evaluation import seed_of
from loose_env.faults import SEVERAL_FAULTS, Fault
from loose_env.registration import TIERS
from loose_env.rig import Records, ReducedRig, SimulatedRig, Trials
from loose_env.sensors import SensorSuite
from loose_env.typing import IndexArray

UNLIKE: dict[str, tuple[str, Mapping[str, Any]]] = {
    "trained": ("as trained", {}),
    "several": ("two faults at once", {"fault": SEVERAL_FAULTS}),
    "mismatch": ("three times the mismatch", {"mismatch_scale": 3.0}),
    "other": ("lengths and masses 15 % off", {}),
    "preload": ("1 g of preload", {"preload_g": 1.0}),
    "friction": ("friction of 1 to 3 times the highest", {}),
    "friction_2x": ("twice the friction", {}),
    "noise_2x": ("twice the sensor noise", {}),
    "small_play": ("a quarter of the play", {}),
    "drift": ("zeros and gains drift between records", {}),
}
"""Kinds of episodes: what each is in a few words, and its options."""

STICKIER = 3.0
"""Highest friction of the kind "friction", over the highest that the difficulty draws."""

SCALED: Mapping[str, tuple[str, float]] = {
    "friction_2x": ("friction", 2.0),
    "small_play": ("gap", 0.25),
}
"""Range of the difficulty that a kind multiplies, and the factor."""

NOISIER = 2.0
"""Noise of the sensors of the kind "noise_2x", over the task's."""

DRIFT = Drift(joint_zero=0.2, gain=0.01)
"""Drift of the kind "drift" per record: as much as the default mismatch of a whole arm."""

OFF = 0.15
"""Relative deviation of each length and mass of another arm, up or down."""


class OtherArmRig:
    """Rig whose arms deviate from nominal in lengths and masses beyond the mismatch.

    Each body is longer or shorter, and heavier or lighter, by one share. Which of the two is
    drawn from the mismatch of the arm, so it takes nothing from any other draw.
    """

    def __init__(self, rig: BatchRig, off: float = OFF) -> None:
        self.rig, self.off = rig, off

    def mount_all(
        self, slots: IndexArray, faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        """Put new arms into slots."""
        others = []
        for draw in mismatches:
            own = np.random.default_rng(draw.sensor.ravel().view(np.uint64))
            length, mass = 1 + self.off * own.choice([-1.0, 1.0], (2, len(draw.length)))
            others.append(replace(draw, length=draw.length * length, mass=draw.mass * mass))
        self.rig.mount_all(slots, faults, others)

    def record(self, asked: Sequence[Trials]) -> Iterator[tuple[int, IndexArray, Records]]:
        """Take measurements."""
        return self.rig.record(asked)


def arguments_for(kind: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of the environment for episodes of a kind: MuJoCo where two faults are hidden."""
    return {**arguments, "engine": "mujoco"} if kind == "several" else dict(arguments)


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
    """Play episodes of a kind: `loose_agents.evaluation` with its options."""
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
    rules = problem.settings
    usual = difficulty_named(rules.difficulty)
    if kind == "friction":
        highest = usual.friction[1]
        return replace(rules, difficulty=replace(usual, friction=(highest, STICKIER * highest)))
    if kind in SCALED:
        name, factor = SCALED[kind]
        low, high = getattr(usual, name)
        scaled: dict[str, Any] = {name: (factor * low, factor * high)}
        return replace(rules, difficulty=replace(usual, **scaled))
    return replace(rules, drift=DRIFT) if kind == "drift" else rules


def rig_for(kind: str, problem: Problem, slots: int) -> BatchRig | None:
    """Rig of episodes of a kind; None for the environment's own."""
    if kind not in ("other", "noise_2x"):
        return None
    sensors = problem.settings.sensors
    if kind == "noise_2x":
        sensors = noisier(sensors, NOISIER)
    rig: BatchRig = (
        ReducedRig(problem.arm, slots=slots, sensors=sensors)
        if problem.settings.engine == "reduced"
        else SimulatedRig(problem.arm, slots=slots, sensors=sensors, threads=1)
    )
    return OtherArmRig(rig) if kind == "other" else rig


def noisier(sensors: SensorSuite, factor: float) -> SensorSuite:
    """The same sensors with more noise; an observation's nominal columns stay as they are."""
    encoder, tool = sensors.encoder, sensors.accelerometer
    return replace(
        sensors,
        encoder=replace(
            encoder, noise=factor * encoder.noise, linear_noise=factor * encoder.linear_noise
        ),
        accelerometer=replace(tool, noise_density=factor * tool.noise_density),
    )


TASKS = (*TIERS, "loose_env/Planar-v0", "loose_env/SixAxis-v1")
"""Ids of the tasks, each with its version. The control tier is ``loose_env/Vera-v0`` as it is."""

ENGINE = "reduced"
"""Simulation engine of the episodes; two faults at once need MuJoCo."""

BLOCKS: Mapping[str, Mapping[str, Any]] = MappingProxyType({"rhythm": {"rhythm": True}})
"""Arguments by which an agent gets the block of the observation that it reads; episodes stay the
same."""


@dataclass(frozen=True, kw_only=True)
class EpisodeSet:
    """Frozen episodes: seed and number fix all that is hidden in each."""

    kind: str
    """Kind of the episodes, of `loose_agents.benchmark.episodes.UNLIKE`."""
    words: str
    """What they are."""
    seed: int
    """Their seed."""
    episodes: int
    """How many, from number 0."""


HIDDEN = "hidden"
"""Set whose seed is secret while its round is open."""

ROUNDS = (
    "e76c8d8f25682f5d213e102e5a6c9f8c1dacdda5b06a2f9253b854cdfcc3eef8",
    "0056d0ee1382a169b2a08d8757cbfe11d3c5786e5d70d6c291c91d79297ae01c",
)
"""Commitments to the salts of all rounds, the first round first."""

SETS: Mapping[str, EpisodeSet] = MappingProxyType(
    {
        "test": EpisodeSet(kind="trained", words="as trained", seed=BENCHMARK_SEED, episodes=320),
        HIDDEN: EpisodeSet(kind="trained", words="as trained, of a salt", seed=-1, episodes=320),
        **{
            kind: EpisodeSet(kind=kind, words=words, seed=BENCHMARK_SEED + 1, episodes=80)
            for kind, (words, _) in UNLIKE.items()
            if kind != "trained"
        },
    }
)
"""Sets by name: "test"; the hidden one, seeded by its salt; those out of distribution."""


def set_named(name: str, salt: str = "") -> EpisodeSet:
    """Look up a set; the hidden one is drawn from a salt.

    Raises
    ------
    UnknownName
        If there is no such set.
    InvalidSetting
        If the hidden set has no salt, or another set has one.
    """
    if name not in SETS:
        raise UnknownName(f"unknown set {name!r}; sets are {list(SETS)}")
    if (name == HIDDEN) != bool(salt):
        raise InvalidSetting(
            f"the set {HIDDEN!r} is drawn from a salt, and no other is: got set {name!r}, salt "
            f"{salt!r}; `scripts/submit.py salt` makes one"
        )
    # Not the commitment's own hash, which is public while the round is open.
    return replace(SETS[name], seed=seed_of(f"episodes of {salt}")) if salt else SETS[name]


def commitment_of(salt: str) -> str:
    """Commitment to a salt, 64 hexadecimal digits: its SHA-256."""
    return hashlib.sha256(salt.encode()).hexdigest()


def task_problem(task: str, episodes: EpisodeSet, agent: str | None = None) -> Problem:
    """The problem of a task, with the engine that a set needs and the blocks an agent reads."""
    if task not in TASKS:
        raise UnknownName(f"unknown task {task!r}; tasks are {list(TASKS)}")
    own = BLOCKS.get(agent or "", {})
    return problem_of(task, arguments_for(episodes.kind, {"engine": ENGINE, **own}))
