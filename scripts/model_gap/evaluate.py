"""Evaluates the agents of loose_env/Gap-v0: accuracy against machine time, and calibration.

Every agent meets the same hidden machines. It is played without stopping, and the belief is kept
after each motion; accuracy against machine time, stopping and calibration are read off that. The
best stopping probabilities are found on other episodes:

    python scripts/model_gap/evaluate.py --seed 20081000 --out out/gap_tuning.json

Usage: python scripts/model_gap/evaluate.py --episodes 60

Episodes are stored as they come: the same command goes on where it was stopped.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gymnasium
import numpy as np
from loose_agents.policies.model_gap import GAP_AGENTS, STOPPING, make_gap_agent
from tyro.conf import OmitArgPrefixes

from loose_env.cli.command import command, one_of
from loose_env.envs import MUTED, GapPrices, ModelGapEnv
from loose_env.evaluation import wilson
from loose_env.io import Count, plain
from loose_env.registration import GAP_ID
from loose_env.typing import Array
from scripts.charts import Panel, chart, curve, points, save
from scripts.study import ROOT
from scripts.suites.rows import Row, code_of_study, run_cases

EVALUATION_SEED, TUNING_SEED = 20_261_126, 20_081_000
"""Seeds of the judging episodes and of those on which stopping is tuned."""
COUNTS = (1, 2, 1, 0, 1, 2, 1, 2, 1, 0)
"""Hidden effects of the episodes, in turn."""
_CERTAIN = 0.9999
"""Probability of a set after which an episode's belief is taken not to change: evidence grows with
every motion."""
_CERTAIN_MOTIONS = 2
GRID = (1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 18.0, 25.0, 40.0)
"""Machine times of the table [s]."""
GROUPS = (("one effect", 1), ("two effects", 2), ("none", 0))
"""Groups of episodes by the number of hidden effects."""
THRESHOLDS = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
"""Probabilities among which the stopping is tuned."""
COLOURS = {
    "greedy": "#0b6e99",
    "battery": "#c4622d",
    "random": "#7a7a7a",
    "brief": "#8e5ba6",
    "ppo": "#5b8c3a",
}
_COLUMNS = [
    "motion",
    "seconds",
    "wear",
    "right",
    "probability",
    "worth",
    "parameter_error",
    "covered",
]
Case = tuple[str, int]
"""Agent and number of the episode."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings that every row depends on."""

    seed: int = EVALUATION_SEED
    """Seed of the machines."""
    model: str = ""
    """MJCF file of the arm; the package's three-joint arm by default."""
    most: Count = 8
    """Motions of an episode."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Rows that are asked for."""

    settings: OmitArgPrefixes[Settings] = field(default_factory=Settings)
    agents: tuple[Annotated[str, one_of(GAP_AGENTS)], ...] = GAP_AGENTS
    """Agents to play."""
    ppo: Path | None = None
    """Weights of train.py: the agent ppo, which stops by itself."""
    episodes: Count = 60
    """Episodes of each agent."""
    out: Path = ROOT / "docs" / "figures" / "gap_env.jsonl"
    """File of the rows; the figure lies beside it."""
    afresh: bool = False
    """Work out again what is stored."""


def made(model: str | Path | None = None, **settings: Any) -> ModelGapEnv:
    """Make the environment of an arm with the whole library, and fields of its settings."""
    env = gymnasium.make(GAP_ID, model=model, **{"library": "whole", **settings})
    unwrapped = env.unwrapped
    assert isinstance(unwrapped, ModelGapEnv)
    return unwrapped


def played(
    env: ModelGapEnv, agent: Any, *, seed: int, number: int, names: tuple[str, ...] = (),
    most: int = 12,
) -> dict[str, Any]:  # fmt: skip
    """Play one episode, and keep the belief after every motion.

    The agent is one that never stops: when it would have is read off the probabilities.
    """
    options = {"names": names} if names else {"count": COUNTS[number % len(COUNTS)]}
    observation, info = env.reset(seed=int(seed + 1000 * number), options=options)
    assert env.machine is not None
    truth, certain = env.machine.names, 0
    steps: list[Row] = []
    state, start = None, True
    while len(steps) < most and certain < _CERTAIN_MOTIONS:
        action, state = agent.predict(observation, state, np.array([start]))
        start = False
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
        best = env.belief.posterior.best
        certain = certain + 1 if best.probability > _CERTAIN else 0
        hidden = {e.name: e for e in env.machine.effects}
        inside = [
            e.low[own.main] <= own.value <= e.high[own.main]
            for e in best.effects
            if (own := hidden.get(e.name)) is not None
        ]
        steps.append(
            {
                "motion": int(action),
                "seconds": float(info["seconds"]),
                "wear": float(info["wear"]),
                "right": int(best.names == truth),
                "probability": best.probability,
                "worth": float(np.max(observation[env.layout.gain] - env.motion_prices)),
                "parameter_error": env.parameter_error(best),
                "covered": float(np.mean(inside)) if inside else -1.0,
            }
        )
    named = env.belief.posterior.best.names if steps else ()
    return {
        "episode": number,
        "effects": len(truth),
        "truth": " + ".join(truth),
        "named": " + ".join(named),
        "failure": info.get("failure", ""),
        **{name: [step[name] for step in steps] for name in _COLUMNS},
    }


_env = cache(lambda model: made(model or None))


def play(case: Case, *, settings: Settings, ppo: Path | None) -> Row:
    """Play one episode of one agent that does not stop, but for ``ppo``, which stops itself."""
    name, number = case
    env = _env(settings.model)
    if name == "ppo":
        from loose_agents.rl.gap_policy import LearnedGapAgent  # torch where it is used

        assert ppo is not None
        agent: Any = LearnedGapAgent(ppo, env)
    else:
        agent = make_gap_agent(name, env, sure=2.0, seed=number)
    row = played(env, agent, seed=settings.seed, number=number, most=settings.most)
    found: Row = plain({"agent": name, **row}, digits=5)
    return found


def accuracy_at(rows: Sequence[Row], seconds: float) -> float:
    """Share of episodes whose most probable set is right after some machine time [s].

    Before its first motion is through, an episode counts as wrong; after its last one as it ended.
    """
    right = []
    for row in rows:
        done = np.searchsorted(row["seconds"], seconds, side="right")
        right.append(row["right"][done - 1] if done else 0)
    return float(np.mean(right)) if right else float("nan")


def of(rows: Sequence[Row], agent: str, effects: int) -> list[Row]:
    """Episodes of an agent with some number of hidden effects, those without failure."""
    return [
        row
        for row in rows
        if row["agent"] == agent and row["effects"] == effects and row["seconds"]
    ]


def agents_in(rows: Sequence[Row]) -> list[str]:
    """Agents, in the order of their rows."""
    return list(dict.fromkeys(row["agent"] for row in rows))


def groups_of(rows: Sequence[Row]) -> list[tuple[str, str, list[Row]]]:
    """Agent, words and episodes of each group that has any."""
    found = [(a, words, of(rows, a, k)) for words, k in GROUPS for a in agents_in(rows)]
    return [each for each in found if each[2]]


def beliefs(rows: Sequence[Row]) -> tuple[Array, Array]:
    """Probability of the most probable set after every motion, and whether it was right."""
    columns = ([v for row in rows for v in row[name]] for name in ("probability", "right"))
    probability, right = map(np.array, columns)
    return probability, right


def accuracy_table(rows: Sequence[Row]) -> list[str]:
    """Accuracy after some machine times, and in the end with its interval."""
    lines = [
        f"| agent | hidden | episodes | {' | '.join(f'{t:g} s' for t in GRID)} | in the end |",
        "|---|---|---|" + "---|" * (len(GRID) + 1),
    ]
    for agent, words, own in groups_of(rows):
        shares = " | ".join(f"{100 * accuracy_at(own, t):.0f} %" for t in GRID)
        right = sum(row["right"][-1] for row in own)
        low, high = wilson(right, len(own))
        end = f"{100 * right / len(own):.0f} % ({100 * low:.0f} to {100 * high:.0f})"
        lines.append(f"| {agent} | {words} | {len(own)} | {shares} | {end} |")
    return lines


def stopped(row: Row, sure: float, prices: GapPrices | None = None) -> dict[str, float]:
    """Right or not, seconds and reward of an episode that stops as its agent does."""
    prices = prices or GapPrices()
    enough = np.array(row["probability"]) >= sure
    if row["agent"] == "greedy":
        enough |= np.array(row["worth"]) <= 0
    enough[-1] = True
    k = int(np.argmax(enough))
    right = bool(row["right"][k])
    verdict = prices.wrong
    if right:
        off = prices.parameter * min(row["parameter_error"][k], 1.0) if row["effects"] else 0.0
        verdict = prices.correct - off
    cost = prices.second * row["seconds"][k] + prices.wear * row["wear"][k]
    return {
        "right": float(right),
        "seconds": row["seconds"][k],
        "reward": verdict - cost,
        "probability": row["probability"][k],
    }


def best_stopping(rows: Sequence[Row]) -> dict[str, float]:
    """Probability of stopping with the largest mean reward, by agent."""
    found = {}
    for agent in agents_in(rows):
        own = [row for row in rows if row["agent"] == agent and row["seconds"]]
        means = [np.mean([stopped(row, p)["reward"] for row in own]) for p in THRESHOLDS]
        found[agent] = THRESHOLDS[int(np.argmax(means))]
    return found


def stopping_table(rows: Sequence[Row], sure: dict[str, float]) -> list[str]:
    """Accuracy, machine time and reward of the agents with their stopping."""
    lines = [
        "| agent | stops at | one effect | two effects | none | machine time | reward |",
        "|---|---|---|---|---|---|---|",
    ]
    for agent in agents_in(rows):
        shares = []
        for _, effects in GROUPS:
            own = [stopped(row, sure[agent]) for row in of(rows, agent, effects)]
            shares.append(f"{100 * np.mean([o['right'] for o in own]):.0f} %" if own else "")
        every = [stopped(r, sure[agent]) for r in rows if r["agent"] == agent and r["seconds"]]
        rewards = np.array([o["reward"] for o in every])
        stops = f"{sure[agent]:g}" if sure[agent] <= 1 else "its choice"
        error = 1.96 * float(rewards.std()) / np.sqrt(len(rewards))
        lines.append(
            f"| {agent} | {stops} | {' | '.join(shares)} | "
            f"{np.mean([o['seconds'] for o in every]):.1f} s | "
            f"{rewards.mean():+.2f} ± {error:.2f} |"
        )
    return lines


def calibration_table(rows: Sequence[Row]) -> list[str]:
    """Right verdicts by the probability of the most probable set, after every motion."""
    p, right = beliefs(rows)
    lines = ["| probability | beliefs | mean probability | right |", "|---|---|---|---|"]
    edges = (0.0, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0001)
    for low, high in pairwise(edges):
        inside = (p >= low) & (p < high)
        if inside.any():
            lines.append(
                f"| {low:g} to {min(high, 1):g} | {inside.sum()} | {p[inside].mean():.3f} | "
                f"{right[inside].mean():.3f} |"
            )
    covered: Array = np.array([v for row in rows for v in row["covered"][-1:] if v >= 0])
    if len(covered):
        lines += [
            "",
            f"95 % intervals of the parameters that are named rightly hold the true value in "
            f"{100 * covered.mean():.0f} % ({len(covered)} episodes).",
        ]
    return lines


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw accuracy by machine time for one and two effects, and the calibration."""
    grid = np.arange(1.0, 91.0, 0.5)
    panels = []
    for title, effects in GROUPS[:2]:
        curves = []
        for agent in agents_in(rows):
            if own := of(rows, agent, effects):
                shares = [100 * accuracy_at(own, float(t)) for t in grid]
                look = {"color": COLOURS[agent], "drawstyle": "steps-post"}
                curves.append(curve(grid, shares, agent, **look))
        ends = {"ylim": (0, 100), "xlabel": "machine time [s]"}
        panels.append(Panel(title=title, up="accuracy [%]", curves=curves, look=ends))
    p, right = beliefs(rows)
    bins = np.clip((10 * p).astype(int), 0, 9)
    means = [[each[bins == k].mean() for k in sorted(set(bins.tolist()))] for each in (p, right)]
    line = curve([0, 1], [0, 1], color=MUTED, linewidth=1)
    dots = points(means[0], means[1], color=COLOURS["greedy"])
    ends = {"xlabel": "probability of the set"}
    panels.append(Panel(title="calibration", up="share right", curves=[line, dots], look=ends))
    save(chart(panels, columns=3, width=11, height=2.9), path)


def evaluate(options: Options) -> None:
    """Play what is missing, print the tables and draw the figure."""
    settings, agents = options.settings, (*options.agents, *(("ppo",) if options.ppo else ()))
    rows = run_cases(
        [(agent, n) for n in range(options.episodes) for agent in agents],
        partial(play, settings=settings, ppo=options.ppo),
        options.out,
        key=itemgetter("agent", "episode"),
        code=code_of_study(settings),
        say=lambda row: f"{row['agent']}, episode {row['episode']}",
        afresh=options.afresh,
    )
    sure = STOPPING
    if settings.seed == TUNING_SEED:
        sure = best_stopping(rows)
        print(f"best stopping on these episodes: {sure}\n")
    parts = [accuracy_table(rows), stopping_table(rows, sure)]
    print("\n\n".join("\n".join(lines) for lines in [*parts, calibration_table(rows)]))
    draw(rows, options.out.with_suffix(".svg"))


if __name__ == "__main__":
    command("evaluate", __doc__, Options, evaluate, interrupted="the same command goes on")
