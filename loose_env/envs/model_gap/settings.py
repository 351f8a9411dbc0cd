"""Settings of the model-gap environment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from loose_env.envs.model_gap.hidden_machine import MachineDraw
from loose_env.gap import BeliefSettings
from loose_env.io import Checked, Count, NonNegative, Positive, Probability, Rule

__all__ = ["GapPrices", "ModelGapSettings"]

_KINDS = Rule("kinds of the catalogue, none for all")


@dataclass(frozen=True, kw_only=True)
class GapPrices(Checked):
    """Rewards of verdicts and prices of machine time.

    Examples
    --------
    >>> GapPrices().verdict(("payload@tool",), ("payload@tool",), parameter_error=0.1)
    0.98
    >>> GapPrices().verdict(("payload@tool",), ("base_tilt@base",), parameter_error=1.0)
    -1.0
    """

    correct: float = 1.0
    """Reward for naming every missing effect at its location and nothing else."""
    partly: float = 0.0
    """Reward for naming one of two and nothing false."""
    wrong: float = -1.0
    """Reward for anything else."""
    parameter: NonNegative = 0.2
    """Price of the mean relative error of the parameters, at most 1, of a correct verdict."""
    second: NonNegative = 0.01
    """Price of one second of machine time."""
    wear: NonNegative = 0.1
    """Price of one second at the torque limit of one joint: wear is the integral of the squared
    shares of the torque limits."""

    def verdict(
        self, named: tuple[str, ...], truth: tuple[str, ...], *, parameter_error: float
    ) -> float:
        """Reward of a verdict."""
        reward = self.named(named, truth)
        if set(named) == set(truth):
            return reward - self.parameter * min(parameter_error, 1.0) * bool(truth)
        return reward

    def named(self, named: tuple[str, ...], truth: tuple[str, ...]) -> float:
        """Reward of the names alone."""
        if set(named) == set(truth):
            return self.correct
        if named and set(named) < set(truth):
            return self.partly
        return self.wrong


@dataclass(frozen=True, kw_only=True)
class ModelGapSettings(Checked):
    """Everything about the environment but the arm.

    Examples
    --------
    >>> ModelGapSettings(max_motions=6).max_motions
    6
    """

    draw: MachineDraw = field(default_factory=MachineDraw)
    """Distribution of the hidden machines."""
    prices: GapPrices = field(default_factory=GapPrices)
    """Rewards and prices."""
    belief: BeliefSettings = field(default_factory=BeliefSettings)
    """Priors and errors of the belief."""
    kinds: Annotated[tuple[str, ...], _KINDS] = ()
    """Kinds of effect that are hidden and considered; none for the whole catalogue but those that
    the sensors cannot show."""
    library: Literal["whole", "brief", "battery"] = "whole"
    """Motions: the whole library; the brief ones and the fixed battery; the battery alone."""
    max_motions: Count = 12
    """Motions an episode may take; after the last one only a verdict is left."""
    ranks: Count = 5
    """Sets of effects that a verdict can name: the most probable ones."""
    tolerance: Probability = 0.03
    """Relative error within which masses, inertias, dampings and gains are known [1]."""
    max_speed: Positive = 2.0
    """Largest joint speed of motions [rad/s]; of slides a fifth of it [m/s]."""
