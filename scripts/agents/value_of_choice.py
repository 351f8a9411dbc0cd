"""Value of choosing records: an adaptive agent against those that look at no result.

Every agent names the fault by the same posterior, so that only the choice of records differs. The
fixed sequences and all stopping probabilities were tuned on training episodes by
scripts/agents/tune_agents.py; the arms played here are fresh. Agents of a tier meet the same arms,
so that differences are paired; errors are 95 % intervals by the bootstrap over arms.

Usage: python scripts/agents/value_of_choice.py --tiers loose_env/WeakDriveTier-v0 --blocks 4

Blocks of episodes are stored as they come: the same command goes on where it was stopped, and more
blocks add to those played.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

# One thread each: the order in which threads add up changes the last digit of a return.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from loose_agents.benchmark.sharded import EvaluationTask, evaluate_shard
from loose_agents.core.seeds import EVALUATION_SEED
from loose_agents.execution.command import option
from loose_agents.execution.study import ClusterRun, Row, Study

from loose_env.faults import UNSURE
from loose_env.io import Count
from loose_env.registration import TIERS
from scripts.study_parts.choice_tables import agent_table, value_table

AGENTS = (
    *("fixed_1", "fixed_2", "fixed_3", "fixed_4", "fixed"),
    *("amortised/random", "open_loop", "greedy"),
)

Case = tuple[str, str, int]
"""Tier, agent, and block of episodes."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings that every row depends on."""

    seed: int = option(EVALUATION_SEED + 40, "seed of the arms")
    engine: str = option("reduced", "simulation engine", choices=("reduced", "mujoco"))
    block: Count = option(40, "episodes in a block")


@dataclass(frozen=True, kw_only=True)
class Run(ClusterRun):
    """Rows that are asked for."""

    tiers: tuple[str, ...] = option(tuple(TIERS), "tiers to play", choices=tuple(TIERS))
    agents: tuple[str, ...] = option(AGENTS, "agents to play")
    blocks: Count = option(4, "blocks of episodes for each agent")


def cases_of(settings: Settings, run: Run) -> list[Case]:
    """Cases, block by block, so that an interrupted study has all agents of a tier."""
    return [(t, a, b) for t in run.tiers for b in range(run.blocks) for a in run.agents]


def play(case: Case, *, settings: Settings, run: Run, say: Callable[[str], None]) -> list[Row]:
    """Play one block of one agent."""
    tier, agent, block = case
    task = EvaluationTask(
        agent=agent,
        env_id=tier,
        arguments={"engine": settings.engine},
        first=block * settings.block,
        count=settings.block,
        seed=settings.seed,
    )
    played = evaluate_shard(task)
    return [
        {
            "tier": tier,
            "agent": agent,
            "block": block,
            "reward": [row["reward"] for row in played],
            "success": [int(row["success"]) for row in played],
            "unsure": [int(row["verdict"] == UNSURE) for row in played],
            "records": [row["records"] for row in played],
        }
    ]


def case_of(row: Row) -> Case:
    """Case of a row."""
    return row["tier"], row["agent"], row["block"]


def show(rows: list[Row], settings: Settings, path: Path, run: Run) -> None:
    """Print both tables."""
    print("\n".join([*value_table(rows), "", *agent_table(rows)]))


STUDY = Study(
    script=__file__,
    about=__doc__,
    settings=Settings,
    cases=cases_of,
    work=play,
    case_of=case_of,
    show=show,
    run=Run,
    quick={"block": 4},
    unit="blocks",
    digits=6,
)


if __name__ == "__main__":
    STUDY.main()
