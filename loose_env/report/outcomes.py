"""Statistics of a comparison: means over trainings, strata, curves, Pareto front, calibration.

A posterior is calibrated if, of all times it gave its best hypothesis the probability p, the
best hypothesis was right in the share p. That is a statement about what the agent can see.
Among arms alike in what it cannot see, such as the friction, even the exact posterior errs:
too sure on faults held fast, which look healthy, not sure enough on those that move freely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from loose_env.errors import InvalidData
from loose_env.evaluation import (
    SEPARATOR,
    Interval,
    Row,
    Standing,
    arm_of,
    by_agent,
    standing_of,
    standings,
)
from loose_env.inference import RESAMPLES, expected_calibration_error, log_score, percentiles
from loose_env.typing import Array

RATIO_EDGES = (1.0, 2.0, 4.0, 10.0)
"""Inner edges of the classes of seat drive over friction [1]."""
KIND_WORDS = {
    "healthy": "healthy",
    "structural_looseness": "link slides",
    "backlash": "joint play",
    "rotational_looseness": "link rocks",
}
"""Kinds of fault in few words."""
_SIGNIFICANCE = 0.05  # p-value [1] of the sign test above which a lead is sampling error


def trained_agents(agents: Iterable[str]) -> dict[str, list[str]]:
    """Put trainings of one agent together; agents trained once are left out.

    The first training goes by the plain name too.
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
    drawn = rng.integers(0, len(x), size=(resamples, *x.shape))
    values = np.take_along_axis(x[None], drawn, axis=1).reshape(resamples, -1)
    estimate = float(stats.trim_mean(x, 0.25, axis=None))
    return percentiles(stats.trim_mean(values, 0.25, axis=1), estimate)


def runs_of(rows: Sequence[Row], *, rng: np.random.Generator) -> dict[str, dict[str, Interval]]:
    """Interquartile means of every agent that was trained more than once."""
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


def crossing(found: Sequence[Standing]) -> dict[str, dict[str, Standing]]:
    """Agents called ``estimator/policy`` by policy and estimator, best first; empty with one."""
    cells: dict[str, dict[str, Standing]] = {}
    for s in found:
        estimator, mark, policy = s.agent.partition("/")
        if mark:
            cells.setdefault(policy, {})[estimator] = s
    return cells if sum(map(len, cells.values())) > 1 else {}


def success_after(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Share of arms on which each agent's best hypothesis is right after record 1, 2, ...

    Agents were made to take all records: every trail has the same length. A trail cut short by a
    diverging simulation counts with its last entry, one without an entry as wrong.
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


def pareto_front(cost: Array, value: Array) -> NDArray[np.bool_]:
    """True for the points (N,) that no other dominates: costs no more, is worth no less.

    It is better in one of the two. Equal points do not dominate each other.
    """
    no_worse = (cost[:, None] >= cost) & (value[:, None] <= value)
    better = (cost[:, None] > cost) | (value[:, None] < value)
    return np.asarray(~(no_worse & better).any(axis=1))


@dataclass(frozen=True, kw_only=True)
class Division:
    """Episodes divided into groups."""

    heading: str
    """By what they are divided."""
    groups: tuple[str, ...]
    """Names of the groups."""
    cells: dict[str, tuple[Standing, ...]]
    """By agent, one for each group; the best agent first."""
    ordered: bool = True
    """True if the strata have an order, so that a line may join them."""


def ratio_names(edges: Sequence[float] = RATIO_EDGES) -> tuple[str, ...]:
    """Names of the classes of seat drive over friction."""
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
            standing_of(s.agent, [row for row in own[s.agent] if group_of(row) == group])
            for group in groups
        )
        for s in standings(rows)
    }
    return Division(heading=heading, groups=tuple(groups), cells=cells)


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
    left = {arm_of(row): bool(row["success"]) for row in own[first.agent]}
    right = {arm_of(row): bool(row["success"]) for row in own[second.agent]}
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
