"""Success of agents: rates, paired differences, several trainings, strata, Pareto front."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from loose_env.errors import InvalidData, UnknownName
from loose_env.faults import UNSURE
from loose_env.inference import RESAMPLES, Interval, bootstrap_mean, percentiles, wilson

Row = Mapping[str, Any]
"""Outcome of one episode: agent, seed, truth, verdict, success, link_success, poses, records,
seconds, reward and truncated. ``episode`` may stand beside or in place of ``seed``; tables that
divide the episodes also take difficulty and friction_ratio, calibration the trails."""

SEPARATOR = "#"
"""Stands between the name of an agent and the number of its training: ``ppo#3``."""
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
_SIGNIFICANCE = 0.05  # p-value [1] of the sign test above which a lead is sampling error
_NO_FAULT = ("healthy", UNSURE, None)


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Summary of one agent's episodes."""

    agent: str
    episodes: int
    right: int
    """Episodes with the right verdict."""
    low: float
    """Lower end of the 95 % Wilson interval of the success rate."""
    high: float
    """Upper end of the same."""
    link_success: float
    """Share of episodes whose verdict names the right link or joint, whatever the kind."""
    false_alarms: float
    """Share of the healthy arms on which a fault was named; NaN where none was healthy."""
    misses: float
    """Share of the faulty arms that were called healthy; NaN where none was faulty."""
    unsure: float
    """Share of the episodes that ended with the verdict "unsure"."""
    poses: float
    """Mean number of poses measured in."""
    records: float
    """Mean number of records."""
    seconds: float
    """Mean time of excitation [s]."""
    reward: float
    """Mean return."""
    records_interval: Interval | None = None
    """Mean number of records with its 95 % bootstrap interval, where it was asked for."""
    reward_interval: Interval | None = None
    """Mean return with the same."""
    lead: Interval | None = None
    """Mean difference of return to the reference on the same arms; None for the reference."""

    @property
    def success(self) -> float:
        """Share of episodes with the right verdict."""
        return self.right / self.episodes


def by_agent(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Sort rows by agent, agents in the order in which they first appear."""
    if not rows:
        raise InvalidData("there are no episodes to report: rows is empty")
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(str(row["agent"]), []).append(row)
    return found


def standings(
    rows: Sequence[Row], *, reference: str | None = None, rng: np.random.Generator | None = None
) -> list[Standing]:
    """Sum up the rows of each agent; the one with the highest mean return comes first.

    Parameters
    ----------
    rows : sequence of Row
        Episodes of all agents.
    reference : str, optional
        Agent whose return the others' is compared with, on the same arms.
    rng : numpy.random.Generator, optional
        Draws the bootstrap; without it there are no intervals of records and return.

    Raises
    ------
    InvalidData
        If there are no episodes, or agents to be compared met different arms.
    UnknownName
        If the reference has no rows.

    Examples
    --------
    >>> base = dict(
    ...     truth="healthy", verdict="healthy", link_success=1, poses=1, records=2, seconds=1.2
    ... )
    >>> rows = [dict(agent="a", success=k > 3, reward=0.5, **base) for k in range(20)]
    >>> best = standings(rows)[0]
    >>> best.success, round(best.low, 2), round(best.high, 2)
    (0.8, 0.58, 0.92)
    """
    own = by_agent(rows)
    if reference is not None and reference not in own:
        raise UnknownName(f"no rows of the reference {reference!r}; agents are {list(own)}")
    found = []
    for agent, some in own.items():
        standing = _standing(agent, some)
        if rng is not None:
            standing = replace(
                standing,
                records_interval=bootstrap_mean([row["records"] for row in some], rng=rng),
                reward_interval=bootstrap_mean([row["reward"] for row in some], rng=rng),
            )
            if reference is not None and agent != reference:
                lead = paired_difference(some, own[reference], rng=rng)
                standing = replace(standing, lead=lead)
        found.append(standing)
    return sorted(found, key=lambda s: (-s.reward, -s.success))


def _standing(agent: str, rows: Sequence[Row]) -> Standing:
    right = sum(bool(row["success"]) for row in rows)
    low, high = wilson(right, len(rows))
    named = [row["verdict"] not in _NO_FAULT for row in rows if row["truth"] == "healthy"]
    called = [row["verdict"] == "healthy" for row in rows if row["truth"] != "healthy"]
    names = ("link_success", "poses", "records", "seconds", "reward")
    means: dict[str, Any] = {name: float(np.mean([row[name] for row in rows])) for name in names}
    return Standing(
        agent=agent,
        episodes=len(rows),
        right=right,
        low=low,
        high=high,
        false_alarms=float(np.mean(named)) if named else float("nan"),
        misses=float(np.mean(called)) if called else float("nan"),
        unsure=float(np.mean([row["verdict"] == UNSURE for row in rows])),
        **means,
    )


def _arm_of(row: Row) -> tuple[Any, Any, Any]:
    """Key of a hidden arm: difficulty, seed and number of its episode."""
    return row.get("difficulty"), row.get("seed"), row.get("episode")


def paired_values(rows: Sequence[Row], reference: Sequence[Row], name: str) -> NDArray[np.float64]:
    """Differences of a column on the arms that two agents met (N,); else InvalidData."""
    other = {_arm_of(row): row for row in reference}
    own = {_arm_of(row): row for row in rows}
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
    rows: Sequence[Row],
    reference: Sequence[Row],
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


def trained_agents(agents: Iterable[str]) -> dict[str, list[str]]:
    """Put trainings of one agent together; agents trained once are left out.

    The first training goes by the plain name too.

    Examples
    --------
    >>> trained_agents(["ppo", "ppo#1", "ppo#2", "thesis"])
    {'ppo': ['ppo', 'ppo#2']}
    """
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(agents):
        whole, _, number = name.partition(SEPARATOR)
        if number != "1" or whole not in found.get(whole, []):
            found.setdefault(whole, []).append(name)
    return {whole: runs for whole, runs in found.items() if len(runs) > 1}


def stratified_interval(
    scores: ArrayLike, *, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """Interquartile mean over runs and tasks (runs, tasks), with its bootstrap interval.

    As rliable has it: in each resample the runs of each task are drawn anew, independently of the
    other tasks, and of N scores the whole part of N/4 is cut off on each side (Agarwal et al.,
    Deep Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021).
    """
    x = np.asarray(scores, dtype=float)
    if x.ndim != 2 or x.size == 0 or not np.isfinite(x).all():
        raise InvalidData(f"scores are a finite table (runs, tasks), got shape {x.shape}")
    drawn = rng.integers(0, len(x), size=(resamples, *x.shape))
    values = np.take_along_axis(x[None], drawn, axis=1).reshape(resamples, -1)
    estimate = float(stats.trim_mean(x, 0.25, axis=None))
    return percentiles(stats.trim_mean(values, 0.25, axis=1), estimate)


def runs_of(rows: Sequence[Row], *, rng: np.random.Generator) -> dict[str, dict[str, Interval]]:
    """Interquartile means of every agent that was trained more than once.

    Returns
    -------
    dict
        By agent, then by column: success, records, reward.

    Raises
    ------
    InvalidData
        If a training was not played in every difficulty.
    """
    tasks = list(dict.fromkeys(row.get("difficulty") for row in rows))
    cells: dict[tuple[Any, Any], list[Row]] = {}
    for row in rows:
        cells.setdefault((row["agent"], row.get("difficulty")), []).append(row)
    found: dict[str, dict[str, Interval]] = {}
    for agent, runs in trained_agents(str(row["agent"]) for row in rows).items():
        if any((run, task) not in cells for run in runs for task in tasks):
            raise InvalidData("every training must have been played in every difficulty")
        for name in ("success", "records", "reward"):
            scores = [
                [np.mean([float(row[name]) for row in cells[run, task]]) for task in tasks]
                for run in runs
            ]
            found.setdefault(agent, {})[name] = stratified_interval(scores, rng=rng)
    return found


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
    """Lay agents called ``estimator/policy`` out, best first; None where nothing is crossed."""
    cells = {}
    for s in found:
        estimator, mark, policy = s.agent.partition("/")
        if mark:
            cells[policy, estimator] = s
    if len(cells) < 2:
        return None
    return Crossing(
        estimators=tuple(dict.fromkeys(estimator for _, estimator in cells)),
        policies=tuple(dict.fromkeys(policy for policy, _ in cells)),
        cells=cells,
    )


def success_after(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Share of arms on which each agent's best hypothesis is right after record 1, 2, ...

    Agents were made to take all records: every trail has the same length. A trail cut short by a
    diverging simulation counts with its last entry, one without an entry as wrong.

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
    cost, value : array_like (N,)
        What is to be small, as mean records, and what is to be large, as success; finite.

    Returns
    -------
    ndarray of bool (N,)
        True for the points on the front.

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


def ratio_class(ratio: float | None) -> str | None:
    """Class of a seat drive over friction, a lower edge included; None on a healthy arm."""
    if ratio is None or np.isnan(ratio):
        return None
    return ratio_names()[int(np.searchsorted(RATIO_EDGES, ratio, side="right"))]


def divisions(rows: Sequence[Row]) -> list[Division]:
    """Divide episodes by friction, by kind of fault, and by difficulty where there are several.

    A division that the rows say nothing about is left out.
    """
    found = []
    if any(row.get("friction_ratio") is not None for row in rows):
        heading = "seat drive over friction (faulty arms)"
        found.append(
            _divide(rows, heading, lambda row: ratio_class(row["friction_ratio"]), ratio_names())
        )
    ratios = [(row.get("friction_ratio"), row.get("opening_ratio")) for row in rows]
    if any(a and b and b < 0.5 * a for a, b in ratios):  # gravity holds seats shut
        heading = "seat drive over friction and gravity, best pose (faulty arms)"
        found.append(
            _divide(rows, heading, lambda row: ratio_class(row["opening_ratio"]), ratio_names())
        )
    kinds = list(dict.fromkeys(str(row["truth"]).partition("@")[0] for row in rows))
    kinds.sort(key=lambda kind: list(KIND_WORDS).index(kind) if kind in KIND_WORDS else 99)
    words = {kind: KIND_WORDS.get(kind, kind.replace("_", " ")) for kind in kinds}
    hidden = _divide(
        rows,
        "what was hidden",
        lambda row: words[row["truth"].partition("@")[0]],
        tuple(words.values()),
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
    return Cell(
        episodes=len(rows),
        success=right / len(rows) if rows else float("nan"),
        low=low,
        high=high,
        records=float(np.mean([row["records"] for row in rows])) if rows else float("nan"),
    )


def who_won(rows: Sequence[Row]) -> list[str]:
    """Say in plain words who earned most, who came next, and who was right more often."""
    best, *others = standings(rows)
    sentences = [
        f"The best by return was {best.agent}: right on {best.right} of {best.episodes} arms"
        f" ({100 * best.success:.0f} %), after {best.records:.1f} records on average."
    ]
    if others:
        followed = [
            f"{s.agent} ({s.right} of {s.episodes}, {s.records:.1f} records)" for s in others
        ]
        ahead = ", ".join(followed[:-1])
        sentences.append(f"Then came {ahead}{' and ' if ahead else ''}{followed[-1]}.")
        sentences.append(_lead(rows, best, others[0]))
    return sentences


def _lead(rows: Sequence[Row], first: Standing, second: Standing) -> str:
    """Compare the two best agents on the arms that both were given (sign test)."""
    own = by_agent(rows)
    left = {_arm_of(row): bool(row["success"]) for row in own[first.agent]}
    right = {_arm_of(row): bool(row["success"]) for row in own[second.agent]}
    shared = left.keys() & right.keys()
    alone = sum(left[k] and not right[k] for k in shared)
    lost = sum(right[k] and not left[k] for k in shared)
    if not shared:
        return f"{first.agent} and {second.agent} were given different arms."
    if alone == lost:
        return f"Between {first.agent} and {second.agent} there is nothing to choose."
    chance = float(stats.binomtest(alone, alone + lost).pvalue)
    met = (
        f"Where only one of the two best was right, it was {first.agent} on {alone} arms and "
        f"{second.agent} on {lost}:"
    )
    if chance > _SIGNIFICANCE:
        return f"{met} the difference is within sampling error (sign test, p = {chance:.2f})."
    shown = "p < 0.001" if chance < 0.001 else f"p = {chance:.3f}"
    return f"{met} the difference exceeds sampling error (sign test, {shown})."
