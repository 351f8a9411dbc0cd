"""Success by stratum, by estimator and policy, and after each record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData
from loose_env.evaluation.success_rates import Row, Standing, by_agent, standings, wilson

__all__ = [
    "RATIO_EDGES",
    "Cell",
    "Crossing",
    "Division",
    "crossing",
    "divisions",
    "pareto_front",
    "ratio_class",
    "ratio_names",
    "success_after",
]


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """Agents made of an estimator and a policy, laid out by both."""

    estimators: tuple[str, ...]
    """The columns."""
    policies: tuple[str, ...]
    """The rows."""
    cells: dict[tuple[str, str], Standing]
    """By policy and estimator; pairs that were not played are missing."""


def crossing(found: Sequence[Standing]) -> Crossing | None:
    """Lay agents called ``estimator/policy`` out; None where nothing is crossed.

    Estimators and policies stand in the order of their best agent.
    """
    cells = {}
    for s in found:
        estimator, mark, policy = s.agent.partition("/")
        if mark:
            cells[policy, estimator] = s
    estimators = tuple(dict.fromkeys(estimator for _, estimator in cells))
    policies = tuple(dict.fromkeys(policy for policy, _ in cells))
    if len(cells) < 2:
        return None
    return Crossing(estimators=estimators, policies=policies, cells=cells)


def success_after(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Share of arms on which each agent's best hypothesis is right after record 1, 2, ...

    Parameters
    ----------
    rows : sequence of Row
        Episodes of agents that were made to take all records: every trail has the same length.

    Returns
    -------
    dict
        By agent. A trail cut short by a diverging simulation counts with its last entry, one
        without an entry as wrong.

    Examples
    --------
    >>> first = dict(agent="a", truth="x", trail_best=["y", "x"])
    >>> second = dict(agent="a", truth="x", trail_best=["x", "x"])
    >>> success_after([first, second])
    {'a': [0.5, 1.0]}
    """
    found = {}
    for agent, own in by_agent(rows).items() if rows else ():
        most = max(len(row.get("trail_best") or ()) for row in own)
        right = np.zeros((len(own), most))
        for hits, row in zip(right, own, strict=True):
            best = list(row.get("trail_best") or ())
            if best:
                best += [best[-1]] * (most - len(best))
                hits[:] = [name == row["truth"] for name in best]
        if most:
            found[agent] = [float(share) for share in right.mean(axis=0)]
    return found


def pareto_front(cost: ArrayLike, value: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that no other point dominates.

    A point dominates another if it costs no more and is worth no less, and is better in one
    of the two. Equal points do not dominate each other.

    Parameters
    ----------
    cost : array_like (N,)
        What is to be small: mean records.
    value : array_like (N,)
        What is to be large: success.

    Returns
    -------
    ndarray of bool (N,)
        Whether each point lies on the front.

    Raises
    ------
    InvalidData
        If the two differ in length or hold what is not finite.

    Examples
    --------
    >>> pareto_front([1, 2, 3, 2], [0.7, 0.9, 0.9, 0.8]).tolist()
    [True, True, False, False]
    """
    c, v = np.asarray(cost, dtype=float), np.asarray(value, dtype=float)
    if c.ndim != 1 or c.shape != v.shape or not (np.isfinite(c).all() and np.isfinite(v).all()):
        raise InvalidData(
            f"a front needs a finite cost and value for each point, got {c.shape} and {v.shape}"
        )
    no_worse = (c[:, None] <= c) & (v[:, None] >= v)
    better = (c[:, None] < c) | (v[:, None] > v)
    return np.asarray(~(no_worse & better).any(axis=0))


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
    """Results of one agent in one stratum."""

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
    """True if the strata have an order, so that a line may join them."""


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
    rows: Sequence[Row], heading: str, group_of: Callable[[Row], str | None], groups: Sequence[str]
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
