"""Parts that strike stops, and how they are fitted."""

from __future__ import annotations

from collections.abc import Sequence

from loose_env.gap.effect import Effect
from loose_env.gap.fit import FitSettings

__all__ = ["BESIDE_STOPS", "strikes"]

BESIDE_STOPS = FitSettings(iterations=6, enough=3e-3)
"""How parts with stops, and what stands beside them, are fitted: a simulation takes three times as
long, and the law of stops is never that of the machine to the last per mille."""


def strikes(effects: Sequence[Effect]) -> bool:
    """Whether one of some effects has stops.

    Parameters
    ----------
    effects : sequence of Effect
        Of a hypothesis.
    """
    return any(effect.has_stops for effect in effects)
