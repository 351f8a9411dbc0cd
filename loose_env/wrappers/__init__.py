"""Gymnasium wrappers of observation, action and score; posterior features, decoded records.

Those of a batch are in `loose_env.wrappers.vector`.
"""

from loose_env.envs import RecordLayout
from loose_env.wrappers.changes import (
    JointSideObservation,
    MacroActions,
    MeasuredMinusNominal,
    PosteriorObservation,
    default_macros,
)
from loose_env.wrappers.posteriors import (
    PROBABILITY_FLOOR,
    Posterior,
    analytic_posterior,
    checked_order,
    posterior_bounds,
    posterior_features,
    record_from,
    records_from,
    taken_in,
)
from loose_env.wrappers.shells import DiagnosisVectorWrapper, DiagnosisWrapper

__all__ = [
    "PROBABILITY_FLOOR",
    "DiagnosisVectorWrapper",
    "DiagnosisWrapper",
    "JointSideObservation",
    "MacroActions",
    "MeasuredMinusNominal",
    "Posterior",
    "PosteriorObservation",
    "RecordLayout",
    "analytic_posterior",
    "checked_order",
    "default_macros",
    "posterior_bounds",
    "posterior_features",
    "record_from",
    "records_from",
    "taken_in",
]
