"""Diagnosis of a session as dataclasses, and the file ``result.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from loose_env.doctor import Finding
from loose_env.errors import InvalidData
from loose_env.instrument.arm import BOLTS, place_name
from loose_env.io import JsonFile, read_result_file

FORMAT = "loose-diagnosis/2"
"""Format of the file."""
Verdict = Literal["loose", "tight", "open", "refused"]
"""Something knocks; nothing does, and every place was tested; not decided; no usable record."""
PlaceVerdict = Literal["loose", "suspect", "tight", "not tested"]


@dataclass(frozen=True, kw_only=True)
class Place:
    """A link's seat or a joint's teeth, and what the session says of it."""

    kind: str
    """"structural_looseness" of a link on its joint, or "backlash" of a joint."""
    at: str
    """Link or joint, by the model's name."""
    verdict: PlaceVerdict
    probability: float
    """That it is the loose one, if one is [1]."""
    rhythm: float
    """Correlation of its foretold knocks with what was heard [1]."""
    tested: float
    """Share of its directions whose load reversed [1]."""
    direction: tuple[float, float, float] | None = None
    """Direction of a seat's slide, link frame, axial; None for a joint."""
    why: str = ""
    """Reason of the verdict, in a sentence."""
    base: bool = False
    """True for the seat of the arm's base on the ground."""

    @property
    def name(self) -> str:
        """Name as ``backlash@elbow``."""
        return place_name(self.kind, self.at)

    @property
    def words(self) -> str:
        """Place for a reader."""
        if self.base:
            return "the seat of the base on the ground"
        if self.kind == BOLTS:
            return f"the seat of {_named('link', self.at)}"
        return f"the gear of {_named('joint', self.at)}"


def _named(noun: str, name: str) -> str:
    """Name with its noun, where the name does not say it."""
    return name if noun in name.lower() else f"{noun} {name}"


@dataclass(frozen=True, kw_only=True)
class RunSeen:
    """One run of the session."""

    file: str
    condition: str
    pose: Mapping[str, float]
    """Mean joint positions [rad, m where a joint slides]; empty where it could not be used."""
    used: bool
    why: str = ""
    """Reason why it was not, and what to do."""
    repeats: float = 0.0
    """Correlation of the top band's energy between periods [1]."""
    heard: tuple[float, ...] = ()
    """Amplitude of what repeats in the top band over a period [m/s²], a hundred samples."""
    foretold: tuple[float, ...] = ()
    """Amplitude that the best place foretells, at its best scale [m/s²]."""
    lines_hz: tuple[float, ...] = ()
    lines: tuple[float, ...] = ()
    """Amplitude of the tool's lines [m/s²]."""
    healthy_lines: tuple[float, ...] = ()
    """The same on the healthy day; empty without one."""


@dataclass(frozen=True, kw_only=True)
class Diagnosis(JsonFile):
    """The content of ``result.json``."""

    noun = "diagnosis"

    verdict: Verdict
    headline: str
    """Outcome in a sentence."""
    remedy: str
    """What to do next, in a sentence."""
    settled: bool
    """True if one place is sure."""
    places: tuple[Place, ...]
    """All places, best first."""
    reasons: tuple[str, ...] = ()
    """What said that something is loose, or what came nearest."""
    remarks: tuple[str, ...] = ()
    """What limits the result or was seen beside, in sentences."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """Statistics that decided, by name."""
    runs: tuple[RunSeen, ...] = ()
    reference: bool = False
    """True if a healthy session was compared."""
    hobby: bool = False
    """True for a class of machine whose joints all have play: no verdict without a trend."""
    model: str = "model.xml"
    date: str = ""
    """Date of the measurement (ISO 8601)."""
    version: str = ""
    seconds: float = 0.0
    """Processor time of the diagnosis [s]."""
    shaken_s: float = 0.0
    """Time that the arm was shaken [s]."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    preflight: tuple[Finding, ...] = ()
    """Findings of `loose_env.doctor`, errors first."""
    format: str = FORMAT

    def __post_init__(self) -> None:
        """Check."""
        if self.format != FORMAT:
            raise InvalidData(
                f"a diagnosis of the format {FORMAT!r} is needed, not {self.format!r}; diagnose "
                "the recording anew"
            )

    def place(self, name: str) -> Place:
        """Place of a name, as ``backlash@elbow``."""
        found = next((p for p in self.places if p.name == name), None)
        if found is None:
            listed = ", ".join(p.name for p in self.places)
            raise InvalidData(f"there is no place {name!r}; the places are {listed}")
        return found

    @property
    def untested(self) -> tuple[str, ...]:
        """Names of the places that the session did not test."""
        return tuple(p.name for p in self.places if p.verdict == "not tested")


def read_diagnosis(path: str | Path) -> Diagnosis:
    """Read a diagnosis, from its file or from the folder that holds ``result.json``.

    Raises
    ------
    InvalidData
        If there is none, or it is none of the format.

    Examples
    --------
    >>> Diagnosis.from_json('{"format": "loose-gap/1"}')
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: a diagnosis of the format 'loose-diagnosis/2' is needed, ...
    """
    return read_result_file(path, Diagnosis.from_json, noun="diagnosis")
