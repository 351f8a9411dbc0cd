"""Model error: find, identify and correct the physical effects that a simulation lacks.

Data flow: model -> runs -> simulator -> core -> output -> explain, session; experiment_design is
beside the core, for `Gap-v0`.
"""

from loose_env.gap.core.find import Answer, find_gap
from loose_env.gap.core.residual import Correlation, Overlay, Played, Response
from loose_env.gap.core.tolerances import Tolerances
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
from loose_env.gap.explain import (
    GapSolution,
    check_gap,
    explain_gap,
    pulled_words,
    solve_gap,
    write_gap,
)
from loose_env.gap.joined_runs import join_recordings, note_source, read_source
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import read_effects, register
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.parameter import Parameter
from loose_env.gap.output.advice import how_to_see, how_to_separate
from loose_env.gap.output.corrected_model import write_model
from loose_env.gap.output.result import (
    ChannelVerdict,
    EffectLocation,
    Gap,
    GapResult,
    Identifiability,
    JointExcitation,
    NamedEffect,
    RankedSet,
    ResidualTest,
    TolerancePull,
    VisibleEffect,
    read_result,
)
from loose_env.gap.output.targets.export import (
    TARGETS,
    ExportSettings,
    export_result,
    write_export,
)
from loose_env.gap.output.targets.source import Export
from loose_env.gap.session import GapSession
from loose_env.gap.settings import GapSettings

__all__ = [
    "TARGETS",
    "Answer",
    "BankSettings",
    "Belief",
    "BeliefSettings",
    "ChannelVerdict",
    "Correlation",
    "Effect",
    "EffectEstimate",
    "EffectLocation",
    "Export",
    "ExportSettings",
    "Gap",
    "GapResult",
    "GapSession",
    "GapSettings",
    "GapSolution",
    "Hypothesis",
    "HypothesisSet",
    "Identifiability",
    "JointExcitation",
    "LocalModels",
    "Motion",
    "MotionCheck",
    "MotionSignatures",
    "NamedEffect",
    "Outlook",
    "Overlay",
    "Parameter",
    "Played",
    "Posterior",
    "RankedSet",
    "Ray",
    "ResidualTest",
    "Response",
    "Sensing",
    "ServoArm",
    "SignatureBank",
    "TolerancePull",
    "Tolerances",
    "VisibleEffect",
    "battery",
    "brief_library",
    "check_gap",
    "check_motion",
    "explain_gap",
    "export_result",
    "find_gap",
    "how_to_see",
    "how_to_separate",
    "join_recordings",
    "motion_library",
    "note_source",
    "outlook",
    "pair_gains",
    "pulled_words",
    "rays_of",
    "read_effects",
    "read_result",
    "read_servo_arm",
    "read_source",
    "register",
    "scaled_to_fit",
    "signature_bank",
    "solve_gap",
    "write_export",
    "write_gap",
    "write_model",
]
