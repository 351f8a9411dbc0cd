"""Evaluates the agents of loose_env/Gap-v0 on other arms: six axes, and a foreign MJCF file.

Few kinds of effects and the brief library keep the signatures to some minutes an arm. The agents
stop at the probabilities that were tuned on the three-joint arm.

Usage: python scripts/model_gap/arms.py --episodes 12

The UR5e is skipped where its file is absent: one with a `<position>` servo at each joint and a key
"home", such as MuJoCo Menagerie's with its general actuators written so, in the folder `--models`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.execution.command import option
from loose_agents.execution.study import Row, Study, StudyRun
from loose_agents.policies.model_gap import GAP_AGENTS, STOPPING

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.envs import ModelGapEnv
from loose_env.io import Count
from scripts.model_gap.play import EVALUATION_SEED, agent_of, made, played
from scripts.model_gap.tables import GROUPS, of, stopped

ARMS = ("six_axis", "ur5e")
"""Arms: `loose_env.arms.SIX_AXIS_SERVO_ARM`, and a file of others."""
KINDS = ("coulomb_friction", "payload", "joint_compliance", "encoder_offset")
Case = tuple[str, str, int]
"""Arm, agent and number of the episode."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings that every row depends on."""

    seed: int = option(EVALUATION_SEED + 2, "seed of the machines")
    most: Count = option(3, "motions of an episode")
    kinds: tuple[str, ...] = option(KINDS, "kinds of effects")


@dataclass(frozen=True, kw_only=True)
class Run(StudyRun):
    """Rows that are asked for."""

    arms: tuple[str, ...] = option(ARMS, "arms", choices=ARMS)
    agents: tuple[str, ...] = option(GAP_AGENTS, "agents to play", choices=GAP_AGENTS)
    episodes: Count = option(12, "episodes of each agent on each arm")
    ppo: Path | None = option(None, "weights of train.py: the agent ppo, which stops by itself")
    models: Path = option(Path("../shared/models"), "folder of ur5e_bare.xml")


def file_of(arm: str, run: Run) -> Path:
    """File of an arm."""
    return SIX_AXIS_SERVO_ARM if arm == "six_axis" else run.models / f"{arm}_bare.xml"


def cases_of(settings: Settings, run: Run) -> list[Case]:
    """Cases of the arms whose files are there, paired."""
    found: list[Case] = []
    for arm in run.arms:
        if file_of(arm, run).is_file():
            agents = (*run.agents, *(("ppo",) if run.ppo else ()))
            found += [(arm, agent, n) for n in range(run.episodes) for agent in agents]
        else:
            print(f"{arm} is skipped: there is no {file_of(arm, run)}", file=sys.stderr)
    return found


@cache
def _env(path: Path, kinds: tuple[str, ...]) -> ModelGapEnv:
    return made(path, library="brief", kinds=kinds)


def play(case: Case, *, settings: Settings, run: Run, say: Callable[[str], None]) -> list[Row]:
    """Play one episode of one agent on one arm."""
    arm, agent, number = case
    env = _env(file_of(arm, run), settings.kinds)
    never = agent_of(env, agent, number, run.ppo)
    row = played(env, never, seed=settings.seed, number=number, most=settings.most)
    return [{"arm": arm, "candidates": len(env.bank.names), "agent": agent, **row}]


def case_of(row: Row) -> Case:
    """Case of a row."""
    return row["arm"], row["agent"], row["episode"]


def show(rows: list[Row], settings: Settings, path: Path, run: Run) -> None:
    """Print the table: shares right and machine time with the agents' stopping."""
    print(
        "| arm | candidates | agent | one effect | two effects | none | machine time | "
        "after the last motion |\n|---|---|---|---|---|---|---|---|"
    )
    for arm in dict.fromkeys(row["arm"] for row in rows):
        every = [row for row in rows if row["arm"] == arm]
        for agent in dict.fromkeys(row["agent"] for row in every):
            shares, seconds, last = [], [], []
            for _, effects in GROUPS:
                own = of(every, agent, effects)
                ends = [stopped(row, STOPPING[agent]) for row in own]
                right = sum(end["right"] for end in ends)
                shares.append(f"{right:.0f} of {len(own)}")
                seconds += [end["seconds"] for end in ends]
                last += [row["right"][-1] for row in own]
            print(
                f"| {arm} | {every[0]['candidates']} | {agent} | {' | '.join(shares)} | "
                f"{np.mean(seconds):.1f} s | {sum(last)} of {len(last)} |"
            )


STUDY = Study(
    script=__file__,
    about=__doc__,
    settings=Settings,
    cases=cases_of,
    work=play,
    case_of=case_of,
    show=show,
    run=Run,
    quick={"most": 2},
    file="gap_arms.json",
    unit="episodes",
    digits=5,
)


if __name__ == "__main__":
    STUDY.main()
