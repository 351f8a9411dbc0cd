"""How the agents stand after a comparison, as numbers, as a table and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from loose_env.errors import InvalidData

__all__ = ["Row", "Standing", "by_agent", "standings", "table_of", "who_won"]

Row = Mapping[str, Any]
"""How one episode went: agent, seed, truth, verdict, success, link_success, poses, records,
seconds, reward and truncated. ``episode`` may stand beside or in place of ``seed``."""

_LEVEL = 0.95
_CHANCE = 0.05  # above this, a lead may well be luck


@dataclass(frozen=True, kw_only=True)
class Standing:
    """How one agent did."""

    agent: str
    episodes: int
    right: int
    """Episodes with the right verdict."""
    low: float
    """Lower end of the 95 % Wilson interval of the success rate."""
    high: float
    """Upper end of the same."""
    link_success: float
    """Share of episodes in which the right place was named, whatever the kind."""
    poses: float
    """Mean number of poses measured in."""
    records: float
    """Mean number of records."""
    seconds: float
    """Mean time of excitation [s]."""
    reward: float
    """Mean return."""

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


def standings(rows: Sequence[Row]) -> list[Standing]:
    """Sum up the rows of each agent; the one with the highest mean return comes first.

    Examples
    --------
    >>> base = dict(link_success=1, poses=1, records=2, seconds=1.2, reward=0.5)
    >>> rows = [dict(agent="a", success=k > 3, **base) for k in range(20)]
    >>> best = standings(rows)[0]
    >>> best.success, round(best.low, 2), round(best.high, 2)
    (0.8, 0.58, 0.92)
    """
    found = []
    for agent, own in by_agent(rows).items():
        right = sum(bool(row["success"]) for row in own)
        interval = stats.binomtest(right, len(own)).proportion_ci(_LEVEL, method="wilson")
        means = {
            name: float(np.mean([row[name] for row in own]))
            for name in ("link_success", "poses", "records", "seconds", "reward")
        }
        found.append(
            Standing(
                agent=agent,
                episodes=len(own),
                right=right,
                low=float(interval.low),
                high=float(interval.high),
                **means,
            )
        )
    return sorted(found, key=lambda s: (-s.reward, -s.success))


def table_of(found: Sequence[Standing]) -> list[dict[str, str]]:
    """Write the standings as rows of a table, one an agent."""
    return [
        {
            "Agent": s.agent,
            "Right": f"{100 * s.success:.0f} %",
            "95 % interval": f"{100 * s.low:.0f} to {100 * s.high:.0f} %",
            "Poses": f"{s.poses:.1f}",
            "Records": f"{s.records:.1f}",
            "Return": f"{s.reward:.2f}".replace("-", "−"),
        }
        for s in found
    ]


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
    left = {_arm(row): bool(row["success"]) for row in own[first.agent]}
    right = {_arm(row): bool(row["success"]) for row in own[second.agent]}
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
    if chance > _CHANCE:
        return f"{met} such a difference may well be luck (sign test, p = {chance:.2f})."
    shown = "p < 0.001" if chance < 0.001 else f"p = {chance:.3f}"
    return f"{met} luck alone would hardly do that (sign test, {shown})."


def _arm(row: Row) -> tuple[Any, Any]:
    return row.get("seed"), row.get("episode")
