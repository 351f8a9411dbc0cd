"""Records that the training of shipped agents took."""

from __future__ import annotations

import json
from typing import Any

from loose_agents.core.base import Problem
from loose_agents.core.estimators import (
    setting_name,
    tuning_name,
    usual_estimator,
    weights_path,
)
from loose_agents.registry import AGENTS, LEARNED, is_outside

__all__ = ["training_of"]

_UNTRAINED = ("always_healthy", "always_unsure", "random", "classical", "classical_literal",
              "outward", "inward", "bisection", "local", "images")  # fmt: skip
_BANKS = {"amortised": "posterior", "ratio": "ratio", "posterior": None}
"""First part of the name of the weights that an estimator is trained to, None where it is not."""


def training_of(agent: str, problem: Problem) -> int | None:
    """Number of records behind a shipped agent's weights, tuning left out.

    None of an agent from outside, whose training is not known here.
    """
    plain, _, number = agent.partition("#")
    if plain in _UNTRAINED:
        return 0
    estimator = plain.partition("/")[0] if "/" in plain else usual_estimator(problem)
    if estimator not in _BANKS or (plain not in AGENTS and is_outside(agent)):
        return None
    trained_to, name = _BANKS[estimator], setting_name(problem)
    records = 0
    if trained_to is not None:
        own = tuning_name(problem) if estimator == "ratio" else name
        records = _of_bank(_described(f"{trained_to}-{own}").get("bank"), problem)
    if plain in LEARNED:
        suffix = f"-{number}" if number not in ("", "1") else ""
        trained = _described(f"{LEARNED[plain]}-{name}{suffix}").get("trained", {})
        records += int(trained.get("steps", 0))
    return records


def _of_bank(bank: dict[str, Any] | None, problem: Problem) -> int:
    """Records of a bank: episodes of a few, and some of as many as the rules allow."""
    if bank is None:
        return 0
    few, every = int(bank["records"]["records"]), int(bank["records"]["long_every"])
    return round(int(bank["episodes"]) * (few + (problem.settings.max_records - few) / every))


def _described(name: str) -> dict[str, Any]:
    path = weights_path(name) / "configuration.json"
    found: dict[str, Any] = {}
    if path.is_file():
        found = json.loads(path.read_text(encoding="utf-8"))
    return found
