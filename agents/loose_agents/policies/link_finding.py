"""Link-finding agents: the thesis's planar method to the letter, and one by spatial directions.

Of the latter all joints are excited at once: the regression of the tool's motion on theirs takes
them apart, and one record then sees a slide in any direction. Where nothing stands out, the seat
may be held shut by gravity or friction, or hit its stops all the time: the next record is taken in
another pose at another level before the arm is called healthy. Whether something is loose is judged
from all records together, errors of the arm and of its sensors counted once, as the classical
method does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import EpisodeAgent, Problem
from loose_env.diagnosis import (
    ChangeModel,
    ChangeSighting,
    LinkFindingSettings,
    LinkPosterior,
    PlaceDirections,
    PooledScatter,
    RecordStatistics,
    SensorFloor,
    Sighting,
    ToolFrames,
    TurnSearch,
    backlash_joint,
    candidate_poses,
    choose_open_move,
    confusable_faults,
    fault_locations,
    judge_turn,
    link_posterior,
    looks_healthy,
    next_joint,
    predict,
    sight_change,
    stiffness_errors,
)
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation
from loose_env.io import Checked, Count, Probability
from loose_env.wrappers import record_from


@dataclass
class _Search:
    """State of one search."""

    low: int
    high: int
    sightings: list[Sighting] = field(default_factory=list)
    moved: int | None = None
    tries: int = 0


class LinkFindingAgent(EpisodeAgent):
    """Excites one joint, moves the others one by one, tracks the direction (4.2.2)."""

    def __init__(
        self, problem: Problem, settings: LinkFindingSettings | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(problem, seed=seed)
        self.settings = LinkFindingSettings() if settings is None else settings

    def begin(self, rng: np.random.Generator) -> Any:
        """Start with every link as a candidate."""
        return _Search(low=1, high=self.problem.arm.n)

    def act(self, observation: NDArray[np.float32], memory: _Search) -> NDArray[np.int64]:
        """Process the latest record, then move on or decide."""
        problem, settings = self.problem, self.settings
        taken = problem.layout.records_of(observation)
        if taken == 0:
            return self._measure(memory, observation, None)
        seen = self._sighting(observation, taken - 1)
        self._judge(memory, seen)
        memory.sightings.append(seen)
        sightings = memory.sightings
        if len(sightings) == settings.healthy_poses and looks_healthy(sightings, settings):
            return problem.verdict("healthy")
        if memory.low == memory.high and len(sightings) >= settings.healthy_poses:
            return self._decide(memory)
        if taken >= problem.settings.max_records:
            return self._decide(memory)
        if memory.low == memory.high:  # one link only, but still too few poses for healthy
            return self._measure(memory, observation, problem.arm.n)
        joint = next_joint(settings.order, memory.low, memory.high)
        return self._measure(memory, observation, joint)

    def _judge(self, memory: _Search, seen: Sighting) -> None:
        """Narrow the candidate links by the result of the last move."""
        joint = memory.moved
        if joint is None or not memory.low < joint <= memory.high:
            return
        finding = judge_turn(memory.sightings[-1], seen, joint, self.settings)
        if finding == "unclear":
            memory.tries += 1
            if memory.tries <= self.settings.retries:
                return
            # Out of retries: the nearer of the two thresholds decides.
            finding = self._nearer(memory.sightings[-1], seen, joint)  # type: ignore[assignment]
        memory.tries = 0
        if finding == "turned":
            memory.high = joint - 1
        else:
            memory.low = joint

    def _nearer(self, before: Sighting, after: Sighting, joint: int) -> str:
        wide = LinkFindingSettings(still=0.5, turned=np.finfo(float).max)
        return judge_turn(before, after, joint, wide)

    def _decide(self, memory: _Search) -> NDArray[np.int64]:
        problem = self.problem
        if looks_healthy(memory.sightings, self.settings):
            return problem.verdict("healthy")
        joint = backlash_joint(problem.linear, memory.sightings, self.settings)
        if joint is not None:
            return problem.verdict(f"backlash@joint{joint}")
        link = memory.high if self.settings.order == "inward" else memory.low
        return problem.verdict(f"structural_looseness@link{link}")

    def _measure(
        self, memory: _Search, observation: NDArray[np.float32], joint: int | None
    ) -> NDArray[np.int64]:
        """Move one joint to the end of its reach, then excite and measure."""
        problem = self.problem
        moves = problem.stay
        if joint is not None:
            reach = _reach(problem, observation, problem.actions.moves)[joint - 1]
            moves[joint - 1] = _farthest(reach, memory.tries, moves[joint - 1])
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[self.settings.joint - 1] = self.settings.level
        memory.moved = joint
        return problem.actions.encode(moves=moves, levels=levels)

    def _sighting(self, observation: NDArray[np.float32], slot: int) -> Sighting:
        read = self.problem.layout.physical

        def at(name: str) -> NDArray[np.float64]:
            return read(observation, name)[slot]  # type: ignore[no-any-return]

        return Sighting(
            pose=self.problem.layout.record_poses_of(observation)[slot],
            direction=_axial(at("lowest_direction")),
            correlation=float(at("correlation")[0]),
            kurtosis=float(at("lowest_kurtosis")[0]),
            nominal_direction=_axial(at("nominal_lowest_direction")),
            nominal_correlation=float(at("nominal_correlation")[0]),
        )


def _reach(problem: Problem, observation: NDArray[np.float32], steps: Any) -> Any:
    """Turn of a direction that each move of each joint allows, 0 where it is out of range."""
    allowed = problem.actions.allowed_moves(problem.layout.pose_of(observation))
    return np.abs(np.sin(steps)) * allowed


def _farthest(reach: NDArray[np.float64], tries: int, stay: int) -> int:
    """Move of the largest reach; a retry takes the next best one, not to repeat the first."""
    best = np.argsort(-reach, kind="stable")
    best = best[reach[best] > 1e-6]
    return int(best[tries % len(best)]) if len(best) else stay


def _axial(products: NDArray[np.float64]) -> float:
    """Angle of a planar direction from its products xx, xy, yy."""
    xx, xy, yy = products
    return float(0.5 * np.arctan2(2 * xy, xx - yy))


Policy = Literal["images", "turns"]

SURE = 0.95
"""Probability, of a hypothesis and those confusable with it together, at which it stops."""
SEEN = 1.8
"""For turns: change over what errors leave from which a record shows something loose [1]."""
SCALES = (1.0, 2.0, 4.0)
"""Factors by which the directions' standard deviations may be too small."""
CANDIDATES, SHORTLIST = 1024, 12
"""Moves of all joints that are weighed; the best of these by direction alone, looked at again for
what gravity holds shut."""
RULES = LinkFindingSettings()
"""For turns: the order of the joints, and 4.31's thresholds and retries."""


@dataclass(frozen=True, kw_only=True)
class SpaceLinkFindingSettings(Checked):
    """Motion and stopping criteria of the agent."""

    policy: Policy = "images"
    """Predicted images with all joints moving, or turns of one joint judged by 4.31."""
    significance: Probability = 0.01
    """For images: probability at which errors alone make the change of all records, below which
    something is loose [1]."""
    healthy_poses: Count = 5
    """Records that show nothing before the verdict healthy."""


@dataclass
class _DirectionSearch:
    """State of one search."""

    rng: np.random.Generator
    search: TurnSearch
    level: int
    pool: PooledScatter
    sightings: list[ChangeSighting] = field(default_factory=list)
    tried: list[tuple[float, int]] = field(default_factory=list)
    moved: int | None = None


class SpaceLinkFindingAgent(EpisodeAgent):
    """Spatial link finding: measure the direction of looseness, move, repeat (4.2.2)."""

    def __init__(
        self, problem: Problem, settings: SpaceLinkFindingSettings | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(problem, seed=seed)
        self.settings = SpaceLinkFindingSettings() if settings is None else settings
        arm, rules = problem.arm, problem.settings
        self.frames = ToolFrames(arm)
        self.names = fault_locations(arm)
        self.mismatch = difficulty_named(rules.difficulty).mismatch
        self.model = ChangeModel.of(self.mismatch, joints=arm.n)
        self.floor = SensorFloor.of(rules.sensors, arm.band)
        self.places = PlaceDirections(problem.linear, rules.sensors, self.mismatch)
        # Hypotheses that the environment does not hold are left out.
        self.prior = np.array([float(name in problem.hypotheses) for name in self.names])
        if not self.prior.any():
            raise InvalidSetting(
                "link finding by direction needs structural looseness or backlash among the "
                f"hypotheses, got {problem.hypotheses}"
            )

    def begin(self, rng: np.random.Generator) -> Any:
        """Start with every link as a candidate, at the top level."""
        arm = self.problem.arm
        pool = PooledScatter.none(self.places, outlier=1.0)
        return _DirectionSearch(
            rng=rng, search=TurnSearch.over(arm.n), level=len(arm.levels), pool=pool
        )

    def act(self, observation: NDArray[np.float32], memory: _DirectionSearch) -> NDArray[np.int64]:
        """Process the latest record, then move on or decide."""
        problem, settings = self.problem, self.settings
        most = problem.settings.max_records
        taken = problem.layout.records_of(observation)
        if taken == 0:
            return self._measure(memory, self.problem.stay)
        turns = settings.policy == "turns"
        record = record_from(problem.layout, observation, taken - 1)
        if record is not None:
            seen = self._sighting(record)
            visible = seen.excess >= SEEN and np.trace(seen.precision) > 0
            gained = seen.excess
            if turns:
                self._judge(memory, seen, visible)
            else:
                before, memory.pool = memory.pool.gain, memory.pool.after(self.places.of(record))
                gained = memory.pool.gain - before
            memory.tried.append((gained, memory.level))
            # Faint sightings count for the little they say.
            if visible or not turns:
                memory.sightings.append(seen)
        if not memory.sightings or not (
            turns or memory.pool.stands_out(settings.significance, memory.rng)
        ):
            if taken >= min(settings.healthy_poses, most):
                return self._name("healthy", None)
            # Another level, and gravity from another side.
            memory.level = 1 + (memory.level - 2) % len(problem.arm.levels)
            return self._measure(
                memory, problem.random_moves(problem.layout.pose_of(observation), memory.rng)
            )
        memory.level = max(memory.tried)[1]
        if turns:
            return self._by_turns(observation, memory, taken >= most)
        return self._by_images(observation, memory, taken >= most)

    def _by_images(
        self, observation: NDArray[np.float32], memory: _DirectionSearch, last: bool
    ) -> NDArray[np.int64]:
        found = self._posterior(memory)
        if last or found.of(self._alike(found)) >= SURE:
            return self._name(found.best, found)
        arm, actions = self.problem.arm, self.problem.actions
        pose = self.problem.layout.pose_of(observation)
        where = candidate_poses(
            arm,
            pose,
            actions.moves,
            joints="all",
            sliding=self.frames.slides,
            most=CANDIDATES,
            rng=memory.rng,
        )
        sd = self._clearest_sd(memory)
        target = choose_open_move(
            self.frames,
            self.problem.linear,
            found,
            where,
            sd=sd,
            level=arm.levels[memory.level - 1],
            shortlist=SHORTLIST,
        )
        return self._measure(memory, self._moves_to(pose, target))

    def _by_turns(
        self, observation: NDArray[np.float32], memory: _DirectionSearch, last: bool
    ) -> NDArray[np.int64]:
        reach = _reach(self.problem, observation, self.problem.actions.steps)
        joint = memory.search.joint(
            self.frames,
            memory.sightings[-1],
            moves=self.problem.actions.moves,
            rules=RULES,
            can_move=reach.max(axis=1) > 1e-6,
        )
        if joint is None or last:
            return self._decide_by_turns(memory)
        memory.moved = joint
        moves = self.problem.stay
        moves[joint - 1] = _farthest(reach[joint - 1], memory.search.tries, moves[joint - 1])
        return self._measure(memory, moves)

    def _judge(self, memory: _DirectionSearch, seen: ChangeSighting, visible: bool) -> None:
        """Narrow the candidate links by the result of the last move."""
        joint, memory.moved = memory.moved, None
        if joint is None or not memory.sightings:
            return
        before = memory.sightings[-1]
        others = np.delete(seen.pose - before.pose, joint - 1)
        if np.abs(others).max(initial=0.0) > 1e-6:
            return  # the direction before was seen in another pose
        memory.search = memory.search.after(
            self.frames, before, seen, joint=joint, rules=RULES, visible=visible
        )

    def _decide_by_turns(self, memory: _DirectionSearch) -> NDArray[np.int64]:
        """Declare the link, unless one joint's backlash fits every direction better."""
        found = self._posterior(memory)
        slide = f"structural_looseness@link{memory.search.link(RULES)}"
        play = [name for name in self.names if name.startswith("backlash")]
        best = max(play, key=lambda name: found.of([name]))
        explained = found.of([best]) > found.of([slide])
        return self._name(best if explained else slide, found)

    def _name(self, hypothesis: str, found: LinkPosterior | None) -> NDArray[np.int64]:
        """Give a verdict, falling back to the most probable hypothesis available."""
        if hypothesis not in self.problem.hypotheses:
            likely = self.prior if found is None else found.probabilities
            hypothesis = self.names[int(np.argmax(likely))]
        return self.problem.verdict(hypothesis)

    def _posterior(self, memory: _DirectionSearch) -> LinkPosterior:
        return link_posterior(self.frames, memory.sightings, prior=self.prior, scales=SCALES)

    def _alike(self, found: LinkPosterior) -> tuple[str, ...]:
        """Return the best hypothesis and those indistinguishable from it by any move."""
        k = self.names.index(found.best)
        direction = found.directions[k] if k < self.problem.arm.n else None
        return confusable_faults(self.frames, found.best, direction, tolerance=self.model.floor)

    def _clearest_sd(self, memory: _DirectionSearch) -> float:
        """Smallest standard deviation of the directions so far, a right angle at most [rad]."""
        precision = max(np.trace(s.precision) for s in memory.sightings) / (
            self.frames.dimension - 1
        )
        return float(1 / np.sqrt(max(precision, (2 / np.pi) ** 2)))

    def _moves_to(self, pose: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.intp]:
        """Index of each joint's move that leads nearest to a pose."""
        off = np.abs((target - pose)[:, None] - self.problem.actions.steps)
        return np.argmin(off, axis=1).astype(np.intp)  # type: ignore[no-any-return]

    def _measure(self, memory: _DirectionSearch, moves: NDArray[np.intp]) -> NDArray[np.int64]:
        levels = np.full(self.problem.arm.n, memory.level, dtype=np.intp)
        return self.problem.actions.encode(moves=moves, levels=levels)

    def _sighting(self, record: RecordStatistics) -> ChangeSighting:
        """Direction that one record shows."""
        problem, at = self.problem, self.problem.linear.at(record.pose)
        excitation = Excitation(
            torque_rms=tuple(float(t) for t in record.torque),
            duration=record.duration,
            band=problem.arm.band,
        )
        return sight_change(
            record,
            predict(at, excitation, self.floor),
            band=problem.arm.band,
            floor=self.floor,
            model=self.model,
            springs=stiffness_errors(at.alone, record.excited[None], self.mismatch)[0],
        )
