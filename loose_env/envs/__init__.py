"""Gymnasium environments: diagnosis of a hidden fault, single and vector, and model errors.

Data flow: palette -> settings -> faults -> spaces -> batch -> rendering -> env -> vector_env ->
sb3; gap_env.
"""

from loose_env.envs import palette
from loose_env.envs.batch import BatchRig, Beginning, EnvBatch, Steps
from loose_env.envs.env import DiagnosisEnv, EnvState
from loose_env.envs.faults import FaultSampler, fault_words, hypothesis_words
from loose_env.envs.gap_env import (
    GapObservation,
    GapPrices,
    HiddenEffect,
    HiddenMachine,
    MachineDraw,
    ModelGapEnv,
    ModelGapSettings,
    make_model_gap,
)
from loose_env.envs.palette import EDGE, FAINT, INK, MEASURED, MUTED, PAPER, SHAKEN, TRUTH
from loose_env.envs.rendering import (
    ArmDrawing,
    CorrelationByDirection,
    Picture,
    measured_correlation,
    predicted_correlation,
)
from loose_env.envs.settings import (
    DIFFICULTIES,
    DiagnosisSettings,
    Difficulty,
    Prices,
    difficulty_named,
    refuse_unknown,
)
from loose_env.envs.spaces import (
    Action,
    ActionLayout,
    Element,
    JointPose,
    ObservationLayout,
    RecordLayout,
)
from loose_env.envs.vector_env import DiagnosisVectorEnv, batch_seeds

__all__ = [
    "DIFFICULTIES",
    "EDGE",
    "FAINT",
    "INK",
    "MEASURED",
    "MUTED",
    "PAPER",
    "SHAKEN",
    "TRUTH",
    "Action",
    "ActionLayout",
    "ArmDrawing",
    "BatchRig",
    "Beginning",
    "CorrelationByDirection",
    "DiagnosisEnv",
    "DiagnosisSettings",
    "DiagnosisVectorEnv",
    "Difficulty",
    "Element",
    "EnvBatch",
    "EnvState",
    "FaultSampler",
    "GapObservation",
    "GapPrices",
    "HiddenEffect",
    "HiddenMachine",
    "JointPose",
    "MachineDraw",
    "ModelGapEnv",
    "ModelGapSettings",
    "ObservationLayout",
    "Picture",
    "Prices",
    "RecordLayout",
    "Steps",
    "batch_seeds",
    "difficulty_named",
    "fault_words",
    "hypothesis_words",
    "make_model_gap",
    "measured_correlation",
    "palette",
    "predicted_correlation",
    "refuse_unknown",
]
