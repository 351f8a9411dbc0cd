"""Agents that find the loose link or joint of an arm: made by name, built of parts, played.

`make_agent` makes an agent by name, `evaluate` plays it on hidden faults. An agent of one's own
subclasses `EpisodeAgent`, or puts a policy of its own into a `BeliefAgent`; all it needs is
``predict``. Training is in `loose_agents.rl` and `loose_agents.posterior_training`, the benchmark
in `loose_agents.benchmark`.
"""

from loose_agents.base import Agent, EpisodeAgent, Problem
from loose_agents.belief import (
    BeliefAgent,
    Estimator,
    Policy,
    Situation,
    StoppingRule,
    Sure,
    Tracker,
    make_estimator,
)
from loose_agents.evaluation import EpisodeRow, diagnosis_env, evaluate, problem_of
from loose_agents.policies.choice import make_policy
from loose_agents.registry import AGENTS, belief_agent, describe, make_agent

__all__ = [
    "AGENTS",
    "Agent",
    "BeliefAgent",
    "EpisodeAgent",
    "EpisodeRow",
    "Estimator",
    "Policy",
    "Problem",
    "Situation",
    "StoppingRule",
    "Sure",
    "Tracker",
    "belief_agent",
    "describe",
    "diagnosis_env",
    "evaluate",
    "make_agent",
    "make_estimator",
    "make_policy",
    "problem_of",
]
