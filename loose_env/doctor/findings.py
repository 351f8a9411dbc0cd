"""Findings of the preflight, tolerances that a user may set, and the report as text and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

from loose_env.doctor.corrections import Correction
from loose_env.errors import InvalidData
from loose_env.io import Checked, json_text, positive

Severity = Literal["error", "warning", "note"]
"""``"error"``: a result would be wrong. ``"warning"``: it may be. ``"note"``: worth knowing."""

FORMAT = "loose-doctor/1"
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
_SHOWN = 3
"""Findings of one kind that are written out."""


@dataclass(frozen=True, kw_only=True)
class DoctorSettings(Checked):
    """Tolerances of the preflight.

    Raises
    ------
    InvalidSetting
        If one is not a positive number.

    Examples
    --------
    >>> DoctorSettings(clock_s=-1.0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: DoctorSettings.clock_s must be positive seconds; got -1.0
    """

    clock_s: Annotated[float, positive("seconds")] = 1e-3
    """Offset between the clocks of two recorders, from which it is a warning [s]: 54 degrees of
    phase at 150 Hz."""
    turned_deg: Annotated[float, positive("degrees")] = 15.0
    """Angle between measured and predicted gravity at an accelerometer, from which it is a warning
    [deg]: mounting and pose are known to a few degrees."""
    pose_offset: Annotated[float, positive("rad or m")] = 0.05
    """Distance of a measured from a noted joint position, from which it is a warning [rad or m]:
    servos sag by less."""
    fastest: Annotated[float, positive("rad/s or m/s")] = 60.0
    """Joint speed above which the unit is doubted [rad/s or m/s]: fast arms reach 10 rad/s."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One defect of a recording, with its consequence and remedy."""

    check: str
    """Check that found it, such as "units" or "clock"."""
    severity: Severity
    """Whether it makes a result wrong."""
    channel: str
    """Column it is about, or several; empty where it is about a whole run."""
    found: str
    """Observation, with its number and unit."""
    consequence: str
    """Effect on a diagnosis."""
    remedy: str
    """Action that removes it."""
    run: str = ""
    """File of the run; empty where it holds for the recording."""
    value: float | None = None
    """The number of the observation."""
    unit: str = ""
    """Its unit."""
    fix: Correction | None = None
    """Change of the recording that removes it; None where only a person can tell."""


@dataclass(frozen=True)
class Defect:
    """Kind of findings that share check, severity, consequence and remedy."""

    check: str
    severity: Severity
    consequence: str
    remedy: str

    def at(self, channel: str, found: str, value: float | None = None, **more: Any) -> Finding:
        """Finding of this kind on a channel; ``more`` sets or overrides any other field."""
        kind = {
            name: getattr(self, name) for name in ("check", "severity", "consequence", "remedy")
        }
        return Finding(**{**kind, "channel": channel, "found": found, "value": value, **more})


@dataclass(frozen=True, kw_only=True)
class Report:
    """All findings of a recording, errors first."""

    recording: str
    """Name of the folder."""
    runs: int
    """Number of runs examined."""
    seconds: float
    """Length of all runs together [s]."""
    findings: tuple[Finding, ...] = field(default=())
    """Findings, errors first, else in the order of the checks."""

    @classmethod
    def of(cls, recording: str, runs: int, seconds: float, findings: Iterable[Finding]) -> Report:
        """Make a report of findings in any order."""
        ordered = sorted(findings, key=lambda each: SEVERITIES.index(each.severity))
        return cls(recording=recording, runs=runs, seconds=seconds, findings=tuple(ordered))

    def of_severity(self, severity: Severity) -> tuple[Finding, ...]:
        """Findings of one severity."""
        return tuple(each for each in self.findings if each.severity == severity)

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that make a result wrong."""
        return self.of_severity("error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that may make a result wrong."""
        return self.of_severity("warning")

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Findings worth knowing."""
        return self.of_severity("note")

    def headline(self) -> str:
        """Count of the findings, in one line."""
        counts = {each: len(_grouped(self.findings, each)) for each in SEVERITIES}
        told = [f"{n} {each}{'s' * (n != 1)}" for each, n in counts.items() if n]
        runs = f"{self.runs} run{'s' * (self.runs != 1)}, {self.seconds:.4g} s"
        return f"{self.recording} ({runs}): {', '.join(told) or 'nothing found'}"

    def lines(self, *, least: Severity = "note") -> list[str]:
        """Findings as text; a defect that several runs have is written once.

        Parameters
        ----------
        least : {"error", "warning", "note"}
            Least severity that is written.
        """
        severe = SEVERITIES[: SEVERITIES.index(least) + 1]
        groups = [(each, group) for each in severe for group in _grouped(self.findings, each)]
        return [line for severity, group in groups for line in _lines(severity, group)]

    def text(self) -> str:
        """Whole report as text."""
        return "\n".join([self.headline(), *self.lines()])

    def refuse_errors(self, *, listed: str, remedy: str) -> None:
        """Refuse the recording if there are errors.

        Parameters
        ----------
        listed : str
            Where the errors are listed.
        remedy : str
            How to go on in spite of them.

        Raises
        ------
        InvalidData
            If there are errors.

        Examples
        --------
        >>> Report(recording="arm", runs=2, seconds=4.0).refuse_errors(listed="", remedy="")
        """
        count = len(self.errors)
        if count:
            raise InvalidData(
                f"the preflight found {count} error{'s' * (count != 1)} of the recording, "
                f"{listed}; correct it, or go on with {remedy}"
            )

    def to_json(self) -> str:
        """Whole report as JSON."""
        whole: dict[str, Any] = {
            "format": FORMAT,
            "recording": self.recording,
            "runs": self.runs,
            "seconds": self.seconds,
            "errors": len(self.errors),
            "warnings": len(self.warnings),
            "notes": len(self.notes),
            "findings": [asdict(each) for each in self.findings],
        }
        return json_text(whole)


def graded_findings(
    findings: Sequence[Finding],
) -> tuple[tuple[Literal["critical", "warning", "note"], str], ...]:
    """Findings as warnings of a result with their weight, the most severe first.

    A defect that several runs have is written once.

    Examples
    --------
    >>> one = Finding(
    ...     check="pauses",
    ...     severity="error",
    ...     channel="time",
    ...     run="a.csv",
    ...     found="a pause",
    ...     consequence="one piece is used",
    ...     remedy="record it again",
    ... )
    >>> graded_findings([one, one])
    (('critical', 'in a.csv, time: a pause (and 1 more); one piece is used; record it again'),)
    """
    return tuple(
        (
            "critical" if severity == "error" else severity,
            f"{'in ' if _place(group[0]) else ''}{_observed(group[0])}"
            f"{f' (and {len(group) - 1} more)' if len(group) > 1 else ''}; "
            f"{group[0].consequence}; {group[0].remedy}",
        )
        for severity in SEVERITIES
        for group in _grouped(findings, severity)
    )


def _grouped(findings: Sequence[Finding], severity: str) -> list[list[Finding]]:
    """Findings of one severity; those that differ by run or channel alone are together."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for each in findings:
        if each.severity == severity:
            groups.setdefault((each.check, each.consequence, each.remedy), []).append(each)
    return list(groups.values())


def _lines(severity: str, group: list[Finding]) -> list[str]:
    lines = [f"{severity}: {_observed(group[0])}"]
    lines += [f"  also {_observed(each)}" for each in group[1:_SHOWN]]
    if len(group) > _SHOWN:
        more = group[_SHOWN:]
        runs = len({each.run for each in more if each.run})  # one without holds for all
        place = f", in {runs} run{'s' * (runs != 1)}" if runs else ""
        lines.append(f"  and {len(more)} more of this kind{place}")
    return [*lines, f"  consequence: {group[0].consequence}", f"  remedy: {group[0].remedy}"]


def _place(one: Finding) -> str:
    return ", ".join(filter(None, (one.run, one.channel)))


def _observed(one: Finding) -> str:
    place = _place(one)
    return f"{place}: {one.found}" if place else one.found
