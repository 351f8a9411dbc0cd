"""Tuned settings that ship with the package, by arm and difficulty."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from loose_agents.core.base import Problem

__all__ = ["WEIGHTS", "setting_name", "tuned"]

WEIGHTS = Path(__file__).parents[1] / "weights"
"""Where tuned settings and trained weights lie."""


def tuned(problem: Problem) -> dict[str, Any]:
    """Settings tuned on training episodes of an arm and difficulty; may be empty.

    ``stop`` maps agents to the probability at which they stop, ``constant`` holds the best
    levels of one joint, ``information`` the factors on expected information. Written by
    scripts/agents/tune_agents.py and scripts/agents/fit_information.py.
    """
    path = WEIGHTS / f"{setting_name(problem)}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def setting_name(problem: Problem) -> str:
    """Name of the tuned or trained item for an arm at a difficulty."""
    difficulty = problem.settings.difficulty
    name = difficulty if isinstance(difficulty, str) else "own"
    return f"{problem.arm.name}-{name}"
