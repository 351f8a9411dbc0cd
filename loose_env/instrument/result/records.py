"""Results by run of a diagnosis: posterior after it, correlation loops, transmission spectra."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from loose_env.errors import InvalidData
from loose_env.instrument.result.fault import Vector


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
    """Of every hypothesis after this run and all before it, at the parameters that all runs
    together have; empty for a healthy reference and for a run that could not be used."""
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
class TransmissionSpectrum:
    """Transmission of one run from an excited joint to one axis of the accelerometer.

    The amplitude of the reading over that of the joint's driving force, in narrow bands of the
    excited lines: the root of the ratio of their powers.

    Examples
    --------
    >>> TransmissionSpectrum(
    ...     record=0,
    ...     joint="elbow",
    ...     channel="tool.x",
    ...     unit="m/s² per N·m",
    ...     drive_rms=1.0,
    ...     frequency_hz=(10.0, 20.0),
    ...     measured=(0.5,),
    ... )
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: a transmission has one amplitude for each of 2 frequencies, got 1
    """

    record: int
    """Index of its run among the records, from 0."""
    joint: str
    """The excited joint."""
    channel: str
    """Sensor and axis, as "tool_acc.x"."""
    unit: str
    """Unit of the amplitudes."""
    drive_rms: float
    """Rms of the joint's driving force in the excited band [N·m; N where it slides], or of its
    acceleration where no command and no force was recorded [rad/s², m/s²]."""
    frequency_hz: tuple[float, ...]
    """Centres of the narrow bands [Hz] (B,), upwards."""
    measured: tuple[float, ...]
    """Measured amplitudes (B,), in ``unit``."""
    predicted: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Hypothesis -> amplitudes by its fit (B,): the healthy arm, and the most probable faults with
    the seat's motion that the readings make most likely."""

    def __post_init__(self) -> None:
        """Check."""
        count = len(self.frequency_hz)
        for values in (self.measured, *self.predicted.values()):
            if len(values) != count:
                raise InvalidData(
                    f"a transmission has one amplitude for each of {count} frequencies, got "
                    f"{len(values)}"
                )
            if not all(math.isfinite(v) and v >= 0 for v in (*values, *self.frequency_hz)):
                raise InvalidData(
                    f"amplitudes and frequencies of the transmission of {self.joint!r:.60} are "
                    "finite and not negative"
                )
