"""Tables of the value of choice, from the rows of its study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from loose_env.evaluation import Interval, bootstrap_mean
from loose_env.typing import Array

__all__ = ["ADAPTIVE", "BASELINES", "agent_table", "pooled", "value_table"]

ADAPTIVE = "greedy"
"""Adaptive agent whose return is compared."""
BASELINES = {
    "fixed_k": "best fixed sequence without stopping",
    "fixed": "fixed sequence with stopping",
    "open_loop": "open loop",
}
"""What its return is compared with; ``fixed_k`` is the best of fixed_1, fixed_2, ... on the same
episodes, which favours it."""

Pooled = dict[str, dict[str, dict[str, Array]]]
"""Columns of the episodes by tier and agent, episodes in order."""


def pooled(rows: Sequence[dict[str, Any]]) -> Pooled:
    """Join the blocks of episodes of each tier and agent."""
    found: dict[str, dict[str, dict[str, list[float]]]] = {}
    for row in sorted(rows, key=lambda r: int(r["block"])):
        own = found.setdefault(row["tier"], {}).setdefault(row["agent"], {})
        for name in ("reward", "success", "unsure", "records"):
            own.setdefault(name, []).extend(row[name])
    return {
        tier: {
            agent: {name: np.array(values, dtype=float) for name, values in columns.items()}
            for agent, columns in agents.items()
        }
        for tier, agents in found.items()
    }


def agent_table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Success, records and return of every agent, as lines of markdown."""
    lines = [
        "| tier | agent | arms | right % | unsure % | records | return |",
        "|---|---|---|---|---|---|---|",
    ]
    for tier, agents in pooled(rows).items():
        for agent, own in agents.items():
            cells = (
                _short(tier),
                agent,
                str(len(own["reward"])),
                f"{100 * own['success'].mean():.1f}",
                f"{100 * own['unsure'].mean():.1f}",
                f"{own['records'].mean():.2f}",
                _signed(_mean(own["reward"])),
            )
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def value_table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return of the adaptive agent less that of each baseline on the same arms, as markdown."""
    lines = [
        f"| tier | arms | {ADAPTIVE} | {' | '.join(f'V over {w}' for w in BASELINES.values())} |",
        "|---|---|---|" + "---|" * len(BASELINES),
    ]
    for tier, agents in pooled(rows).items():
        if ADAPTIVE not in agents:
            continue
        own = agents[ADAPTIVE]["reward"]
        cells = [_short(tier), str(len(own)), _signed(_mean(own))]
        for name in BASELINES:
            other = _baseline(agents, name)
            paired = other is not None and len(other) == len(own)
            cells.append(_signed(_mean(own - other)) if paired and other is not None else "")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _baseline(agents: dict[str, dict[str, Array]], name: str) -> Array | None:
    """Returns of a baseline; None where it did not play."""
    if name != "fixed_k":
        return agents[name]["reward"] if name in agents else None
    fixed = [own["reward"] for agent, own in agents.items() if agent.startswith("fixed_")]
    return max(fixed, key=lambda reward: float(reward.mean()), default=None)


def _mean(values: Array) -> Interval:
    return bootstrap_mean(values, rng=np.random.default_rng(0))


def _signed(interval: Interval) -> str:
    return f"{interval.estimate:+.3f} ± {interval.half:.3f}"


def _short(tier: str) -> str:
    return tier.removeprefix("loose_env/").removesuffix("-v0")
