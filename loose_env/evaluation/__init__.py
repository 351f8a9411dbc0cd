"""Evaluation: success rates, paired intervals, calibration, strata.

Data flow: calibration -> paired_bootstrap -> seat_openness -> fault_difficulty ->
seed_aggregates -> success_rates -> factorial -> rows -> strata.
"""

from loose_env.evaluation.calibration import (
    Calibration,
    calibration_of,
    claims_of,
    expected_calibration_error,
    reliability,
)
from loose_env.evaluation.factorial import (
    Crossing,
    crossing,
    pareto_front,
    success_after,
)
from loose_env.evaluation.fault_difficulty import (
    HiddenFigures,
    drive_over_friction,
    hidden_figures,
)
from loose_env.evaluation.paired_bootstrap import (
    Interval,
    bootstrap_mean,
    paired_difference,
)
from loose_env.evaluation.rows import (
    configuration_hash,
    need_format,
    read_rows,
    write_rows,
)
from loose_env.evaluation.seed_aggregates import (
    SEPARATOR,
    runs_of,
    trained_agents,
)
from loose_env.evaluation.strata import (
    RATIO_EDGES,
    Division,
    divisions,
    ratio_names,
)
from loose_env.evaluation.success_rates import (
    Row,
    Standing,
    by_agent,
    percent,
    standings,
    table_of,
    who_won,
    wilson,
)

__all__ = [
    "RATIO_EDGES",
    "SEPARATOR",
    "Calibration",
    "Crossing",
    "Division",
    "HiddenFigures",
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
    "hidden_figures",
    "need_format",
    "paired_difference",
    "pareto_front",
    "percent",
    "ratio_names",
    "read_rows",
    "reliability",
    "runs_of",
    "standings",
    "success_after",
    "table_of",
    "trained_agents",
    "who_won",
    "wilson",
    "write_rows",
]
