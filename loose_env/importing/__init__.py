"""Import of measured data from loggers: MCAP, CSV and universal files (UFF 58).

Data flow: samples -> timing -> mapping -> join_runs -> readers -> describe -> pipeline.
"""

from loose_env.importing.describe import describe_sources, list_sources
from loose_env.importing.mapping.mapping import ImportMapping
from loose_env.importing.mapping.mapping_file import read_mapping
from loose_env.importing.pipeline import ImportSettings, import_recording
from loose_env.importing.samples import FileList
from loose_env.importing.timing.resampling import median_step

__all__ = [
    "FileList",
    "ImportMapping",
    "ImportSettings",
    "describe_sources",
    "import_recording",
    "list_sources",
    "median_step",
    "read_mapping",
]
