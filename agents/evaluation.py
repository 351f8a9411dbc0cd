"""One evaluator for every agent: the same hidden faults, one row an episode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.base import Agent
from loose_env.arms.arm import Arm
from loose_env.envs.episode import BatchRig, EpisodeBatch
from loose_env.envs.settings import DiagnosisSettings

__all__ = ["EpisodeRow", "evaluate"]


@dataclass(frozen=True, kw_only=True)
class EpisodeRow:
    """How one episode went."""

    agent: str
    episode: int
    truth: str
    verdict: str | None
    success: bool
    link_success: bool
    poses: int
    records: int
    seconds: float
    reward: float
    truncated: bool


def evaluate(
    agent: Agent,
    name: str,
    arm: Arm,
    settings: DiagnosisSettings,
    *,
    episodes: int,
    seed: int,
    width: int = 64,
    threads: int = 0,
    rig: BatchRig | None = None,
    progress: Callable[[int], None] | None = None,
    deterministic: bool = True,
) -> list[EpisodeRow]:
    """Play episodes 0 to ``episodes - 1`` of a seed.

    Episode k hides the same fault in the same true arm for every agent, and goes the same way
    at any ``width`` (number of arms side by side) and thread count.
    """
    width = min(width, episodes)
    batch = EpisodeBatch(arm, settings, num=width, threads=threads, rig=rig)
    rows: dict[int, EpisodeRow] = {}
    running: dict[int, int] = {}  # slot -> episode
    returns: dict[int, float] = {}
    states: dict[int, Any] = {}
    waiting = iter(range(episodes))

    def begin(slot: int) -> None:
        number = next(waiting, None)
        running.pop(slot, None)
        if number is not None:
            batch.start(slot, seed=seed, number=number)
            running[slot], returns[slot], states[slot] = number, 0.0, None

    for slot in range(width):
        begin(slot)
    while running:
        slots = sorted(running)
        observations = np.stack([batch.observe(s) for s in slots])
        starts = np.array([states[s] is None for s in slots])
        actions, after = agent.predict(
            observations, _gather(states, slots), starts, deterministic=deterministic
        )
        _scatter(states, slots, after)
        for slot, outcome in zip(slots, batch.step(slots, list(actions)), strict=True):
            returns[slot] += outcome.reward
            if outcome.terminated or outcome.truncated:
                info = outcome.info
                rows[running[slot]] = EpisodeRow(
                    agent=name,
                    episode=running[slot],
                    truth=info["fault"],
                    verdict=info["verdict"],
                    success=bool(info["is_success"]),
                    link_success=bool(info["link_success"]),
                    poses=info["poses"],
                    records=info["records"],
                    seconds=info["seconds"],
                    reward=returns[slot],
                    truncated=outcome.truncated,
                )
                if progress is not None:
                    progress(len(rows))
                begin(slot)
    return [rows[k] for k in range(episodes)]


def _gather(states: dict[int, Any], slots: Sequence[int]) -> Any:
    """Put the states of the slots together; None where no agent has kept any yet."""
    kept = [states[s] for s in slots]
    return None if all(k is None for k in kept) else [_unwrap(k) for k in kept]


def _scatter(states: dict[int, Any], slots: Sequence[int], after: Any) -> None:
    values = after if after is not None else [None] * len(slots)
    for slot, value in zip(slots, values, strict=True):
        states[slot] = _Kept(value)


@dataclass(frozen=True)
class _Kept:
    """A state that may itself be None, told apart from 'episode not begun'."""

    value: Any


def _unwrap(kept: _Kept | None) -> Any:
    return kept.value if kept is not None else None
