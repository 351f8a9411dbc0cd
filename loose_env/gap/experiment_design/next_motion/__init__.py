"""Choice of the motion that best separates effects that runs of a real machine do not tell apart.

Data flow: settings -> laplace -> open_pairs -> motion_trials -> limits -> expected_gain ->
choice -> files.
"""

from loose_env.gap.experiment_design.next_motion.choice import (
    NextMotion,
    PairGain,
    choose_motion,
)
from loose_env.gap.experiment_design.next_motion.files import (
    NEXT_MOTION,
    NextMotionSummary,
    next_motion_lines,
    read_next_motion,
    summary_of,
    write_next_motion,
)
from loose_env.gap.experiment_design.next_motion.open_pairs import (
    NOTHING,
    Hypotheses,
    OpenPair,
    Place,
    open_hypotheses,
)
from loose_env.gap.experiment_design.next_motion.settings import NextMotionSettings

__all__ = [
    "NEXT_MOTION",
    "NOTHING",
    "Hypotheses",
    "NextMotion",
    "NextMotionSettings",
    "NextMotionSummary",
    "OpenPair",
    "PairGain",
    "Place",
    "choose_motion",
    "next_motion_lines",
    "open_hypotheses",
    "read_next_motion",
    "summary_of",
    "write_next_motion",
]
