"""Result of a diagnosis: dataclasses, and ``result.json`` (``loose-diagnosis/1``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from loose_env.errors import InvalidData
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.validation import settings_within
from loose_env.io import json_text, read_result_file, restored, whole_of, write_text

__all__ = [
    "FORMAT",
    "HEALTHY",
    "Diagnosis",
    "Fault",
    "FaultKind",
    "Loop",
    "NextMeasurement",
    "RecordSeen",
    "SlideDirection",
    "VerdictKind",
    "hypothesis_of",
    "read_diagnosis",
]

FORMAT = "loose-diagnosis/1"
"""Format of the file."""
HEALTHY = "healthy"
"""Name of the hypothesis that nothing is loose."""
FaultKind = Literal["healthy", "structural_looseness", "backlash"]
"""Kinds of fault."""
VerdictKind = Literal["healthy", "faulty", "open", "model_mismatch"]
"""Kinds of verdict."""
Vector = tuple[float, float, float]

_SUM = 0.02
"""Largest deviation of the sum of a file's probabilities from 1."""


_SHOWN = 300
"""Most signs of what a file has that an error repeats."""


def _short(value: object) -> str:
    said = str(value)
    return said if len(said) <= _SHOWN else f"{said[:_SHOWN]}..."


def hypothesis_of(kind: str, where: str | None) -> str:
    """Name of a hypothesis, as the keys of a posterior have it.

    Examples
    --------
    >>> hypothesis_of("backlash", "elbow"), hypothesis_of("healthy", None)
    ('backlash@elbow', 'healthy')
    """
    return kind if where is None else f"{kind}@{where}"


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Fault of an arm.

    Examples
    --------
    >>> Fault(kind="structural_looseness", where="forearm", direction=(0.0, 0.6, 0.8)).hypothesis
    'structural_looseness@forearm'
    >>> Fault(kind="healthy", where="forearm")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: a healthy arm has no location, got 'forearm'
    """

    kind: FaultKind
    """"healthy", "structural_looseness" or "backlash"."""
    where: str | None = None
    """The model's own name of the body that is loose on its joint, or of the joint that has play;
    None for a healthy arm."""
    direction: Vector | None = None
    """Unit vector along which the body slides, in its own frame, axial; None for a healthy arm,
    for backlash, and where the data do not say."""
    direction_half_angle_deg: float | None = None
    """Half the opening of the cone about ``direction`` that holds the truth with 95 %
    probability [degrees]."""
    gap_m: float | None = None
    """Free travel [m]; of backlash the free turn [rad], where the joint slides [m]. None where the
    data do not say."""
    gap_interval_m: tuple[float, float] | None = None
    """Ends of its 95 % interval, in the unit of ``gap_m``."""

    def __post_init__(self) -> None:
        """Check.

        Raises
        ------
        InvalidData
            If kind and location do not go together, the direction is no unit vector, or an interval
            is upside down.
        """
        if self.kind not in get_args(FaultKind):
            raise InvalidData(
                f"the kind of a fault is one of {list(get_args(FaultKind))}, not {self.kind!r}"
            )
        if self.kind == HEALTHY and self.where is not None:
            raise InvalidData(f"a healthy arm has no location, got {self.where!r:.60}")
        if self.kind != HEALTHY and not self.where:
            raise InvalidData(f"{self.kind} needs the name of a location, got {self.where!r}")
        if self.direction is not None:
            if self.kind != "structural_looseness":
                raise InvalidData(f"{self.kind} has no direction, got {self.direction}")
            length = math.sqrt(sum(x * x for x in self.direction))
            if not abs(length - 1) < 1e-3:
                raise InvalidData(f"the direction is a unit vector, got {self.direction}")
        ends = self.gap_interval_m
        if ends is not None and not 0 <= ends[0] <= ends[1]:
            raise InvalidData(f"an interval of the gap goes upwards from zero or more, got {ends}")

    @property
    def hypothesis(self) -> str:
        """Key of the posterior."""
        return hypothesis_of(self.kind, self.where)


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
        """Check.

        Raises
        ------
        InvalidData
            If no joint is named, there is not one level and one torque for each, or a figure or
            a setting makes no sense.
        """
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
class Loop:
    """Correlation of the tool's motion with the excited joint's, by direction in a plane.

    Drawn over the full circle it is the loop whose waist lies across what the joint transmits.
    """

    joint: str
    """The excited joint."""
    plane: Literal["xy", "xz", "yz"]
    """Plane of the tool frame."""
    angle_deg: tuple[float, ...]
    """Directions in the plane, from its first axis [degrees] (P,)."""
    correlation: tuple[float, ...]
    """Measured, -1 to 1 (P,)."""
    expected: tuple[float, ...]
    """Of the healthy arm, by the model (P,)."""

    def __post_init__(self) -> None:
        """Check."""
        if not len(self.angle_deg) == len(self.correlation) == len(self.expected):
            raise InvalidData("a loop has one correlation, measured and expected, for each angle")


@dataclass(frozen=True, kw_only=True)
class RecordSeen:
    """One run of the recording, in the order of evaluation."""

    file: str
    """The run's file."""
    pose: Mapping[str, float]
    """Positions held [rad, m where a joint slides]."""
    excited: tuple[str, ...]
    """Joints that were excited."""
    condition: str
    """"suspect" or "healthy"."""
    probabilities: Mapping[str, float]
    """Of every hypothesis after this run and all before it; empty for a healthy reference and
    for a run that could not be used."""
    direction_tool: Vector | None = None
    """Direction in which the most probable fault moves the tool in this pose, tool frame, axial: as
    all runs together have it, not this one alone. None where none is seen."""
    half_angle_deg: float | None = None
    """Half the opening of its 95 % cone [degrees]."""
    loops: tuple[Loop, ...] = ()
    """For the figure of this run."""
    notes: tuple[str, ...] = ()
    """Notes on the run, in sentences."""


@dataclass(frozen=True, kw_only=True)
class SlideDirection:
    """Along which direction a link would slide if it were the loose one."""

    axis: Vector
    """Unit vector in the body's own frame, axial."""
    half_angle_deg: float
    """Half the opening of its 95 % cone [degrees]."""


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
    verdict: VerdictKind = "open"
    """"healthy" or "faulty" where that is settled; "model_mismatch" where the model is not that of
    the arm and has to be corrected first; else "open"."""
    open_because: tuple[str, ...] = ()
    """Reasons why it is not settled, in sentences."""
    misfit: float = math.nan
    """Share of the power of the tool's motion that the best hypothesis leaves unexplained [1]; NaN
    in files of versions that did not say."""
    format: str = FORMAT
    """Of the file."""

    def __post_init__(self) -> None:
        """Check.

        Raises
        ------
        InvalidData
            If the format is another, or the posterior is none or does not have the fault.
        """
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
        return restored(cls, whole, "diagnosis")

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
