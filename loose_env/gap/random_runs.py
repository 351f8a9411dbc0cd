"""A run of random excitation whose trajectory parts ways with any simulation, as features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.features import RandomFeatures
from loose_env.gap.machine import Machine
from loose_env.gap.trial import Channel, Trial

__all__ = ["GROUP", "RandomRun"]

Array = NDArray[np.float64]

GROUP = 4
"""Numbers in a block."""


@dataclass(frozen=True, eq=False)
class RandomRun:
    """One run of random excitation, as numbers of unit variance that are independent.

    The whitened differences of all features are turned by a fixed random rotation, so that what a
    hypothesis gets wrong, in however few features, shows in every block of them.

    Parameters
    ----------
    features : RandomFeatures
        Of the measured run.
    """

    features: RandomFeatures

    @classmethod
    def of_trial(
        cls, trial: Trial, machine: Machine, channels: Sequence[Channel], floors: Array
    ) -> RandomRun:
        """Features of a measured run."""
        return cls(RandomFeatures.of_trial(trial, machine, channels, floors))

    def __len__(self) -> int:
        """How many numbers there are."""
        return len(self.features.names)

    @property
    def channel(self) -> NDArray[np.intp]:
        """Number of a channel for each of the numbers: the channels in turn (K,)."""
        return self.features.used[np.arange(len(self)) % len(self.features.used)]

    @cached_property
    def rotation(self) -> Array:
        """Orthogonal matrix, the same for every run with as many features (K, K)."""
        normal = np.random.default_rng(len(self)).standard_normal((len(self), len(self)))
        return np.asarray(np.linalg.qr(normal)[0])

    def residual(self, predicted: Array) -> Array:
        """Measured less predicted (T, C) -> (K,), in standard deviations of a right model."""
        return np.asarray(
            self.features.whitened(self.features.differences(predicted)) @ self.rotation
        )
