"""Agents by name, with the settings and weights that ship beside them."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path

from agents.base import Agent, Problem
from agents.link_finding import LinkFindingAgent
from agents.space_link_finding import SpaceLinkFindingAgent, SpaceLinkFindingSettings
from loose_env.diagnosis.link_finding import LinkFindingSettings, Order
from loose_env.errors import UnknownName

__all__ = ["AGENTS", "WEIGHTS", "make_agent"]

WEIGHTS = Path(__file__).parent / "weights"
"""Where tuned settings and trained weights lie."""


def _random(problem: Problem, seed: int) -> Agent:
    from agents.random_agent import RandomAgent

    return RandomAgent(problem, seed=seed)


def _link_finding(order: Order) -> Callable[[Problem, int], Agent]:
    def make(problem: Problem, seed: int) -> Agent:
        if len(problem.arm.axes) == 3:
            # In space; its thresholds follow from the mismatch and need no tuning.
            rules = LinkFindingSettings(order=order)
            return SpaceLinkFindingAgent(
                problem, SpaceLinkFindingSettings(policy="turns", rules=rules), seed=seed
            )
        tuned = WEIGHTS / f"{problem.arm.name}-{order}.json"
        if not tuned.is_file():
            warnings.warn(
                f"link finding {order} is not tuned for arm {problem.arm.name!r}: it plays with "
                "untuned thresholds; scripts/tune_link_finding.py tunes them",
                stacklevel=2,
            )
            return LinkFindingAgent(problem, LinkFindingSettings(order=order), seed=seed)
        settings = LinkFindingSettings(**json.loads(tuned.read_text(encoding="utf-8")))
        return LinkFindingAgent(problem, settings, seed=seed)

    return make


def _images(problem: Problem, seed: int) -> Agent:
    return SpaceLinkFindingAgent(problem, seed=seed)


def _ppo(problem: Problem, seed: int) -> Agent:
    from agents.learned import LearnedAgent

    return LearnedAgent.load(problem, WEIGHTS / problem.arm.name)


AGENTS: dict[str, tuple[Callable[[Problem, int], Agent], str]] = {
    "random": (_random, "random moves and shakes until its posterior is sure"),
    "thesis": (_link_finding("outward"), "the thesis's link finding, from the base outward"),
    "inward": (_link_finding("inward"), "the same, from the tool inward"),
    "bisection": (_link_finding("bisection"), "the same, halving the arm"),
    "images": (_images, "predicted directions of every hypothesis, all joints at once"),
    "ppo": (_ppo, "a policy trained by PPO on the posterior"),
}
"""How each agent is made, and what it is in a few words."""


def make_agent(name: str, problem: Problem, *, seed: int = 0) -> Agent:
    """Make an agent for a problem.

    Raises
    ------
    UnknownName
        If there is no agent of that name.
    """
    if name not in AGENTS:
        raise UnknownName(f"unknown agent {name!r}; agents are {list(AGENTS)}")
    return AGENTS[name][0](problem, seed)
