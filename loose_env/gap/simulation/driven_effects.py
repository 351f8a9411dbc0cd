"""Driven effects of a hypothesis evaluated: commands that reach actuators, and dry frictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.model.driven_effect import DrivenEffect
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.typing import Array

Places = slice | NDArray[np.intp]
"""Indices of simulations."""


@dataclass(frozen=True, eq=False)
class Driven:
    """Driven effects with their values, in the order in which they act."""

    pairs: tuple[tuple[DrivenEffect, Array], ...]
    """Effects and values, (P,) or by simulation (P, sims)."""

    @classmethod
    def of(cls, hypothesis: Hypothesis) -> Driven:
        """The driven effects of a hypothesis."""
        return cls(tuple((e, values) for e, values in hypothesis.pairs if _is_driven(e)))

    def frictions(self, drive: Array, load: Array, speed: Array) -> Array:
        """Sum of the dry frictions under torques of drive and load (..., joints) [N·m, N]."""
        found = np.zeros(drive.shape)
        for effect, values in self.pairs:
            if has_friction(effect):
                found += effect.dry_friction(drive, load, speed, values)
        return found

    def commands(self, command: Array, position: Array, speed: Array) -> Array:
        """Commands (..., actuators) that reach the actuators in some states (..., joints)."""
        for effect, values in self.pairs:
            if has_feedback(effect):
                command = effect.feedback(command, position, speed, values)
        return command


def has_friction(effect: Effect) -> bool:
    """Return whether an effect is a dry friction that is set step by step."""
    return _is_driven(effect) and type(effect).dry_friction is not DrivenEffect.dry_friction


def has_feedback(effect: Effect) -> bool:
    """Return whether an effect changes commands step by step."""
    return _is_driven(effect) and type(effect).feedback is not DrivenEffect.feedback


def grouped_driven_effects(hypotheses: Sequence[Hypothesis]) -> list[tuple[Driven, Places]]:
    """Driven effects of some simulations, with the indices of those on which they act.

    Examples
    --------
    >>> grouped_driven_effects([Hypothesis()])  # nothing is driven
    []
    """
    each = [Driven.of(hypothesis) for hypothesis in hypotheses]
    keys = [tuple(id(effect) for effect, _ in driven.pairs) for driven in each]
    found = []
    for key in dict.fromkeys(key for key in keys if key):
        mask = [other == key for other in keys]
        members = [driven.pairs for driven, own in zip(each, mask, strict=True) if own]
        pairs = tuple(
            (same[0][0], np.stack([values for _, values in same], axis=-1))
            for same in zip(*members, strict=True)
        )
        found.append((Driven(pairs), indices(mask)))
    return found


def indices(mask: Sequence[bool]) -> Places:
    """Indices at which a mask is true; a slice where it is everywhere, which makes views."""
    return slice(None) if all(mask) else np.flatnonzero(mask)


def _is_driven(effect: Effect) -> TypeGuard[DrivenEffect]:
    return isinstance(effect, DrivenEffect)
