"""Preflight of a recording: units, ranges, signs, sampling, channels, clocks and entries.

Data flow: corrections -> findings -> machine -> channels -> units -> positions ->
signals -> torques, clocks -> preflight. Each check sees the runs as the fixes before it left them.
"""

from loose_env.doctor.corrections import Correction, write_corrected
from loose_env.doctor.findings import DoctorSettings, Finding, Report, Severity, graded_findings
from loose_env.doctor.preflight import examine

__all__ = [
    "Correction",
    "DoctorSettings",
    "Finding",
    "Report",
    "Severity",
    "examine",
    "graded_findings",
    "write_corrected",
]
