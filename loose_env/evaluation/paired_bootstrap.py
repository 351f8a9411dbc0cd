"""Means over episodes with bootstrap intervals, alone and against another agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData

__all__ = ["Interval", "arm_of", "bootstrap_mean", "paired_difference", "paired_values"]

RESAMPLES = 2000
_CHUNK = 1_000_000  # indices drawn at a time


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An estimate and the ends of its confidence interval."""

    estimate: float
    """The estimate."""
    low: float
    """Lower end."""
    high: float
    """Upper end."""

    @property
    def half(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


def bootstrap_mean(
    values: ArrayLike,
    *,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
    level: float = 0.95,
) -> Interval:
    """Mean of independent values and its percentile bootstrap interval.

    Parameters
    ----------
    values : array_like (N,)
        One value an episode.
    rng : numpy.random.Generator
        Draws the resamples.
    resamples : int
        Number of resamples.
    level : float
        Confidence level, 0 to 1.

    Raises
    ------
    InvalidData
        If there are no values, or one is not finite.

    References
    ----------
    Efron and Tibshirani, An Introduction to the Bootstrap (1993), section 13.3.

    Examples
    --------
    >>> found = bootstrap_mean([0.0, 1.0] * 50, rng=np.random.default_rng(0))
    >>> found.estimate, bool(0.35 < found.low < 0.45), bool(0.55 < found.high < 0.65)
    (0.5, True, True)
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 1 or len(x) == 0 or not np.isfinite(x).all():
        raise InvalidData(f"a mean needs one or more finite numbers, got shape {x.shape}")
    mean = float(x.mean())
    if np.ptp(x) == 0:
        return Interval(estimate=mean, low=mean, high=mean)
    rows = max(1, _CHUNK // len(x))
    parts = [
        x[rng.integers(0, len(x), size=(min(rows, resamples - begin), len(x)))].mean(axis=1)
        for begin in range(0, resamples, rows)
    ]
    tail = 0.5 * (1.0 - level)
    low, high = np.quantile(np.concatenate(parts), (tail, 1.0 - tail))
    return Interval(estimate=mean, low=float(low), high=float(high))


def arm_of(row: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    """What tells a hidden arm from others: difficulty, seed and number of its episode."""
    return row.get("difficulty"), row.get("seed"), row.get("episode")


def paired_values(
    rows: Sequence[Mapping[str, Any]], reference: Sequence[Mapping[str, Any]], name: str
) -> NDArray[np.float64]:
    """Differences of a column on the arms that two agents met, ``rows`` less ``reference`` (N,).

    Raises
    ------
    InvalidData
        If they met different arms, or something else was hidden in them.
    """
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
    rows: Sequence[Mapping[str, Any]],
    reference: Sequence[Mapping[str, Any]],
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
