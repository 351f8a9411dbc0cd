"""Figures that stay from one release to the next, worked out anew."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["GOLDEN", "PARTS", "comparison", "diagnosis", "environments", "gap", "instrument"]

GOLDEN = Path(__file__).resolve().parents[3] / "tests" / "trust" / "golden.json"
"""The figures as they are kept."""
DIGITS = 6
"""Significant digits that are kept."""
ENVIRONMENTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("loose_env/Vera-v0", {"engine": "mujoco"}),
    ("loose_env/Vera-v0", {"engine": "reduced"}),
    ("loose_env/Planar-v0", {"n_links": 3, "engine": "mujoco", "hold": "servo"}),
    ("loose_env/SixAxis-v0", {"engine": "reduced", "difficulty": "hard"}),
    ("loose_env/Scara-v0", {"engine": "mujoco", "difficulty": "easy"}),
)
"""Environments whose episodes are kept."""
SEED = 20260101
DURATIONS = (0.1, 0.15)
"""Lengths of records [s]. Stops that are struck carry on what a processor rounds another way: after
half a second a loose arm may be somewhere else."""
WIDTH = 3
RECORDS = 2


def environments(threads: int = 1) -> dict[str, Any]:
    """Episodes of three arms side by side: faults, observations, rewards."""
    import gymnasium

    import loose_env  # noqa: F401

    found = {}
    for env_id, arguments in ENVIRONMENTS:
        envs: Any = gymnasium.make_vec(
            env_id, num_envs=WIDTH, threads=threads, durations=DURATIONS, **arguments
        )
        rng = np.random.default_rng(SEED)
        observation, _ = envs.reset(seed=list(range(SEED, SEED + WIDTH)))
        faults = [envs.batch.episode(k).fault.hypothesis for k in range(WIDTH)]
        seen, rewards = [observation], []
        for step in range(RECORDS + 1):
            actions = rng.integers(0, envs.actions.nvec, size=(WIDTH, len(envs.actions.nvec)))
            actions[:, -1] = 1 if step == RECORDS else 0
            observation, reward, *_ = envs.step(actions)
            seen.append(observation)
            rewards.append(reward)
        envs.close()
        name = f"{env_id} {arguments}"
        found[name] = {
            "faults": faults,
            "rewards": _digits(np.array(rewards)),
            # The first arm whole, of the others the sum of squares: a change anywhere shows.
            "observations": _digits(np.array([each[0] for each in seen])),
            "squares": _digits(np.array([(each.astype(float) ** 2).sum(axis=1) for each in seen])),
        }
    return found


def comparison(threads: int = 1) -> list[dict[str, Any]]:
    """Rows of two agents on the same six arms."""
    from loose_agents.comparison import EvaluationTask, evaluate_shard

    rows = []
    for agent in ("random", "posterior/random"):
        task = EvaluationTask(
            agent=agent,
            env_id="loose_env/Planar-v0",
            arguments={"n_links": 2, "max_records": 4},
            count=6,
            seed=SEED,
            width=3,
            threads=threads,
        )
        names = ("agent", "episode", "truth", "verdict", "success", "records", "seconds", "reward")
        for row in evaluate_shard(task):
            rows.append({name: _plain(row[name]) for name in names})
    return rows


def diagnosis() -> dict[str, Any]:
    """Posterior over the faults after one record and after two."""
    import gymnasium
    from loose_agents.base import Problem
    from loose_agents.belief import Tracker

    env: Any = gymnasium.make("loose_env/Vera-v0", durations=DURATIONS).unwrapped
    tracker = Tracker(Problem.of(env.arm, env.settings))
    found = {}
    for fault in env.hypotheses:
        observation, _ = env.reset(seed=SEED, options={"fault": fault})
        memory = tracker.begin()
        shown = []
        for moves in ([0, 0], [45, -45]):
            action = env.actions.encode(
                moves=[env.settings.moves.index(float(move)) for move in moves],
                levels=[3, 0],
                duration=1,
            )
            observation, *_ = env.step(action)
            shown.append(_digits(tracker.follow(observation, memory)))
        found[fault] = shown
    env.close()
    return found


def gap(threads: int = 1) -> dict[str, Any]:
    """What `loose gap` finds on a small recording."""
    from loose_env.gap import GapSettings, find_gap
    from loose_env.recording import read_recording
    from scripts.suites.trust.kills.commands import make_recording

    with tempfile.TemporaryDirectory() as place:
        make_recording(Path(place) / "recording")
        recording = read_recording(Path(place) / "recording")
        kinds = ("viscous_friction", "link_mass")
        result = find_gap(recording, GapSettings(threads=threads, kinds=kinds))
    return {
        "verdict": result.verdict,
        "effects": [
            [e.kind, e.where, _digits(list(e.parameters.values()))] for e in result.effects
        ],
        "before": _plain(result.base.held_out_rms),
        "after": _plain(result.best.held_out_rms),
    }


def instrument() -> dict[str, Any]:
    """What `loose diagnose` says of a small recording, and what `loose plan` asks for."""
    from loose_env.instrument import (
        DiagnoseSettings,
        NextSettings,
        diagnose,
        next_for,
        plan,
        read_arm,
    )
    from loose_env.recording import read_recording
    from scripts.suites.trust.kills.commands import make_shaken_recording

    with tempfile.TemporaryDirectory() as place:
        make_shaken_recording(Path(place) / "recording")
        recording = read_recording(Path(place) / "recording")
        choice = NextSettings(poses=4, seconds=1.0)
        found = diagnose(recording, DiagnoseSettings(poses=4, seconds=1.0))
        # Two runs settle it, and then a diagnosis asks for nothing more: a plan does.
        following = next_for(read_arm(recording.model_path), found, choice)
        first = plan(recording.model_path, choice=choice)
    signal = first.signals[0]
    return {
        "fault": found.fault.hypothesis,
        "posterior": {name: _plain(p) for name, p in found.posterior.items()},
        "next": _measurement(following),
        "first": _measurement(first.next),
        "signal": {name: _plain(float(u @ u)) for name, u in signal.commands.items()},
        "tool": _plain(signal.tool_rms),
    }


def _measurement(asked: Any) -> dict[str, Any]:
    return {
        "pose": {name: _plain(q) for name, q in asked.pose.items()},
        "joints": list(asked.joints),
        "torques": _digits(asked.torques),
        "gain": _plain(asked.gain),
    }


PARTS = {
    "environments": environments,
    "comparison": comparison,
    "diagnosis": diagnosis,
    "gap": gap,
    "instrument": instrument,
}
"""Parts of the golden results, by name."""


def _digits(values: Any) -> Any:
    if isinstance(values, (list, tuple, np.ndarray)):
        return [_digits(value) for value in values]
    return _plain(float(values))


def _plain(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
