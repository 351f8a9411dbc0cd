"""One evaluator for every agent: the same hidden faults, one row an episode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from agents.base import Agent
from loose_env.arms.arm import Arm
from loose_env.envs.episode import BatchRig, EpisodeBatch
from loose_env.envs.settings import DiagnosisSettings

__all__ = ["EpisodeRow", "Summary", "evaluate", "summarise", "wilson_interval"]


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


@dataclass(frozen=True, kw_only=True)
class Summary:
    """How one agent did over many episodes."""

    agent: str
    episodes: int
    success: float
    success_low: float
    success_high: float
    link_success: float
    poses: float
    records: float
    seconds: float
    reward: float
    false_alarms: float
    """Share of healthy arms on which a fault was named."""
    diverged: int


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


def summarise(rows: Sequence[EpisodeRow]) -> Summary:
    """Average the rows of one agent; the success rate has a 95 % Wilson interval."""
    success = np.array([r.success for r in rows])
    low, high = wilson_interval(int(success.sum()), len(rows))
    healthy = [r for r in rows if r.truth == "healthy"]
    alarms = [r.verdict != "healthy" for r in healthy]

    def mean(name: str) -> float:
        return float(np.mean([getattr(r, name) for r in rows]))

    return Summary(
        agent=rows[0].agent,
        episodes=len(rows),
        success=float(success.mean()),
        success_low=low,
        success_high=high,
        link_success=mean("link_success"),
        poses=mean("poses"),
        records=mean("records"),
        seconds=mean("seconds"),
        reward=mean("reward"),
        false_alarms=float(np.mean(alarms)) if alarms else 0.0,
        diverged=sum(r.truncated for r in rows),
    )


def wilson_interval(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a rate.

    Examples
    --------
    >>> [round(x, 3) for x in wilson_interval(90, 100)]
    [0.826, 0.945]
    """
    result = stats.binomtest(hits, trials).proportion_ci(level, method="wilson")
    return float(result.low), float(result.high)


def as_dicts(rows: Sequence[EpisodeRow]) -> list[dict[str, Any]]:
    """Turn rows into dictionaries, for tables and files."""
    return [asdict(r) for r in rows]


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
