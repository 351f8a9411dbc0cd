"""Oracle agent: the agent's posterior and policy given all but the location.

It is no agent: what it is told, no agent may know. It says how much of an agent's error comes
from not knowing the direction of the slide and the friction of the guide.

It is told the sliding direction in the frame of the loose link and the guide's friction over the
seat's drive. Both are drawn alike under every hypothesis, so they say nothing about which one is
true; arms that have none of them, healthy ones or joints with play, are told those of a fault
that could have been hidden.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import Problem
from loose_agents.belief import (
    BeliefAgent,
    Policy,
    StoppingRule,
    Tracker,
    make_estimator,
    tuned_stopping,
)
from loose_agents.policies.choice import make_policy
from loose_env.diagnosis import Belief, RecordStatistics
from loose_env.envs import FaultSampler, difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.evaluation import fault_parameters
from loose_env.faults import Backlash, Fault, StructuralLooseness

__all__ = ["InformedBelief", "OracleAgent", "Told", "oracle_agent", "restricted"]


@dataclass(frozen=True, kw_only=True)
class Told:
    """Side information given to the oracle."""

    direction: int
    """Index of the sliding direction among those of the posterior, in the link's frame."""
    friction: int
    """Index of the node of friction over drive."""


def restricted(belief: Belief, told: Told) -> Belief:
    """Condition a belief on the side information, keeping the hypotheses' prior.

    Examples
    --------
    >>> belief = Belief(
    ...     healthy=np.log([0.5]),
    ...     loose=np.log(np.full((1, 3, 2), [[0.1, 0.02], [0.02, 0.02], [0.06, 0.06]])),
    ...     links=1,
    ...     directions=np.eye(2),
    ... )
    >>> restricted(belief, Told(direction=0, friction=0)).probabilities.round(3).tolist()
    [0.49, 0.392, 0.118]
    """
    count, nodes = len(belief.directions), belief.loose.shape[2]
    slides = belief.links * count
    loose = np.full_like(belief.loose, -np.inf)
    at = np.arange(belief.links) * count + told.direction
    # A share of the prior each; divided by it, a hypothesis keeps all of its own.
    loose[:, at, told.friction] = belief.loose[:, at, told.friction] + math.log(count * nodes)
    loose[:, slides:, told.friction] = belief.loose[:, slides:, told.friction] + math.log(nodes)
    return replace(belief, loose=loose)


@dataclass(frozen=True, kw_only=True, eq=False)
class InformedBelief:
    """Posterior belief combined with the side information."""

    base: Any
    """As the posterior keeps it."""
    told: Told | None
    """None: nothing."""

    @cached_property
    def belief(self) -> Belief:
        """Log-weights of the remaining candidates."""
        whole = getattr(self.base, "belief", self.base)
        return whole if self.told is None else restricted(whole, self.told)

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Probability of each hypothesis, in the posterior's order."""
        return self.belief.probabilities


class _InformedPosterior:
    """Posterior whose beliefs carry the side information."""

    def __init__(self, base: Any) -> None:
        self.base, self.hypotheses = base, base.hypotheses

    def start(self, told: Told | None = None) -> InformedBelief:
        """Return the prior."""
        return InformedBelief(base=self.base.start(), told=told)

    def update(self, belief: InformedBelief, record: RecordStatistics) -> InformedBelief:
        """Update with one record."""
        return InformedBelief(base=self.base.update(belief.base, record), told=belief.told)


class OracleAgent(BeliefAgent):
    """`BeliefAgent` that is given direction and friction at the start of an episode.

    `loose_agents.evaluation` tells it, by ``informed``.
    """

    def __init__(
        self,
        problem: Problem,
        estimator: Tracker,
        policy: Policy,
        stopping: StoppingRule,
        *,
        seed: int = 0,
    ) -> None:
        self._posterior = _InformedPosterior(estimator.posterior)
        super().__init__(problem, Tracker(problem, self._posterior), policy, stopping, seed=seed)
        self._directions = self._posterior.start().belief.directions
        self._frictions = np.asarray(estimator.posterior.frictions)  # type: ignore[union-attr]
        self._sampler = FaultSampler(
            problem.linear, difficulty_named(problem.settings.difficulty), problem.settings.kinds
        )

    def begin(self, rng: np.random.Generator) -> Any:
        """Refuse to play without side information."""
        raise InvalidSetting(
            "the oracle must be told each hidden fault: play it with "
            "loose_agents.evaluation, or take the estimator/policy of the same "
            "name, which needs no telling"
        )

    def informed(self, fault: Fault, observation: NDArray[np.float32]) -> Any:
        """Return the initial state of an episode with a hidden fault."""
        rng = self._generator(np.asarray(observation))
        memory = super().begin(rng)
        # A stream of its own: the policy draws what it would have drawn untold.
        memory.estimate.belief = self._posterior.start(self.told(fault, rng.spawn(1)[0]))
        return memory

    def told(self, fault: Fault, rng: np.random.Generator) -> Told:
        """Side information of a fault: nearest direction and friction node.

        Of what it does not have, that of a slide drawn as the environment draws faults.
        """
        slide = fault if isinstance(fault, StructuralLooseness) else self._drawn(rng)
        rubbing = fault if isinstance(fault, Backlash) else slide
        u = np.asarray(slide.direction)[: self._directions.shape[1]]
        ratio = fault_parameters(self._sampler, rubbing).friction_ratio
        assert ratio is not None
        # A guide without friction is nearest to the lowest node.
        share = max(1 / ratio, 1e-12)
        return Told(
            direction=int(np.argmax(np.abs(self._directions @ u))),
            friction=int(np.argmin(np.abs(np.log(self._frictions / share)))),
        )

    def _drawn(self, rng: np.random.Generator) -> StructuralLooseness:
        """Sample a slide that could have been hidden."""
        link = 1 + int(rng.integers(self.problem.arm.n))
        drawn = self._sampler.draw(rng, hypothesis=f"structural_looseness@link{link}")
        assert isinstance(drawn, StructuralLooseness)
        return drawn


def oracle_agent(
    problem: Problem,
    *,
    seed: int = 0,
    estimator: str = "amortised",
    policy: str = "greedy",
) -> OracleAgent:
    """Make the oracle of an estimator and a policy, with the stopping rule tuned for them."""
    made = make_estimator(estimator, problem)
    if not isinstance(made, Tracker) or not hasattr(made.posterior, "frictions"):
        raise InvalidSetting(
            f"the oracle needs an estimator with a posterior over places and frictions, not "
            f"{estimator!r}"
        )
    stopping = tuned_stopping(problem, f"oracle/{policy}")
    return OracleAgent(problem, made, make_policy(policy, problem, made), stopping, seed=seed)
