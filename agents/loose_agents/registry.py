"""Registry of agents: made by name or as ``estimator/policy``, described, hashed.

An agent is a name of `AGENTS`, or an estimator and a policy in the form ``estimator/policy``,
such as ``posterior/random``.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import json
import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from loose_agents.base import Agent, Problem
from loose_agents.belief import (
    ESTIMATORS,
    AfterRecords,
    BeliefAgent,
    Sure,
    make_estimator,
    tuned_stopping,
    usual_estimator,
)
from loose_agents.policies.choice import (
    FIXED_RECORDS,
    POLICIES,
    FixedPolicy,
    make_policy,
    tuned_sequence,
)
from loose_agents.policies.classical import (
    BlindAgent,
    ClassicalAgent,
    ClassicalSettings,
    LocalAgent,
    arm_class,
)
from loose_agents.policies.link_finding import LinkFindingAgent
from loose_agents.policies.rhythm import RhythmAgent
from loose_agents.stored import setting_name, tuned, weights_digest, weights_path
from loose_env.diagnosis import LinkFindingSettings, Order
from loose_env.errors import UnknownName
from loose_env.faults import UNSURE


def belief_agent(estimator: str, policy: str, problem: Problem, *, seed: int = 0) -> BeliefAgent:
    """Make an agent of an estimator and a policy, with the stopping rule tuned for them.

    Parameters
    ----------
    estimator, policy : str
        Names in `loose_agents.belief.ESTIMATORS` and
        `loose_agents.policies.choice.POLICIES`.
    problem : Problem
        The nominal arm and the rules.
    seed : int
        Seed of its random draws.
    """
    made = make_estimator(estimator, problem)
    stopping = tuned_stopping(problem, f"{estimator}/{policy}")
    return BeliefAgent(problem, made, make_policy(policy, problem, made), stopping, seed=seed)


def classical_settings(problem: Problem) -> ClassicalSettings:
    """Settings of the classical method that ship for an arm's class."""
    return ClassicalSettings(**_tuned_search(f"{arm_class(problem)}-classical"))


def _of(policy: str, estimator: str = "") -> Callable[[Problem, int], Agent]:
    """A policy with an estimator, by default the usual one of the problem: rivals share it."""
    return lambda problem, seed: belief_agent(
        estimator or usual_estimator(problem), policy, problem, seed=seed
    )


def _fixed(records: int) -> Callable[[Problem, int], Agent]:
    """The best sequence of so many records, all of them taken."""

    def make(problem: Problem, seed: int) -> Agent:
        made = make_estimator(usual_estimator(problem), problem)
        policy = FixedPolicy(problem, tuned_sequence(problem, records))
        return BeliefAgent(problem, made, policy, AfterRecords(records=records), seed=seed)

    return make


def _classical(
    order: Order | None = None, method: type[ClassicalAgent] = ClassicalAgent
) -> Callable[[Problem, int], Agent]:
    """The classical method or its local form, in the tuned order or in a given one."""

    def make(problem: Problem, seed: int) -> Agent:
        settings = classical_settings(problem)
        if order is not None:
            settings = replace(settings, order=order)
        return method(problem, settings, seed=seed)

    return make


def _classical_literal(problem: Problem, seed: int) -> Agent:
    settings = _tuned_search(f"{problem.arm.name}-classical_literal")
    agent = LinkFindingAgent(problem, LinkFindingSettings(**settings), seed=seed)
    if not settings:
        warnings.warn(
            f"classical_literal is not tuned for arm {problem.arm.name!r}: it plays with untuned "
            "thresholds; scripts/agents/tune_link_finding.py tunes them",
            stacklevel=2,
        )
    return agent


def _tuned_search(name: str) -> dict[str, Any]:
    """Settings of a search tuned for an arm or a class of arms; none where it was not."""
    path = weights_path(f"{name}.json")
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def _blind(verdict: str) -> Callable[[Problem, int], Agent]:
    return lambda problem, seed: BlindAgent(problem, verdict, seed=seed)


def _learned(name: str, training: str = "") -> Callable[[Problem, int], Agent]:
    def make(problem: Problem, seed: int) -> Agent:
        from loose_agents.rl.agents import LearnedAgent

        folder = f"{name}-{setting_name(problem)}"
        agent = LearnedAgent.load(
            problem, weights_path(f"{folder}-{training}" if training else folder)
        )
        stop = tuned(problem).get("stop", {}).get(name)
        if stop is not None:  # earns more than the policy's own stopping, on training episodes
            agent.stopping = Sure(probability=stop)
        return agent

    return make


LEARNED = ("ppo", "maskable_ppo")
"""Learned agents, named after the algorithm that trained each."""


AGENTS: dict[str, tuple[Callable[[Problem, int], Agent], str]] = {
    "random": (_of("random", "posterior"), "random moves and shakes until its posterior is sure"),
    "classical": (
        _classical(),
        "the thesis's link finding by the change of motion, all poses pooled",
    ),
    "outward": (_classical("outward"), "the same, from the base outward"),
    "inward": (_classical("inward"), "the same, from the tool inward"),
    "bisection": (_classical("bisection"), "the same, halving the arm"),
    "local": (
        _classical(method=LocalAgent),
        "the same with accelerometers on the links beside the tool's",
    ),
    "rhythm": (
        lambda problem, seed: RhythmAgent(problem, seed=seed),
        "the seat whose knocks explain when the accelerometer rang, no learned model",
    ),
    "classical_literal": (
        _classical_literal,
        "the thesis's link finding to the letter, in the plane: two poses compared",
    ),
    "constant": (
        _of("constant"),
        "the task's posterior, always the best single joint, random poses",
    ),
    "together": (
        _of("together"),
        "the task's posterior, always all joints, random poses",
    ),
    "greedy": (_of("greedy"), "the task's posterior, the most telling record next"),
    "look_ahead": (_of("look_ahead"), "the same, two records ahead"),
    "foresight": (
        _of("foresight", "calibrated"),
        "probabilities and the choice of records corrected by what came true on simulated arms",
    ),
    **{
        f"fixed_{k}": (_fixed(k), f"the same {k} record{'s' * (k > 1)} on every arm, then a name")
        for k in range(1, FIXED_RECORDS + 1)
    },
    "fixed": (_of("fixed"), "the same records on every arm, until its posterior is sure"),
    "open_loop": (_of("open_loop"), "records chosen by the model, blind to their results"),
    "always_healthy": (_blind("healthy"), "blind: healthy, after the cheapest record"),
    "always_unsure": (_blind(UNSURE), "blind: unsure, after the cheapest records that allow it"),
    "ppo": (_learned("ppo"), "a policy trained by PPO on the learned posterior"),
    "maskable_ppo": (_learned("maskable_ppo"), "the same, allowed choices only"),
}
"""Constructor and short description of each agent."""


def describe(name: str) -> str:
    """Describe an agent in a short phrase; of ``ppo#2`` with the number of its training."""
    name, _, number = name.partition("#")
    if name in AGENTS:
        return AGENTS[name][1] + (f"; training {number}" if number else "")
    if is_outside(name):
        return f"from {name}"
    estimator, _, policy = name.partition("/")
    _require(name, estimator, policy)
    return f"{ESTIMATORS[estimator][1]}; {POLICIES[policy][1]}"


def make_agent(name: str, problem: Problem, *, seed: int = 0) -> Agent:
    """Make an agent for a problem.

    A learned agent's further trainings, from other seeds, are ``ppo#2``, ``ppo#3``, ...;
    ``ppo#1`` is the first, ``ppo`` itself. From outside the package come ``module:Class``, called
    as ``Class(problem, seed=seed)``, with `predict`, or `choose` alone (a policy on the usual
    estimator); ``path/model.zip``, a model of stable-baselines3 (`loose_agents.rl.model_agent`);
    and ``path/folder``, a policy that ``scripts/agents/train.py --export`` wrote.

    Raises
    ------
    UnknownName
        If there is no agent of that name.
    InvalidData
        If a file is no model of this problem.
    """
    if name in AGENTS:
        return AGENTS[name][0](problem, seed)
    plain, _, training = name.partition("#")
    if plain in LEARNED and training.isdigit():
        return _learned(plain, "" if training == "1" else training)(problem, seed)
    if is_outside(name):
        return _from_outside(name, problem, seed)
    estimator, _, policy = name.partition("/")
    _require(name, estimator, policy)
    return belief_agent(estimator, policy, problem, seed=seed)


def content_of(name: str) -> str:
    """SHA-256 of what an agent is made of: its file or folder, its module, or the weights.

    Played episodes are taken up again only for the same content.
    """
    place = Path(name)
    if place.exists():
        files = sorted(place.rglob("*")) if place.is_dir() else [place]
    elif ":" in name:
        _look_beside_the_command()
        try:
            found = importlib.util.find_spec(name.partition(":")[0])
        except (ImportError, ValueError):
            found = None  # making the agent says why
        origin = None if found is None else found.origin
        files = [] if origin is None else [Path(origin)]
    else:
        return weights_digest()
    content = b"".join(each.read_bytes() for each in files if each.is_file())
    return hashlib.sha256(content).hexdigest()


def is_outside(name: str) -> bool:
    """Return whether a name stands for an agent from outside the package."""
    return name.endswith(".zip") or Path(name).is_dir() or ":" in name


def _from_outside(name: str, problem: Problem, seed: int) -> Agent:
    if name.endswith(".zip"):
        from loose_agents.rl.agents import model_agent

        return model_agent(name, problem, seed=seed)
    if Path(name).is_dir():
        from loose_agents.rl.agents import LearnedAgent

        return LearnedAgent.load(problem, name)
    module, _, attribute = name.partition(":")
    _look_beside_the_command()
    try:
        kind = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise UnknownName(
            f"no agent {name!r}: {error}; give module:Class, with the module importable from here"
        ) from error
    try:
        inspect.signature(kind).bind(problem, seed=seed)
    except (TypeError, ValueError) as error:
        raise UnknownName(f"{name!r} is not made by Class(problem, seed=seed): {error}") from error
    made: Any = kind(problem, seed=seed)
    if callable(getattr(made, "predict", None)):
        return cast(Agent, made)
    if not callable(getattr(made, "choose", None)):
        raise UnknownName(
            f"{name!r} makes a {type(made).__name__}, which has no predict(observation, state, "
            "episode_start, deterministic), nor choose(situation)"
        )
    estimator = make_estimator(usual_estimator(problem), problem)
    return BeliefAgent(problem, estimator, made, Sure(), seed=seed)


def _look_beside_the_command() -> None:
    """Let a module beside the command be found, as python itself finds it."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def _require(name: str, estimator: str, policy: str) -> None:
    if estimator not in ESTIMATORS or policy not in POLICIES:
        raise UnknownName(
            f"unknown agent {name!r}; agents are {list(AGENTS)}, or an estimator of "
            f"{list(ESTIMATORS)} and a policy of {list(POLICIES)}, as in posterior/random; "
            "from outside come module:Class, path/model.zip and the folder of an exported policy"
        )
