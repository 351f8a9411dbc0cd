"""Belief about one machine, updated by the motions that are measured."""

from __future__ import annotations

import numpy as np

from loose_env.gap.experiment_design.bank import SignatureBank
from loose_env.gap.experiment_design.local_models import LocalModels
from loose_env.gap.experiment_design.posterior import (
    BeliefSettings,
    NormalEquations,
    Posterior,
    posterior_of,
)
from loose_env.typing import Array

__all__ = ["Belief"]


class Belief:
    """Belief about one machine, updated by measured motions.

    Parameters
    ----------
    models : LocalModels
        Local models of the bank.
    settings : BeliefSettings, optional
        Priors and errors.
    """

    def __init__(self, models: LocalModels, settings: BeliefSettings | None = None) -> None:
        self.models, self.settings = models, settings or BeliefSettings()
        self.bank: SignatureBank = models.bank
        self.sums: dict[int, Array] = {}
        """Motion -> sum of the projected residuals of its repetitions (K,)."""
        self.counts: dict[int, int] = {}
        """Motion -> repetitions."""
        self.rest: dict[int, float] = {}
        """Motion -> rms of the latest residual beyond the bank's directions [noise sd]."""
        self._posterior: Posterior | None = None

    def add(self, motion: int, readings: Array) -> None:
        """Add measured readings (n, C) of a motion of the library, by its index."""
        found = self.bank.signatures[motion]
        inside, rest = found.projected(readings, self.bank.arm.noise)
        self.sums[motion] = self.sums.get(motion, np.zeros(len(inside))) + inside
        self.counts[motion] = self.counts.get(motion, 0) + 1
        self.rest[motion] = rest
        self._posterior = None

    @property
    def posterior(self) -> Posterior:
        """Posterior over sets of effects, given all motions so far."""
        if self._posterior is None:
            self._posterior = posterior_of(self.normal_equations(), self.models, self.settings)
        return self._posterior

    def error(self, residual: Array) -> float:
        """Variance of the linearisation error in each direction, for a residual (K,)."""
        eta = self.settings.linearisation
        return eta**2 * float(residual @ residual) / max(len(residual), 1)

    def normal_equations(self) -> NormalEquations:
        """Weighted products of base vectors and residuals, all motions together."""
        count = self.bank.signatures[0].vectors.shape[1]
        gram, right, total, dof = np.zeros((count, count)), np.zeros(count), 0.0, 0
        for motion, summed in self.sums.items():
            repeated = self.counts[motion]
            mean = summed / repeated
            weight = 1.0 / (1.0 / repeated + self.error(mean))
            # in single precision the large signatures hide what tells the small ones apart
            vectors = self.bank.signatures[motion].vectors.astype(float)
            gram += weight * (vectors.T @ vectors)
            right += weight * (vectors.T @ mean)
            total += weight * float(mean @ mean)
            dof += len(mean)
        return NormalEquations(gram, right, total, dof, self.models)
