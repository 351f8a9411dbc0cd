"""Diagnosis and its next measurement as dataclasses, and the file ``result.json``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from loose_env.doctor import Finding, graded_findings
from loose_env.errors import InvalidData
from loose_env.instrument.result.fault import HEALTHY, Fault, SlideDirection
from loose_env.instrument.result.records import RecordSeen, TransmissionSpectrum
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.validation import settings_within
from loose_env.io import json_text, read_result_file, restored, whole_of, write_text

FORMAT = "loose-diagnosis/1"
"""Format of the file."""
Verdict = Literal["healthy", "faulty", "open", "model_mismatch"]
"""Outcome: settled without and with a fault; not decided; the model is not that of the arm."""
Severity = Literal["critical", "warning", "note"]
"""Weight of a warning: it invalidates the result, limits it, or is for information."""
_SUM = 0.02
"""Largest deviation of the sum of a file's probabilities from 1."""


_SHOWN = 300
"""Most signs of what a file has that an error repeats."""


def _short(value: object) -> str:
    said = str(value)
    return said if len(said) <= _SHOWN else f"{said[:_SHOWN]}..."


@dataclass(frozen=True, kw_only=True)
class NextMeasurement:
    """Next measurement and its reason."""

    pose: Mapping[str, float]
    """Position of every joint to hold [rad, m where it slides]."""
    joints: tuple[str, ...]
    """Joints to excite, one after the other, each in a run of its own."""
    band_hz: tuple[float, float]
    """Band of the noise to play [Hz]."""
    levels: tuple[float, ...]
    """Rms acceleration of each of these joints [rad/s², m/s² where it slides]."""
    torques: tuple[float, ...]
    """Rms torque that is expected to do that [N·m, N where it slides]."""
    seconds: float
    """Length of each run [s]."""
    rate_hz: float
    """Sampling rate [Hz]."""
    reason: str
    """Reason, in a sentence."""
    gain: float = 0.0
    """Information that is expected of it about what is loose [bits]."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings with which it was chosen, those of
    `loose_env.instrument.settings.measurement.NextSettings`; empty in files of versions that did
    not say."""

    def __post_init__(self) -> None:
        """Check."""
        if not self.joints or not len(self.joints) == len(self.levels) == len(self.torques):
            raise InvalidData(
                "a next measurement has one or more joints, with a level and a torque for each, "
                f"got {len(self.joints)}, {len(self.levels)} and {len(self.torques)}"
            )
        if not 0 < self.band_hz[0] < self.band_hz[1] < math.inf:
            raise InvalidData(f"a band goes upwards from above 0 Hz, got {self.band_hz}")
        played = (*self.levels, *self.torques)
        if not all(math.isfinite(q) for q in self.pose.values()):
            raise InvalidData(
                f"the pose of a next measurement is finite, got {_short(dict(self.pose))}"
            )
        if not all(0 <= value < math.inf for value in played):
            raise InvalidData(
                f"levels and torques are finite and not negative, got {_short(played)}"
            )
        settings_within(NextSettings, {"seconds": self.seconds, "rate_hz": self.rate_hz}, "next")
        _ = self.choice

    @property
    def choice(self) -> NextSettings:
        """Settings with which it was chosen; those that the file does not say are the usual."""
        said = {"seconds": self.seconds, "rate_hz": self.rate_hz, **self.settings}
        return settings_within(NextSettings, said, "next.settings")


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The content of ``result.json``."""

    fault: Fault
    """The most probable one."""
    probability: float
    """That it is the one, of those asked for [1]."""
    posterior: Mapping[str, float]
    """Probability of "healthy", of "structural_looseness@LINK" for every link and of
    "backlash@JOINT" for every joint."""
    next: NextMeasurement | None = None
    """Most informative measurement; None where nothing more is needed, or no pose will do:
    `settled` says which."""
    warnings: tuple[str, ...] = ()
    """Warnings that limit the validity."""
    records: tuple[RecordSeen, ...] = ()
    """The runs."""
    model: str = "model.xml"
    """File of the nominal model."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Everything that the result depends on besides recording and model."""
    directions: Mapping[str, SlideDirection] = field(default_factory=dict)
    """Body -> direction of its slide by all runs together, if it were the loose one; those of which
    the data say one. Empty in files of versions that did not say."""
    settled: bool = False
    """True if nothing more needs to be measured: two runs at least, and the probability above the
    setting ``sure``. False in files of versions that did not say."""
    verdict: Verdict = "open"
    """Outcome; in files of versions that did not say, by ``settled`` and ``fault``."""
    open_because: tuple[str, ...] = ()
    """Reasons why the verdict is open or the model is refused, in sentences."""
    nothing_opened: float = math.nan
    """Probability that no seat opened in any run, whether tight or kept shut [1]; NaN in files of
    versions that did not say. A verdict of "healthy" rests on it."""
    misfit: float = math.nan
    """Share of the record's power that the best model leaves unexplained [1]; NaN if unknown."""
    severities: tuple[Severity, ...] = ()
    """Severity of each warning, in their order; those that lack one count as "warning"."""
    spectra: tuple[TransmissionSpectrum, ...] = ()
    """Transmission of every run, measured and by the most probable hypotheses."""
    date: str = ""
    """Date of the measurement (ISO 8601): as given, else the time of the latest run's file (UTC);
    "" if unknown."""
    version: str = ""
    """Version of loose-env that wrote it."""
    model_hash: str = ""
    """First 16 hexadecimal digits of the SHA-256 of the model file."""
    preflight: tuple[Finding, ...] = ()
    """Findings of `loose_env.doctor` in the recording, errors first; empty in files of versions
    that did not say."""
    format: str = FORMAT
    """Of the file."""

    def __post_init__(self) -> None:
        """Check."""
        if self.format != FORMAT:
            raise InvalidData(
                f"a diagnosis of the format {FORMAT!r} is needed, not {self.format!r}"
            )
        total = math.fsum(self.posterior.values())
        if not abs(total - 1) < _SUM or min(self.posterior.values(), default=-1.0) < 0:
            raise InvalidData(
                f"the posterior has probabilities of sum 1, got {_short(self.posterior)}"
            )
        if self.fault.hypothesis not in self.posterior:
            raise InvalidData(
                f"the posterior does not have the fault {self.fault.hypothesis!r:.80}; it has "
                f"{_short(list(self.posterior))}"
            )
        _ = self.choice

    @property
    def choice(self) -> NextSettings:
        """Settings with which the next measurement is chosen, also where none was."""
        if self.next is not None:
            return self.next.choice
        return settings_within(NextSettings, self.settings, "settings")

    @property
    def graded_warnings(self) -> tuple[tuple[Severity, str], ...]:
        """Warnings and findings of the preflight with their severity, the most severe first."""
        missing = len(self.warnings) - len(self.severities)
        usual: Severity = "warning"
        severities = (*self.severities, *((usual,) * max(missing, 0)))
        own = zip(severities, self.warnings, strict=False)
        pairs = (*own, *graded_findings(self.preflight))
        return tuple(sorted(pairs, key=lambda pair: get_args(Severity).index(pair[0])))

    def to_json(self) -> str:
        """Text of ``result.json``; numbers that are not finite become null."""
        whole = {"format": self.format, **asdict(self)}
        return json_text(whole)

    @classmethod
    def from_json(cls, text: str) -> Diagnosis:
        """Read the text of ``result.json``.

        Raises
        ------
        InvalidData
            If it is none of the format ``loose-diagnosis/1``.

        Examples
        --------
        >>> Diagnosis.from_json('{"format": "loose-gap/1"}')
        Traceback (most recent call last):
        ...
        loose_env.errors.InvalidData: a diagnosis of the format 'loose-diagnosis/1' is needed, ...
        """
        whole = whole_of(text, format=FORMAT, noun="diagnosis")
        found = restored(cls, whole, "diagnosis")
        if "verdict" in whole or not found.settled:
            return found
        return replace(found, verdict="healthy" if found.fault.kind == HEALTHY else "faulty")

    def write(self, path: str | Path) -> Path:
        """Write ``result.json`` beside its place and rename it."""
        return write_text(Path(path), self.to_json())


def read_diagnosis(path: str | Path) -> Diagnosis:
    """Read a diagnosis, from its file or from the folder that holds ``result.json``.

    Raises
    ------
    InvalidData
        If there is none, or it is none of the format.
    """
    return read_result_file(path, Diagnosis.from_json, noun="diagnosis")
