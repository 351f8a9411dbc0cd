"""Calibration of an agent's probabilities.

A posterior is calibrated if, of all times it gave its best hypothesis the probability p, the
best hypothesis was right in the share p. That is a statement about what the agent can see.
Among arms alike in what it cannot see, such as the friction, even the exact posterior errs:
too sure on faults held fast, which look healthy, not sure enough on those that move freely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.inference import expected_calibration_error, log_score


@dataclass(frozen=True, kw_only=True, eq=False)
class Claims:
    """Posterior of an agent after each record of each episode."""

    confidence: NDArray[np.float64]
    """Probability of the most probable hypothesis (N,)."""
    right: NDArray[np.bool_]
    """True where that was the truth (N,)."""
    truth: NDArray[np.float64]
    """Probability of the truth (N,)."""
    record: NDArray[np.intp]
    """After which record, from 1 (N,)."""
    last: NDArray[np.bool_]
    """True where the episode's verdict followed (N,)."""
    ratio: NDArray[np.float64]
    """Seat drive over friction of the arm; NaN where it is healthy (N,)."""

    def where(self, mask: NDArray[np.bool_]) -> Claims:
        """Only some of them."""
        return Claims(**{name: values[mask] for name, values in vars(self).items()})


def claims_of(rows: Sequence[Mapping[str, Any]]) -> Claims:
    """Collect the beliefs along the trails of episodes; none where an agent keeps none."""
    found = []
    for row in rows:
        best = row.get("trail_best") or ()
        ratio = row.get("friction_ratio")
        for k, name in enumerate(best):
            found.append(
                (
                    row["trail_confidence"][k],
                    name == row["truth"],
                    row["trail_truth"][k],
                    k + 1,
                    k == len(best) - 1 and not row.get("truncated", False),
                    np.nan if ratio is None else ratio,
                )
            )
    columns: list[Any] = list(zip(*found, strict=True)) if found else [()] * 6
    kinds = (float, bool, float, int, bool, float)
    arrays: list[Any] = [np.array(c, dtype=kind) for c, kind in zip(columns, kinds, strict=True)]
    names = ("confidence", "right", "truth", "record", "last", "ratio")
    return Claims(**dict(zip(names, arrays, strict=True)))


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Calibration errors and log score of one agent."""

    agent: str
    """The agent."""
    claims: int
    """Number of beliefs, one after each record."""
    error: float
    """Expected calibration error over all of them."""
    at_verdict: float
    """The same at the verdicts only."""
    score: float
    """Mean logarithm of the truth's probability at the verdicts [nat]."""
    by_record: tuple[float, ...]
    """The error after record 1, 2, ..., the last entry for all later ones."""
    by_ratio: tuple[float, ...]
    """The error on faulty arms by seat drive over friction."""


def calibration_of(
    agent: str, rows: Sequence[Mapping[str, Any]], *, edges: Sequence[float], records: int = 4
) -> Calibration | None:
    """Judge the probabilities of one agent; None where it keeps none.

    By classes of seat drive over friction with the inner ``edges``, and by record, those after the
    first few put together.
    """
    claims = claims_of(rows)
    if len(claims.record) == 0:
        return None

    def error(mask: NDArray[np.bool_]) -> float:
        some = claims.where(mask)
        return expected_calibration_error(some.confidence, some.right)

    number = np.minimum(claims.record, records + 1)
    bounds = (-np.inf, *edges, np.inf)
    return Calibration(
        agent=agent,
        claims=len(claims.record),
        error=error(np.ones(len(claims.record), dtype=bool)),
        at_verdict=error(claims.last),
        score=log_score(claims.truth[claims.last]),
        by_record=tuple(error(number == k) for k in range(1, records + 2)),
        by_ratio=tuple(
            error((claims.ratio >= low) & (claims.ratio < high)) for low, high in pairwise(bounds)
        ),
    )
