"""The recording format for measured data: description, tables, reading, writing.

Data flow: columns -> folder -> run -> corrupt_samples -> sensor_roles -> table -> parquet_file ->
csv_file -> description -> recording -> writing.
"""

from loose_env.recording.columns import (
    ModelColumns,
    nearest,
)
from loose_env.recording.corrupt_samples import (
    LARGEST_VALUE,
    Corrupt,
    corrupt_mask,
    set_aside,
    without_corrupt,
)
from loose_env.recording.csv_file import (
    write_csv,
)
from loose_env.recording.description import (
    DESCRIPTION,
    FORMAT,
    RunEntry,
    read_description,
)
from loose_env.recording.folder import (
    existing_file,
    read_text,
)
from loose_env.recording.parquet_file import (
    write_parquet,
)
from loose_env.recording.recording import (
    Recording,
    load_model,
    read_recording,
)
from loose_env.recording.run import (
    Comparison,
    Condition,
    Run,
)
from loose_env.recording.sensor_roles import (
    JointSensors,
    check_comparison,
    joint_sensors,
)
from loose_env.recording.table import (
    FEWEST_SAMPLES,
    MOST_MISSING,
    MOST_VALUES,
)
from loose_env.recording.writing import (
    FileFormat,
    check_target,
    table_of,
    write_recording,
)

__all__ = [
    "DESCRIPTION",
    "FEWEST_SAMPLES",
    "FORMAT",
    "LARGEST_VALUE",
    "MOST_MISSING",
    "MOST_VALUES",
    "Comparison",
    "Condition",
    "Corrupt",
    "FileFormat",
    "JointSensors",
    "ModelColumns",
    "Recording",
    "Run",
    "RunEntry",
    "check_comparison",
    "check_target",
    "corrupt_mask",
    "existing_file",
    "joint_sensors",
    "load_model",
    "nearest",
    "read_description",
    "read_recording",
    "read_text",
    "set_aside",
    "table_of",
    "without_corrupt",
    "write_csv",
    "write_parquet",
    "write_recording",
]
