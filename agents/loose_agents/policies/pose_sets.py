"""Pose sets: rules that choose the poses of a diagnosis, and trials of their accuracy.

All rules play the same excitation, so that the choice of poses stands alone. Every block of cases
can be worked out alone and anywhere: all that is random in case k comes from streams of its own,
the same for every rule.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp

from loose_agents.base import Agent, Problem
from loose_agents.belief import Policy, Situation, Tracker
from loose_agents.registry import make_agent
from loose_env.arms import Arm, planar, six_axis
from loose_env.diagnosis import (
    PLANNED,
    Belief,
    DirectionSighting,
    FaultPosterior,
    LinkPosterior,
    PoseSets,
    ToolFrames,
    bingham_width,
    candidate_poses,
    choose_move,
    choose_open_move,
    direction_limit,
    fault_locations,
    link_posterior,
    log_mean_bingham,
    scattered_axes,
)
from loose_env.envs import DiagnosisSettings, EpisodeBatch
from loose_env.errors import InvalidSetting
from loose_env.faults import StructuralLooseness
from loose_env.typing import Array

Excited = Literal["all", "first"]
"""Joints that are shaken, at the top level: all of them, or joint 1."""


def levels_for(problem: Problem, excited: Excited) -> NDArray[np.intp]:
    """Level of every joint (n,)."""
    if excited not in ("all", "first"):
        raise InvalidSetting(f"excited joints are 'all' or 'first', got {excited!r}")
    top = len(problem.arm.levels)
    levels = np.full(problem.arm.n, top, dtype=np.intp)
    if excited == "first":
        levels[1:] = 0
    return levels


def nearest_moves(problem: Problem, pose: ArrayLike, target: ArrayLike) -> NDArray[np.intp]:
    """Move of each joint that brings it nearest to a target, within limits (n,).

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.envs import DiagnosisSettings
    >>> problem = Problem.of(planar(2), DiagnosisSettings())
    >>> problem.actions.moves[nearest_moves(problem, [0.0, 2.0], [0.9, 9.0])].round(2).tolist()
    [0.79, 0.0]
    """
    q, wanted = np.asarray(pose, dtype=float), np.asarray(target, dtype=float)
    actions = problem.actions
    miss = q[:, None] + actions.steps - wanted[:, None]
    for j, limits in enumerate(problem.arm.joint_ranges):
        if limits is None:  # turns without end
            miss[j] = (miss[j] + np.pi) % (2 * np.pi) - np.pi
    # Of equals the smaller move, so that a joint which is there stays there.
    away = np.abs(miss) + 1e-9 * np.abs(actions.steps)
    return np.asarray(np.argmin(np.where(actions.allowed_moves(q), away, np.inf), axis=1))


class PoseSetPolicy:
    """Visits a set of poses in order, by the nearest reachable moves.

    After the last pose it begins again.
    """

    def __init__(self, problem: Problem, poses: ArrayLike, *, excited: Excited = "all") -> None:
        rows = np.asarray(poses, dtype=float)
        n = problem.arm.n
        if rows.ndim != 2 or len(rows) < 1 or rows.shape[1] != n or not np.isfinite(rows).all():
            raise InvalidSetting(
                f"a pose set of {problem.arm.name!r} is one or more rows of {n} finite joint "
                f"positions [rad or m], got shape {rows.shape}"
            )
        self.problem, self.poses = problem, rows
        self.levels = levels_for(problem, excited)

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Go to the next pose of the set."""
        target = self.poses[situation.records % len(self.poses)]
        moves = nearest_moves(self.problem, situation.pose, target)
        return self.problem.actions.encode(moves=moves, levels=self.levels)


class GreedySeparation:
    """Maximises the posterior-weighted separation of the hypotheses' images.

    The first record is taken where the arm stands.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        excited: Excited = "all",
        sd: float = np.radians(8.0),
        candidates: int = 512,
        sight: Callable[[Problem, Situation], LinkPosterior] | None = None,
    ) -> None:
        self.problem, self.sd, self.candidates = problem, sd, candidates
        self.frames = ToolFrames(problem.arm)
        self.levels = levels_for(problem, excited)
        self.sight = image_posterior if sight is None else sight

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Score the reachable moves and choose the best."""
        problem = self.problem
        if situation.records == 0:
            return problem.actions.encode(levels=self.levels)
        where = candidate_poses(
            problem.arm,
            situation.pose,
            problem.actions.moves,
            joints="all",
            sliding=self.frames.slides,
            most=self.candidates,
            rng=situation.rng,
        )
        target = choose_open_move(
            self.frames,
            problem.linear,
            self.sight(problem, situation),
            where,
            sd=self.sd,
            level=problem.arm.levels[-1],
        )
        moves = nearest_moves(problem, situation.pose, target)
        return problem.actions.encode(moves=moves, levels=self.levels)


def image_posterior(problem: Problem, situation: Situation) -> LinkPosterior:
    """Convert the tracker's belief to the input of the move selection."""
    belief = getattr(situation.memory, "belief", None)
    if belief is None:
        raise InvalidSetting(
            "the estimator's memory holds no belief about directions; use "
            "loose_agents.belief.Tracker or give another `sight`"
        )
    names, n = fault_locations(problem.arm), problem.arm.n
    weights = dict(zip(problem.hypotheses, situation.probabilities, strict=True))
    probabilities = np.array([weights.get(name, 0.0) for name in names])
    if probabilities.sum() <= 0:  # all weight on what has no direction
        probabilities = np.ones(len(names))
    axes = belief.directions
    shares = np.array([belief.by_direction(link) for link in range(1, n + 1)])
    values, vectors = np.linalg.eigh(np.einsum("ka,ai,aj->kij", shares, axes, axes))
    across = vectors[:, :, :-1]
    return LinkPosterior(
        names=names,
        probabilities=probabilities / probabilities.sum(),
        log_likelihoods=np.log(np.maximum(probabilities, 1e-300)),
        directions=vectors[:, :, -1],
        covariances=np.einsum("kia,ka,kja->kij", across, values[:, :-1], across),
    )


class MovesOf:
    """Copies another agent's moves, at the common excitation.

    Where that agent would give a verdict the arm stays. One instance plays one episode.
    """

    def __init__(self, problem: Problem, agent: Agent, *, excited: Excited = "all") -> None:
        self.problem, self.agent = problem, agent
        self.levels = levels_for(problem, excited)
        self._state: Sequence[Any] | None = None

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Query the other agent and use its moves."""
        start = np.array([situation.records == 0])
        actions, self._state = self.agent.predict(
            situation.observation[None], self._state, start, deterministic=True
        )
        moves = self.problem.actions.decode(np.asarray(actions)[0]).moves
        return self.problem.actions.encode(moves=moves, levels=self.levels)


Row = dict[str, Any]

ARMS: dict[str, Callable[[], Arm]] = {
    **{f"planar{n}": functools.partial(planar, n) for n in range(2, 8)},
    "six_axis": six_axis,
}
GREEDY, LIMIT = "greedy separation", "limit"
MOVES = np.radians([m for m in range(-90, 91, 15) if m])
"""Moves of a hinge at the level of directions [rad]."""


@dataclass(frozen=True, kw_only=True)
class Directions:
    """Directions with a stated scatter."""

    arms: tuple[str, ...] = tuple(ARMS)
    sds: tuple[float, ...] = (5.0, 10.0, 20.0)
    """Standard deviations of a direction [deg]."""
    cases: int = 400
    poses: int = 7
    block: int = 50
    """Cases that are worked on together; changes no figure."""
    samples: int = 40_000
    """Draws for each limit."""
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class Records:
    """Simulated records."""

    arms: tuple[str, ...] = tuple(ARMS)
    difficulty: str = "default"
    cases: int = 400
    poses: int = 7
    block: int = 50
    excited: Excited = "all"
    engine: str = "mujoco"
    learned: tuple[str, ...] = ()
    """Agents of the registry whose moves are played as well."""
    seed: int = 0

    def rules(self) -> DiagnosisSettings:
        """Rules of the environment with its default settings."""
        rules = DiagnosisSettings(difficulty=self.difficulty)
        return rules if self.engine == "mujoco" else replace(rules, engine=self.engine)  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True)
class Task:
    """Block of cases for one strategy on one arm."""

    arm: str
    strategy: str
    first: int
    cases: int

    def __str__(self) -> str:
        """Return a description, for messages."""
        return f"{self.strategy} on {self.arm}, cases from {self.first}"


@functools.cache
def sets_of(arm: str, moves: tuple[float, ...]) -> PoseSets:
    """Factory of pose sets that caches pose scores."""
    return PoseSets(ARMS[arm](), moves=np.array(moves))


def stream(seed: int, arm: str, case: int, *kind: int) -> np.random.Generator:
    """Generator of one kind of draw of one case, common to strategies and workers."""
    key = (list(ARMS).index(arm), case, *kind)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def link_log_likelihoods(images: Array, seen: Array, width: float) -> Array:
    """Log-likelihood of each link after each pose; vectorised `link_posterior`."""
    d = seen.shape[-1]
    across = (np.eye(d) - seen[..., :, None] * seen[..., None, :]) / width**2
    carried = np.einsum("ctkia,ctij,ctkjb->ctkab", images, across, images).cumsum(axis=1)
    alone = np.cumsum(log_mean_bingham(across), axis=1)
    return np.asarray(log_mean_bingham(carried) - alone[..., None])


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Case of a loose link whose direction is observed with scatter."""

    link: int
    direction: Array
    start: Array

    @classmethod
    def draw(cls, sets: PoseSets, rng: np.random.Generator) -> Case:
        """Sample link, direction in the link frame, and initial pose."""
        z = rng.standard_normal(sets.frames.dimension)
        link = 1 + int(rng.integers(sets.arm.n))
        start = sets.arm.random_pose(rng)
        return cls(link=link, direction=z / np.linalg.norm(z), start=start)

    def seen(self, images: Array, width: float, rng: np.random.Generator) -> Array:
        """Observed axes for given images (poses, n, d, d)."""
        return scattered_axes(images[:, self.link - 1] @ self.direction, width, rng)


def greedy_poses(
    sets: PoseSets, case: Case, count: int, sd: float, rngs: Sequence[np.random.Generator]
) -> Array:
    """Maximise the separation of the candidate links' images, pose by pose."""
    frames, width = sets.frames, bingham_width(sd, sets.frames.dimension)
    noise, draw = rngs
    n = sets.arm.n
    prior = np.concatenate([np.ones(n), np.zeros(n)])
    poses, sightings = [case.start], []
    while len(poses) < count:
        seen = case.seen(frames.images(poses[-1]), width, noise)[0]
        sightings.append(DirectionSighting.of(poses[-1], seen, width))
        known = link_posterior(frames, sightings, prior=prior)
        where = candidate_poses(
            sets.arm, poses[-1], MOVES, joints="all", sliding=frames.slides, most=192, rng=draw
        )
        poses.append(where[choose_move(frames, known, where, sd=sd)[0][0]])
    return np.array(poses)


def directions_block(task: Task, settings: Directions) -> list[Row]:
    """Number of correctly identified links after each pose, for each scatter."""
    sets = sets_of(task.arm, tuple(MOVES))
    frames, count, seed = sets.frames, settings.poses, settings.seed
    numbers = range(task.first, task.first + task.cases)
    cases = [Case.draw(sets, stream(seed, task.arm, k, 0)) for k in numbers]
    links = np.array([case.link for case in cases])
    chosen: list[Array] = []
    rows = []
    for part, degrees in enumerate(settings.sds):
        sd = float(np.radians(degrees))
        if task.strategy == GREEDY:
            chosen = [
                greedy_poses(
                    sets,
                    case,
                    count,
                    sd,
                    [stream(seed, task.arm, k, kind, part) for kind in (2, 3)],
                )
                for k, case in zip(numbers, cases, strict=True)
            ]
        elif not chosen:  # laid out once for every scatter
            chosen = [
                sets.make(task.strategy, case.start, count, stream(seed, task.arm, k, 1))
                for k, case in zip(numbers, cases, strict=True)
            ]
        width = bingham_width(sd, frames.dimension)
        images = np.array([frames.images(poses) for poses in chosen])
        # Pose by pose, so that the greedy choice sees the axes that it is judged by.
        seen = []
        for k, case, image in zip(numbers, cases, images, strict=True):
            noise = stream(seed, task.arm, k, 2, part)
            seen.append([case.seen(image[t : t + 1], width, noise)[0] for t in range(count)])
        log = link_log_likelihoods(images, np.array(seen), width)
        # A fair draw among equals, or one link would be favoured before anything is known.
        ties = np.array([stream(seed, task.arm, k, 4).random(sets.arm.n) for k in numbers])
        named = 1 + np.argmax(log + 1e-7 * ties[:, None], axis=2)
        right = (named == links[:, None]).sum(axis=0)
        rows.append(
            asdict(task) | {"links": sets.arm.n, "sd": degrees, "right": [int(r) for r in right]}
        )
    return rows


def limit_rows(settings: Directions) -> list[Row]:
    """Theoretical limits for each arm and scatter."""
    rows = []
    for name in settings.arms:
        arm = ARMS[name]()
        for degrees in settings.sds:
            # One stream for all arms: the limits differ by what is asked, not by sampling error.
            rng = np.random.default_rng([settings.seed, 99])
            best = direction_limit(
                arm.n,
                settings.poses,
                float(np.radians(degrees)),
                len(arm.axes),
                rng,
                samples=settings.samples,
            )
            rows.append(
                {
                    "arm": name,
                    "strategy": LIMIT,
                    "links": arm.n,
                    "sd": degrees,
                    "share": [float(b) for b in best],
                }
            )
    return rows


def policy_for(task: Task, problem: Problem, settings: Records, start: Array, k: int) -> Policy:
    """Make the policy of one episode."""
    if task.strategy == GREEDY:
        return GreedySeparation(problem, excited=settings.excited)
    if task.strategy in PLANNED:
        sets = sets_of(task.arm, tuple(problem.actions.moves[problem.actions.moves != 0]))
        rng = stream(settings.seed, task.arm, k, 5)
        poses = sets.make(task.strategy, start, settings.poses, rng)
        return PoseSetPolicy(problem, poses, excited=settings.excited)
    agent = make_agent(task.strategy, problem, seed=settings.seed)
    return MovesOf(problem, agent, excited=settings.excited)


def records_block(task: Task, settings: Records) -> list[Row]:
    """Correct links after each record, also given direction and friction.

    The latter is worked out from the same records beside the episode; no strategy sees it.
    """
    arm, rules = ARMS[task.arm](), settings.rules()
    problem = Problem.of(arm, rules)
    tracker = Tracker(problem)
    batch = EpisodeBatch(arm, rules, num=task.cases, threads=1)
    links = [f"structural_looseness@link{i}" for i in range(1, arm.n + 1)]
    place = [problem.hypotheses.index(name) for name in links]
    truth, policies, rngs, secrets = [], [], [], []
    for slot in range(task.cases):
        k = task.first + slot
        truth.append(k % arm.n)
        batch.start(slot, seed=settings.seed, number=k, options={"fault": links[k % arm.n]})
        hidden = batch.episode(slot)
        assert isinstance(hidden.fault, StructuralLooseness)
        drive = batch.sampler.drive.slide(hidden.fault.link, hidden.fault.direction)
        direction = np.array(hidden.fault.direction)[: len(arm.axes)]
        secrets.append((direction, hidden.fault.friction / drive))
        pose = problem.layout.pose_of(batch.observe(slot))
        policies.append(policy_for(task, problem, settings, pose, k))
        rngs.append(stream(settings.seed, task.arm, k, 6))
    memories = [tracker.begin() for _ in truth]
    among = np.full((task.cases, arm.n), 1 / arm.n)
    right, informed = [], []
    running = list(range(task.cases))
    for t in range(settings.poses):
        actions = []
        for slot in running:
            observation = batch.observe(slot)
            shares = np.zeros(len(problem.hypotheses))
            shares[place] = among[slot]
            situation = Situation(
                observation=observation,
                pose=problem.layout.pose_of(observation),
                records=t,
                probabilities=shares,
                memory=memories[slot],
                rng=rngs[slot],
            )
            actions.append(policies[slot].choose(situation))
        outcomes = batch.step(running, actions)
        # A record that failed ends its episode; what was known before it stands.
        running = [s for s, o in zip(running, outcomes, strict=True) if not o.truncated]
        for slot in running:
            # It is known that a link is loose, not which: the other hypotheses do not count.
            found = tracker.follow(batch.observe(slot), memories[slot])[place]
            among[slot] = found / found.sum() if found.sum() > 0 else 1 / arm.n
        right.append(int(np.sum(np.argmax(among, axis=1) == truth)))
        named = [
            int(np.argmax(informed_links(tracker.posterior, m.belief, *known)))  # type: ignore[arg-type]
            for m, known in zip(memories, secrets, strict=True)
        ]
        informed.append(int(np.sum(np.array(named) == truth)))
    failed = task.cases - len(running)
    return [asdict(task) | {"links": arm.n, "right": right, "informed": informed, "failed": failed}]


def informed_links(
    posterior: FaultPosterior, belief: Belief, direction: Array, friction: float
) -> Array:
    """Log-weight of each link given the slide's direction and friction.

    Neither says which link it is: both are drawn alike for all. Nodes of the posterior's grid near
    the truth count, those half a spacing away for 0.6.
    """
    axes, count = belief.directions, len(belief.directions)
    spacing = np.pi / count if axes.shape[1] == 2 else np.sqrt(2 * np.pi / count)
    angle = np.arccos(np.minimum(np.abs(axes @ direction) / np.linalg.norm(direction), 1.0))
    variants, _, nodes = belief.loose.shape
    low, high = np.log(posterior.settings.friction)
    place = (np.log(friction) - low) / max(high - low, 1e-9) * nodes - 0.5
    near = -2 * ((angle / spacing)[:, None] ** 2 + (np.arange(nodes) - place) ** 2)
    slides = belief.loose[:, : belief.links * count].reshape(variants, belief.links, count, nodes)
    return np.asarray(logsumexp(slides + near, axis=(0, 2, 3)))
