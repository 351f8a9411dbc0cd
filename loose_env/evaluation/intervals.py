"""Bootstrap intervals: means over episodes, paired differences, several trainings of one agent."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from loose_env.errors import InvalidData

__all__ = [
    "SEPARATOR",
    "Interval",
    "arm_of",
    "bootstrap_mean",
    "interquartile_mean",
    "paired_difference",
    "paired_values",
    "runs_of",
    "stratified_interval",
    "task_scores",
    "trained_agents",
]


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
    values: ArrayLike, *, rng: np.random.Generator, resamples: int = RESAMPLES, level: float = 0.95
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
    """Key of a hidden arm: difficulty, seed and number of its episode."""
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


SEPARATOR = "#"
"""Stands between the name of an agent and the number of its training: ``ppo#3``."""


def trained_agents(agents: Iterable[str]) -> dict[str, list[str]]:
    """Put trainings of one agent together; agents trained once are left out.

    The first training goes by the plain name too.

    Examples
    --------
    >>> trained_agents(["ppo#1", "thesis", "ppo#2", "net#1"])
    {'ppo': ['ppo#1', 'ppo#2']}
    >>> trained_agents(["ppo", "ppo#1", "ppo#2", "thesis"])
    {'ppo': ['ppo', 'ppo#2']}
    """
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(agents):
        whole, _, number = name.partition(SEPARATOR)
        if number != "1" or whole not in found.get(whole, []):
            found.setdefault(whole, []).append(name)
    return {whole: runs for whole, runs in found.items() if len(runs) > 1}


def interquartile_mean(scores: ArrayLike) -> float:
    """Mean of the middle half of all scores: a quarter is cut off at each end.

    As rliable has it: of N scores, the whole part of N/4 goes on each side.

    Parameters
    ----------
    scores : array_like
        Scores of any shape.

    Examples
    --------
    >>> interquartile_mean([0.0, 1.0, 2.0, 3.0, 100.0])
    2.0
    """
    return float(stats.trim_mean(np.asarray(scores, dtype=float), 0.25, axis=None))


def stratified_interval(
    scores: ArrayLike, *, rng: np.random.Generator, resamples: int = RESAMPLES, level: float = 0.95
) -> Interval:
    """Interquartile mean over runs and tasks, with its stratified bootstrap interval.

    In each resample the runs of each task are drawn anew, with replacement and independently
    of the other tasks.

    Parameters
    ----------
    scores : array_like (runs, tasks)
        Score of each training in each task.
    rng : numpy.random.Generator
        Draws the resamples.
    resamples : int
        Number of resamples.
    level : float
        Confidence level, 0 to 1.

    Raises
    ------
    InvalidData
        If the scores are no finite table.

    Examples
    --------
    >>> found = stratified_interval([[0.5], [0.6], [0.7]], rng=np.random.default_rng(0))
    >>> round(found.estimate, 3), found.low >= 0.5, found.high <= 0.7
    (0.6, True, True)
    """
    x = np.asarray(scores, dtype=float)
    if x.ndim != 2 or x.size == 0 or not np.isfinite(x).all():
        raise InvalidData(f"scores are a finite table (runs, tasks), got shape {x.shape}")
    runs, tasks = x.shape
    drawn = rng.integers(0, runs, size=(resamples, runs, tasks))
    values = np.take_along_axis(x[None], drawn, axis=1).reshape(resamples, -1)
    means = stats.trim_mean(values, 0.25, axis=1)
    tail = 0.5 * (1.0 - level)
    low, high = np.quantile(means, (tail, 1.0 - tail))
    return Interval(estimate=interquartile_mean(x), low=float(low), high=float(high))


def task_scores(
    rows: Sequence[Mapping[str, Any]], runs: Sequence[str], name: str
) -> NDArray[np.float64]:
    """Mean of a column for each training in each difficulty (runs, tasks)."""
    tasks = list(dict.fromkeys(row.get("difficulty") for row in rows))
    cells: dict[tuple[Any, Any], list[float]] = {(r, t): [] for r in runs for t in tasks}
    for row in rows:
        key = (row["agent"], row.get("difficulty"))
        if key in cells:
            cells[key].append(float(row[name]))
    if not all(cells.values()):
        raise InvalidData("every training must have been played in every difficulty")
    return np.array([[np.mean(cells[run, task]) for task in tasks] for run in runs])


def runs_of(
    rows: Sequence[Mapping[str, Any]], *, rng: np.random.Generator
) -> dict[str, dict[str, Interval]]:
    """Interquartile means of every agent that was trained more than once.

    Returns
    -------
    dict
        By agent, then by column: success, records, reward.
    """
    found = trained_agents(str(row["agent"]) for row in rows)
    return {
        agent: {
            name: stratified_interval(task_scores(rows, runs, name), rng=rng)
            for name in ("success", "records", "reward")
        }
        for agent, runs in found.items()
    }
