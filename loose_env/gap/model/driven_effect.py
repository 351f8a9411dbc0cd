"""Base class of effects that depend on commands or drive torques: feedback and dry friction."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.typing import Array


class DrivenEffect(Effect):
    """An effect that depends on commands or drive torques, applied step by step.

    MJCF has no elements for such effects: a simulation is stepped from Python, which sets them
    before each step, and so does the code in the result.
    """

    in_model: ClassVar[bool] = False

    @property
    def drives(self) -> bool:
        """True if it changes the drives; a friction acts beside them."""
        return type(self).feedback is not DrivenEffect.feedback or super().drives

    @property
    def moves(self) -> bool:
        """True: it changes the motion."""
        return True

    def feedback(self, command: Array, position: Array, speed: Array, values: Array) -> Array:
        """Compute the commands that reach the actuators in some states.

        A simulation holds them over each step, at its middle.
        """
        return command

    def dry_friction(self, drive: Array, load: Array, speed: Array, values: Array) -> Array:
        """Compute dry friction beyond the joints' friction loss; it holds a joint at rest."""
        return np.zeros_like(drive)

    def feedback_code(self, values: Array) -> str:
        """Python lines that change ``command`` (actuators,) as `feedback` does; "" if none.

        They read ``position`` and ``speed`` (joints,).
        """
        return ""

    def friction_code(self, values: Array) -> str:
        """Python lines that add `dry_friction` to ``friction``; "" if none.

        They read ``drive``, ``load`` and ``speed`` (joints,).
        """
        return ""
