"""Estimators crossed with policies: what each of the two gives.

How often agents are right after so many records when they may not stop.

Which agents no other one beats in both cost and success.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData
from loose_env.evaluation.success_rates import Row, Standing, by_agent

__all__ = ["Crossing", "crossing", "pareto_front", "success_after"]


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
