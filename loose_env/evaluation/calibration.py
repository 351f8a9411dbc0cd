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
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData

__all__ = [
    "Calibration",
    "Claims",
    "Reliability",
    "calibration_of",
    "claims_of",
    "expected_calibration_error",
    "log_score",
    "reliability",
]

BINS = 15
"""Bins of equal width from 0 to 1, as in Guo et al. (2017)."""

SMALLEST = 1e-6
"""Probabilities of the truth below this count as this in the log score."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reliability:
    """Accuracy by confidence, in bins that are not empty."""

    confidence: NDArray[np.float64]
    """Mean confidence (bins,)."""
    right: NDArray[np.float64]
    """Share that was right (bins,)."""
    count: NDArray[np.intp]
    """Number of claims (bins,)."""


def reliability(confidence: ArrayLike, right: ArrayLike, *, bins: int = BINS) -> Reliability:
    """Sort claims by confidence and see how often each bin was right.

    Parameters
    ----------
    confidence : array_like (N,)
        Probability given to what was claimed, 0 to 1.
    right : array_like of bool (N,)
        Whether the claim was right.
    bins : int
        Bins of equal width; a claim on an edge belongs to the bin below it.

    Raises
    ------
    InvalidData
        If the two differ in length or a confidence is no probability.
    """
    p, hit = np.asarray(confidence, dtype=float), np.asarray(right, dtype=float)
    if p.ndim != 1 or p.shape != hit.shape:
        raise InvalidData(
            f"every claim has a confidence and an outcome, got {p.shape} and {hit.shape}"
        )
    if not ((p >= 0) & (p <= 1 + 1e-9)).all():
        raise InvalidData("a confidence is a probability, from 0 to 1")
    index = np.clip(np.ceil(p * bins).astype(int) - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    full = count > 0
    number = count[full]
    return Reliability(
        confidence=np.bincount(index, p, minlength=bins)[full] / number,
        right=np.bincount(index, hit, minlength=bins)[full] / number,
        count=number,
    )


def expected_calibration_error(
    confidence: ArrayLike, right: ArrayLike, *, bins: int = BINS
) -> float:
    """Mean distance between confidence and share of right claims, weighted by claims.

    Parameters
    ----------
    confidence, right, bins
        As in `reliability`.

    Returns
    -------
    float
        From 0 to 1; NaN without claims. It is never quite 0 in a finite sample: with N claims a
        perfect posterior shows about sqrt(bins / N) / 3.

    References
    ----------
    Naeini, Cooper and Hauskrecht, Obtaining Well Calibrated Probabilities Using Bayesian
    Binning (AAAI 2015); Guo et al., On Calibration of Modern Neural Networks (ICML 2017).

    Examples
    --------
    >>> round(expected_calibration_error([0.8] * 10, [True] * 6 + [False] * 4), 3)
    0.2
    """
    found = reliability(confidence, right, bins=bins)
    if len(found.count) == 0:
        return float("nan")
    distance = np.abs(found.confidence - found.right)
    return float(np.sum(distance * found.count) / np.sum(found.count))


def log_score(truth_probability: ArrayLike) -> float:
    """Mean natural logarithm of the probability given to the truth [nat]; 0 is the best.

    Probabilities below `SMALLEST` count as that. NaN without claims.

    Examples
    --------
    >>> round(log_score([1.0, 0.5]), 4)
    -0.3466
    """
    p = np.asarray(truth_probability, dtype=float)
    return float(np.mean(np.log(np.maximum(p, SMALLEST)))) if p.size else float("nan")


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

    Parameters
    ----------
    agent : str
        Its name.
    rows : sequence of mapping
        Its episodes.
    edges : sequence of float
        Inner edges of the classes of seat drive over friction.
    records : int
        How many records stand alone; later ones are put together.
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
