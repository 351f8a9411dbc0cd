"""Compare agents on the same hidden faults: a table, raw rows, and a page if asked.

Usage: python scripts/compare.py --env loose_env/Planar-v0 --agents random thesis --episodes 400
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium

import loose_env
from agents.base import Problem
from agents.evaluation import EpisodeRow, evaluate
from agents.registry import AGENTS, make_agent
from loose_env.envs.diagnosis import DiagnosisEnv
from loose_env.envs.registration import IDS
from loose_env.errors import LooseEnvError
from loose_env.report.standings import Standing, standings

EVALUATION_SEED = 20_260_000
"""Seed of the evaluation episodes; training uses others."""


def table(found: Sequence[Standing]) -> str:
    """Lay the standings out for a terminal."""
    head = f"{'agent':<12}{'success':>9}{'95 % interval':>17}{'mean poses':>12}"
    lines = [head + f"{'mean records':>14}{'mean return':>13}", "-" * 77]
    for s in found:
        interval = f"{100 * s.low:.1f} to {100 * s.high:.1f} %"
        lines.append(
            f"{s.agent:<12}{100 * s.success:>7.1f} %{interval:>17}{s.poses:>12.2f}"
            f"{s.records:>14.2f}{s.reward:>+13.3f}"
        )
    return "\n".join(lines)


def arguments_of(text: str) -> dict[str, Any]:
    """Read the environment's arguments."""
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(
            f"--arguments must be JSON such as '{{\"n_links\": 3}}': {error}"
        ) from error
    if not isinstance(found, dict):
        raise ValueError(f"--arguments must be a JSON object, got {text!r}")
    return found


def problem_of(env_id: str, arguments: dict[str, Any]) -> Problem:
    """Make the environment once to learn what problem it poses."""
    env = gymnasium.make(env_id, **arguments).unwrapped
    if not isinstance(env, DiagnosisEnv):
        raise ValueError(f"{env_id} is no diagnosis environment; those are {', '.join(IDS)}")
    return Problem.of(env.arm, env.settings)


def play(
    names: Sequence[str], problem: Problem, *, episodes: int, seed: int, width: int, threads: int
) -> dict[str, list[EpisodeRow]]:
    """Let every agent play the same episodes; progress goes to standard error."""
    results = {}
    # All are made before the first plays: a missing weight shows at once.
    for name, agent in [(name, make_agent(name, problem)) for name in names]:
        begin = time.perf_counter()

        def progress(done: int, name: str = name, begin: float = begin) -> None:
            if done == episodes or (sys.stderr.isatty() and done % 10 == 0):
                spent = time.perf_counter() - begin
                line = f"\r{name:<12}{done:>6} of {episodes} episodes, {spent:.0f} s"
                end = "\n" if done == episodes else ""
                print(line, end=end, file=sys.stderr, flush=True)

        results[name] = evaluate(
            agent,
            name,
            problem.arm,
            problem.settings,
            episodes=episodes,
            seed=seed,
            width=width,
            threads=threads,
            progress=progress,
        )
    return results


def write_rows(path: Path, rows: Sequence[dict[str, Any]], configuration: object) -> None:
    """Write all rows with the configuration, beside first, then renamed."""
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps({"configuration": configuration, "rows": rows}, indent=0) + "\n")
    beside.replace(path)


def write_page(
    path: Path,
    problem: Problem,
    rows: Sequence[dict[str, Any]],
    options: argparse.Namespace,
) -> Path:
    """Write the page: what was played, who won, figures, and one episode in pictures."""
    from loose_env.report.comparison import write_comparison
    from loose_env.report.story import tell_episode

    best = standings(rows)[0].agent
    own = [row for row in rows if row["agent"] == best]
    # The first faulty arm that the best agent got right after more than one record.
    right = (r for r in own if r["success"] and r["truth"] != "healthy" and r["records"] > 1)
    told = next(right, own[0])
    story = tell_episode(
        make_agent(best, problem),
        problem.arm,
        problem.settings,
        seed=options.seed,
        number=told["episode"],
    )
    kinds = len(problem.hypotheses)
    return write_comparison(
        path,
        rows,
        title=f"Finding the loose link on {problem.arm.name}",
        played=[
            f"{options.episodes} arms, each with a fault hidden at random: nothing, a link that "
            "slides on its flange, or a joint with play. Every agent met the same arms. It moved "
            "joints, shook one at a time, saw how the tool followed, and named the fault when it "
            f"was sure. There are {kinds} possible verdicts. A right one earns 1, a wrong one "
            "loses 1, and every record costs a little.",
            *(f"{name}: {AGENTS[name][1]}." for name in options.agents),
        ],
        hypotheses=problem.hypotheses,
        chance=max(Counter(row["truth"] for row in own).values()) / len(own),
        story=story,
        story_of=best,
        notes=f"Made by: python scripts/compare.py --page --env {options.env} "
        f"--arguments {shlex.quote(options.arguments)} --agents {' '.join(options.agents)} "
        f"--episodes {options.episodes} --seed {options.seed}",
    )


def parser() -> argparse.ArgumentParser:
    """Options of the comparison."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = ", ".join(f"{name} ({words})" for name, (_, words) in AGENTS.items())
    options.add_argument("--env", default="loose_env/Vera-v0", help="environment id")
    options.add_argument("--arguments", default="{}", help="its arguments, as JSON")
    options.add_argument(
        "--agents", nargs="+", default=["random", "thesis", "ppo"], help=f"any of {known}"
    )
    options.add_argument("--episodes", type=int, default=400, help="episodes for each agent")
    options.add_argument("--seed", type=int, default=EVALUATION_SEED, help="seed of the episodes")
    options.add_argument("--width", type=int, default=64, help="arms simulated side by side")
    options.add_argument("--threads", type=int, default=0, help="simulation threads, 0 for all")
    options.add_argument("--out", default="out", help="folder for rows.json and the page")
    options.add_argument("--page", action="store_true", help="write a page with pictures too")
    return options


def compare(options: argparse.Namespace) -> None:
    """Play, print the table, write rows and page."""
    begin = time.perf_counter()
    arguments = arguments_of(options.arguments)
    if options.episodes < 1:
        raise ValueError(f"--episodes must be 1 or more, got {options.episodes}")
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)  # fails before an hour of play, not after
    problem = problem_of(options.env, arguments)
    results = play(
        options.agents,
        problem,
        episodes=options.episodes,
        seed=options.seed,
        width=options.width,
        threads=options.threads,
    )
    rows = [asdict(row) for own in results.values() for row in own]
    title = f"{options.env}, {options.episodes} episodes for each agent, seed {options.seed}"
    print(f"\n{title}\n\n{table(standings(rows))}\n")
    diverged = Counter(row["truth"].partition("@")[0] for row in rows if row["truncated"])
    if diverged:
        print(f"Episodes ended by a diverging simulation: {dict(diverged)}\n")
    configuration = {
        "env": options.env,
        "arguments": arguments,
        "agents": options.agents,
        "episodes": options.episodes,
        "seed": options.seed,
        "version": loose_env.__version__,
    }
    write_rows(out / "rows.json", rows, configuration)
    print(f"Rows: {out / 'rows.json'}")
    if options.page:
        print(f"Page: {write_page(out / 'index.html', problem, rows, options)}")
    print(f"Took {time.perf_counter() - begin:.0f} s.")


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    options = parser().parse_args(arguments)
    try:
        compare(options)
    except KeyboardInterrupt:
        sys.exit("compare: interrupted; nothing was written")
    except (LooseEnvError, gymnasium.error.Error, ValueError, OSError) as error:
        sys.exit(f"compare: {error}")


if __name__ == "__main__":
    main()
