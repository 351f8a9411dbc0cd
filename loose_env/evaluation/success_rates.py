"""Success rates of a comparison, as numbers, as a table and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from loose_env.errors import InvalidData, UnknownName
from loose_env.evaluation.intervals import (
    Interval,
    arm_of,
    bootstrap_mean,
    paired_difference,
)
from loose_env.faults import UNSURE

Row = Mapping[str, Any]
"""Outcome of one episode: agent, seed, truth, verdict, success, link_success, poses, records,
seconds, reward and truncated. ``episode`` may stand beside or in place of ``seed``; tables that
divide the episodes also take difficulty and friction_ratio, calibration the trails."""

_LEVEL = 0.95
_SIGNIFICANCE = 0.05  # p-value [1] of the sign test above which a lead is sampling error
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
        """Share of episodes with the right verdict."""
        return self.right / self.episodes


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
        standing = _standing(agent, some)
        if rng is not None:
            columns = {name: [row[name] for row in some] for name in ("records", "reward")}
            standing = replace(
                standing,
                records_interval=bootstrap_mean(columns["records"], rng=rng),
                reward_interval=bootstrap_mean(columns["reward"], rng=rng),
            )
            if reference is not None and agent != reference:
                lead = paired_difference(some, own[reference], rng=rng)
                standing = replace(standing, lead=lead)
        found.append(standing)
    return sorted(found, key=lambda s: (-s.reward, -s.success))


def wilson(right: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share; 0 to 1 without episodes.

    Examples
    --------
    >>> low, high = wilson(16, 20)
    >>> round(low, 2), round(high, 2)
    (0.58, 0.92)
    """
    if of == 0:
        return 0.0, 1.0
    found = stats.binomtest(right, of).proportion_ci(_LEVEL, method="wilson")
    return float(found.low), float(found.high)


def _standing(agent: str, rows: Sequence[Row]) -> Standing:
    right = sum(bool(row["success"]) for row in rows)
    low, high = wilson(right, len(rows))
    named = [row["verdict"] not in _NO_FAULT for row in rows if row["truth"] == "healthy"]
    called = [row["verdict"] == "healthy" for row in rows if row["truth"] != "healthy"]

    def mean(name: str) -> float:
        return float(np.mean([row[name] for row in rows]))

    return Standing(
        agent=agent,
        episodes=len(rows),
        right=right,
        low=low,
        high=high,
        false_alarms=float(np.mean(named)) if named else float("nan"),
        misses=float(np.mean(called)) if called else float("nan"),
        unsure=float(np.mean([row["verdict"] == UNSURE for row in rows])),
        link_success=mean("link_success"),
        poses=mean("poses"),
        records=mean("records"),
        seconds=mean("seconds"),
        reward=mean("reward"),
    )


def who_won(rows: Sequence[Row]) -> list[str]:
    """Say in plain words who earned most, who came next, and who was right more often."""
    best, *others = standings(rows)
    sentences = [
        f"The best by return was {best.agent}: right on {best.right} of {best.episodes} arms"
        f" ({100 * best.success:.0f} %), after {best.records:.1f} records on average."
    ]
    if others:
        followed = [
            f"{s.agent} ({s.right} of {s.episodes}, {s.records:.1f} records)" for s in others
        ]
        ahead = ", ".join(followed[:-1])
        sentences.append(f"Then came {ahead}{' and ' if ahead else ''}{followed[-1]}.")
        sentences.append(_lead(rows, best, others[0]))
    return sentences


def _lead(rows: Sequence[Row], first: Standing, second: Standing) -> str:
    """Compare the two best agents on the arms that both were given (sign test)."""
    own = by_agent(rows)
    left = {arm_of(row): bool(row["success"]) for row in own[first.agent]}
    right = {arm_of(row): bool(row["success"]) for row in own[second.agent]}
    shared = left.keys() & right.keys()
    alone = sum(left[k] and not right[k] for k in shared)
    lost = sum(right[k] and not left[k] for k in shared)
    if not shared:
        return f"{first.agent} and {second.agent} were given different arms."
    if alone == lost:
        return f"Between {first.agent} and {second.agent} there is nothing to choose."
    chance = float(stats.binomtest(alone, alone + lost).pvalue)
    met = (
        f"Where only one of the two best was right, it was {first.agent} on {alone} arms and "
        f"{second.agent} on {lost}:"
    )
    if chance > _SIGNIFICANCE:
        return f"{met} the difference is within sampling error (sign test, p = {chance:.2f})."
    shown = "p < 0.001" if chance < 0.001 else f"p = {chance:.3f}"
    return f"{met} the difference exceeds sampling error (sign test, {shown})."
