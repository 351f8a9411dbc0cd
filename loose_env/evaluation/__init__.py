"""Evaluation: success rates, paired intervals, calibration, strata.

Data flow: calibration -> intervals -> hidden_faults -> success_rates -> rows -> strata.
"""

from loose_env.evaluation.calibration import (
    Calibration,
    calibration_of,
    claims_of,
    expected_calibration_error,
    reliability,
)
from loose_env.evaluation.hidden_faults import (
    FaultParameters,
    drive_over_friction,
    fault_parameters,
)
from loose_env.evaluation.intervals import (
    SEPARATOR,
    Interval,
    bootstrap_mean,
    paired_difference,
    runs_of,
    trained_agents,
)
from loose_env.evaluation.rows import configuration_hash, need_format, read_rows, write_rows
from loose_env.evaluation.strata import (
    RATIO_EDGES,
    Crossing,
    Division,
    crossing,
    divisions,
    pareto_front,
    ratio_names,
    success_after,
)
from loose_env.evaluation.success_rates import (
    Row,
    Standing,
    by_agent,
    standings,
    who_won,
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
