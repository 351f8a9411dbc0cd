"""Gymnasium wrappers: other observations, other actions, other scores of the same episodes.

Data flow: base -> records -> posterior -> actions -> prediction.
"""

from loose_env.wrappers.actions import MacroActions, SeparateVerdict, default_macros
from loose_env.wrappers.base import DiagnosisWrapper
from loose_env.wrappers.posterior import (
    PROBABILITY_FLOOR,
    Posterior,
    PosteriorObservation,
    analytic_posterior,
    posterior_bounds,
    posterior_features,
    record_from,
)
from loose_env.wrappers.prediction import ActionAndPrediction
from loose_env.wrappers.records import (
    JointSideObservation,
    LatestRecord,
    MeasuredMinusNominal,
    RecordLayout,
)

__all__ = [
    "PROBABILITY_FLOOR",
    "ActionAndPrediction",
    "DiagnosisWrapper",
    "JointSideObservation",
    "LatestRecord",
    "MacroActions",
    "MeasuredMinusNominal",
    "Posterior",
    "PosteriorObservation",
    "RecordLayout",
    "SeparateVerdict",
    "analytic_posterior",
    "default_macros",
    "posterior_bounds",
    "posterior_features",
    "record_from",
]
