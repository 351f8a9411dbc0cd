"""Records that the training of shipped agents took."""

from __future__ import annotations

import json
from typing import Any

from loose_agents.core.base import Problem
from loose_agents.core.estimators import setting_name, weights_path
from loose_agents.registry import AGENTS, LEARNED

__all__ = ["training_of"]

_UNTRAINED = ("always_healthy", "always_unsure", "random", "classical", "classical_literal",
              "images")  # fmt: skip


def training_of(agent: str, problem: Problem) -> int | None:
    """Number of records behind a shipped agent's weights, tuning left out.

    None of an agent from outside, whose training is not known here.
    """
    plain = agent.partition("#")[0]
    if plain not in AGENTS and not agent.startswith("amortised/"):
        return None
    if plain in _UNTRAINED:
        return 0
    records = 0
    bank = _described(f"posterior-{setting_name(problem)}").get("bank")
    if bank is not None:  # episodes of a few records, and some of as many as the rules allow
        few, every = bank["records"]["records"], bank["records"]["long_every"]
        records = round(bank["episodes"] * (few + (problem.settings.max_records - few) / every))
    if plain in LEARNED:
        trained = _described(f"{LEARNED[plain]}-{setting_name(problem)}").get("trained", {})
        records += int(trained.get("steps", 0))
    return records


def _described(name: str) -> dict[str, Any]:
    path = weights_path(name) / "configuration.json"
    found: dict[str, Any] = {}
    if path.is_file():
        found = json.loads(path.read_text(encoding="utf-8"))
    return found
