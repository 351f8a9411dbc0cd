"""The benchmark of agents: play the frozen episodes, check a results file, build the leaderboard.

Usage: python scripts/submit.py make --agents AGENT ... [--tasks TASK ...] [--sets SET ...]
           [--episodes N] [--entry NAME] [--about TEXT] [--code ADDRESS] [--log ADDRESS]
           [--training-records N] [--agent-seed N] [--actions-only] [--out FOLDER]
           [--shards FOLDER]
       python scripts/submit.py check FILE ... [--episodes 20] [--seed N] [--actions-only]
       python scripts/submit.py board [--docs]

make plays an agent (a name, module:Class, path/model.zip or the folder of an exported policy) and
writes OUT/TASK/ENTRY.json, OUT/TASK/SET/ENTRY.json for sets out of distribution; stopped at any
moment, the same command goes on. check reads files and plays a sample of their episodes again:
their actions, and the agent where the file names one. board prints the leaderboard of the files in
docs/benchmark_results. docs/benchmark.md has protocol and format. Exit codes: 0 done, 2 a file or
an argument cannot be used, or what was replayed differs.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

# One thread each: the order in which threads add up changes the last digit of a return.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from loose_agents.benchmark.episodes import SETS, TASKS, set_named, task_problem
from loose_agents.benchmark.leaderboard import (
    RESULTS,
    leaderboard,
    results_path,
    stored_results,
    value_tables,
)
from loose_agents.benchmark.results import (
    Results,
    check_results,
    play_results,
    read_results,
    training_of,
    write_results,
)
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.execution.study import write_between
from loose_agents.registry import describe

from loose_env.errors import InvalidData, InvalidSetting

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmark.md"
"""Page of the leaderboard."""
SAMPLE = 20
"""Episodes that are played again by default."""


def parser_of() -> argparse.ArgumentParser:
    """The commands and their options."""
    parser = argparse.ArgumentParser(
        prog="python scripts/submit.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    made = commands.add_parser("make", help="play agents and write results files")
    made.add_argument("--agents", nargs="+", required=True, metavar="AGENT")
    made.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS, metavar="TASK")
    made.add_argument("--sets", nargs="+", default=["test"], choices=list(SETS), metavar="SET",
                      help=f"of {', '.join(SETS)}")  # fmt: skip
    made.add_argument("--episodes", type=int, help="the first so many; default: the whole set")
    made.add_argument("--entry", default="", help="name on the leaderboard; default: the agent's")
    made.add_argument("--about", default="", help="the method in a sentence")
    made.add_argument("--code", default="", help="address of code and weights")
    made.add_argument("--log", default="", help="learning curve or log: path or address")
    made.add_argument("--training-records", type=int, help="records taken in training and tuning")
    made.add_argument("--agent-seed", type=int, default=0, help="seed of what the agent draws")
    made.add_argument("--actions-only", action="store_true",
                      help="do not name the agent: it is not in the repository")  # fmt: skip
    made.add_argument("--out", type=Path, default=Path("benchmark_results"), metavar="FOLDER")
    made.add_argument("--shards", type=Path, default=Path("runs/benchmark"), metavar="FOLDER",
                      help="folder of episodes until a file is whole")  # fmt: skip
    checked = commands.add_parser("check", help="check files by playing a sample again")
    checked.add_argument("files", type=Path, nargs="+", metavar="FILE")
    checked.add_argument("--episodes", type=int, default=SAMPLE, help="episodes of each file")
    checked.add_argument("--seed", type=int, help="seed of the sample; default: drawn")
    checked.add_argument("--actions-only", action="store_true", help="do not play the agent")
    board = commands.add_parser("board", help="leaderboard of stored results")
    board.add_argument("--docs", action="store_true", help="write it to docs/benchmark.md")
    return parser


def check_same_agent(path: Path, there: Results, given: argparse.Namespace, agent: str) -> None:
    """Refuse to take a stored file for the results of another agent.

    Raises
    ------
    InvalidSetting
        If agent or seed differ from those of the file.
    """
    asked = None if given.actions_only else agent
    if (there.agent, there.agent_seed) != (asked, given.agent_seed):
        raise InvalidSetting(
            f"{path} holds agent {there.agent!r} with seed {there.agent_seed}, asked for are "
            f"{asked!r} and {given.agent_seed}; give another --entry or remove the file"
        )


def make(given: argparse.Namespace) -> None:
    """Play what is missing; a file that is there is left alone."""
    if given.entry and len(given.agents) > 1:
        raise InvalidSetting("--entry names one agent; leave it out for several")
    if given.training_records is not None and given.training_records < 0:
        raise InvalidSetting("--training-records must be 0 or more")
    for task in given.tasks:
        for agent in given.agents:
            for set_name in given.sets:
                entry = given.entry or agent
                path = results_path(given.out, task, set_name, entry)
                whole = set_named(set_name).episodes
                wanted = whole if given.episodes is None else given.episodes
                if path.is_file() and (there := read_results(path)):
                    check_same_agent(path, there, given, agent)
                    if len(there.reward) >= wanted:
                        print(f"{path}: there already")
                        continue
                told = {
                    "entry": entry,
                    "about": given.about or describe(agent),
                    "code": given.code,
                    "log": given.log,
                    "training_records": given.training_records
                    if given.training_records is not None
                    else training_of(agent, task_problem(task, set_named(set_name))),
                }
                results = play_results(
                    task,
                    set_name,
                    agent,
                    told=told,
                    folder=given.shards,
                    count=wanted,
                    agent_seed=given.agent_seed,
                    named=not given.actions_only,
                    say=lambda line: print(line, file=sys.stderr),
                )
                print(
                    f"{write_results(path, results)}: return {results.returns.mean():+.3f}",
                    flush=True,
                )


def check(given: argparse.Namespace) -> None:
    """Check files one by one; the first that is wrong ends it."""
    if given.episodes < 1:
        raise InvalidSetting(f"--episodes must be 1 or more, got {given.episodes}")
    rng = np.random.default_rng(given.seed)
    for path in given.files:
        results = read_results(path)
        try:
            said = check_results(
                results, episodes=given.episodes, rng=rng, by_agent=not given.actions_only
            )
        except InvalidData as error:
            raise InvalidData(f"{path}: {error}") from error
        print(f"{path}: {said}")


def board(given: argparse.Namespace) -> None:
    """Print the tables, and put them on the page."""
    results = stored_results(RESULTS)
    values, entries = value_tables(results), leaderboard(results)
    print(f"{values}\n\n{entries}")
    if given.docs:
        write_between(PAGE, values, name="value of choice")
        write_between(PAGE, entries, name="leaderboard")


def main(arguments: Sequence[str] | None = None) -> None:
    """Take the command line."""
    given = parser_of().parse_args(arguments)
    run = {"make": make, "check": check, "board": board}[given.command]
    try:
        with errors_in_one_line(f"submit {given.command}", interrupted="the same command goes on"):
            run(given)
    except SystemExit as ended:
        if not isinstance(ended.code, str):
            raise
        print(ended.code, file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
