"""Wrappers of a batch of environments, as `gymnasium.make_vec` makes it.

They show and take what those of `loose_env.wrappers` do, of all arms at once, in every mode of
automatic reset; environment k of a batch shows bit for bit what it would alone.

Examples
--------
>>> import gymnasium, loose_env
>>> from loose_env.wrappers import vector
>>> envs = gymnasium.make_vec("loose_env/Vera-v0", num_envs=3, engine="reduced")
>>> envs = vector.MacroActions(vector.PosteriorObservation(envs))
>>> observations, infos = envs.reset(seed=0)
>>> observations.shape, infos["probabilities"].shape, envs.single_action_space
((3, 21), (3, 5), Discrete(21))
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.wrappers import changes
from loose_env.wrappers.shells import DiagnosisVectorWrapper

__all__ = [
    "JointSideObservation",
    "MacroActions",
    "MeasuredMinusNominal",
    "PosteriorObservation",
]


class MeasuredMinusNominal(changes.Differences, DiagnosisVectorWrapper):
    """As `loose_env.wrappers.MeasuredMinusNominal`."""


class JointSideObservation(changes.JointSide, DiagnosisVectorWrapper):
    """As `loose_env.wrappers.JointSideObservation`."""


class PosteriorObservation(changes.OfPosterior, DiagnosisVectorWrapper):
    """As `loose_env.wrappers.PosteriorObservation`."""

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posteriors of the environments' hypotheses (num_envs, hypotheses)."""
        return self._shares.copy()


class MacroActions(changes.Macros, DiagnosisVectorWrapper):
    """As `loose_env.wrappers.MacroActions`."""
