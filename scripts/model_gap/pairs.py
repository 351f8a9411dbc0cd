"""Machine time that separates confusable effects: chosen motions against the fixed battery.

One effect of a pair is hidden. The chosen motions are those whose expected gain in log evidence
between both per second is largest; the battery is run in order and repeated. Both go on until the
log evidence of the hidden effect is ahead of the other's by 5 nats (odds of 150 to 1).

Usage: python scripts/model_gap/pairs.py --machines 4
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from loose_agents.execution.command import option
from loose_agents.execution.study import Row, Study, StudyRun

from loose_env.envs import ModelGapEnv
from loose_env.gap import Belief, BeliefSettings, battery
from loose_env.io import Count
from loose_env.typing import Array
from scripts.model_gap.play import EVALUATION_SEED, made

PAIRS = (
    ("coulomb_friction@joint2", "stribeck_friction@joint2"),
    ("rotor_inertia@joint3", "link_mass@link3"),
    ("payload@tool", "actuator_gain@motor2"),
    ("command_delay@motor2", "joint_compliance@joint2"),
    ("backlash@joint1", "joint_compliance@joint1"),
    ("backlash@joint2", "joint_compliance@joint2"),
    ("base_tilt@base", "encoder_offset@joint2"),
)
"""Confusable pairs."""
_APART = ("backlash", "joint_compliance")
"""Kinds with signatures of their own, on the brief library: play is no candidate of the whole
task."""
AHEAD = 5.0
"""Log evidence ahead at which two effects count as separated [nats]."""
_SETUP_S = 0.5

Case = tuple[str, str, int]
"""Hidden effect, the other one, number of the machine."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings that every row depends on."""

    seed: int = option(EVALUATION_SEED + 1, "seed of the machines")
    most: Count = option(8, "motions at most")


@dataclass(frozen=True, kw_only=True)
class Run(StudyRun):
    """Rows that are asked for."""

    machines: Count = option(4, "machines for each hidden effect")
    only: str = option("", "kind that one effect of a pair has; all pairs by default")


def cases_of(settings: Settings, run: Run) -> list[Case]:
    """Cases: both effects of every pair are hidden in turn."""
    wanted = [pair for pair in PAIRS if f"{run.only}@" in " ".join(pair) or not run.only]
    ways = [way for pair in wanted for way in (pair, pair[::-1])]
    return [(*way, n) for n in range(run.machines) for way in ways]


@cache
def _env(kinds: tuple[str, ...]) -> ModelGapEnv:
    return made(kinds=kinds, library="brief" if kinds else "whole")


def _env_of(hidden: str, other: str) -> ModelGapEnv:
    """The environment whose candidates both effects are."""
    return _env(_APART if "backlash@" in hidden + other else ())


def ahead(belief: Belief, hidden: str, other: str) -> float:
    """Log evidence of one effect alone over that of another, by exact fits [nats]."""
    return belief.log_evidence(hidden) - belief.log_evidence(other)


def gains(env: ModelGapEnv, hidden: str, other: str) -> Array:
    """Expected gain of each motion between two effects [nats] (M,).

    Of the middle sizes of the hidden effect, with the other one fitted to its signature.
    """
    bank, names, found = env.bank, env.bank.names, np.zeros(len(env.bank.library))
    rays = [k for k, ray in enumerate(bank.rays) if ray.name == hidden]
    for motion in range(len(found)):
        for ray in rays:
            belief = Belief(env.models, BeliefSettings(simulations=0))
            at = bank.point(ray)
            belief.sums[motion] = bank.signatures[motion].vectors[:, at].astype(float)
            belief.counts[motion], belief.rest[motion] = 1, 1.0
            evidence = belief.posterior.log_evidence
            gain = evidence[names.index(hidden)] - evidence[names.index(other)]
            found[motion] += gain / len(rays)
    return found


@cache
def _gains(hidden: str, other: str) -> Array:
    return gains(_env_of(hidden, other), hidden, other)


def seconds_until(
    env: ModelGapEnv, hidden: str, other: str, order: list[int], rng: np.random.Generator
) -> float:
    """Machine time until the hidden effect is ahead [s]; NaN if it never is."""
    machine, belief, spent = env.machine, Belief(env.models, env.settings.belief), 0.0
    assert machine is not None
    for motion in order:
        belief.add(motion, machine.run(motion, rng))
        spent += float(env.bank.seconds[motion])
        if ahead(belief, hidden, other) >= AHEAD:
            return spent
    return float("nan")


def play(case: Case, *, settings: Settings, run: Run, say: Callable[[str], None]) -> list[Row]:
    """Separate one pair on one machine."""
    hidden, other, number = case
    env = _env_of(hidden, other)
    row: Row = {"hidden": hidden, "other": other, "machine": number}
    if hidden not in env.bank.names or other not in env.bank.names:
        return [{**row, "motion": "", "gain": 0.0, "chosen": -2.0, "battery": -2.0}]
    expected = _gains(hidden, other)
    rate = expected / (env.bank.seconds + _SETUP_S)
    chosen = [int(k) for k in np.argsort(-rate)[: settings.most]]
    in_order = [env.bank.index_of(motion) for motion in battery(env.bank.arm)]
    cycled = [in_order[k % len(in_order)] for k in range(settings.most)]
    times = []
    for order in (chosen, cycled):
        env.reset(seed=settings.seed + 1000 * number, options={"names": (hidden,)})
        rng = np.random.default_rng([settings.seed, number])
        times.append(seconds_until(env, hidden, other, order, rng))
    return [
        {
            **row,
            "motion": env.motions[chosen[0]].description,
            "gain": float(expected[chosen[0]]),
            "chosen": -1.0 if np.isnan(times[0]) else times[0],
            "battery": -1.0 if np.isnan(times[1]) else times[1],
        }
    ]


def case_of(row: Row) -> Case:
    """Case of a row."""
    return row["hidden"], row["other"], row["machine"]


def show(rows: list[Row], settings: Settings, path: Path, run: Run) -> None:
    """Print the table: medians over the machines."""
    print(
        "| hidden | against | first chosen motion | expected gain | chosen | battery |\n"
        "|---|---|---|---|---|---|"
    )
    for hidden, other in dict.fromkeys((row["hidden"], row["other"]) for row in rows):
        own = [r for r in rows if (r["hidden"], r["other"]) == (hidden, other)]
        if own[0]["chosen"] == -2:
            print(f"| {hidden} | {other} | one of them is no candidate here | | | |")
            continue
        cells = [_median([r[way] for r in own]) for way in ("chosen", "battery")]
        gain = f"{own[0]['gain']:.0f} nats"
        print(f"| {hidden} | {other} | {own[0]['motion']} | {gain} | {' | '.join(cells)} |")


def _median(times: list[float]) -> str:
    """Median of machine times, those not reached as infinite."""
    found = float(np.median([t if t >= 0 else np.inf for t in times]))
    reached = sum(t >= 0 for t in times)
    time = f"{found:.1f} s" if np.isfinite(found) else "not separated"
    return time if reached == len(times) else f"{time} ({reached} of {len(times)})"


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
    file="gap_pairs.json",
    unit="pairs",
)


if __name__ == "__main__":
    STUDY.main()
