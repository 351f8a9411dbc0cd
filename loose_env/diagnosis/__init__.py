"""Diagnosis from several records: likelihoods, learned posteriors, link finding, design.

Data flow: records -> likelihood -> learned -> experiment_design -> link_finding
-> research.
"""

from loose_env.diagnosis.experiment_design.information_gain import (
    ImaginedFaults,
    InformationFactors,
    RecordInformation,
)
from loose_env.diagnosis.experiment_design.record_bound import (
    least_records,
)
from loose_env.diagnosis.learned.amortised_posterior import (
    REFERENCE,
    AmortisedBelief,
    AmortisedPosterior,
    read_network,
    write_network,
)
from loose_env.diagnosis.learned.features import (
    LOCATION_FEATURES,
    RECORD_FEATURES,
    SeatFeatures,
)
from loose_env.diagnosis.learned.network import (
    SeatNetwork,
)
from loose_env.diagnosis.learned.novelty import (
    NOVELTY_STATISTICS,
    NoveltyReference,
    Seen,
    used_columns,
)
from loose_env.diagnosis.likelihood.axial_likelihood import (
    log_mean_bingham,
    precision_of,
)
from loose_env.diagnosis.likelihood.opening_table import (
    PRESSES,
    RATIOS,
    shipped_table,
)
from loose_env.diagnosis.likelihood.posterior import (
    Belief,
    FaultPosterior,
    PosteriorSettings,
    variants,
)
from loose_env.diagnosis.likelihood.record_likelihood import (
    LOOSE,
    OPENINGS,
    SHUT,
    fit_record,
)
from loose_env.diagnosis.likelihood.seat_response import (
    predict_seats,
)
from loose_env.diagnosis.link_finding.direction_images import (
    ToolFrames,
    fault_locations,
)
from loose_env.diagnosis.link_finding.driven_joint import MotionShape, shape_of_motion
from loose_env.diagnosis.link_finding.measured_direction import (
    ChangeModel,
    ChangeSighting,
    sight_change,
)
from loose_env.diagnosis.link_finding.moves import (
    candidate_poses,
    choose_move,
)
from loose_env.diagnosis.link_finding.opening_moves import (
    choose_open_move,
)
from loose_env.diagnosis.link_finding.planar import (
    LinkFindingSettings,
    Order,
    Sighting,
    backlash_joint,
    judge_turn,
    looks_healthy,
    next_joint,
)
from loose_env.diagnosis.link_finding.pooled_scatter import (
    PlaceDirections,
    PooledScatter,
    RecordScatter,
)
from loose_env.diagnosis.link_finding.search import (
    TurnSearch,
)
from loose_env.diagnosis.link_finding.seat_coverage import SeatCoverage
from loose_env.diagnosis.link_finding.sensed_places import SensedPlaces
from loose_env.diagnosis.link_finding.spatial import (
    DirectionSighting,
    LinkPosterior,
    confusable_faults,
    link_posterior,
)
from loose_env.diagnosis.records.excitation_design import (
    Proposal,
    holding_modes,
    propose_excitation,
)
from loose_env.diagnosis.records.link_readings import (
    LinkReadings,
    NominalLinks,
    link_axes,
    link_readings_of,
    link_readings_of_all,
)
from loose_env.diagnosis.records.model_uncertainty import (
    stiffness_errors,
)
from loose_env.diagnosis.records.prediction import (
    Prediction,
    SensorFloor,
    predict,
    predictions,
)
from loose_env.diagnosis.records.record_statistics import (
    RecordStatistics,
    statistics_of,
    statistics_of_all,
)
from loose_env.diagnosis.research.pose_sets.limits import (
    bingham_width,
    direction_limit,
    one_by_one_share,
    scattered_axes,
)
from loose_env.diagnosis.research.pose_sets.pose_sets import (
    PLANNED,
    PoseSets,
)

__all__ = [
    "LOCATION_FEATURES",
    "LOOSE",
    "NOVELTY_STATISTICS",
    "OPENINGS",
    "PLANNED",
    "PRESSES",
    "RATIOS",
    "RECORD_FEATURES",
    "REFERENCE",
    "SHUT",
    "AmortisedBelief",
    "AmortisedPosterior",
    "Belief",
    "ChangeModel",
    "ChangeSighting",
    "DirectionSighting",
    "FaultPosterior",
    "ImaginedFaults",
    "InformationFactors",
    "LinkFindingSettings",
    "LinkPosterior",
    "LinkReadings",
    "MotionShape",
    "NominalLinks",
    "NoveltyReference",
    "Order",
    "PlaceDirections",
    "PooledScatter",
    "PoseSets",
    "PosteriorSettings",
    "Prediction",
    "Proposal",
    "RecordInformation",
    "RecordScatter",
    "RecordStatistics",
    "SeatCoverage",
    "SeatFeatures",
    "SeatNetwork",
    "Seen",
    "SensedPlaces",
    "SensorFloor",
    "Sighting",
    "ToolFrames",
    "TurnSearch",
    "backlash_joint",
    "bingham_width",
    "candidate_poses",
    "choose_move",
    "choose_open_move",
    "confusable_faults",
    "direction_limit",
    "fault_locations",
    "fit_record",
    "holding_modes",
    "judge_turn",
    "least_records",
    "link_axes",
    "link_posterior",
    "link_readings_of",
    "link_readings_of_all",
    "log_mean_bingham",
    "looks_healthy",
    "next_joint",
    "one_by_one_share",
    "precision_of",
    "predict",
    "predict_seats",
    "predictions",
    "propose_excitation",
    "read_network",
    "scattered_axes",
    "shape_of_motion",
    "shipped_table",
    "sight_change",
    "statistics_of",
    "statistics_of_all",
    "stiffness_errors",
    "used_columns",
    "variants",
    "write_network",
]
