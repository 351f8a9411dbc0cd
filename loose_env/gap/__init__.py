"""Model error: find, identify and correct the physical effects that a simulation lacks.

Data flow: model -> runs -> simulator -> core -> output -> servo_arm -> motions -> next_motion
-> explain; bank and belief use the core's columns for `Gap-v0`.
"""

from loose_env.gap.bank import VISIBLE, MotionBank, Shape, motion_bank
from loose_env.gap.belief import Belief, HypothesisSet, Outlook, outlook
from loose_env.gap.core.exact import LARGE
from loose_env.gap.core.find import Answer, find_gap, split_held_out
from loose_env.gap.core.residual import Correlation, Overlay, Played
from loose_env.gap.core.tolerances import GapSettings, Tolerances
from loose_env.gap.explain import (
    GapSolution,
    check_gap,
    solve_gap,
    try_effect,
    write_gap,
)
from loose_env.gap.model.effect import DrivenEffect, Effect, JointEffect, Parameter
from loose_env.gap.model.effects.catalogue import effect_class, read_effects, register
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.motions import Library, Motion, check_motion, motion_library
from loose_env.gap.next_motion import (
    NEXT_MOTION,
    NextMotion,
    NextMotionSettings,
    choose_next,
    next_motion_lines,
    write_next_motion,
)
from loose_env.gap.output.corrected_model import write_model
from loose_env.gap.output.export import TARGETS, Export, ExportSettings, export_result, write_export
from loose_env.gap.output.result import (
    ChannelVerdict,
    EffectLocation,
    FittedEffect,
    Gap,
    GapResult,
    Identifiability,
    JointExcitation,
    NamedEffect,
    RankedSet,
    ResidualTest,
    TolerancePull,
    VisibleEffect,
    effect_words,
    how_to_see,
    how_to_separate,
    kind_words,
    read_result,
)
from loose_env.gap.runs import join_recordings, note_source, read_source
from loose_env.gap.servo_arm import ServoArm, read_servo_arm

__all__ = [
    "LARGE",
    "NEXT_MOTION",
    "TARGETS",
    "VISIBLE",
    "Answer",
    "Belief",
    "ChannelVerdict",
    "Correlation",
    "DrivenEffect",
    "Effect",
    "EffectLocation",
    "Export",
    "ExportSettings",
    "FittedEffect",
    "Gap",
    "GapResult",
    "GapSettings",
    "GapSolution",
    "Hypothesis",
    "HypothesisSet",
    "Identifiability",
    "JointEffect",
    "JointExcitation",
    "Library",
    "Motion",
    "MotionBank",
    "NamedEffect",
    "NextMotion",
    "NextMotionSettings",
    "Outlook",
    "Overlay",
    "Parameter",
    "Played",
    "RankedSet",
    "ResidualTest",
    "ServoArm",
    "Shape",
    "TolerancePull",
    "Tolerances",
    "VisibleEffect",
    "check_gap",
    "check_motion",
    "choose_next",
    "effect_class",
    "effect_words",
    "export_result",
    "find_gap",
    "how_to_see",
    "how_to_separate",
    "join_recordings",
    "kind_words",
    "motion_bank",
    "motion_library",
    "next_motion_lines",
    "note_source",
    "outlook",
    "read_effects",
    "read_result",
    "read_servo_arm",
    "read_source",
    "register",
    "solve_gap",
    "split_held_out",
    "try_effect",
    "write_export",
    "write_gap",
    "write_model",
    "write_next_motion",
]
