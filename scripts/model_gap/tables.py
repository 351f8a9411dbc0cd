"""Tables and curves of the episodes of loose_env/Gap-v0."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from loose_env.envs import GapPrices
from loose_env.evaluation import wilson
from loose_env.typing import Array

__all__ = [
    "GRID",
    "GROUPS",
    "accuracy_at",
    "accuracy_table",
    "best_stopping",
    "calibration_table",
    "confusion_table",
    "curves",
    "of",
    "ratio_table",
    "seconds_for",
    "stopped",
    "stopping_table",
    "time_table",
]

Row = dict[str, Any]
GRID = (1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 18.0, 25.0, 40.0)
"""Machine times of the table [s]."""
GROUPS = (("one effect", 1), ("two effects", 2), ("none", 0))
"""Groups of episodes by the number of hidden effects."""
LEVELS = (0.9, 0.8)
"""Accuracies asked for, of one effect and of two."""
THRESHOLDS = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
"""Probabilities among which the stopping is tuned."""


def accuracy_at(rows: Sequence[Row], seconds: float) -> float:
    """Share of episodes whose most probable set is right after some machine time [s].

    Before its first motion is through, an episode counts as wrong; after its last one as it ended.
    """
    right = []
    for row in rows:
        done = np.searchsorted(row["seconds"], seconds, side="right")
        right.append(row["right"][done - 1] if done else 0)
    return float(np.mean(right)) if right else float("nan")


def of(rows: Sequence[Row], agent: str, effects: int) -> list[Row]:
    """Episodes of an agent with some number of hidden effects, those without failure."""
    return [
        row
        for row in rows
        if row["agent"] == agent and row["effects"] == effects and row["seconds"]
    ]


def agents_in(rows: Sequence[Row]) -> list[str]:
    """Agents, in the order of their rows."""
    return list(dict.fromkeys(row["agent"] for row in rows))


def curves(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Accuracy by machine second, for each agent and number of effects."""
    grid = np.arange(1.0, 91.0, 0.5)
    return [
        {
            "agent": agent,
            "effects": effects,
            "seconds": float(t),
            "accuracy": accuracy_at(own, float(t)),
            "episodes": len(own),
        }
        for agent in agents_in(rows)
        for _, effects in GROUPS
        if (own := of(rows, agent, effects))
        for t in grid
    ]


def accuracy_table(rows: Sequence[Row]) -> list[str]:
    """Accuracy after some machine times."""
    lines = [
        "| agent | hidden | episodes | " + " | ".join(f"{t:g} s" for t in GRID) + " |",
        "|---|---|---|" + "---|" * len(GRID),
    ]
    for words, effects in GROUPS:
        for agent in agents_in(rows):
            own = of(rows, agent, effects)
            if own:
                shares = " | ".join(f"{100 * accuracy_at(own, t):.0f} %" for t in GRID)
                lines.append(f"| {agent} | {words} | {len(own)} | {shares} |")
    return lines


def seconds_for(rows: Sequence[Row], accuracy: float) -> float:
    """Machine time from which accuracy stays at a level or above [s]; NaN if it never does."""
    ends = sorted({s for row in rows for s in row["seconds"]})
    found = float("nan")
    for t in reversed(ends):
        if accuracy_at(rows, t) < accuracy:
            break
        found = t
    return found


def time_table(rows: Sequence[Row]) -> list[str]:
    """Machine times to reach and keep some accuracies."""
    levels = (0.5, 0.7, 0.8, 0.9)
    lines = [
        "| agent | hidden | " + " | ".join(f"{100 * a:.0f} %" for a in levels) + " | in the end |",
        "|---|---|" + "---|" * (len(levels) + 1),
    ]
    for words, effects in GROUPS:
        for agent in agents_in(rows):
            own = of(rows, agent, effects)
            if not own:
                continue
            times = [seconds_for(own, a) for a in levels]
            cells = " | ".join("not reached" if np.isnan(t) else f"{t:.1f} s" for t in times)
            right = sum(row["right"][-1] for row in own)
            low, high = wilson(right, len(own))
            end = f"{100 * right / len(own):.0f} % ({100 * low:.0f} to {100 * high:.0f})"
            lines.append(f"| {agent} | {words} | {cells} | {end} |")
    return lines


def stopped(row: Row, sure: float, prices: GapPrices | None = None) -> dict[str, float]:
    """Right or not, seconds and reward of an episode that stops as its agent does."""
    prices = prices or GapPrices()
    enough = np.array(row["probability"]) >= sure
    if row["agent"] == "greedy":
        enough |= np.array(row["worth"]) <= 0
    enough[-1] = True
    k = int(np.argmax(enough))
    right = bool(row["right"][k])
    verdict = prices.wrong
    if right:
        off = prices.parameter * min(row["parameter_error"][k], 1.0) if row["effects"] else 0.0
        verdict = prices.correct - off
    cost = prices.second * row["seconds"][k] + prices.wear * row["wear"][k]
    return {
        "right": float(right),
        "seconds": row["seconds"][k],
        "reward": verdict - cost,
        "probability": row["probability"][k],
    }


def best_stopping(rows: Sequence[Row]) -> dict[str, float]:
    """Probability of stopping with the largest mean reward, by agent."""
    found = {}
    for agent in agents_in(rows):
        own = [row for row in rows if row["agent"] == agent and row["seconds"]]
        means = [np.mean([stopped(row, p)["reward"] for row in own]) for p in THRESHOLDS]
        found[agent] = THRESHOLDS[int(np.argmax(means))]
    return found


def stopping_table(rows: Sequence[Row], sure: dict[str, float]) -> list[str]:
    """Accuracy, machine time and reward of the agents with their stopping."""
    lines = [
        "| agent | stops at | one effect | two effects | none | machine time | reward |",
        "|---|---|---|---|---|---|---|",
    ]
    for agent in agents_in(rows):
        shares = []
        for _, effects in GROUPS:
            own = [stopped(row, sure[agent]) for row in of(rows, agent, effects)]
            shares.append(f"{100 * np.mean([o['right'] for o in own]):.0f} %" if own else "")
        every = [stopped(r, sure[agent]) for r in rows if r["agent"] == agent and r["seconds"]]
        rewards = np.array([o["reward"] for o in every])
        error = 1.96 * float(rewards.std()) / np.sqrt(len(rewards))
        lines.append(
            f"| {agent} | {_threshold(sure[agent])} | {' | '.join(shares)} | "
            f"{np.mean([o['seconds'] for o in every]):.1f} s | "
            f"{rewards.mean():+.2f} ± {error:.2f} |"
        )
    return lines


def _threshold(sure: float) -> str:
    """Probability that an agent stops at; one above 1 is that of an agent with its own rule."""
    return f"{sure:g}" if sure <= 1 else "its choice"


def ratio_table(rows: Sequence[Row], sure: dict[str, float]) -> list[str]:
    """Machine time of greedy over that of the battery for the accuracies that are asked for."""
    lines = [
        "| hidden | accuracy | battery | greedy | ratio | greedy, stopped | right | ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for (words, effects), level in zip(GROUPS, LEVELS, strict=False):
        chosen, fixed = of(rows, "greedy", effects), of(rows, "battery", effects)
        if chosen and fixed:
            times = seconds_for(fixed, level), seconds_for(chosen, level)
            ends = [stopped(row, sure["greedy"]) for row in chosen]
            mean = float(np.mean([end["seconds"] for end in ends]))
            right = float(np.mean([end["right"] for end in ends]))
            lines.append(
                f"| {words} | {100 * level:.0f} % | {times[0]:.1f} s | {times[1]:.1f} s | "
                f"{times[1] / times[0]:.2f} | {mean:.1f} s | {100 * right:.0f} % | "
                f"{mean / times[0]:.2f} |"
            )
    return lines


def calibration_table(rows: Sequence[Row]) -> list[str]:
    """Right verdicts by the probability of the most probable set, after every motion."""
    p = np.array([v for row in rows for v in row["probability"]])
    right = np.array([v for row in rows for v in row["right"]])
    lines = ["| probability | beliefs | mean probability | right |", "|---|---|---|---|"]
    edges = (0.0, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0001)
    for low, high in pairwise(edges):
        inside = (p >= low) & (p < high)
        if inside.any():
            lines.append(
                f"| {low:g} to {min(high, 1):g} | {inside.sum()} | {p[inside].mean():.3f} | "
                f"{right[inside].mean():.3f} |"
            )
    covered: Array = np.array([v for row in rows for v in row["covered"][-1:] if v >= 0])
    if len(covered):
        lines += [
            "",
            f"95 % intervals of the parameters that are named rightly hold the true value in "
            f"{100 * covered.mean():.0f} % ({len(covered)} episodes).",
        ]
    return lines


def confusion_table(rows: Sequence[Row], agent: str) -> list[str]:
    """Single effects that are not named in the end, with what is named instead."""
    wrong = Counter(
        (row["truth"] or "none", row["named"] or "none")
        for row in rows
        if row["agent"] == agent and row["seconds"] and not row["right"][-1]
    )
    lines = ["| hidden | named | episodes |", "|---|---|---|"]
    lines += [f"| {t} | {n} | {count} |" for (t, n), count in sorted(wrong.items())]
    return lines
