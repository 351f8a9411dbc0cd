"""Success and records by what makes a fault easy or hard to find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from loose_env.evaluation.success_rates import Row, by_agent, standings, wilson

__all__ = ["RATIO_EDGES", "Cell", "Division", "divisions", "ratio_class", "ratio_names"]

RATIO_EDGES = (1.0, 2.0, 4.0, 10.0)
"""Inner edges of the classes of seat drive over friction [1]."""

KIND_WORDS = {
    "healthy": "healthy",
    "structural_looseness": "link slides",
    "backlash": "joint play",
    "rotational_looseness": "link rocks",
    "compound_looseness": "link slides and rocks",
}
"""Kinds of fault in few words."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What one agent made of one group of episodes."""

    episodes: int
    """Episodes in the group."""
    success: float
    """Share of right verdicts; NaN without episodes."""
    low: float
    """Lower end of its 95 % Wilson interval."""
    high: float
    """Upper end."""
    records: float
    """Mean records; NaN without episodes."""


@dataclass(frozen=True, kw_only=True)
class Division:
    """Episodes divided into groups."""

    heading: str
    """By what they are divided."""
    groups: tuple[str, ...]
    """Names of the groups."""
    cells: dict[str, tuple[Cell, ...]]
    """By agent, one for each group; the best agent first."""
    ordered: bool = True
    """Whether the groups follow each other, so that a line may join them."""


def ratio_names(edges: Sequence[float] = RATIO_EDGES) -> tuple[str, ...]:
    """Names of the classes of seat drive over friction.

    Examples
    --------
    >>> ratio_names((1.0, 4.0))
    ('below 1', '1 to 4', 'above 4')
    """
    between = [f"{a:g} to {b:g}" for a, b in pairwise(edges)]
    return (f"below {edges[0]:g}", *between, f"above {edges[-1]:g}")


def ratio_class(ratio: float | None, edges: Sequence[float] = RATIO_EDGES) -> str | None:
    """Class of a seat drive over friction; None on a healthy arm.

    Examples
    --------
    >>> ratio_class(0.5), ratio_class(4.0), ratio_class(None)
    ('below 1', '4 to 10', None)
    """
    if ratio is None or np.isnan(ratio):
        return None
    return ratio_names(edges)[int(np.searchsorted(edges, ratio, side="right"))]


def divisions(rows: Sequence[Row]) -> list[Division]:
    """Divide episodes by friction, by kind of fault, and by difficulty where there are several.

    A division that the rows say nothing about is left out.
    """
    found = []
    if any(row.get("friction_ratio") is not None for row in rows):
        names = ratio_names()
        heading = "seat drive over friction (faulty arms)"
        found.append(_divide(rows, heading, lambda row: ratio_class(row["friction_ratio"]), names))
    ratios = [(row.get("friction_ratio"), row.get("opening_ratio")) for row in rows]
    if any(a and b and b < 0.5 * a for a, b in ratios):  # gravity holds seats shut
        heading = "seat drive over friction and gravity, best pose (faulty arms)"
        found.append(_divide(rows, heading, lambda row: ratio_class(row["opening_ratio"]), names))
    kinds = list(dict.fromkeys(str(row["truth"]).partition("@")[0] for row in rows))
    kinds.sort(key=lambda kind: list(KIND_WORDS).index(kind) if kind in KIND_WORDS else 99)
    words = tuple(KIND_WORDS.get(kind, kind.replace("_", " ")) for kind in kinds)
    by_kind = dict(zip(kinds, words, strict=True))
    hidden = _divide(
        rows, "what was hidden", lambda r: by_kind[r["truth"].partition("@")[0]], words
    )
    found.append(replace(hidden, ordered=False))
    levels = tuple(dict.fromkeys(str(row["difficulty"]) for row in rows if row.get("difficulty")))
    if len(levels) > 1:
        found.append(_divide(rows, "difficulty", lambda row: str(row["difficulty"]), levels))
    return found


def _divide(
    rows: Sequence[Row],
    heading: str,
    group_of: Callable[[Row], str | None],
    groups: Sequence[str],
) -> Division:
    own = by_agent(rows)
    cells = {
        s.agent: tuple(
            _cell([row for row in own[s.agent] if group_of(row) == group]) for group in groups
        )
        for s in standings(rows)
    }
    return Division(heading=heading, groups=tuple(groups), cells=cells)


def _cell(rows: Sequence[Row]) -> Cell:
    right = sum(bool(row["success"]) for row in rows)
    low, high = wilson(right, len(rows))
    nothing = float("nan")
    return Cell(
        episodes=len(rows),
        success=right / len(rows) if rows else nothing,
        low=low,
        high=high,
        records=float(np.mean([row["records"] for row in rows])) if rows else nothing,
    )
