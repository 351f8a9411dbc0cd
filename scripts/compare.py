"""Compare agents on the same hidden faults: a table, raw rows, and a page if asked.

Usage: python scripts/compare.py --env loose_env/Planar-v0 --agents random thesis --episodes 400
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import gymnasium

import loose_env
from agents.base import Problem
from agents.evaluation import EpisodeRow, Summary, evaluate, summarise
from agents.registry import AGENTS, make_agent
from loose_env.errors import LooseEnvError

EVALUATION_SEED = 20_260_000
"""Seed of the evaluation episodes; training uses others."""


def table(summaries: Sequence[Summary]) -> str:
    """Lay the summaries out for a terminal."""
    head = f"{'agent':<12}{'success':>9}{'95 % interval':>17}{'mean poses':>12}"
    lines = [head + f"{'mean records':>14}{'mean return':>13}", "-" * 77]
    for s in summaries:
        interval = f"{100 * s.success_low:.1f} to {100 * s.success_high:.1f} %"
        lines.append(
            f"{s.agent:<12}{100 * s.success:>7.1f} %{interval:>17}{s.poses:>12.2f}"
            f"{s.records:>14.2f}{s.reward:>+13.3f}"
        )
    return "\n".join(lines)


def play(
    names: Sequence[str], problem: Problem, *, episodes: int, seed: int, width: int, threads: int
) -> dict[str, list[EpisodeRow]]:
    """Let every agent play the same episodes; progress goes to standard error."""
    results = {}
    for name in names:
        agent = make_agent(name, problem)
        begin = time.perf_counter()

        def progress(done: int, name: str = name, begin: float = begin) -> None:
            spent = time.perf_counter() - begin
            end = "\n" if done == episodes else ""
            print(
                f"\r{name:<12}{done:>6} of {episodes} episodes, {spent:.0f} s",
                end=end,
                file=sys.stderr,
                flush=True,
            )

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


def write_rows(path: Path, results: dict[str, list[EpisodeRow]], configuration: object) -> None:
    """Write all rows with the configuration, beside first, then renamed."""
    rows = [asdict(row) for agent in results.values() for row in agent]
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps({"configuration": configuration, "rows": rows}, indent=0) + "\n")
    beside.replace(path)


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


def compare(options: argparse.Namespace) -> list[Summary]:
    """Play, print the table, write rows and page."""
    begin = time.perf_counter()
    arguments = json.loads(options.arguments)
    env = gymnasium.make(options.env, **arguments).unwrapped
    problem = Problem.of(env.arm, env.settings)  # type: ignore[attr-defined]
    results = play(
        options.agents,
        problem,
        episodes=options.episodes,
        seed=options.seed,
        width=options.width,
        threads=options.threads,
    )
    summaries = [summarise(rows) for rows in results.values()]
    title = f"{options.env}, {options.episodes} episodes for each agent, seed {options.seed}"
    print(f"\n{title}\n\n{table(summaries)}\n")
    diverged = sum(s.diverged for s in summaries)
    if diverged:
        print(f"{diverged} episodes ended because the simulation diverged.\n")
    configuration = {
        "env": options.env,
        "arguments": arguments,
        "agents": options.agents,
        "episodes": options.episodes,
        "seed": options.seed,
        "version": loose_env.__version__,
    }
    out = Path(options.out)
    write_rows(out / "rows.json", results, configuration)
    print(f"Rows: {out / 'rows.json'}")
    if options.page:
        from agents.comparison_page import write_page

        page = write_page(out / "index.html", title, problem, results, summaries, options.seed)
        print(f"Page: {page}")
    print(f"Took {time.perf_counter() - begin:.0f} s.")
    return summaries


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    options = parser().parse_args(arguments)
    try:
        compare(options)
    except (LooseEnvError, ValueError) as error:
        sys.exit(f"compare: {error}")


if __name__ == "__main__":
    main()
