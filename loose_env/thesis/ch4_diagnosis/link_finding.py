"""Finding the loose link by moving joints one by one: outward, inward, halving (4.2.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from loose_env.arms import Arm, LinearArm, planar
from loose_env.diagnosis import (
    LinkFindingSettings,
    Order,
    Sighting,
    judge_turn,
    next_joint,
    statistics_of,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import at_levels
from loose_env.faults import Healthy
from loose_env.report import FigureCard
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.thesis.ch6_experiments.shaken_vera.tables import percent
from loose_env.thesis.shared.plots import Points, by_category
from loose_env.thesis.shared.sections import Section, Table
from loose_env.typing import Array

_FRAMES = "loose_env.diagnosis.directions.ToolFrames"
EQUATIONS: dict[str, str] = {
    "4.27": "loose_env.diagnosis.directions.predicted_images",
    "4.28": f"{_FRAMES}.images",
    "4.29": f"{_FRAMES}.images",
    "4.30": f"{_FRAMES}.axes",
    "4.31": "loose_env.diagnosis.link_finding.judge_turn",
}
"""Function of each equation."""

Estimator = Callable[[Measurement, Measurement], float]

ARMS = 64
LINKS = 4
DURATION = 1.2
_MOVE = np.pi / 2  # a quarter turn: the direction then turns by as much as it can
_NEARER = LinkFindingSettings(still=0.5, turned=np.finfo(float).max)


def _lowest(loose: Measurement, healthy: Measurement) -> float:
    return _angle(statistics_of(loose).lowest_direction)


def _change(loose: Measurement, healthy: Measurement) -> float:
    change = statistics_of(loose).transmission_by_instrument
    change = change - statistics_of(healthy).transmission_by_instrument
    return _angle(change[:, 0])


def _angle(vector: Array) -> float:
    return float(np.arctan2(vector[1], vector[0]))


ESTIMATORS: Mapping[str, Estimator] = {
    "lowest correlation": _lowest,
    "change of transmission": _change,
}
ORDERS: tuple[Order, ...] = ("outward", "inward", "bisection")


@dataclass(frozen=True, kw_only=True)
class Search:
    """One search for the loose link of one arm."""

    link: int
    """The loose link."""
    named: int
    """The one that was named."""
    moves: int
    """Moves after the first pose."""


def section(seed: int) -> Section:
    """Search arms of four links; `vera_link_finding` has the step that VERA allows."""
    arm = planar(LINKS)
    found = {
        (name, order): search(arm, estimator, order, seed=seed)
        for name, estimator in ESTIMATORS.items()
        for order in ORDERS
    }
    return Section(
        key="link_finding",
        title="Finding the loose link (4.2.2, 7.1.2)",
        finding=_words(found)[1].partition(";")[0] + ".",
        words=_words(found),
        tables=[_search_table(found)],
        cards=[_card(found)],
        equations=EQUATIONS,
    )


def search(
    arm: Arm, estimator: Estimator, order: Order, *, seed: int, arms: int = ARMS
) -> list[Search]:
    """Let the steps of 4.2.2 look for the loose link of many arms.

    Every arm has its own mismatch, fault and first pose; a healthy twin of it gives the
    reference in each pose. Joint 1 is shaken, all others are braked. A joint moves by a quarter
    turn; the direction has turned if it turned by more than half of that.

    ``estimator``: direction of looseness [rad] from a record and the healthy twin's.
    """
    linear, difficulty = LinearArm(arm), Difficulty()
    sampler = FaultSampler(linear, difficulty)
    rig = SimulatedRig(arm, slots=2 * arms)
    pose = np.zeros((arms, arm.n))
    links = 1 + np.arange(arms) % arm.n
    for k in range(arms):
        rng = np.random.default_rng([seed, 11, k])
        fault = sampler.draw(rng, hypothesis=f"structural_looseness@link{links[k]}")
        mismatch = difficulty.mismatch.draw(arm, rng)
        rig.mount(2 * k, fault, mismatch)
        rig.mount(2 * k + 1, Healthy(), mismatch)
        pose[k] = arm.random_pose(rng)
    levels = np.zeros(arm.n)
    levels[0] = arm.levels[-1]
    low, high = np.ones(arms, dtype=int), np.full(arms, arm.n)
    moves, moved = np.zeros(arms, dtype=int), np.zeros(arms, dtype=int)
    before: list[Sighting | None] = [None] * arms
    for step in range(arm.n):
        open_ = np.flatnonzero(low < high)
        if not len(open_):
            break
        jobs = []
        for k in map(int, open_):
            shake, _ = at_levels(linear.at(pose[k]), levels, duration=DURATION)
            for twin in (0, 1):
                rng = np.random.default_rng([seed, 12, k, step, twin])
                jobs.append(Job(slot=2 * k + twin, pose=pose[k], excitation=shake, rng=rng))
        measured = rig.measure_many(jobs)
        for i, k in enumerate(map(int, open_)):
            seen = _sighting(pose[k].copy(), estimator(measured[2 * i], measured[2 * i + 1]))
            last = before[k]
            before[k] = seen
            if last is not None:
                joint = int(moved[k])
                if judge_turn(last, seen, joint, _NEARER) == "still":
                    low[k] = joint
                else:
                    high[k] = joint - 1
            if low[k] < high[k]:
                moved[k] = next_joint(order, int(low[k]), int(high[k]))
                pose[k, moved[k] - 1] += _MOVE
                moves[k] += 1
    return [Search(link=int(links[k]), named=int(low[k]), moves=int(moves[k])) for k in range(arms)]


def _sighting(pose: Array, direction: float) -> Sighting:
    """Sighting of which only the direction is used."""
    return Sighting(
        pose=pose,
        direction=direction,
        correlation=1.0,
        kurtosis=0.0,
        nominal_direction=direction,
        nominal_correlation=1.0,
    )


Found = Mapping[tuple[str, Order], Sequence[Search]]


def _share(runs: Sequence[Search]) -> float:
    return float(np.mean([r.named == r.link for r in runs]))


def _interval(runs: Sequence[Search]) -> tuple[float, float]:
    """Wilson's 95 % interval of the share of right searches."""
    right = sum(r.named == r.link for r in runs)
    interval = binomtest(right, len(runs)).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def _words(found: Found) -> list[str]:
    n = LINKS
    expected = (n - 1) * (n + 2) / (2 * n)
    by = {name: float(np.mean([_share(found[name, o]) for o in ORDERS])) for name in ESTIMATORS}
    first, second = ESTIMATORS
    moves = {o: np.mean([s.moves for s in found[second, o]]) for o in ORDERS}
    return [
        "A joint between the loose link and the tool turns the direction of looseness in the tool "
        f"frame when it moves; a joint below does not. {ARMS} arms of {n} links, each with its own "
        "mismatch, fault and first pose, are searched: from the base outward (the steps of 4.2.2), "
        "from the tool inward (7.1.2), and halving. Gap, friction and stops are drawn as in the "
        "environment. A healthy twin gives the reference in every pose.",
        f"With the direction of lowest correlation {percent(by[first])} of the searches name the "
        f"right link, with the change of transmission {percent(by[second])}; a blind guess names "
        f"{percent(1 / n)}. "
        "The order of the joints hardly matters for that; it decides on the moves: "
        f"{moves['outward']:.1f} outward, {moves['inward']:.1f} inward and "
        f"{moves['bisection']:.1f} halving, where {expected:.2f} are expected one by one and "
        f"{np.log2(n):.0f} by halving.",
    ]


def _search_table(found: Found) -> Table:
    rows = []
    for (name, order), runs in found.items():
        low, high = _interval(runs)
        rows.append(
            (
                f"{name}, {order}",
                f"{percent(_share(runs))}",
                f"{percent(low)} to {percent(high)}",
                f"{np.mean([s.moves for s in runs]):.2f}",
            )
        )
    return Table(
        caption=f"Searches for the loose link of {ARMS} planar arms with {LINKS} links",
        columns=("direction by, order", "right", "95 % interval", "moves"),
        rows=tuple(rows),
    )


def _card(found: Found) -> FigureCard:
    points = []
    for name in ESTIMATORS:
        ends = [_interval(found[name, order]) for order in ORDERS]
        points.append(
            Points(
                name=name,
                values=[100 * _share(found[name, order]) for order in ORDERS],
                low=[100 * e[0] for e in ends],
                high=[100 * e[1] for e in ends],
            )
        )
    return FigureCard(
        title="Right links by order and estimator",
        image=by_category(points, ORDERS, ylabel="right link [%]", xlabel="order of the joints"),
        caption="Share of searches that name the right link, with the 95 % interval.",
    )
