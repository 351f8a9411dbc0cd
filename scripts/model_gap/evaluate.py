"""Evaluates the agents of loose_env/Gap-v0: accuracy against machine time, and calibration.

Every agent meets the same hidden machines. It is played without stopping, and the belief is kept
after each motion; accuracy against machine time, stopping and calibration are read off that. The
best stopping probabilities are found on other episodes:

    python scripts/model_gap/evaluate.py --seed 20081000 --out out/gap_tuning

Usage: python scripts/model_gap/evaluate.py --episodes 60

Episodes are stored as they come: the same command goes on where it was stopped.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from loose_agents.execution.command import option
from loose_agents.execution.study import Row, Study, StudyRun
from loose_agents.policies.model_gap import GAP_AGENTS, STOPPING

from loose_env.envs import ModelGapEnv
from loose_env.io import Count
from scripts.model_gap.figure import draw, write_curves
from scripts.model_gap.play import EVALUATION_SEED, TUNING_SEED, agent_of, made, played
from scripts.model_gap.tables import (
    accuracy_table,
    best_stopping,
    calibration_table,
    confusion_table,
    ratio_table,
    stopping_table,
    time_table,
)

Case = tuple[str, int]
"""Agent and number of the episode."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings that every row depends on."""

    seed: int = option(EVALUATION_SEED, "seed of the machines")
    model: str = option("", "MJCF file of the arm; the package's three-joint arm by default")
    most: Count = option(8, "motions of an episode")


@dataclass(frozen=True, kw_only=True)
class Run(StudyRun):
    """Rows that are asked for."""

    agents: tuple[str, ...] = option(GAP_AGENTS, "agents to play", choices=GAP_AGENTS)
    episodes: Count = option(60, "episodes of each agent")
    ppo: Path | None = option(None, "weights of train.py: the agent ppo, which stops by itself")


def cases_of(settings: Settings, run: Run) -> list[Case]:
    """Cases, episode by episode, so that an interrupted study is paired."""
    agents = (*run.agents, *(("ppo",) if run.ppo else ()))
    return [(agent, n) for n in range(run.episodes) for agent in agents]


@cache
def _env(model: str) -> ModelGapEnv:
    return made(model or None)


def play(case: Case, *, settings: Settings, run: Run, say: Callable[[str], None]) -> list[Row]:
    """Play one episode of one agent."""
    agent, number = case
    env = _env(settings.model)
    never = agent_of(env, agent, number, run.ppo)
    row = played(env, never, seed=settings.seed, number=number, most=settings.most)
    return [{"agent": agent, **row}]


def case_of(row: Row) -> Case:
    """Case of a row."""
    return row["agent"], row["episode"]


def show(rows: list[Row], settings: Settings, path: Path, run: Run) -> None:
    """Print the tables."""
    sure = best_stopping(rows) if settings.seed == TUNING_SEED else STOPPING
    if settings.seed == TUNING_SEED:
        print(f"best stopping on these episodes: {sure}\n")
    parts = [accuracy_table(rows), time_table(rows), stopping_table(rows, sure)]
    parts += [ratio_table(rows, sure)]
    parts += [calibration_table(rows), confusion_table(rows, "greedy")]
    print("\n\n".join("\n".join(lines) for lines in parts))


def drawn(rows: list[Row], settings: Settings, picture: Path) -> None:
    """Draw the figure, and write the curves beside it."""
    draw(rows, picture)
    write_curves(rows, picture.with_suffix(".csv"))


STUDY = Study(
    script=__file__,
    about=__doc__,
    settings=Settings,
    cases=cases_of,
    work=play,
    case_of=case_of,
    show=show,
    run=Run,
    quick={"most": 3},
    file="gap_env.json",
    unit="episodes",
    draw=drawn,
    digits=5,
)


if __name__ == "__main__":
    STUDY.main()
