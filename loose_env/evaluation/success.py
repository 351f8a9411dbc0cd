"""Success of agents: rates, intervals and paired differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData, UnknownName
from loose_env.faults import UNSURE
from loose_env.inference import RESAMPLES, Interval, bootstrap_mean, wilson

Row = Mapping[str, Any]
"""Outcome of one episode: agent, seed, truth, verdict, success, link_success, poses, records,
seconds, reward and truncated. ``episode`` may stand beside or in place of ``seed``; tables that
divide the episodes also take difficulty and friction_ratio, calibration the trails."""

SEPARATOR = "#"
"""Stands between the name of an agent and the number of its training: ``ppo#3``."""
_NO_FAULT = ("healthy", UNSURE, None)


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Summary of one agent's episodes."""

    agent: str
    episodes: int
    right: int
    """Episodes with the right verdict."""
    low: float
    """Lower end of the 95 % Wilson interval of the success rate."""
    high: float
    """Upper end of the same."""
    link_success: float
    """Share of episodes whose verdict names the right link or joint, whatever the kind."""
    false_alarms: float
    """Share of the healthy arms on which a fault was named; NaN where none was healthy."""
    misses: float
    """Share of the faulty arms that were called healthy; NaN where none was faulty."""
    unsure: float
    """Share of the episodes that ended with the verdict "unsure"."""
    poses: float
    """Mean number of poses measured in."""
    records: float
    """Mean number of records."""
    seconds: float
    """Mean time of excitation [s]."""
    reward: float
    """Mean return."""
    records_interval: Interval | None = None
    """Mean number of records with its 95 % bootstrap interval, where it was asked for."""
    reward_interval: Interval | None = None
    """Mean return with the same."""
    lead: Interval | None = None
    """Mean difference of return to the reference on the same arms; None for the reference."""

    @property
    def success(self) -> float:
        """Share of episodes with the right verdict; NaN without episodes."""
        return self.right / self.episodes if self.episodes else float("nan")


def by_agent(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Sort rows by agent, agents in the order in which they first appear."""
    if not rows:
        raise InvalidData("there are no episodes to report: rows is empty")
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(str(row["agent"]), []).append(row)
    return found


def standings(
    rows: Sequence[Row], *, reference: str | None = None, rng: np.random.Generator | None = None
) -> list[Standing]:
    """Sum up the rows of each agent; the one with the highest mean return comes first.

    Parameters
    ----------
    rows : sequence of Row
        Episodes of all agents.
    reference : str, optional
        Agent whose return the others' is compared with, on the same arms.
    rng : numpy.random.Generator, optional
        Draws the bootstrap; without it there are no intervals of records and return.

    Raises
    ------
    InvalidData
        If there are no episodes, or agents to be compared met different arms.
    UnknownName
        If the reference has no rows.

    Examples
    --------
    >>> base = dict(
    ...     truth="healthy", verdict="healthy", link_success=1, poses=1, records=2, seconds=1.2
    ... )
    >>> rows = [dict(agent="a", success=k > 3, reward=0.5, **base) for k in range(20)]
    >>> best = standings(rows)[0]
    >>> best.success, round(best.low, 2), round(best.high, 2)
    (0.8, 0.58, 0.92)
    """
    own = by_agent(rows)
    if reference is not None and reference not in own:
        raise UnknownName(f"no rows of the reference {reference!r}; agents are {list(own)}")
    found = []
    for agent, some in own.items():
        standing = standing_of(agent, some)
        if rng is not None:
            standing = replace(
                standing,
                records_interval=bootstrap_mean([row["records"] for row in some], rng=rng),
                reward_interval=bootstrap_mean([row["reward"] for row in some], rng=rng),
            )
            if reference is not None and agent != reference:
                lead = paired_difference(some, own[reference], rng=rng)
                standing = replace(standing, lead=lead)
        found.append(standing)
    return sorted(found, key=lambda s: (-s.reward, -s.success))


def standing_of(agent: str, rows: Sequence[Row]) -> Standing:
    """Sum up some episodes of one agent."""
    right = sum(bool(row["success"]) for row in rows)
    low, high = wilson(right, len(rows))
    named = [row["verdict"] not in _NO_FAULT for row in rows if row["truth"] == "healthy"]
    called = [row["verdict"] == "healthy" for row in rows if row["truth"] != "healthy"]
    names = ("link_success", "poses", "records", "seconds", "reward")
    means: dict[str, Any] = {name: _mean([row[name] for row in rows]) for name in names}
    return Standing(
        agent=agent,
        episodes=len(rows),
        right=right,
        low=low,
        high=high,
        false_alarms=_mean(named),
        misses=_mean(called),
        unsure=_mean([row["verdict"] == UNSURE for row in rows]),
        **means,
    )


def _mean(values: Sequence[Any]) -> float:
    return float(np.mean(values)) if values else float("nan")


def arm_of(row: Row) -> tuple[Any, Any, Any]:
    """Key of a hidden arm: difficulty, seed and number of its episode."""
    return row.get("difficulty"), row.get("seed"), row.get("episode")


def paired_values(rows: Sequence[Row], reference: Sequence[Row], name: str) -> NDArray[np.float64]:
    """Differences of a column on the arms that two agents met (N,); else InvalidData."""
    other = {arm_of(row): row for row in reference}
    own = {arm_of(row): row for row in rows}
    if own.keys() != other.keys() or len(own) != len(rows) or len(other) != len(reference):
        raise InvalidData(
            f"only agents that met the same arms are paired: {len(rows)} and {len(reference)} "
            f"rows share {len(own.keys() & other.keys())} arms; play all with the same episodes "
            "and seed"
        )
    changed = [key for key in own if own[key]["truth"] != other[key]["truth"]]
    if changed:
        raise InvalidData(
            f"episode {changed[0]} hides {own[changed[0]]['truth']!r} for one agent and "
            f"{other[changed[0]]['truth']!r} for the other; they were played on different arms"
        )
    return np.array([float(own[key][name]) - float(other[key][name]) for key in own])


def paired_difference(
    rows: Sequence[Row],
    reference: Sequence[Row],
    *,
    rng: np.random.Generator,
    name: str = "reward",
    resamples: int = RESAMPLES,
) -> Interval:
    """Mean difference of a column on the same arms, with its bootstrap interval.

    Arms are resampled, each with what both agents made of it, so that what is easy or hard
    for both cancels.

    Parameters
    ----------
    rows, reference : sequence of mapping
        Episodes of the agent and of the one it is compared with.
    rng : numpy.random.Generator
        Draws the resamples.
    name : str
        Column, the return by default.
    resamples : int
        Number of resamples.

    Examples
    --------
    >>> arms = [dict(seed=1, episode=k, truth="healthy") for k in range(40)]
    >>> better = [dict(arm, reward=0.5 + k % 2) for k, arm in enumerate(arms)]
    >>> worse = [dict(arm, reward=0.0 + k % 2) for k, arm in enumerate(arms)]
    >>> paired_difference(better, worse, rng=np.random.default_rng(0))
    Interval(estimate=0.5, low=0.5, high=0.5)
    """
    return bootstrap_mean(paired_values(rows, reference, name), rng=rng, resamples=resamples)
