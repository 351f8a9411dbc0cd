"""Tuned settings and trained weights: where they lie, and what they are named after."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from loose_agents.base import Problem
from loose_env.envs import DiagnosisSettings

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of tuned settings and trained weights."""


OWN_WEIGHTS = "LOOSE_ENV_WEIGHTS"
"""Environment variable: folder of weights of one's own, which go before the shipped ones."""


def weights_path(name: str) -> Path:
    """Path of weights or tuned settings by name, such as "ppo-vera-default".

    Those in the folder that the environment variable ``LOOSE_ENV_WEIGHTS`` names come first.
    """
    own = os.environ.get(OWN_WEIGHTS)
    if own and (Path(own) / name).exists():
        return Path(own) / name
    return WEIGHTS / name


def weights_digest() -> str:
    """SHA-256 of all tuned settings and trained weights, one's own included.

    What is resumed may only go on with the weights that it began with.
    """
    found = hashlib.sha256()
    folders = [WEIGHTS, *([Path(os.environ[OWN_WEIGHTS])] if os.environ.get(OWN_WEIGHTS) else [])]
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                found.update(path.relative_to(folder).as_posix().encode("utf-8"))
                found.update(path.read_bytes())
    return found.hexdigest()


def tuned(problem: Problem) -> dict[str, Any]:
    """Settings tuned on training episodes of an arm, difficulty and rules; may be empty.

    ``stop`` maps agents to the probability at which they stop, ``constant`` holds the best
    levels of one joint, ``fixed`` the best sequences of records. What was not tuned under other
    rules (`tuning_name`) is that of the usual ones. Written by scripts/agents/tune_agents.py.
    """
    usual, own = (
        json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        for path in (weights_path(f"{f(problem)}.json") for f in (setting_name, tuning_name))
    )
    if setting_name(problem) != tuning_name(problem):
        usual.pop("fixed", None)  # actions of other rules
    return {**usual, **own, "stop": {**usual.get("stop", {}), **own.get("stop", {})}}


def setting_name(problem: Problem) -> str:
    """Name of the tuned or trained item for an arm at a difficulty."""
    difficulty = problem.settings.difficulty
    name = difficulty if isinstance(difficulty, str) else f"own{_digest(difficulty)}"
    return f"{problem.arm.name}-{name}"


def _digest(settings: object) -> str:
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:8]


def tuning_name(problem: Problem) -> str:
    """Name of the settings tuned for an arm, a difficulty and rules other than the usual ones.

    What was trained is known by `setting_name`: a posterior holds for any rules of its arm.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.envs import DiagnosisSettings, Prices
    >>> tuning_name(Problem.of(planar(4), DiagnosisSettings(max_excited=1, durations=(0.2,))))
    'planar4-default-excited1-0.2s'
    >>> tuning_name(Problem.of(planar(4), DiagnosisSettings(prices=Prices(miss=-2.0))))
    'planar4-default-miss-2'
    """
    settings, arm, usual = problem.settings, problem.arm, DiagnosisSettings()
    parts = [setting_name(problem)]
    if settings.max_excited is not None:
        parts.append(f"excited{settings.max_excited}")
    if settings.max_moved is not None:
        parts.append(f"moved{settings.max_moved}")
    if settings.durations != usual.durations:
        parts += [f"{seconds:g}s" for seconds in settings.durations]
    if arm.rated_level is not None:
        parts.append("level" + "_".join(f"{level:g}" for level in arm.levels))
    gravity = arm.model.opt.gravity
    if not np.allclose(gravity, (0.0, 0.0, -9.81), atol=0.1):
        parts.append("gravity" + "_".join(f"{g:g}" for g in gravity))
    for name, price in vars(settings.prices).items():
        if price != getattr(usual.prices, name):
            parts.append(f"{name}{price:g}")
    if settings.moves != usual.moves:
        parts.append("moves" + "_".join(f"{degrees:g}" for degrees in settings.moves))
    for name in ("max_records", "unsure_after"):
        if getattr(settings, name) != getattr(usual, name):
            parts.append(f"{name}{getattr(settings, name)}")
    if settings.kinds != usual.kinds:
        parts.append("kinds_" + "_".join(settings.kinds))
    if settings.sensors != usual.sensors:
        parts.append(f"sensors{_digest(settings.sensors)}")
    return "-".join(parts)
