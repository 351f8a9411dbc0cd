"""Compare agents on the same hidden faults: tables, raw rows, and a page if asked.

Usage: python scripts/agents/compare.py --env loose_env/Planar-v0 --agents random classical
--episodes 400

Estimators are crossed with ways of choosing poses by --estimators and --policies; both are named
together as in --agents posterior/random. Agents called name#1, name#2, ... are trainings of one
agent with several seeds.
"""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# One thread each: the order in which threads add up changes the last digit of a row.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np
from loose_agents.base import EVALUATION_SEED, Problem, action_of
from loose_agents.belief import ESTIMATORS
from loose_agents.evaluation import arguments_of, diagnosis_env, problem_of
from loose_agents.jobs import BackendSettings, canonical
from loose_agents.policies.choice import POLICIES
from loose_agents.registry import AGENTS, describe, make_agent
from loose_agents.sharded_play import EvaluationTask, bound_line, play_task
from loose_agents.stored import OWN_WEIGHTS, setting_name, weights_digest, weights_path

import loose_env
from loose_env.arms import unfelt_words
from loose_env.cli.command import command
from loose_env.evaluation import by_agent, configuration_hash, need_format, standings, write_rows
from loose_env.io import Count, NonNegativeCount, written_beside
from loose_env.report import comparison_text

EPISODES = 4000
"""Episodes of a published comparison."""

CLASSICAL = ("classical", "classical_literal", "always_healthy", "always_unsure")
"""Reference first, then what every comparison shows beside it: the method's letter, where the arm
is in the plane, and the constant baselines."""

BOOTSTRAP_SEED = 0
"""Seed of the resamples behind the intervals."""


ABOUT = f"""{__doc__}
Estimators: {", ".join(ESTIMATORS)}. Policies: {", ".join(POLICIES)}. Agents by name:

""" + "\n".join(f"    {name:18} {words}" for name, (_, words) in AGENTS.items())
"""Help of the command."""


@dataclass(frozen=True, kw_only=True)
class Options(BackendSettings):
    """Options of the comparison."""

    env: str = "loose_env/Vera-v0"
    """Environment id."""
    arguments: str = "{}"
    """Its arguments, as JSON."""
    agents: tuple[str, ...] = ()
    """Names as below, estimator/policy, module:Class, path/model.zip, or the folder of an exported
    policy."""
    weights: str | None = None
    """Folder of weights of your own, which go before the shipped ones."""
    estimators: tuple[str, ...] = ()
    """Estimators to cross with the policies."""
    policies: tuple[str, ...] = ()
    """Policies to cross with the estimators."""
    reference: str | None = None
    """Agent whose return is subtracted; default: classical, or the first agent."""
    curve: Count | None = None
    """Play again, K records each: success after 1 to K."""
    episodes: Count = EPISODES
    """Episodes for each agent."""
    seed: NonNegativeCount = EVALUATION_SEED
    """Seed of the episodes."""
    shard: Count = 200
    """Episodes that a worker plays at a time."""
    out: str = "out"
    """Folder of rows and page."""
    keep: bool = False
    """Keep what was played: the same command with further agents plays only these."""
    rows: str = "parquet"
    """Raw rows as parquet or json."""
    dataset: Path | None = None
    """File (.npz) of all steps of these episodes, for offline reinforcement learning."""
    page: bool = False
    """Write a page with pictures too."""


def names_of(options: Options, problem: Problem) -> list[str]:
    """Agents to play: those named, and every estimator with every policy."""
    if bool(options.estimators) != bool(options.policies):
        raise ValueError("--estimators and --policies are crossed: give both or neither")
    crossed = [f"{e}/{p}" for p in options.policies for e in options.estimators]
    named = list(options.agents)
    if not (named or crossed):
        trained = weights_path(f"posterior-{setting_name(problem)}").is_dir()
        usual = ["greedy", "constant"] if trained else ["posterior/greedy"]
        flat = len(problem.arm.axes) == 2
        named = [*usual, "random", *(n for n in CLASSICAL if flat or n != "classical_literal")]
    return list(dict.fromkeys([*named, *crossed]))


def reference_of(options: Options, names: Sequence[str]) -> str | None:
    """Agent that the others are compared with: the classical method, or the first one."""
    if options.reference is not None:
        if options.reference not in names:
            raise ValueError(f"--reference {options.reference} does not play; {list(names)} do")
        return str(options.reference)
    if len(names) < 2:
        return None
    return CLASSICAL[0] if CLASSICAL[0] in names else names[0]


def play(
    names: Sequence[str],
    arguments: Mapping[str, Any],
    options: Options,
    *,
    records: int | None = None,
) -> list[dict[str, Any]]:
    """Let every agent play the same episodes; progress goes to standard error."""
    rows = []
    for name in names:
        made = "" if records is None else f", {records} records each"
        print(f"{name}{made}", file=sys.stderr, flush=True)
        task = EvaluationTask(
            agent=name,
            env_id=options.env,
            arguments=arguments,
            count=options.episodes,
            seed=options.seed,
            records=records,
            threads=0,
        )
        folder = Path(options.out) / "shards"
        rows += play_task(task, folder, settings=options, shard=options.shard, keep=options.keep)
    return rows


def write_page(
    path: Path,
    rows: Sequence[dict[str, Any]],
    forced: Sequence[dict[str, Any]],
    *,
    problem: Problem,
    options: Options,
    notes: str,
    reference: str | None,
    said: Sequence[str],
    engine: str,
) -> Path:
    """Write the page: what was played, who won, tables, figures, one episode in pictures."""
    from loose_env.report import episode_timeline, write_comparison

    best = standings(rows)[0].agent
    told, agent = _told(rows, best), make_agent(best, problem)
    arm, settings = problem.arm, problem.settings
    timeline = episode_timeline(agent, arm, settings, seed=told["seed"], number=told["episode"])
    own = by_agent(rows)
    truths = Counter(row["truth"] for row in own[best])
    return write_comparison(
        path,
        rows,
        title=f"Finding the loose link on {problem.arm.name}",
        played=[
            f"{len(own[best])} arms, each with a fault hidden at random: nothing, a link that "
            "slides on its flange, or a joint with play. Every agent met the same arms. It moved "
            "joints, shook them, saw how the tool followed, and named the fault when it "
            f"was sure. There are {len(problem.hypotheses)} hypotheses. A right verdict earns 1, a "
            f"wrong one loses 1, and every record costs a little. Simulated by {engine}.",
            *(f"{name}: {describe(name)}." for name in own),
        ],
        chance=max(truths.values()) / len(own[best]),
        forced=forced,
        reference=reference,
        rng=np.random.default_rng(BOOTSTRAP_SEED),
        said=said,
        timeline=timeline,
        timeline_agent=best,
        notes=notes,
    )


def write_dataset(
    path: Path, rows: Sequence[dict[str, Any]], env_id: str, arguments: Mapping[str, Any]
) -> Path:
    """Play the episodes of rows again by their actions, and write all steps as arrays.

    One step a row: ``observations``, ``actions``, ``rewards``, ``next_observations``,
    ``terminals``, ``timeouts`` (as D4RL calls them), ``action_masks``, and ``episode_ends``, the
    number of steps up to the end of each episode; beside them its ``agents`` and ``truths``.
    """
    batch = diagnosis_env(env_id, arguments).batch
    steps: dict[str, list[Any]] = defaultdict(list)
    ends = []
    for row in rows:
        batch.start(0, seed=row["seed"], number=row["episode"])
        for code in row["actions"].split():
            action = action_of(batch.actions, code)
            steps["observations"].append(batch.observe(0))
            steps["action_masks"].append(batch.masks([0])[0])
            found = batch.step([0], [action])
            steps["actions"].append(action)
            for name, own in zip(("rewards", "terminals", "timeouts"), found.arrays, strict=True):
                steps[name].append(own[0])
            steps["next_observations"].append(batch.observe(0))
        ends.append(len(steps["rewards"]))
    told = {f"{name}s": np.array([row[name] for row in rows]) for name in ("agent", "truth")}
    arrays: dict[str, Any] = {name: np.array(values) for name, values in steps.items()}
    arrays |= {"episode_ends": np.array(ends), **told}
    return written_beside(path, lambda file: np.savez_compressed(file, **arrays))


def _told(rows: Sequence[dict[str, Any]], best: str) -> dict[str, Any]:
    """The first faulty arm that the best agent got right after more than one record."""
    own = [row for row in rows if row["agent"] == best]
    right = (r for r in own if r["success"] and r["truth"] != "healthy" and r["records"] > 1)
    return next(right, own[0])


def compare(options: Options) -> None:
    """Play, print the tables, write rows and page."""
    begin = time.perf_counter()
    if options.weights is not None:
        if not Path(options.weights).is_dir():
            raise ValueError(f"--weights {options.weights} is no folder")
        os.environ[OWN_WEIGHTS] = str(Path(options.weights).resolve())  # for the workers too
    if options.dataset is not None and options.dataset.suffix != ".npz":
        raise ValueError(f"--dataset is a file .npz, got {options.dataset}")
    form = need_format(options.rows)  # whatever is wrong shows now, not after an hour of play
    arguments = arguments_of(options.arguments)
    problem = problem_of(options.env, arguments)
    names = names_of(options, problem)
    reference = reference_of(options, names)
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    made = {name: make_agent(name, problem) for name in names}
    goers = [name for name in names if hasattr(made[name], "stopping")]
    if options.curve is not None and not 1 <= options.curve <= problem.settings.max_records:
        raise ValueError(
            f"--curve must be 1 to {problem.settings.max_records}, got {options.curve}"
        )
    rows = play(names, arguments, options)
    forced = [] if options.curve is None else play(goers, arguments, options, records=options.curve)
    configuration = canonical(
        {
            "env": options.env,
            "engine": problem.settings.engine,
            "arguments": arguments,
            "agents": list(names),
            "episodes": options.episodes,
            "seed": options.seed,
            "curve": options.curve,
            "settings": problem.settings,
            "version": loose_env.__version__,
            **({"weights": weights_digest()} if options.weights else {}),
        }
    )
    digest = configuration_hash(configuration)
    reduced = problem.settings.engine != "mujoco"
    engine = f"the {problem.settings.engine} engine" if reduced else "MuJoCo"
    said = [*filter(None, (bound_line(problem, rows), unfelt_words(problem.arm)))]
    frozen = "the frozen one" if options.seed == EVALUATION_SEED else "for trials"
    title = (
        f"{options.env}, {engine}, {problem.settings.difficulty}: {options.episodes} episodes for "
        f"each agent\nseed {options.seed} ({frozen}), configuration {digest[:12]}"
    )
    told = comparison_text(
        rows,
        forced,
        reference=reference,
        rng=np.random.default_rng(BOOTSTRAP_SEED),
        said=said,
    )
    print(f"\n{title}\n\n{told}\n")
    if options.dataset is not None:
        print(f"Steps: {write_dataset(options.dataset, rows, options.env, arguments)}")
    print(f"Rows: {write_rows(out, 'rows', rows, configuration, form=form)}")
    if forced:
        print(f"Rows of the curve: {write_rows(out, 'curve', forced, configuration, form=form)}")
    if options.page:
        page = write_page(
            out / "index.html",
            rows,
            forced,
            problem=problem,
            options=options,
            notes=f"Made by: {command_of(options)}. Configuration {digest[:12]}.",
            reference=reference,
            said=said,
            engine=engine,
        )
        print(f"Page: {page}")
    print(f"Took {time.perf_counter() - begin:.0f} s.")


def command_of(options: Options) -> str:
    """The command that gives the same rows."""
    given: list[str] = []
    for name in ("env", "arguments", "episodes", "seed", "curve", "reference", "weights"):
        if (value := getattr(options, name)) is not None:
            given += [f"--{name}", str(value)]
    for name in ("agents", "estimators", "policies"):
        if getattr(options, name):
            given += [f"--{name}", *getattr(options, name)]
    return shlex.join(["python", "scripts/agents/compare.py", "--page", *given])


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    going_on = "the same command goes on from what was played"
    command("compare", ABOUT, Options, compare, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
