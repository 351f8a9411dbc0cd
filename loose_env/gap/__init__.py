"""Model error: find, identify and correct the physical effects that a simulation lacks.

Data flow: model -> data -> settings -> simulation -> residuals -> fitting ->
output -> selection -> diagnostics -> experiment_design -> workflow.
"""

from loose_env.gap.diagnostics.experiment_advice import (
    how_to_see,
    how_to_separate,
)
from loose_env.gap.diagnostics.feature_localisation import (
    FeatureChannel,
)
from loose_env.gap.diagnostics.joint_torque_residual import (
    JointMotion,
)
from loose_env.gap.diagnostics.localisation import (
    main_band,
    strongest,
)
from loose_env.gap.diagnostics.regressors import (
    binned,
)
from loose_env.gap.diagnostics.residual_spectra import (
    Series,
    in_bands,
    series_of,
    spectrum,
)
from loose_env.gap.experiment_design import (
    BankSettings,
    Belief,
    BeliefSettings,
    EffectEstimate,
    HypothesisSet,
    LocalModels,
    Motion,
    MotionCheck,
    MotionSignatures,
    Outlook,
    Posterior,
    Ray,
    Sensing,
    ServoArm,
    SignatureBank,
    battery,
    brief_library,
    check_motion,
    motion_library,
    outlook,
    pair_gains,
    rays_of,
    read_servo_arm,
    scaled_to_fit,
    signature_bank,
)
from loose_env.gap.experiment_design.next_motion import (
    NEXT_MOTION,
    NOTHING,
    NextMotionSettings,
    NextMotionSummary,
    PairGain,
    next_motion_lines,
    read_next_motion,
)
from loose_env.gap.model.effect import (
    Effect,
)
from loose_env.gap.model.effects.catalogue import (
    read_effects,
    register,
)
from loose_env.gap.model.hypothesis import (
    Hypothesis,
)
from loose_env.gap.model.parameter import (
    Parameter,
)
from loose_env.gap.output.calibration import (
    PROBABILITY_FEATURES,
    GapCalibration,
    interval_score,
    probability_features,
    stored_calibration,
)
from loose_env.gap.output.checkpoints import (
    Stages,
    key_of,
)
from loose_env.gap.output.corrected_model import (
    write_model,
)
from loose_env.gap.output.evidence_schema import (
    Dependence,
    Identifiability,
)
from loose_env.gap.output.export_check import (
    compared,
    exported,
    resting_runs,
)
from loose_env.gap.output.result import (
    DeletionTest,
    EffectLocation,
    Gap,
    GapResult,
    NamedEffect,
    RankedHypothesis,
    read_result,
)
from loose_env.gap.output.targets.export import (
    TARGETS,
    ExportSettings,
    export_result,
    write_export,
)
from loose_env.gap.output.targets.source import (
    Export,
)
from loose_env.gap.residuals.physical_units import (
    quantity_notes,
)
from loose_env.gap.settings import (
    ACCEPTED_Z,
    NOISE_RMS,
    GapSettings,
)
from loose_env.gap.workflow.explain import explain_gap, prediction_error
from loose_env.gap.workflow.joined_runs import (
    Source,
    join_recordings,
    note_source,
    read_source,
)
from loose_env.gap.workflow.pipeline import (
    GapSolution,
    find_gap,
)
from loose_env.gap.workflow.quick_look import QuickCandidate, QuickLook, quick_look
from loose_env.gap.workflow.residual_diagnostics import ResidualDiagnostics, diagnose_residuals
from loose_env.gap.workflow.session import GapSession
from loose_env.gap.workflow.summary import NO_MOTION, result_of, write_gap

__all__ = [
    "ACCEPTED_Z",
    "NEXT_MOTION",
    "NOISE_RMS",
    "NOTHING",
    "NO_MOTION",
    "PROBABILITY_FEATURES",
    "TARGETS",
    "BankSettings",
    "Belief",
    "BeliefSettings",
    "DeletionTest",
    "Dependence",
    "Effect",
    "EffectEstimate",
    "EffectLocation",
    "Export",
    "ExportSettings",
    "FeatureChannel",
    "Gap",
    "GapCalibration",
    "GapResult",
    "GapSession",
    "GapSettings",
    "GapSolution",
    "Hypothesis",
    "HypothesisSet",
    "Identifiability",
    "JointMotion",
    "LocalModels",
    "Motion",
    "MotionCheck",
    "MotionSignatures",
    "NamedEffect",
    "NextMotionSettings",
    "NextMotionSummary",
    "Outlook",
    "PairGain",
    "Parameter",
    "Posterior",
    "QuickCandidate",
    "QuickLook",
    "RankedHypothesis",
    "Ray",
    "ResidualDiagnostics",
    "Sensing",
    "Series",
    "ServoArm",
    "SignatureBank",
    "Source",
    "Stages",
    "battery",
    "binned",
    "brief_library",
    "check_motion",
    "compared",
    "diagnose_residuals",
    "explain_gap",
    "export_result",
    "exported",
    "find_gap",
    "how_to_see",
    "how_to_separate",
    "in_bands",
    "interval_score",
    "join_recordings",
    "key_of",
    "main_band",
    "motion_library",
    "next_motion_lines",
    "note_source",
    "outlook",
    "pair_gains",
    "prediction_error",
    "probability_features",
    "quantity_notes",
    "quick_look",
    "rays_of",
    "read_effects",
    "read_next_motion",
    "read_result",
    "read_servo_arm",
    "read_source",
    "register",
    "resting_runs",
    "result_of",
    "scaled_to_fit",
    "series_of",
    "signature_bank",
    "spectrum",
    "stored_calibration",
    "strongest",
    "write_export",
    "write_gap",
    "write_model",
]
