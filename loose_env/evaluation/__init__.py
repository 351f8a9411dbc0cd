"""Evaluation: success rates, paired intervals, calibration, strata.

Data flow: success -> calibration -> hidden_faults -> rows.
"""

from loose_env.evaluation.calibration import Calibration, calibration_of, claims_of
from loose_env.evaluation.hidden_faults import (
    FaultParameters,
    drive_over_friction,
    fault_parameters,
)
from loose_env.evaluation.rows import configuration_hash, need_format, read_rows, write_rows
from loose_env.evaluation.success import (
    RATIO_EDGES,
    SEPARATOR,
    Crossing,
    Division,
    Row,
    Standing,
    by_agent,
    crossing,
    divisions,
    paired_difference,
    pareto_front,
    ratio_names,
    runs_of,
    standings,
    success_after,
    trained_agents,
    who_won,
)
from loose_env.inference import (
    Interval,
    bootstrap_mean,
    expected_calibration_error,
    reliability,
    wilson,
)

__all__ = [
    "RATIO_EDGES",
    "SEPARATOR",
    "Calibration",
    "Crossing",
    "Division",
    "FaultParameters",
    "Interval",
    "Row",
    "Standing",
    "bootstrap_mean",
    "by_agent",
    "calibration_of",
    "claims_of",
    "configuration_hash",
    "crossing",
    "divisions",
    "drive_over_friction",
    "expected_calibration_error",
    "fault_parameters",
    "need_format",
    "paired_difference",
    "pareto_front",
    "ratio_names",
    "read_rows",
    "reliability",
    "runs_of",
    "standings",
    "success_after",
    "trained_agents",
    "who_won",
    "wilson",
    "write_rows",
]
