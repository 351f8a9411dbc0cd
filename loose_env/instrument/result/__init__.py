"""Result of a diagnosis: dataclasses, and ``result.json`` (``loose-diagnosis/1``).

Data flow: fault -> records -> diagnosis.
"""

from loose_env.instrument.result.diagnosis import (
    FORMAT,
    Diagnosis,
    NextMeasurement,
    Severity,
    Verdict,
    read_diagnosis,
)
from loose_env.instrument.result.fault import (
    HEALTHY,
    Fault,
    FaultKind,
    SlideDirection,
    Vector,
    hypothesis_of,
)
from loose_env.instrument.result.records import Loop, RecordSeen, TransmissionSpectrum

__all__ = [
    "FORMAT",
    "HEALTHY",
    "Diagnosis",
    "Fault",
    "FaultKind",
    "Loop",
    "NextMeasurement",
    "RecordSeen",
    "Severity",
    "SlideDirection",
    "TransmissionSpectrum",
    "Vector",
    "Verdict",
    "hypothesis_of",
    "read_diagnosis",
]
