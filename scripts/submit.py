"""The benchmark of agents: play the frozen episodes, check a results file, build the leaderboard.

Usage: python scripts/submit.py make --agents AGENT ... [--tasks TASK ...] [--sets SET ...]
           [--salt SALT] [--episodes N] [--entry NAME] [--about TEXT] [--code ADDRESS]
           [--log ADDRESS] [--training-records N] [--agent-seed N] [--actions-only] [--out FOLDER]
           [--shards FOLDER]
       python scripts/submit.py check FILE ... [--episodes 20] [--seed N] [--actions-only]
       python scripts/submit.py board [--docs]
       python scripts/submit.py salt

make plays an agent (a name, module:Class, path/model.zip or the folder of an exported policy) and
writes OUT/TASK/ENTRY.json, OUT/TASK/SET/ENTRY.json for sets out of distribution; stopped at any
moment, the same command goes on. check reads files and plays a sample of their episodes again:
their actions, and the agent where the file names one. board prints the leaderboard of the files in
docs/benchmark_results. salt draws the salt of a new round of the hidden set, with its commitment.
docs/benchmark.md has protocol and format. Exit codes: 0 done, 1 a file or a setting cannot be
used, or what was replayed differs, 2 the command line is wrong.
"""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

# One thread each: the order in which threads add up changes the last digit of a return.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from loose_agents.benchmark.episodes import SETS, TASKS, commitment_of, set_named, task_problem
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
)
from loose_agents.registry import describe
from tyro.conf import Positional

from loose_env.cli.command import Actions, commands, one_of
from loose_env.errors import InvalidData, InvalidSetting, LooseEnvError
from loose_env.io import Count, NonNegativeCount, write_text
from scripts.study import write_between

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmark.md"
"""Page of the leaderboard."""


@dataclass(frozen=True, kw_only=True)
class Make:
    """Play agents and write results files."""

    agents: tuple[str, ...]
    """Names, module:Class, path/model.zip or the folder of an exported policy."""
    tasks: tuple[Annotated[str, one_of(TASKS)], ...] = TASKS
    """Tasks of the benchmark."""
    sets: tuple[Annotated[str, one_of(tuple(SETS))], ...] = ("test",)
    """Sets of episodes."""
    salt: str = ""
    """Salt of the set "hidden"."""
    episodes: Count | None = None
    """The first so many; the whole set by default."""
    entry: str = ""
    """Name on the leaderboard; the agent's by default."""
    about: str = ""
    """The method in a sentence."""
    code: str = ""
    """Address of code and weights."""
    log: str = ""
    """Learning curve or log: path or address."""
    training_records: NonNegativeCount | None = None
    """Records taken in training and tuning."""
    agent_seed: int = 0
    """Seed of what the agent draws."""
    actions_only: bool = False
    """Do not name the agent: it is not in the repository."""
    out: Path = Path("benchmark_results")
    """Folder of the results."""
    shards: Path = Path("runs/benchmark")
    """Folder of episodes until a file is whole."""

    def __post_init__(self) -> None:
        if self.entry and len(self.agents) > 1:
            raise InvalidSetting("--entry names one agent; leave it out for several")


@dataclass(frozen=True, kw_only=True)
class Check:
    """Check files by playing a sample again."""

    files: Positional[tuple[Path, ...]]
    """Results files."""
    episodes: Count = 20
    """Episodes of each file."""
    seed: int | None = None
    """Seed of the sample; drawn by default."""
    actions_only: bool = False
    """Do not play the agent."""


@dataclass(frozen=True, kw_only=True)
class Board:
    """Leaderboard of stored results."""

    docs: bool = False
    """Write it to docs/benchmark.md."""


def check_same_agent(path: Path, there: Results, given: Make, agent: str) -> None:
    """Refuse to take a stored file for the results of another agent."""
    asked = (None if given.actions_only else agent, given.agent_seed, given.salt)
    if (there.agent, there.agent_seed, there.salt) != asked:
        raise InvalidSetting(
            f"{path} holds agent {there.agent!r} with seed {there.agent_seed} and salt "
            f"{there.salt!r}, asked for are {asked}; give another --entry or remove the file"
        )


def make(given: Make) -> None:
    """Play what is missing; a file that is there is left alone."""
    for task in given.tasks:
        for agent in given.agents:
            for set_name in given.sets:
                entry = given.entry or agent
                path = results_path(given.out, task, set_name, entry)
                episodes = set_named(set_name, given.salt)
                whole = episodes.episodes
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
                    else training_of(agent, task_problem(task, episodes)),
                }
                results = play_results(
                    task,
                    set_name,
                    agent,
                    told=told,
                    folder=given.shards,
                    count=wanted,
                    salt=given.salt,
                    agent_seed=given.agent_seed,
                    named=not given.actions_only,
                    say=lambda line: print(line, file=sys.stderr),
                )
                print(
                    f"{write_text(path, results.to_json())}: return {results.returns.mean():+.3f}",
                    flush=True,
                )


def check(given: Check) -> None:
    """Check files one by one; the first that is wrong ends it."""
    rng = np.random.default_rng(given.seed)
    for path in given.files:
        results = read_results(path)
        try:
            said = check_results(
                results, episodes=given.episodes, rng=rng, by_agent=not given.actions_only
            )
        except LooseEnvError as error:
            raise InvalidData(f"{path}: {error}") from error
        print(f"{path}: {said}")


def board(given: Board) -> None:
    """Print the tables, and put them on the page."""
    results = stored_results(RESULTS)
    values, entries = value_tables(results), leaderboard(results)
    print(f"{values}\n\n{entries}")
    if given.docs:
        write_between(PAGE, values, name="value of choice")
        write_between(PAGE, entries, name="leaderboard")


@dataclass(frozen=True, kw_only=True)
class Salt:
    """Draw the salt of a new round, and its commitment."""


def salt(given: Salt) -> None:
    """Print them."""
    drawn = secrets.token_hex(16)
    print(f"salt (keep it back until the round closes): {drawn}")
    print(f"commitment (append it to ROUNDS of the benchmark): {commitment_of(drawn)}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command that is named."""
    actions: Actions = {
        "make": (Make, make),
        "check": (Check, check),
        "board": (Board, board),
        "salt": (Salt, salt),
    }
    going_on = "the same command goes on"
    commands("submit", __doc__, actions, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
