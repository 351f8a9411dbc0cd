"""Compare selection rules for pose sets: accuracy of the loose link, pose by pose.

Two levels. "directions": every pose gives the direction of looseness with a stated scatter, and
the posterior over links is exact; the limit that no choice of poses can pass is drawn in.
"records": simulated records of arms with hidden faults, one analytic posterior and one excitation
for all strategies. Rows are stored block by block; they are the same for any backend and number of
workers.

Usage: python scripts/studies/pose_sets.py [--level directions|records] [--quick]
           [--engine mujoco|reduced] [--learned AGENT ...] [--workers N] [--out FOLDER]
       python scripts/studies/pose_sets.py --level     (draws and prints what is stored)
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from loose_agents.base import Problem
from loose_agents.belief import Policy, Situation, Tracker
from loose_agents.jobs import BackendSettings
from loose_agents.policies.pose_sets import Excited, GreedySeparation, MovesOf, PoseSetPolicy
from loose_agents.registry import make_agent
from scipy.special import logsumexp

from loose_env.arms import Arm, planar, six_axis
from loose_env.cli.command import command, one_of
from loose_env.diagnosis import (
    PLANNED,
    Belief,
    DirectionSighting,
    FaultPosterior,
    PoseSets,
    bingham_width,
    candidate_poses,
    choose_move,
    direction_limit,
    link_posterior,
    log_mean_bingham,
    scattered_axes,
)
from loose_env.envs import DiagnosisSettings, EpisodeBatch
from loose_env.errors import InvalidSetting, LooseEnvError
from loose_env.evaluation import wilson
from loose_env.faults import StructuralLooseness
from loose_env.io import Count
from loose_env.report import AGENTS as PALETTE
from loose_env.report import INK, MUTED
from loose_env.typing import Array
from scripts.charts import DASHED, Curve, Panel, chart, curve, save
from scripts.study import ROOT, Row, read_study, study_rows, write_between

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


STRATEGIES = (*PLANNED, GREEDY)
COLOURS = dict(zip(STRATEGIES, (6, 1, 3, 4, 5, 0, 2), strict=True))
LEVELS = ("directions", "records")
_LIMITS = Task(arm="", strategy=LIMIT, first=0, cases=0)


@dataclass(frozen=True, kw_only=True)
class Options(BackendSettings):
    """Settings of both levels."""

    level: tuple[Annotated[str, one_of(LEVELS)], ...] = LEVELS
    """Levels that are worked out; none: print and draw what is stored."""
    arm: tuple[Annotated[str, one_of(tuple(ARMS))], ...] = tuple(ARMS)
    """Arms."""
    cases: Count | None = None
    """Cases for each arm, scatter and strategy."""
    engine: Literal["mujoco", "reduced"] = "mujoco"
    """Engine of the simulation."""
    excited: Literal["all", "first"] = "all"
    """Excited joints."""
    difficulty: str = "default"
    """Easy, default or hard."""
    learned: tuple[str, ...] = ("ppo",)
    """Agents of the registry; skipped if untrained."""
    seed: int = 0
    """Root of all draws."""
    quick: bool = False
    """A rough look with few cases."""
    out: Path | None = None
    """Folder of rows and figure; docs/figures by default, of a quick run out."""
    afresh: bool = False
    """Work out again what is stored."""


def playable(settings: Records) -> dict[str, list[str]]:
    """For each arm, the learned agents that can play there; says why others cannot."""
    found: dict[str, list[str]] = {name: [] for name in settings.arms}
    for name in settings.arms if settings.learned else ():
        problem = Problem.of(ARMS[name](), settings.rules())
        for agent in settings.learned:
            try:
                make_agent(agent, problem)
            except (LooseEnvError, ValueError, OSError, ImportError) as error:
                print(f"{agent} on {name} is left out: {error}", file=sys.stderr)
            else:
                found[name].append(agent)
    return found


def tasks_of(settings: Directions | Records) -> list[Task]:
    """All blocks, in an order in which a run cut short has a little of everything."""
    further = playable(settings) if isinstance(settings, Records) else {}
    blocks = [
        Task(arm=arm, strategy=s, first=k, cases=min(settings.block, settings.cases - k))
        for k in range(0, settings.cases, settings.block)
        for arm in settings.arms
        for s in (*STRATEGIES, *further.get(arm, []))
    ]
    return blocks if isinstance(settings, Records) else [_LIMITS, *blocks]


def work(task: Task, *, settings: Directions | Records) -> Sequence[Row]:
    """Rows of one block, or the limits of all directions."""
    if isinstance(settings, Records):
        return records_block(task, settings)
    return limit_rows(settings) if task == _LIMITS else directions_block(task, settings)


def task_of(settings: Directions | Records, row: Row) -> Task:
    """Block of a row."""
    if row["strategy"] == LIMIT:
        return _LIMITS
    first = row["first"]
    cases = min(settings.block, settings.cases - first)
    return Task(arm=row["arm"], strategy=row["strategy"], first=first, cases=cases)


def rows_of(
    folder: Path, settings: Directions | Records, backend: BackendSettings, *, afresh: bool = False
) -> list[Row]:
    """Rows of one level."""
    return study_rows(
        path_of(folder, settings),
        tasks_of(settings),
        work,
        partial(task_of, settings),
        script="scripts/studies/pose_sets.py",
        settings=settings,
        order=lambda row: (
            list(ARMS).index(row["arm"]),
            row["strategy"],
            row.get("sd", 0.0),
            row.get("first", 0),
        ),
        unit="blocks",
        backend=backend,
        afresh=afresh,
    )


def path_of(folder: Path, settings: Directions | Records) -> Path:
    """File of the rows of a level."""
    return folder / f"pose_sets_{type(settings).__name__.lower()}.json"


def summed(rows: Sequence[Row]) -> dict[tuple[str, float, str], Row]:
    """Add the blocks up: by arm, scatter (0: records) and strategy."""
    found: dict[tuple[str, float, str], Row] = {}
    for row in rows:
        key = (row["arm"], float(row.get("sd", 0.0)), row["strategy"])
        if row["strategy"] == LIMIT:
            found[key] = row
            continue
        whole = found.setdefault(
            key, {"links": row["links"], "cases": 0, "right": 0, "informed": 0, "failed": 0}
        )
        whole["cases"] += row["cases"]
        whole["failed"] += row.get("failed", 0)
        for name in ("right", "informed"):
            whole[name] = whole[name] + np.array(row.get(name, 0))
    return found


def limit_of(whole: dict[tuple[str, float, str], Row], arm: str, sd: float) -> Array:
    """Limit to draw: that of directions; of records, were direction and friction known."""
    if sd > 0:
        return np.array(whole[arm, sd, LIMIT]["share"])
    own = [row for (name, part, _), row in whole.items() if name == arm and part == 0]
    return np.max([row["informed"] / row["cases"] for row in own], axis=0)  # type: ignore[no-any-return]


# Showing


def strategies_in(whole: dict[tuple[str, float, str], Row]) -> list[str]:
    """Names in the rows, the known ones first."""
    names = {name for _, _, name in whole} - {LIMIT}
    return [s for s in STRATEGIES if s in names] + sorted(names - set(STRATEGIES))


def tables(rows: Sequence[Row]) -> str:
    """Success after 2, 3 and 4 poses as Markdown, a table for each scatter and one for records."""
    whole = summed(rows)
    arms = [a for a in ARMS if any(key[0] == a for key in whole)]
    parts = []
    for sd in sorted({key[1] for key in whole}, key=lambda s: (s == 0, s)):
        here = [a for a in arms if any(key[:2] == (a, sd) for key in whole)]
        own = {key: row for key, row in whole.items() if key[1] == sd}
        counts = {row["cases"] for key, row in own.items() if key[2] != LIMIT}
        least, most = min(counts), max(counts)
        cases = f"{most}" if least == most else f"{least} to {most} (a run cut short)"
        what = f"Directions with a scatter of {sd:g}°" if sd else "Simulated records"
        first = "1 / 2 / 3 / 5" if sd == 0 else "2 / 3 / 4"
        chosen = [int(x) - 1 for x in first.split("/")]
        lines = [
            f"**{what}**: the right link in %, after {first} poses, {cases} cases "
            f"(95 % interval at most ±{100 * _half(least):.1f}).",
            "",
            "| strategy | " + " | ".join(_title(a) for a in here) + " |",
            "| --- |" + " --- |" * len(here),
        ]
        for name in strategies_in(own):
            cells = []
            for a in here:
                row = own.get((a, sd, name))
                share = None if row is None else row["right"] / row["cases"]
                cells.append("" if share is None else _cell(share, chosen))
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        name = "limit" if sd else "direction and friction known"
        cells = [_cell(limit_of(own, a, sd), chosen) for a in here]
        lines.append(f"| *{name}* | " + " | ".join(cells) + " |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _cell(share: Array, chosen: Sequence[int]) -> str:
    return " / ".join(f"{100 * share[t]:.0f}" for t in chosen if t < len(share))


def _half(cases: int) -> float:
    low, high = wilson(cases // 2, cases)
    return (high - low) / 2


def _title(arm: str) -> str:
    return f"{arm.removeprefix('planar')} links" if arm.startswith("planar") else "six-axis arm"


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw success by number of poses: a column an arm, a row a scatter."""
    whole = summed(rows)
    arms = [a for a in ARMS if any(key[0] == a for key in whole)]
    sds = sorted({key[1] for key in whole}, key=lambda s: (s == 0, s))
    colours = {s: PALETTE[k] for s, k in COLOURS.items()}
    panels = [
        Panel(
            title=_title(arm),
            up=f"directions ± {sd:g}°" if sd else "simulated records",
            curves=_curves(whole, arm, sd, colours),
            look={"ylim": (0, 103)},
        )
        for sd in sds
        for arm in arms
    ]
    size = {"columns": len(arms), "width": 1.2 + 2.15 * len(arms), "height": 2.1}
    figure = chart(panels, across="poses; vertical: right link [%]", **size)  # type: ignore[arg-type]
    save(figure, path)


def _curves(
    whole: dict[tuple[str, float, str], Row], arm: str, sd: float, colours: dict[str, str]
) -> list[Curve]:
    """Success of every strategy with its 95 % interval (Wilson), and what bounds it."""
    own = {s: row for (a, part, s), row in whole.items() if (a, part) == (arm, sd) and s != LIMIT}
    if not own:
        return []
    curves = []
    for name in strategies_in(whole):
        if name in own:
            right, cases = own[name]["right"], own[name]["cases"]
            ends = np.array([wilson(int(r), cases) for r in right]).T
            values = 100 * np.vstack([right / cases, ends])
            x = np.arange(1, len(right) + 1)
            curves.append(curve(x, values, name, color=colours.get(name, INK), linewidth=1.5))
    best = limit_of(whole, arm, sd)
    x = np.arange(1, len(best) + 1)
    # One joint at a time, directions perfect: a move settles one link; one of the rest is guessed.
    share = 100 * np.minimum(1.0, x / next(iter(own.values()))["links"])
    return [
        *curves,
        curve(x, 100 * best, "limit", color=INK, linestyle=DASHED),
        curve(x, share, "one joint, perfect directions", color=MUTED, linestyle=":"),
    ]


def evaluate(chosen: Options) -> None:
    """Run the levels, print the tables, write the figure and the tables of the page."""
    directions = Directions(arms=chosen.arm, seed=chosen.seed)
    records = Records(
        arms=chosen.arm,
        difficulty=chosen.difficulty,
        engine=chosen.engine,
        excited=chosen.excited,
        learned=chosen.learned,
        seed=chosen.seed,
    )
    if chosen.quick:
        directions = replace(directions, cases=40, block=20, poses=4, samples=4000)
        records = replace(records, cases=12, block=12, poses=3)
    if chosen.cases is not None:
        directions = replace(directions, cases=chosen.cases)
        records = replace(records, cases=chosen.cases)
    rows: list[Row] = []
    folder = chosen.out or ROOT / ("out" if chosen.quick else "docs/figures")
    both: tuple[Directions | Records, ...] = (directions, records)
    for level, settings in zip(LEVELS, both, strict=True):
        if level in chosen.level:
            rows += rows_of(folder, settings, chosen, afresh=chosen.afresh)
        elif path_of(folder, settings).exists():  # drawn and printed as it was stored
            rows += read_study(path_of(folder, settings))["rows"]
    if not rows:
        raise InvalidSetting(f"no rows lie in {folder}: name a --level")
    draw(rows, folder / "pose_sets.png")
    print(tables(rows))
    if folder == ROOT / "docs/figures":
        write_between(ROOT / "docs/pose_sets.md", tables(rows))
    print(f"\npicture: {folder / 'pose_sets.png'}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the levels asked for, with errors in one line."""
    interrupted = "the same command goes on"
    command("pose_sets", __doc__, Options, evaluate, arguments, interrupted=interrupted)


if __name__ == "__main__":
    main()
