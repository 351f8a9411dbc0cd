"""Test for effects too small to matter, alone or beside another of their kind."""

from __future__ import annotations

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.selection.screening.confusable_effects import joint_of
from loose_env.gap.settings import (
    FRICTION_LAW,
    MASS_DISTRIBUTION,
)
from loose_env.typing import Array


def negligible(hypothesis: Hypothesis, new: int) -> bool:
    """Return whether all effects added last are negligible, however significant.

    A friction is negligible beside another at its joint if it resists far less at the joint's
    typical speed. Where the larger one is identified precisely, the error of its law is visible,
    too, and a small second friction would compensate for it. Likewise a small mass at the tool or
    on a link compensates for the unknown mass distribution along a flexible link.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.gap.model.effects.catalogue import CATALOGUE
    >>> from loose_env.gap.model.nominal_model import NominalModel
    >>> machine = NominalModel(planar(3).spec)
    >>> kinds = CATALOGUE["viscous_friction"], CATALOGUE["coulomb_friction"]
    >>> oil, seal = (kind(machine, machine.joints[1]) for kind in kinds)
    >>> def both(torque):
    ...     return Hypothesis(effects=(oil, seal), values=(np.array([0.9]), np.array([torque])))
    >>> negligible(both(0.002), 1), negligible(both(0.2), 1)
    (True, False)
    """
    pairs = list(hypothesis.pairs)
    earlier, added = pairs[:-new], pairs[-new:]
    return all(
        effect.is_negligible(values)
        or _within_the_law(effect, values, earlier)
        or _within_the_bar(effect, values, earlier)
        for effect, values in added
    )


def _within_the_law(effect: Effect, values: Array, earlier: list[tuple[Effect, Array]]) -> bool:
    """Return whether a friction is within the law error of others at its joint."""
    own = _resistance(effect, values)
    if own == 0.0:
        return False
    there = (_resistance(e, v) for e, v in earlier if joint_of(e) == joint_of(effect))
    return own < FRICTION_LAW * max(there, default=0.0)


def _within_the_bar(effect: Effect, values: Array, earlier: list[tuple[Effect, Array]]) -> bool:
    """Return whether a mass is within the mass distribution error of a flexible link."""
    own, joint = effect.displaced_mass(values), joint_of(effect)
    if own == 0.0:
        return False
    near = ((e.uncertain_mass, joint_of(e)) for e, _ in earlier)
    there = (m for m, other in near if joint is None or other is None or abs(joint - other) <= 1)
    return own < MASS_DISTRIBUTION * max(there, default=0.0)


def _resistance(effect: Effect, values: Array) -> float:
    """Resistance of a friction at its joint's typical speed; 0 for other effects."""
    joint = joint_of(effect)
    if joint is None:
        return 0.0
    return abs(effect.resistance(float(effect.machine.speed_scales[joint]), values))
