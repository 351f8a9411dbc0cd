"""Preflight of a recording: units, ranges, signs, sampling, channels, clocks and entries.

Data flow: thresholds -> settings -> corrections -> findings -> channels -> sampling ->
quality -> entries -> model_checks -> preflight.
"""

from loose_env.doctor.corrections import Correction, write_corrected
from loose_env.doctor.findings import Finding, Report, Severity, graded_findings
from loose_env.doctor.preflight import examine
from loose_env.doctor.settings import DoctorSettings
from loose_env.doctor.thresholds import POSE_OFFSET, POSE_SPREAD

__all__ = [
    "POSE_OFFSET",
    "POSE_SPREAD",
    "Correction",
    "DoctorSettings",
    "Finding",
    "Report",
    "Severity",
    "examine",
    "graded_findings",
    "write_corrected",
]
