"""One learned agent trained several times: what the training gives, not what one run gave.

The interquartile mean over runs and tasks with stratified bootstrap intervals, after Agarwal,
Schwarzer, Castro, Courville and Bellemare, Deep Reinforcement Learning at the Edge of the
Statistical Precipice (NeurIPS 2021), whose library is rliable.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from loose_env.errors import InvalidData
from loose_env.evaluation.paired_bootstrap import RESAMPLES, Interval

__all__ = [
    "SEPARATOR",
    "interquartile_mean",
    "runs_of",
    "stratified_interval",
    "task_scores",
    "trained_agents",
]

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
    scores: ArrayLike,
    *,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
    level: float = 0.95,
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
