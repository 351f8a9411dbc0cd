"""Import of measured data: ROS 2 bags, tables, LeRobot and robomimic datasets and others.

Data flow: samples -> timing -> mapping -> join_runs -> readers -> describe -> guessing ->
pipeline.
"""

from loose_env.importing.describe import describe_sources, list_sources
from loose_env.importing.guessing.proposal import Proposal, propose
from loose_env.importing.guessing.proposal_text import proposal_text
from loose_env.importing.mapping.mapping import ImportMapping
from loose_env.importing.mapping.mapping_file import read_mapping
from loose_env.importing.pipeline import ImportSettings, import_recording
from loose_env.importing.samples import FileList
from loose_env.importing.timing.resampling import median_step

__all__ = [
    "FileList",
    "ImportMapping",
    "ImportSettings",
    "Proposal",
    "describe_sources",
    "import_recording",
    "list_sources",
    "median_step",
    "proposal_text",
    "propose",
    "read_mapping",
]
