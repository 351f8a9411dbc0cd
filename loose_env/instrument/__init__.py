"""Looseness of a real arm: a plan to shake it, and where its records say that something knocks.

Data flow: arm, controllers -> signals -> records -> motion -> knocks -> locate, reference, poses
-> decide -> result -> plan -> pipeline -> trend.
"""

from loose_env.instrument.arm import BOLTS, GEARS, PoseModel, SuspectArm, place_name, read_arm
from loose_env.instrument.controllers import PRESETS, Controller, Preset, preset
from loose_env.instrument.decide import Numbers, knock_limit
from loose_env.instrument.pipeline import DiagnoseSettings, Evidence, diagnose, judge, listen
from loose_env.instrument.plan import (
    MODEL,
    PLAN,
    RECORDING,
    SWEEP,
    Plan,
    PlannedRun,
    PlanSettings,
    commands_of,
    next_number,
    plan,
    read_plan,
    swept,
    write_plan,
)
from loose_env.instrument.poses import is_tested_share
from loose_env.instrument.result import (
    Diagnosis,
    Place,
    PlaceVerdict,
    RunSeen,
    Verdict,
    read_diagnosis,
)
from loose_env.instrument.trend import Trend, Visit, read_trend, trend

__all__ = [
    "BOLTS",
    "GEARS",
    "MODEL",
    "PLAN",
    "PRESETS",
    "RECORDING",
    "SWEEP",
    "Controller",
    "DiagnoseSettings",
    "Diagnosis",
    "Evidence",
    "Numbers",
    "Place",
    "PlaceVerdict",
    "Plan",
    "PlanSettings",
    "PlannedRun",
    "PoseModel",
    "Preset",
    "RunSeen",
    "SuspectArm",
    "Trend",
    "Verdict",
    "Visit",
    "commands_of",
    "diagnose",
    "is_tested_share",
    "judge",
    "knock_limit",
    "listen",
    "next_number",
    "place_name",
    "plan",
    "preset",
    "read_arm",
    "read_diagnosis",
    "read_plan",
    "read_trend",
    "swept",
    "trend",
    "write_plan",
]
