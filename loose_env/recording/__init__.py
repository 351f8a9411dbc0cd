"""The recording format for measured data: description, tables, reading, writing."""

from loose_env.io import nearest
from loose_env.recording.corrupt_samples import (
    LARGEST_VALUE,
    Corrupt,
    corrupt_mask,
    set_aside,
    without_corrupt,
)
from loose_env.recording.measured import check_measured, planned_recording, write_measured
from loose_env.recording.model_columns import JointSensors, ModelColumns, joint_sensors
from loose_env.recording.recording import (
    DESCRIPTION,
    FORMAT,
    Description,
    Recording,
    RunEntry,
    load_model,
    read_description,
    read_recording,
)
from loose_env.recording.run import (
    CommandTiming,
    Comparison,
    Condition,
    Run,
    last_known,
    table_of,
)
from loose_env.recording.tables import (
    FEWEST_SAMPLES,
    MOST_MISSING,
    MOST_VALUES,
    existing_file,
    read_parquet,
    read_text,
    write_csv,
    write_parquet,
)
from loose_env.recording.writing import FileFormat, check_target, write_recording

__all__ = [
    "DESCRIPTION",
    "FEWEST_SAMPLES",
    "FORMAT",
    "LARGEST_VALUE",
    "MOST_MISSING",
    "MOST_VALUES",
    "CommandTiming",
    "Comparison",
    "Condition",
    "Corrupt",
    "Description",
    "FileFormat",
    "JointSensors",
    "ModelColumns",
    "Recording",
    "Run",
    "RunEntry",
    "check_measured",
    "check_target",
    "corrupt_mask",
    "existing_file",
    "joint_sensors",
    "last_known",
    "load_model",
    "nearest",
    "planned_recording",
    "read_description",
    "read_parquet",
    "read_recording",
    "read_text",
    "set_aside",
    "table_of",
    "without_corrupt",
    "write_csv",
    "write_measured",
    "write_parquet",
    "write_recording",
]
