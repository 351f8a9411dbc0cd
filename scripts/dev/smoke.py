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
    """Play one episode at random, then look at files, version and commands."""
    gymnasium.make(f"loose_env:{ENVIRONMENT}").close()  # it names the module: nothing is imported
    env = gymnasium.make(ENVIRONMENT)
    env.reset(seed=0)
    env.action_space.seed(0)
    steps, ended = 0, False
    while not ended:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        steps, ended = steps + 1, terminated or truncated
        if steps == MOST_STEPS:
            raise SystemExit(f"{ENVIRONMENT} did not end within {MOST_STEPS} steps")
    env.close()
    installed = distribution("loose-env")
    for package, place in PACKAGES.items():
        found = Path(str(importlib.import_module(package).__file__)).parent
        if found.is_relative_to(CLONE):
            raise SystemExit(f"{package} comes from {found}, in the clone: run `make build`")
        if missing := sorted(files_below(CLONE / place) - files_below(found)):
            raise SystemExit(f"{package} was installed without {', '.join(missing)}")
    stated = importlib.import_module("loose_env").__version__
    if stated != installed.version:
        raise SystemExit(f"loose_env.__version__ is {stated}, its metadata say {installed.version}")
    for command in installed.entry_points.select(group="console_scripts"):
        command.load()
    print(f"loose-env {stated} works: {ENVIRONMENT} ended after {steps} steps")


def files_below(folder: Path) -> set[str]:
    """Paths of the files below a folder, relative to it, without Python's caches."""
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


if __name__ == "__main__":
    main()
