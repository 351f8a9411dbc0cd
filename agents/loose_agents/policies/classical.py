"""Classical-method agents: directions of motion change pooled over poses, at tool and links.

The steps of 4.2.2: shake, find the direction in which motion is not passed on, move one joint,
shake again, see whether the direction turned, repeat. The direction is that of the change of
motion against the nominal arm (3.34), and every judgement uses all poses so far.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import EpisodeAgent, Problem, hypothesis_prior
from loose_agents.belief import links_from
from loose_env.diagnosis import (
    Order,
    PlaceDirections,
    PooledScatter,
    RecordScatter,
    RecordStatistics,
    SeatCoverage,
    SensedPlaces,
    SensorFloor,
    ToolFrames,
    fault_locations,
    next_joint,
    shape_of_motion,
)
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.faults import UNSURE
from loose_env.io import Checked, NonNegative, Positive, Probability
from loose_env.typing import Array
from loose_env.wrappers import record_from

_TRIED = 8
"""Random moves of which the best is taken."""


class SeatSearch:
    """Chooses records while nothing is seen, and says when to stop searching.

    Weights (P, F) are probabilities of places of the coverage and of their frictions.
    """

    def __init__(self, problem: Problem) -> None:
        rules = problem.settings
        usual = difficulty_named(rules.difficulty)
        self.problem = problem
        self.coverage = SeatCoverage(problem.linear, usual.friction, usual.friction_over)
        prior = hypothesis_prior(problem.hypotheses, usual.probabilities(rules.kinds))
        known = dict(zip(problem.hypotheses, prior, strict=True))
        self.prior = self.spread([known.get(name, 0.0) for name in fault_locations(problem.arm)])
        """Weights before any record (P, F)."""
        self._healthy = known.get("healthy", 0.0)

    def spread(self, weights: Array | list[float]) -> Array:
        """Spread weights of a slide of each link and play in each joint (2 n,) over (P, F)."""
        n, count, frictions = self.problem.arm.n, len(self.coverage.axes), self.coverage.frictions
        given = np.asarray(weights, dtype=float)
        places = np.concatenate([np.repeat(given[:n] / count, count), given[n:]])
        return np.repeat(places[:, None] / frictions, frictions, axis=1)

    def next(
        self, rng: np.random.Generator, pose: Array, levels: NDArray[np.intp], weights: Array
    ) -> tuple[NDArray[np.intp], float]:
        """Moves (n,) to the pose, of some at random, in which most seats open, and how many do."""
        steps, joints = self.problem.actions.steps, np.arange(self.problem.arm.n)
        tried = [self.problem.random_moves(pose, rng) for _ in range(_TRIED)]
        poses = [pose + steps[joints, moves] for moves in tried]
        opened = [
            float(np.sum(weights * self.shown(there, self.excited(there, levels, weights))))
            for there in poses
        ]
        best = int(np.argmax(opened))
        return tried[best], opened[best]

    def excited(self, pose: Array, levels: NDArray[np.intp], weights: Array) -> NDArray[np.intp]:
        """Levels (n,) with as many joints on as the rules allow, those that open most seats."""
        most, n = self.problem.actions.most_excited, len(levels)
        if most >= n:
            return levels
        alone = [np.where(np.arange(n) == joint, levels, 0) for joint in range(n)]
        opened = [float(np.sum(weights * self.shown(pose, one))) for one in alone]
        chosen = np.argsort(-np.array(opened), kind="stable")[:most]
        return np.where(np.isin(np.arange(n), chosen), levels, 0)

    def shown(self, pose: Array, levels: NDArray[np.intp]) -> Array:
        """Probability that a record shows each seat (P, F)."""
        return self.coverage.shown(pose, np.array([0.0, *self.problem.arm.levels])[levels])

    def pays(self, missed: Array, opened: float, duration: float) -> bool:
        """Tell whether a further record is worth its price."""
        prices = self.problem.settings.prices
        named = next(name for name in self.problem.hypotheses if name != "healthy")
        better = prices.correct - prices.verdict("healthy", named)
        most = min(self.problem.actions.most_excited, self.problem.arm.n)
        price = prices.record + prices.second * duration
        price += prices.level * most * len(self.problem.arm.levels)
        found = opened / (self._healthy + float(missed.sum()))
        return bool(found * better > price)


Level = Literal["top", "falling"]
"""Choice of the excitation's level."""

_TURN = np.radians(15.0)
"""Turn that the joint of the order must promise; else any joint may move [rad]."""
_SAME = np.radians(6.0)
"""Angle below which no move tells two places apart [rad]: mounting and leakage make 2 to 3."""


@dataclass(frozen=True, kw_only=True)
class ClassicalSettings(Checked):
    """Order of the joints, excitation, and thresholds of the decisions.

    The source prints no figures for its thresholds. The search on training episodes begins with
    the defaults; what it finds ships for each class of arms, see `arm_class`.
    """

    order: Order = "bisection"
    """Order of the joints: from the base out, from the tool in, or halving."""
    level: Level = "top"
    """The top level, which opens the most seats; or falling to the next lower one while nothing
    shows, so that seats that only hit their stops are seen."""
    duration: int = 2
    """Index of the records' length; the longest by default."""
    significance: Probability = 0.01
    """Probability that errors alone make the change seen, below which something is loose [1]."""
    clear: Positive = 5.0
    """Scatter above the best place's from which a place is ruled out, chi-square [1]."""
    outlier: Positive = 42.5
    """Scatter at which a record begins to count as an outlier, chi-square [1]."""
    line: Positive = 8.0
    """Rms angle to a joint's line up to which a slide is taken for play in it (3.4) [deg]."""
    driven: NonNegative = 3.0
    """Scatter between play in a joint and the best slide up to which a further record, with that
    joint alone driven, tells the two apart by the shape of its motion (3.4); 0 for none [1]."""


def arm_class(problem: Problem) -> Literal["planar", "spatial", "bending"]:
    """Class of arms that share one set of settings.

    Thresholds are in units of errors and serve all arms of a class. In space more directions vie
    for a change than in the plane; on an arm whose links, gears or held joints give way, errors go
    beyond the first order.
    """
    if len(problem.linear.flexible_dofs) > 0 or problem.arm.hold != "brake":
        return "bending"
    return "planar" if len(problem.arm.axes) == 2 else "spatial"


@dataclass
class Search:
    """State of one search."""

    rng: np.random.Generator
    pool: PooledScatter
    level: int
    missed: Array
    """Weights of the seats that no record has shown, see `SeatSearch` (P, F)."""
    tried: list[tuple[float, int]] = field(default_factory=list)
    """What each of them added to the gain, and its level."""
    driven: int | None = None
    """Joint driven alone in the latest record, to tell its play from a slide, from 0."""
    left: tuple[str, ...] = ()
    """Places that the scatter leaves, best first; empty while nothing is seen."""
    moved: int | None = None
    """Joint that was moved last, from 1; None for several or none."""


class ClassicalAgent(EpisodeAgent):
    """Link finding with directions of change, pooled over poses (3.34, 3.4, 4.2.2)."""

    def __init__(
        self, problem: Problem, settings: ClassicalSettings | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(problem, seed=seed)
        self.settings = ClassicalSettings() if settings is None else settings
        rules = problem.settings
        self.frames = ToolFrames(problem.arm)
        mismatch = difficulty_named(rules.difficulty).mismatch
        self.places = PlaceDirections(problem.linear, rules.sensors, mismatch)
        self.floor = SensorFloor.of(rules.sensors, problem.arm.band)
        self.among = np.array([name in problem.hypotheses for name in self.places.names])
        if not self.among.any():
            raise InvalidSetting(
                "link finding needs structural looseness or backlash among the hypotheses, got "
                f"{problem.hypotheses}"
            )
        self.search = SeatSearch(problem)

    def begin(self, rng: np.random.Generator) -> Any:
        """Start with every place in question, at the top level."""
        return Search(
            rng=rng,
            pool=PooledScatter.none(self.places, outlier=self.settings.outlier),
            level=len(self.problem.arm.levels),
            missed=self.search.prior,
        )

    def act(self, observation: NDArray[np.float32], memory: Search) -> NDArray[np.int64]:
        """Process the latest record, then move on or decide."""
        problem, settings = self.problem, self.settings
        taken, most = problem.layout.records_of(observation), problem.settings.max_records
        pose = problem.layout.pose_of(observation)
        if taken == 0:  # steps 1 and 2
            return self._measure(memory, pose, self.problem.stay)
        if memory.driven is not None:
            return problem.verdict(self._by_shape(observation, taken - 1, memory))
        self._look(observation, taken - 1, memory)
        if not memory.pool.stands_out(settings.significance, memory.rng):
            memory.left, memory.moved = (), None
            if settings.level == "falling":
                memory.level = 1 + (memory.level - 2) % len(problem.arm.levels)
            seconds = problem.settings.durations[self._duration]
            moves, opened = self.search.next(memory.rng, pose, self._levels(memory), memory.missed)
            if taken >= most or not self.search.pays(memory.missed, opened, seconds):
                return problem.verdict("healthy")
            return self._measure(memory, pose, moves)
        memory.level = max(memory.tried)[1]
        left = self._left(memory.pool)
        memory.left = tuple(memory.pool.names[k] for k in left)
        move = self._next(pose, memory.pool, left) if len(left) > 1 and taken < most else None
        if move is None:
            named = self._as_play(memory, int(left[0]))
            memory.driven = self._in_doubt(memory, int(left[0]), named) if taken < most else None
            if memory.driven is None:
                return problem.verdict(memory.pool.names[named])
            memory.moved = None
            return self._measure(memory, pose, self.problem.stay)
        moves = self.problem.stay
        moves[move[0]] = move[1]
        memory.moved = move[0] + 1
        return self._measure(memory, pose, moves)

    def _look(self, observation: NDArray[np.float32], slot: int, memory: Search) -> None:
        """Add a record to the pool; an empty slot adds nothing."""
        record = record_from(self.problem.layout, observation, slot)
        if record is None:
            return
        seen = self._scatter(observation, slot, record)
        before = memory.pool.gain
        memory.pool = memory.pool.after(seen)
        memory.tried.append((memory.pool.gain - before, memory.level))

    def _scatter(
        self, observation: NDArray[np.float32], slot: int, record: RecordStatistics
    ) -> RecordScatter:
        """Hold a record, in a slot of the observation, against all places."""
        return self.places.of(record)

    def _left(self, pool: PooledScatter) -> NDArray[np.intp]:
        """Places that the scatter of all poses leaves, best first (steps 6 and 7)."""
        scatter = np.where(self.among, pool.by_hypothesis, np.inf)
        order = np.argsort(scatter, kind="stable")
        near = scatter[order] < scatter[order[0]] + self.settings.clear
        return np.asarray(order[near], dtype=np.intp)

    def _as_play(self, memory: Search, best: int) -> int:
        """The joint to whose line a slide has kept in every pose, else the slide itself.

        Motion in one dimension, the driven joint's own, is play in that joint (3.4).
        """
        n, count = self.problem.arm.n, len(memory.pool.axes)
        if best >= n:
            return best
        slides = memory.pool.scatter[best * count : (best + 1) * count]
        shown = np.stack([record.directions for record in memory.pool.records])  # (T, P, d)
        slide, lines = shown[:, best * count + int(slides.argmin())], shown[:, n * count :]
        off = np.sqrt(np.mean(_angle(np.einsum("tjd,td->tj", lines, slide)) ** 2, axis=0))
        off[~self.among[n:]] = np.inf
        joint = int(np.argmin(off))
        return n + joint if off[joint] <= np.radians(self.settings.line) else best

    def _in_doubt(self, memory: Search, best: int, named: int) -> int | None:
        """Joint, from 0, whose play a record with it alone driven may tell from a slide."""
        n = self.problem.arm.n
        scatter = np.where(self.among, memory.pool.by_hypothesis, np.inf)
        play = named if named >= n else n + int(scatter[n:].argmin())
        near = abs(scatter[play] - scatter[:n].min()) < self.settings.driven
        return play - n if near or (named != best and self.settings.driven > 0) else None

    def _by_shape(self, observation: NDArray[np.float32], slot: int, memory: Search) -> str:
        """Verdict between play in the driven joint and the best slide."""
        assert memory.driven is not None
        n, names = self.problem.arm.n, memory.pool.names
        slide = int(np.where(self.among[:n], memory.pool.by_hypothesis[:n], np.inf).argmin())
        record = record_from(self.problem.layout, observation, slot)
        if record is None or not record.excited.any():
            return names[slide]
        shape = shape_of_motion(record, self.problem.linear.at(record.pose), self.floor)
        return names[n + memory.driven if shape.is_play() else slide]

    def _next(
        self, pose: Array, pool: PooledScatter, left: NDArray[np.intp]
    ) -> tuple[int, int] | None:
        """Joint, from 0, and its move that split the places left; None if none does (step 3).

        The joint of the order moves if it turns the best place's direction against another's,
        else the one that does so most.
        """
        n, steps = self.problem.arm.n, self.problem.actions.steps
        allowed = self.problem.actions.allowed_moves(pose)
        # Joint 1 carries the whole arm along and turns nothing in the tool frame.
        options = [
            (j, int(k))
            for j in range(1, n)
            for k in np.flatnonzero(allowed[j])
            if abs(steps[j, k]) > 1e-6
        ]
        if not options:
            return None
        where = np.array([pose + steps[j, k] * (np.arange(n) == j) for j, k in options])
        slides = np.einsum("ckij,kj->cki", self.frames.images(where), pool.directions)
        shown = np.concatenate([slides, self.frames.unit_lines(where)], axis=1)[:, left]
        split = _angle(np.einsum("cpi,ci->cp", shown[:, 1:], shown[:, 0]))
        most = split.max(axis=1)
        links = 1 + left % n
        low, high = int(links.min()), int(links.max())
        wanted = next_joint(self.settings.order, low, high) - 1 if low < high else -1
        mine = (np.array([j for j, _ in options]) == wanted) & (most >= _TURN)
        # Beyond 30 degrees two directions are told apart, and more is no better.
        worth = np.minimum(split, np.radians(30.0)).sum(axis=1)
        best = int(np.argmax(np.where(mine, worth, -1.0) if mine.any() else worth))
        return options[best] if most[best] >= _SAME else None

    @property
    def _duration(self) -> int:
        return min(self.settings.duration, len(self.problem.settings.durations) - 1)

    def _levels(self, memory: Search) -> NDArray[np.intp]:
        """Levels of all joints, from 1."""
        return np.full(self.problem.arm.n, memory.level, dtype=np.intp)

    def _measure(self, memory: Search, pose: Array, moves: NDArray[np.intp]) -> NDArray[np.int64]:
        n = self.problem.arm.n
        there = pose + self.problem.actions.steps[np.arange(n), moves]
        levels = self._levels(memory)
        if memory.driven is not None:
            levels[np.arange(n) != memory.driven] = 0
        else:
            known = memory.pool.names
            asked = self.search.spread([float(name in memory.left) for name in known])
            weights = asked if memory.left else memory.missed
            levels = self.search.excited(there, levels, weights)
        memory.missed = memory.missed * (1.0 - self.search.shown(there, levels))
        return self.problem.actions.encode(moves=moves, levels=levels, duration=self._duration)


def _angle(cosine: Array) -> Array:
    """Angle between axes from the cosine [rad]."""
    return np.asarray(np.arccos(np.minimum(np.abs(cosine), 1.0)))


class LocalAgent(ClassicalAgent):
    """Link finding by the change of motion at the tool and on the links."""

    places: SensedPlaces

    def __init__(
        self, problem: Problem, settings: ClassicalSettings | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(problem, settings, seed=seed)
        rules = problem.settings
        mismatch = difficulty_named(rules.difficulty).mismatch
        self.places = SensedPlaces(problem.linear, rules.sensors, mismatch)

    def _scatter(
        self, observation: NDArray[np.float32], slot: int, record: RecordStatistics
    ) -> RecordScatter:
        return self.places.with_links(record, links_from(self.problem.layout, observation, slot))

    def _as_play(self, memory: Search, best: int) -> int:
        """The best place itself: play turns all beyond its joint, a slide shifts it."""
        return best


class BlindAgent(EpisodeAgent):
    """Gives the same verdict on every arm, whatever the record shows."""

    def __init__(self, problem: Problem, verdict: str, *, seed: int = 0) -> None:
        super().__init__(problem, seed=seed)
        self.verdict = verdict

    def begin(self, rng: np.random.Generator) -> Any:
        """Keep nothing."""
        return ()

    def act(self, observation: NDArray[np.float32], memory: Any) -> NDArray[np.int64]:
        """Take the cheapest records until the verdict counts; then give it."""
        problem = self.problem
        taken = problem.layout.records_of(observation)
        unsure = problem.actions.allows_unsure(taken, taken)
        if taken and (self.verdict != UNSURE or unsure):
            return problem.verdict(self.verdict)
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[0] = 1
        shortest = int(np.argmin(problem.settings.durations))
        return problem.actions.encode(levels=levels, duration=shortest)
