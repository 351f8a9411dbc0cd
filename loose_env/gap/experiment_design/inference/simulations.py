"""Simulated motions for the exact fits of one comparison, cached and limited in number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.gap.experiment_design.inference.local_models import LocalModels
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.simulator import has_terms
from loose_env.typing import Array

_Key = tuple[object, ...]


class Simulations:
    """Simulated motions of the hypotheses of one comparison.

    Effects whose torques are computed step by step in Python cost by steps, whatever the number of
    simulations: those that will be needed are made together, and count once they are used.
    """

    def __init__(self, models: LocalModels, left: int) -> None:
        self.models, self.left = models, left
        self._made: dict[_Key, Array | None] = {}

    def readings(self, motion: int, hypotheses: Sequence[Hypothesis]) -> list[Array | None]:
        """Projected readings of a motion (K,) under hypotheses; None where one diverged."""
        self.left -= len(hypotheses)
        self._make([motion], hypotheses)
        return [self._made[self._key(motion, each)] for each in hypotheses]

    def ahead(self, motions: Sequence[int], hypotheses: Sequence[Hypothesis]) -> None:
        """Make simulations of some motions that will be needed, where that saves time."""
        slow = [each for each in hypotheses if has_terms(each)]
        if len(slow) * len(motions) > 1:
            self._make(motions, slow)

    def _make(self, motions: Sequence[int], hypotheses: Sequence[Hypothesis]) -> None:
        bank = self.models.bank
        lacking = [
            each
            for each in hypotheses
            if any(self._key(motion, each) not in self._made for motion in motions)
        ]
        if not lacking:
            return
        commands = [bank.library[motion].commands(bank.arm) for motion in motions]
        found = bank.arm.simulate_motions(lacking, commands)
        for motion, rows in zip(motions, found, strict=True):
            for each, readings in zip(lacking, rows, strict=True):
                inside = None
                if np.isfinite(readings).all():
                    inside = bank.signatures[motion].projected(readings, bank.arm.noise)[0]
                self._made[self._key(motion, each)] = inside

    @staticmethod
    def _key(motion: int, hypothesis: Hypothesis) -> _Key:
        pairs = ((id(effect), values.tobytes()) for effect, values in hypothesis.pairs)
        return motion, hypothesis.factors.tobytes(), *pairs
