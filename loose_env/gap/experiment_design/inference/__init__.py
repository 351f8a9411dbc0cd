"""Posterior over missing effects from measured motions, and the information of further ones.

Data flow: local_models -> posterior -> expansion -> screening -> exact_fit -> comparison ->
belief -> information.
"""

from loose_env.gap.experiment_design.inference.belief import Belief
from loose_env.gap.experiment_design.inference.information import (
    expected_information,
    pair_gains,
)
from loose_env.gap.experiment_design.inference.local_models import LocalModels
from loose_env.gap.experiment_design.inference.posterior import (
    BeliefSettings,
    EffectEstimate,
    HypothesisSet,
    Posterior,
)

__all__ = [
    "Belief",
    "BeliefSettings",
    "EffectEstimate",
    "HypothesisSet",
    "LocalModels",
    "Posterior",
    "expected_information",
    "pair_gains",
]
