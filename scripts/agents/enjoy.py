"""Play a trained policy and print, step by step, its actions and its posterior.

Usage: python scripts/agents/enjoy.py --algo ppo --env loose_env/Vera-v0 -f runs

Takes the runs of scripts/agents/train.py, or any folder with trained weights:
--weights agents/loose_agents/weights/ppo-vera-default.
"""

from __future__ import annotations

import argparse
import importlib
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from loose_agents.base import Problem
from loose_agents.evaluation import diagnosis_env
from loose_agents.execution.command import OneLineParser
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.rl.hyperparameters import ALGORITHMS, key_values
from loose_agents.rl.learned_policy import CONFIGURATION, LearnedAgent

from loose_env.envs import Action, DiagnosisEnv
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.io import write_bytes
from loose_env.registration import IDS


def parser() -> OneLineParser:
    """Options of playing."""
    options = OneLineParser(
        prog="enjoy", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = options.add_argument
    add("--algo", default="ppo", choices=list(ALGORITHMS), help="algorithm of the run")
    add("--env", default="loose_env/Vera-v0", help="environment id")
    add("-f", "--folder", default="runs", help="folder of the runs")
    add("--exp-id", type=int, help="the run's number, its seed; by default the latest run")
    add("--weights", default="", help="folder with weights, in place of a run")
    add("--load-best", action="store_true", help="the best policy, not the last")
    add("--env-kwargs", nargs="+", default=[], metavar="KEY:VALUE",
        help="arguments of the environment that override the run's")  # fmt: skip
    add("--gym-packages", nargs="+", default=[], help="packages to import for their ids")
    add("--seed", type=int, default=0, help="seed of the episodes")
    add("--n-episodes", type=int, default=5, help="episodes to play")
    add("-n", "--n-timesteps", type=int, default=1000, help="steps after which no episode begins")
    add("--render", nargs="?", const="pictures", default="", metavar="FOLDER",
        help="write a picture of each record")  # fmt: skip
    add("--no-render", action="store_true", help="write no pictures (as is the default)")
    return options


def run_folder(options: argparse.Namespace) -> Path:
    """Find the weights that are to be played.

    Raises
    ------
    InvalidData
        If there is no such run.
    """
    if options.weights:
        return Path(options.weights)
    home = Path(options.folder) / ALGORITHMS[options.algo][0]
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


def environment_of(
    folder: Path, options: argparse.Namespace
) -> tuple[DiagnosisEnv, dict[str, Any]]:
    """Make the environment of a run, and return the arguments that it was made with.

    Raises
    ------
    UnknownName
        If the id is none of the registered ones.
    """
    from loose_agents.rl.training_run import RunFolder

    described = RunFolder(folder).described()
    if options.env not in gymnasium.registry:
        raise UnknownName(f"unknown environment {options.env!r}; they are {', '.join(IDS)}")
    arguments = {**described.get("env_kwargs", {})}
    arguments |= key_values(options.env_kwargs, "--env-kwargs")
    mode = "rgb_array" if options.render else None
    return diagnosis_env(options.env, arguments, render_mode=mode), arguments


def shaken(env: DiagnosisEnv, action: Action) -> str:
    """Joints that an action excites, and how."""
    names = env.settings.level_names(env.arm)
    on = [
        f"{joint} {names[level].split(' ')[0]}"
        for joint, level in zip(env.arm.joints, action.levels, strict=True)
        if level
    ]
    return ", ".join(on) or "none"


def posed(env: DiagnosisEnv, pose: Sequence[float]) -> str:
    """Pose in degrees, in millimetres where a joint slides."""
    return " ".join(
        f"{1000 * q:+.0f}mm" if slides else f"{np.degrees(q):+.0f}°"
        for q, slides in zip(pose, env.arm.sliding, strict=True)
    )


def believed(problem: Problem, probabilities: Sequence[float], count: int = 3) -> str:
    """Name the most probable hypotheses."""
    order = np.argsort(probabilities)[::-1][:count]
    return "  ".join(f"{problem.hypotheses[k]} {100 * probabilities[k]:.1f} %" for k in order)


def write_picture(env: DiagnosisEnv, path: Path) -> None:
    """Write what the environment draws."""
    from matplotlib import image

    buffer = io.BytesIO()
    image.imsave(buffer, env.render(), format="png")
    write_bytes(path, buffer.getvalue())


def play_episode(
    env: DiagnosisEnv, agent: LearnedAgent, number: int, pictures: Path | None
) -> dict[str, Any]:
    """Play the episode that the environment has begun; print a line a step."""
    observation = env.batch.observe(0)
    belief = agent.estimator.begin()
    problem, state, total, step = agent.problem, None, 0.0, 0
    print(f"\nepisode {number}: {believed(problem, agent.estimator.follow(observation, belief))}")  # type: ignore[arg-type]
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
        pose = problem.layout.pose_of(observation)
        print(
            f"  {step:2d}  pose {posed(env, pose)}  |  m/s² {shaken(env, decoded)}  "  # type: ignore[arg-type]
            f"{decoded.duration:g} s  |  "
            f"{believed(problem, agent.estimator.follow(observation, belief))}"  # type: ignore[arg-type]
        )
        if pictures is not None:
            write_picture(env, pictures / f"episode{number}_record{step}.png")


def enjoy(options: argparse.Namespace) -> None:
    """Play the episodes."""
    for package in options.gym_packages:
        importlib.import_module(package)
    for name in ("n_episodes", "n_timesteps"):
        if getattr(options, name) < 1:
            raise InvalidSetting(
                f"--{name.replace('_', '-')} must be 1 or more, got {getattr(options, name)}"
            )
    if options.seed < 0:
        raise InvalidSetting(f"--seed must be 0 or more, got {options.seed}")
    if options.no_render:
        options.render = ""
    folder = run_folder(options)
    env, arguments = environment_of(folder, options)
    agent = LearnedAgent.load(Problem.of(env.arm, env.settings), folder)
    pictures = Path(options.render) if options.render else None
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
    print(f"{folder}: {options.env} {arguments or ''}")
    played: list[dict[str, Any]] = []
    while len(played) < options.n_episodes:
        env.reset(seed=None if played else options.seed)
        played.append(play_episode(env, agent, len(played) + 1, pictures))
        if sum(row["records"] + 1 for row in played) >= options.n_timesteps:
            break
    env.close()
    print(
        f"\n{len(played)} episodes: success {np.mean([r['success'] for r in played]):.3f}, "
        f"mean records {np.mean([r['records'] for r in played]):.2f}, "
        f"mean return {np.mean([r['return'] for r in played]):+.3f}"
    )
    if pictures is not None:
        print(f"pictures: {pictures}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the options and play, with errors in one line."""
    options = parser().parse_args(arguments)
    with errors_in_one_line("enjoy"):
        enjoy(options)


if __name__ == "__main__":
    main()
