"""Preflight of a recording: units, ranges, signs, sampling, channels, clocks and entries.

Data flow: settings -> corrections -> findings -> machine -> channels -> units -> positions ->
signals -> torques, clocks -> preflight. Each check sees the runs as the fixes before it left them.
"""

from loose_env.doctor.corrections import Correction, write_corrected
from loose_env.doctor.findings import Finding, Report, Severity, graded_findings
from loose_env.doctor.preflight import examine
from loose_env.doctor.settings import POSE_OFFSET, POSE_SPREAD, DoctorSettings

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
