"""Belief: measured motions of one machine in, posterior over sets of missing effects out."""

from __future__ import annotations

import numpy as np

from loose_env.errors import UnknownName
from loose_env.gap.experiment_design.bank import SignatureBank
from loose_env.gap.experiment_design.inference.comparison import Comparison
from loose_env.gap.experiment_design.inference.expansion import Data
from loose_env.gap.experiment_design.inference.local_models import LocalModels
from loose_env.gap.experiment_design.inference.posterior import BeliefSettings, Posterior
from loose_env.typing import Array


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
        self._comparison = Comparison(models, self.settings)
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
    def data(self) -> Data:
        """Mean projected residuals of the motions (K,), and repetitions."""
        return {k: (summed / self.counts[k], self.counts[k]) for k, summed in self.sums.items()}

    @property
    def posterior(self) -> Posterior:
        """Posterior over sets of effects, given all motions so far."""
        if self._posterior is None:
            self._posterior = self._comparison.posterior(self.data)
        return self._posterior

    def log_evidence(self, name: str) -> float:
        """Log evidence of one effect alone, by an exact fit to all motions so far [nats].

        Only differences between effects mean something.

        Raises
        ------
        UnknownName
            If there is no such candidate.
        """
        if name not in self.models.names:
            raise UnknownName(f"no candidate {name!r}; candidates are {list(self.models.names)}")
        return self._comparison.log_evidence(self.data, self.models.names.index(name))
