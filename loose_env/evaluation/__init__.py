"""Evaluation: success rates, paired intervals, parameters of hidden faults, rows on disk.

Data flow: success -> hidden_faults -> rows.
"""

from loose_env.evaluation.hidden_faults import (
    FaultParameters,
    drive_over_friction,
    fault_parameters,
)
from loose_env.evaluation.rows import (
    configuration_hash,
    need_format,
    read_rows,
    seed_of,
    write_rows,
)
from loose_env.evaluation.success import (
    SEPARATOR,
    Row,
    Standing,
    arm_of,
    by_agent,
    paired_difference,
    standing_of,
    standings,
)
from loose_env.inference import (
    Interval,
    bootstrap_mean,
    expected_calibration_error,
    reliability,
    wilson,
)

__all__ = [
    "SEPARATOR",
    "FaultParameters",
    "Interval",
    "Row",
    "Standing",
    "arm_of",
    "bootstrap_mean",
    "by_agent",
    "configuration_hash",
    "drive_over_friction",
    "expected_calibration_error",
    "fault_parameters",
    "need_format",
    "paired_difference",
    "read_rows",
    "reliability",
    "seed_of",
    "standing_of",
    "standings",
    "wilson",
    "write_rows",
]
