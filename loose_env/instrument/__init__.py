"""Diagnosis of looseness in a real arm: recordings in, posterior and next measurement out.

Data flow: settings -> result -> model -> data -> inference -> trend -> planning -> inspect
-> pipeline -> session.
"""

from loose_env.instrument.inspect import (
    inspect_model,
    screen,
)
from loose_env.instrument.model.actuators import (
    JointDrive,
)
from loose_env.instrument.model.instrumented_arm import (
    InstrumentedArm,
    read_arm,
    read_recorded_arm,
)
from loose_env.instrument.model.motion_limits import (
    QUANTITIES,
    unit_of,
)
from loose_env.instrument.pipeline import (
    diagnose,
)
from loose_env.instrument.planning.files.plan_files import (
    plan_json,
    run_columns,
    write_plan,
)
from loose_env.instrument.planning.files.plan_folder import (
    PAGE,
    PLAN,
    RECORDING,
    PlanFiles,
)
from loose_env.instrument.planning.files.planned_runs import (
    PlannedRun,
)
from loose_env.instrument.planning.files.session_settings import (
    KEPT,
    session_beside,
)
from loose_env.instrument.planning.files.signal_files import (
    FIRST,
    TRANSIT,
    signal_stems,
)
from loose_env.instrument.planning.files.tool_plan_files import (
    tool_runs,
    write_tool_plan,
)
from loose_env.instrument.planning.plan import (
    Plan,
    next_for,
    plan,
)
from loose_env.instrument.planning.signals.motion_peaks import (
    MotionPeak,
)
from loose_env.instrument.planning.signals.signal import (
    Signal,
)
from loose_env.instrument.planning.signals.tool_plan import (
    ToolPlan,
    plan_tool,
)
from loose_env.instrument.result import (
    HEALTHY,
    Diagnosis,
    Fault,
    Loop,
    NextMeasurement,
    RecordSeen,
    Severity,
    SlideDirection,
    TransmissionSpectrum,
    Verdict,
    read_diagnosis,
)
from loose_env.instrument.session import (
    find_fault,
)
from loose_env.instrument.settings.arm_and_plan import (
    ModelSettings,
    PlanSettings,
)
from loose_env.instrument.settings.command_line import (
    option_words,
    path_word,
    unlike,
)
from loose_env.instrument.settings.diagnosis import (
    DiagnoseSettings,
)
from loose_env.instrument.settings.measurement import (
    NextSettings,
)
from loose_env.instrument.settings.motion import (
    MotionSettings,
)
from loose_env.instrument.settings.thresholds import (
    PROBABLE,
)
from loose_env.instrument.settings.trend import (
    TrendSettings,
)
from loose_env.instrument.trend.earlier import (
    read_sessions,
)
from loose_env.instrument.trend.maintenance import (
    Maintenance,
    read_maintenance,
    time_of,
)
from loose_env.instrument.trend.trend import (
    SeriesTrend,
    SessionSeen,
    Trend,
    change_since,
)

__all__ = [
    "FIRST",
    "HEALTHY",
    "KEPT",
    "PAGE",
    "PLAN",
    "PROBABLE",
    "QUANTITIES",
    "RECORDING",
    "TRANSIT",
    "DiagnoseSettings",
    "Diagnosis",
    "Fault",
    "InstrumentedArm",
    "JointDrive",
    "Loop",
    "Maintenance",
    "ModelSettings",
    "MotionPeak",
    "MotionSettings",
    "NextMeasurement",
    "NextSettings",
    "Plan",
    "PlanFiles",
    "PlanSettings",
    "PlannedRun",
    "RecordSeen",
    "SeriesTrend",
    "SessionSeen",
    "Severity",
    "Signal",
    "SlideDirection",
    "ToolPlan",
    "TransmissionSpectrum",
    "Trend",
    "TrendSettings",
    "Verdict",
    "change_since",
    "diagnose",
    "find_fault",
    "inspect_model",
    "next_for",
    "option_words",
    "path_word",
    "plan",
    "plan_json",
    "plan_tool",
    "read_arm",
    "read_diagnosis",
    "read_maintenance",
    "read_recorded_arm",
    "read_sessions",
    "run_columns",
    "screen",
    "session_beside",
    "signal_stems",
    "time_of",
    "tool_runs",
    "unit_of",
    "unlike",
    "write_plan",
    "write_tool_plan",
]
