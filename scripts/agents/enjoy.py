"""Play a trained policy and print, step by step, its actions and its posterior.

Usage: python scripts/agents/enjoy.py --algo ppo --env loose_env/Vera-v0 -f runs

Takes the runs of scripts/agents/train.py, or any folder with trained weights:
--weights agents/loose_agents/weights/ppo-vera-default.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
from loose_agents import Problem, diagnosis_env
from loose_agents.rl.agents import CONFIGURATION, LearnedAgent, described_run
from loose_agents.rl.hyperparameters import ALGORITHMS, key_values
from tyro.conf import arg

from loose_env.cli.command import command, one_of
from loose_env.envs import Action, DiagnosisEnv
from loose_env.errors import InvalidData, UnknownName
from loose_env.io import Count, NonNegativeCount, write_bytes
from loose_env.registration import IDS


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of playing."""

    algo: Annotated[str, one_of(ALGORITHMS)] = "ppo"
    """Algorithm of the run."""
    env: str = "loose_env/Vera-v0"
    """Environment id."""
    folder: Annotated[Path, arg(aliases=["-f"])] = Path("runs")
    """Folder of the runs."""
    exp_id: int | None = None
    """The run's number, its seed; by default the latest run."""
    weights: Path | None = None
    """Folder with weights, in place of a run."""
    load_best: bool = False
    """The best policy, not the last."""
    env_kwargs: tuple[str, ...] = ()
    """Arguments of the environment that override the run's, key:value."""
    seed: NonNegativeCount = 0
    """Seed of the episodes."""
    n_episodes: Count = 5
    """Episodes to play."""
    render: Path | None = None
    """Folder for a picture of each record."""


def run_folder(options: Options) -> Path:
    """Find the weights that are to be played."""
    if options.weights is not None:
        return options.weights
    home = options.folder / options.algo
    name = options.env.replace("/", "-")
    number = re.compile(rf"{re.escape(name)}_(\d+)")
    found = {
        int(match[1]): path
        for path in (home.iterdir() if home.is_dir() else ())
        if (match := number.fullmatch(path.name)) and (path / CONFIGURATION).is_file()
    }
    if not found or (options.exp_id is not None and options.exp_id not in found):
        there = f"; there are {sorted(found)}" if found else ""
        wanted = "<seed>" if options.exp_id is None else options.exp_id
        raise InvalidData(
            f"no run at {home / f'{name}_{wanted}'}{there}; scripts/agents/train.py makes one"
        )
    latest = max(found, key=lambda k: (found[k] / CONFIGURATION).stat().st_mtime)
    root = found[latest if options.exp_id is None else options.exp_id]
    return root / "best" if options.load_best else root


def shaken(env: DiagnosisEnv, action: Action) -> str:
    """Joints that an action excites, and how."""
    levels = zip(env.arm.joints, action.levels, strict=True)
    on = [f"{joint} {env.arm.levels[level - 1]:g}" for joint, level in levels if level]
    return ", ".join(on) or "none"


def posed(env: DiagnosisEnv, pose: Sequence[float]) -> str:
    """Pose in degrees, in millimetres where a joint slides."""
    return " ".join(
        f"{1000 * q:+.0f}mm" if slides else f"{np.degrees(q):+.0f}°"
        for q, slides in zip(pose, env.arm.sliding, strict=True)
    )


def believed(problem: Problem, probabilities: Any, count: int = 3) -> str:
    """Name the most probable hypotheses."""
    order = np.argsort(probabilities)[::-1][:count]
    return "  ".join(f"{problem.hypotheses[k]} {100 * probabilities[k]:.1f} %" for k in order)


def play_episode(
    env: DiagnosisEnv, agent: LearnedAgent, number: int, pictures: Path | None
) -> dict[str, Any]:
    """Play the episode that the environment has begun; print a line a step."""
    observation = env.batch.observe(0)
    belief = agent.estimator.begin()
    problem, state, total, step = agent.problem, None, 0.0, 0

    def known() -> Any:
        return agent.estimator.follow(observation[None], [belief])[0]

    print(f"\nepisode {number}: {believed(problem, known())}")
    while True:
        action, state = agent.predict(observation, state)
        observation, reward, terminated, truncated, info = env.step(action)
        total += float(reward)
        step += 1
        if terminated or truncated:
            named = info["verdict"] or info.get("failure", "none")
            right = "right" if info["is_success"] else "wrong"
            print(f"  verdict {named}, truth {info['fault']}: {right}, return {total:+.3f}")
            return {"return": total, "success": info["is_success"], "records": info["records"]}
        decoded = env.actions.decode(action)
        pose: Any = problem.layout.pose_of(observation)
        print(
            f"  {step:2d}  pose {posed(env, pose)}  |  m/s² {shaken(env, decoded)}  "
            f"{decoded.duration:g} s  |  "
            f"{believed(problem, known())}"
        )
        if pictures is not None:
            from matplotlib import image

            buffer = io.BytesIO()
            image.imsave(buffer, env.render(), format="png")
            write_bytes(pictures / f"episode{number}_record{step}.png", buffer.getvalue())


def enjoy(options: Options) -> None:
    """Play the episodes."""
    folder = run_folder(options)
    if options.env not in gymnasium.registry:
        raise UnknownName(f"unknown environment {options.env!r}; they are {', '.join(IDS)}")
    arguments = {**described_run(folder).get("env_kwargs", {})}
    arguments |= key_values(options.env_kwargs, "--env-kwargs")
    mode = "rgb_array" if options.render else None
    env = diagnosis_env(options.env, arguments, render_mode=mode)
    agent = LearnedAgent.load(Problem.of(env.arm, env.settings), folder)
    if options.render is not None:
        options.render.mkdir(parents=True, exist_ok=True)
    print(f"{folder}: {options.env} {arguments or ''}")
    played: list[dict[str, Any]] = []
    for number in range(1, options.n_episodes + 1):
        env.reset(seed=None if played else options.seed)
        played.append(play_episode(env, agent, number, options.render))
    env.close()
    print(
        f"\n{len(played)} episodes: success {np.mean([r['success'] for r in played]):.3f}, "
        f"mean records {np.mean([r['records'] for r in played]):.2f}, "
        f"mean return {np.mean([r['return'] for r in played]):+.3f}"
    )
    if options.render is not None:
        print(f"pictures: {options.render}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the options and play, with errors in one line."""
    command("enjoy", __doc__, Options, enjoy, arguments)


if __name__ == "__main__":
    main()
