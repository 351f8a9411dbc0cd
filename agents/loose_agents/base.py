"""Base classes of agents (`predict`), their problem, hypothesis prior and training seeds."""

from __future__ import annotations

import hashlib
import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm
from loose_env.envs import ActionLayout, DiagnosisSettings, ObservationLayout
from loose_env.errors import InvalidAction, InvalidSetting
from loose_env.faults import UNSURE, hypotheses
from loose_env.typing import Array


def hypothesis_prior(hypotheses: Sequence[str], shares: Mapping[str, float]) -> Array:
    """Prior probability of each hypothesis (H,): its kind's, uniform over locations."""
    kinds = [name.partition("@")[0] for name in hypotheses]
    return np.array([shares.get(kind, 0.0) / kinds.count(kind) for kind in kinds])


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Prior knowledge of an agent: nominal arm, rules and spaces."""

    arm: Arm
    settings: DiagnosisSettings
    linear: LinearArm
    layout: ObservationLayout
    actions: ActionLayout
    hypotheses: tuple[str, ...]

    @classmethod
    def of(cls, arm: Arm, settings: DiagnosisSettings) -> Problem:
        """Describe the problem that an arm and its settings pose."""
        names = hypotheses(arm, settings.kinds)
        return cls(
            arm=arm,
            settings=settings,
            linear=LinearArm(arm),
            layout=ObservationLayout(arm, settings),
            actions=ActionLayout(arm, settings, len(names)),
            hypotheses=names,
        )

    @property
    def fingerprint(self) -> str:
        """Arm, hypotheses, and what observations and actions mean, as 16 hexadecimal digits.

        Two problems may have observations of one size and mean different things by them.
        """
        parts = (
            *(self.arm.name, *self.hypotheses, self.layout.table(), str(self.layout.slots)),
            str(self.actions.nvec.tolist()),
        )
        return hashlib.sha256("\n".join(parts).encode("utf-8")).hexdigest()[:16]

    @property
    def verdicts(self) -> tuple[str, ...]:
        """Verdicts available to an agent: every hypothesis, then "unsure"."""
        return (*self.hypotheses, UNSURE)

    @property
    def stay(self) -> NDArray[np.intp]:
        """Moves that leave every joint where it is (n,)."""
        return np.full(self.arm.n, self.settings.stay, dtype=np.intp)

    def random_moves(self, pose: Array, rng: np.random.Generator) -> NDArray[np.intp]:
        """Draw an allowed move of every joint (n,)."""
        allowed = self.actions.allowed_moves(pose)
        return np.array([rng.choice(np.flatnonzero(row)) for row in allowed])

    def verdict(self, named: str) -> NDArray[np.int64]:
        """Build the action that declares a hypothesis, or "unsure"."""
        return self.actions.encode(verdict=1 + self.verdicts.index(named))


def code_of(layout: ActionLayout, action: Any) -> str:
    """Write an action as its number among all actions, in base 36."""
    layout.decode(action)
    number = 0
    for entry, choices in zip(np.asarray(action).tolist(), layout.nvec.tolist(), strict=True):
        number = number * choices + int(entry)
    return str(np.base_repr(number, 36)).lower()


def action_of(layout: ActionLayout, code: str) -> NDArray[np.int64]:
    """Read an action that `code_of` wrote.

    Raises
    ------
    InvalidAction
        If it stands for no action.
    """
    try:
        number = int(code, 36)
    except ValueError:
        number = -1
    entries = []
    for choices in layout.nvec[::-1].tolist():
        number, entry = divmod(number, choices)
        entries.append(entry)
    if number != 0:
        raise InvalidAction(
            f"{code!r:.40} is not the number of an action, in base 36: there are "
            f"{math.prod(layout.nvec.tolist())} actions"
        )
    return np.array(entries[::-1], dtype=np.int64)


class Agent(Protocol):
    """Protocol of an agent: ``predict``, as in stable-baselines3."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions for observations (num, size), passing the state through."""
        ...


class EpisodeAgent(ABC):
    """Agent with a separate state for every episode.

    Subclasses define the state of a new episode and the action for one observation and state.
    ``predict`` takes one observation or many, with one state an episode in ``state``.
    """

    def __init__(self, problem: Problem, *, seed: int = 0) -> None:
        self.problem = problem
        self.seed = seed

    @abstractmethod
    def begin(self, rng: np.random.Generator) -> Any:
        """Return the initial state of an episode."""

    @abstractmethod
    def act(self, observation: NDArray[np.float32], memory: Any) -> NDArray[np.int64]:
        """Choose an action; may update the state in place."""

    def predict(
        self,
        observation: Any,
        state: Sequence[Any] | None = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose an action for one observation (size,) or for several (num, size)."""
        rows = np.atleast_2d(np.asarray(observation))
        num = len(rows)
        memories = list(state) if state is not None else [None] * num
        starts = (
            np.full(num, state is None) if episode_start is None else np.atleast_1d(episode_start)
        )
        for i, row in enumerate(rows):
            if starts[i] or memories[i] is None:
                memories[i] = self.begin(self._generator(row))
        chosen = np.array(self.act_all(rows, memories))
        return chosen if np.ndim(observation) == 2 else chosen[0], memories

    def act_all(
        self, observations: NDArray[np.float32], memories: Sequence[Any]
    ) -> Sequence[NDArray[np.int64]]:
        """Choose an action for each of several episodes; they do not depend on each other."""
        return [self.act(row, memory) for row, memory in zip(observations, memories, strict=True)]

    def _generator(self, first: NDArray[np.float32]) -> np.random.Generator:
        """Seed an episode's own generator from its first observation.

        So an episode goes the same way wherever in a batch it runs.
        """
        return np.random.default_rng([self.seed, zlib.crc32(first.tobytes())])


EVALUATION_SEEDS = range(20_260_000, 20_260_100)
"""Seeds of episodes that no training, tuning or record bank may use."""
EVALUATION_SEED = EVALUATION_SEEDS[0]
"""Seed of the episodes that published comparisons are played on."""
CURVE_SEED = EVALUATION_SEEDS[50]
"""Seed of the episodes that learning curves are measured on, apart from the comparisons'."""
BENCHMARK_SEED = EVALUATION_SEEDS[60]
"""Seed of the benchmark's test set; those of its further sets follow."""
TUNING_SEED = 20_080_000
"""Seed of the episodes on which stopping thresholds are tuned."""
BANK_SEED = 19_950_000
"""Seed of the episodes of record banks."""
BANK_ACTIONS = 16
"""Stream of an episode for random actions, beyond those the environment uses."""


def check_training_seed(seed: int) -> int:
    """Return a seed for training; refuse evaluation seeds."""
    if seed in EVALUATION_SEEDS:
        raise InvalidSetting(
            f"seed {seed} is one of those kept for evaluation, {EVALUATION_SEEDS[0]} to "
            f"{EVALUATION_SEEDS[-1]}; train with another"
        )
    return seed
