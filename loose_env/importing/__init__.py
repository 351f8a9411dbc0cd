"""Import of measured data: ROS bags, tables, files of arrays, LeRobot datasets.

Data flow: samples -> mapping -> clocks -> readers (text_tables, array_files, messages) ->
sources -> evidence -> targets -> roles -> proposal; pipeline.
"""

from loose_env.importing.command_timing import command_delays, early_by
from loose_env.importing.evidence import coding_of, dry_friction, ratio_of
from loose_env.importing.mapping import ImportMapping, read_mapping
from loose_env.importing.pipeline import ImportSettings, import_recording
from loose_env.importing.proposal import Proposal, proposal_text, propose
from loose_env.importing.resampling import filled, median_step, smoothed
from loose_env.importing.targets import (
    Drive,
    drives_of,
    followers,
    inverse_dynamics,
    joint_targets,
)

__all__ = [
    "Drive",
    "ImportMapping",
    "ImportSettings",
    "Proposal",
    "coding_of",
    "command_delays",
    "drives_of",
    "dry_friction",
    "early_by",
    "filled",
    "followers",
    "import_recording",
    "inverse_dynamics",
    "joint_targets",
    "median_step",
    "proposal_text",
    "propose",
    "ratio_of",
    "read_mapping",
    "smoothed",
]
