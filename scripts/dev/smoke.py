"""Try an installed loose-env: its files, its commands and one episode.

``make build`` runs this file in a clean environment and from another folder, so that what is
tried is the installed package and not the clone this file lies in.
"""

from __future__ import annotations

import importlib
from importlib.metadata import distribution
from pathlib import Path

import gymnasium

CLONE = Path(__file__).resolve().parents[2]
PACKAGES = {"loose_env": "loose_env", "loose_agents": "agents/loose_agents"}
"""Installed packages, and where each lies in the clone."""
ENVIRONMENT = "loose_env/Vera-v0"
MOST_STEPS = 10_000


def main() -> None:
    """Try each part in turn; the first that fails ends the run."""
    steps = play_one_episode()
    installed = distribution("loose-env")
    for package in PACKAGES:
        check_files(package)
    check_version(installed.version)
    for command in installed.entry_points.select(group="console_scripts"):
        command.load()
    print(f"loose-env {installed.version} works: {ENVIRONMENT} ended after {steps} steps")


def play_one_episode() -> int:
    """Play at random until the episode ends, and count the steps.

    The first ``make`` names the module, so nothing has to be imported before it.
    """
    gymnasium.make(f"loose_env:{ENVIRONMENT}").close()
    env = gymnasium.make(ENVIRONMENT)
    env.reset(seed=0)
    env.action_space.seed(0)
    for step in range(1, MOST_STEPS + 1):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.close()
            return step
    raise SystemExit(f"{ENVIRONMENT} did not end within {MOST_STEPS} steps")


def check_files(package: str) -> None:
    """Every file of the clone's package is installed, weights and models included."""
    installed = Path(str(importlib.import_module(package).__file__)).parent
    if installed.is_relative_to(CLONE):
        raise SystemExit(f"{package} comes from {installed}, in the clone: run `make build`")
    missing = sorted(files_below(CLONE / PACKAGES[package]) - files_below(installed))
    if missing:
        raise SystemExit(f"{package} was installed without {', '.join(missing)}")


def files_below(folder: Path) -> set[str]:
    """Paths of the files below a folder, relative to it, without Python's caches."""
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def check_version(version: str) -> None:
    """The package and its metadata name the same version."""
    stated = importlib.import_module("loose_env").__version__
    if stated != version:
        raise SystemExit(f"loose_env.__version__ is {stated}, but pyproject.toml says {version}")


if __name__ == "__main__":
    main()
