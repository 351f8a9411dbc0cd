"""GapResult and its parts: dataclasses of ``result.json``, with verdict, effects and ranking.

The format of the file is ``loose-gap/1``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from loose_env.doctor import Finding, graded_findings
from loose_env.errors import InvalidData
from loose_env.gap.output.evidence_schema import Identifiability, Location, ResidualTest
from loose_env.io import json_text, read_result_file, restored, whole_of, write_text

FORMAT = "loose-gap/1"
UNIT = "RMS over held-out runs, in noise standard deviations"
Verdict = Literal["named", "no_gap", "unexplained"]
"""What a comparison came to."""


@dataclass(frozen=True, kw_only=True)
class EffectLocation:
    """A kind of effect at a location."""

    kind: str
    """Identifier of the catalogue."""
    where: str
    """The model's own name of the joint, body, actuator or sensor; "tool", "base" or "all"."""


@dataclass(frozen=True, kw_only=True)
class DeletionTest:
    """What is lost without an effect, the others refitted."""

    held_out_z: float
    """Improvement (z) with it on held-out runs, over blocks of time."""
    training_z: float
    """The same on the training runs."""
    share_of_error: float
    """What it explains over the explainable error of the nominal model."""
    share_without: float
    """Share of the error without it that it explains."""
    share_in_channel: float
    """The same in the channel in which it explains most, among those in which the error without it
    is clearly autocorrelated."""


@dataclass(frozen=True, kw_only=True)
class NamedEffect:
    """An effect that the model lacks."""

    kind: str
    """Identifier of the catalogue."""
    where: str
    """The model's own name of the joint, body, actuator or sensor; "tool", "base" or "all"."""
    parameters: Mapping[str, float]
    """Fitted values."""
    interval_95: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ends of their 95 % intervals."""
    ambiguous_with: tuple[EffectLocation, ...] = ()
    """Effects that the held-out data cannot distinguish from it."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Unit of each parameter, "" for a ratio."""
    variant: str = ""
    """Variant of the effect, "" for the default."""
    in_model: bool = True
    """Whether ``model.xml`` carries it; if not, ``code`` of the result applies it."""
    impact_power_explained: float | None = None
    """For a part identified by its impact power: the share of that power explained on held-out
    runs."""
    deletion: DeletionTest | None = None
    """Deletion test; None for a part identified by its impact power, and what is beside it."""
    probability: float | None = None
    """Probability that the machine has it, calibrated on blind recordings; None if not judged."""
    rival_probability: float | None = None
    """The same of each effect of `ambiguous_with`."""


@dataclass(frozen=True, kw_only=True)
class RankedHypothesis:
    """A hypothesis that was fitted."""

    kind: str
    """Kind of the effect added in this step; of the first, where there were several."""
    where: str
    """Location of the effect."""
    held_out: float
    """Root mean square on held-out runs, in noise standard deviations."""
    bic: float
    """Bayesian information criterion relative to the hypothesis without it, with the effective
    number of independent rows; negative where the effect is worth its parameters."""
    step: int = 1
    """1 for the first effect, 2 for one beside the first, ..."""
    improvement_z: float = 0.0
    """Improvement (z) over the step before, on held-out runs."""
    together_with: tuple[EffectLocation, ...] = ()
    """Further effects of the same hypothesis: one kind at several locations at once."""

    @property
    def places(self) -> tuple[EffectLocation, ...]:
        """All effects that it adds."""
        return (EffectLocation(kind=self.kind, where=self.where), *self.together_with)


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Residual on the held-out runs, before and after the correction."""

    before: float
    """Residual of the nominal model, fitted within its tolerance."""
    after: float
    """Residual of the corrected model."""
    by_channel: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Channel -> before and after."""
    by_horizon_s: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Horizon in seconds, such as "0.5" -> open-loop prediction error."""
    by_quantity: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Quantity and unit, such as "joint position [rad]" -> error in that unit, before and after."""
    noise_floor: float = 1.0
    """Residual level of sensor noise alone."""
    unit: str = UNIT
    """Unit of all of these but `by_quantity`."""


@dataclass(frozen=True, kw_only=True)
class GapResult:
    """The content of ``result.json``."""

    verdict: Verdict
    """ "named", "no_gap" or "unexplained"."""
    gap: Gap
    """Residual before and after."""
    effects: tuple[NamedEffect, ...] = ()
    """Effects that the model lacks, in the order of identification."""
    doubtful: tuple[NamedEffect, ...] = ()
    """Effects that reduce the error and did not pass all tests; ``model`` carries them."""
    held_out_runs: tuple[str, ...] = ()
    """Files of the held-out runs."""
    ranking: tuple[RankedHypothesis, ...] = ()
    """All fitted hypotheses, the best first in every step."""
    model: str | None = "model.xml"
    """The corrected model, beside the file."""
    code: str = ""
    """Python lines that apply effects which MJCF cannot express; "" if none."""
    nominal_parameters: Mapping[str, float] = field(default_factory=dict)
    """Factors on nominal parameters, within the tolerance, that ``model`` carries too."""
    location: Location = field(default_factory=Location)
    """Location of the model error, before any correction."""
    location_words: tuple[str, ...] = ()
    """The same in sentences; of the remaining residual where the verdict is "unexplained"."""
    remaining: tuple[str, ...] = ()
    """Remaining residual and its location, in sentences; empty where it is noise."""
    remaining_location: Location = field(default_factory=Location)
    """Location of the residual of the corrected model, on all runs."""
    residual_tests: tuple[ResidualTest, ...] = ()
    """Residual tests on the held-out runs."""
    interval_factors: Mapping[str, float] = field(default_factory=dict)
    """Factors on the half widths of intervals, for what the laws of effects leave out: "size" of
    parameters that size an effect, "shape" of those that shape it. Parts with stops have none."""
    identifiability: Identifiability = field(default_factory=Identifiability)
    """Effects that the recorded motions could not show, or distinguish."""
    warnings: tuple[str, ...] = ()
    """Cautions for the reader."""
    preflight: tuple[Finding, ...] = ()
    """Findings of `loose_env.doctor` in the recording, errors first; empty in files of versions
    that did not say."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Provenance: all inputs of the result besides the recording."""
    format: str = FORMAT
    """Format of the file."""

    def __post_init__(self) -> None:
        """Check the values."""
        if self.format != FORMAT:
            raise InvalidData(f"a result of the format {FORMAT!r} is needed, not {self.format!r}")
        if self.verdict not in get_args(Verdict):
            raise InvalidData(
                f"the verdict is one of {list(get_args(Verdict))}, not {self.verdict!r}"
            )

    @property
    def graded_warnings(self) -> tuple[tuple[str, str], ...]:
        """Warnings and findings of the preflight with their severity, the most severe first."""
        pairs = (*(("warning", words) for words in self.warnings), *graded_findings(self.preflight))
        return tuple(sorted(pairs, key=lambda pair: ("critical", "warning", "note").index(pair[0])))

    def to_json(self) -> str:
        """Format as ``result.json``; numbers that are not finite become null."""
        whole = {"format": self.format, **asdict(self)}
        return json_text(whole)

    @classmethod
    def from_json(cls, text: str) -> GapResult:
        """Parse the text of ``result.json``.

        Raises
        ------
        InvalidData
            If it is none of the format ``loose-gap/1``.

        Examples
        --------
        >>> GapResult.from_json('{"format": "loose-gap/2"}')
        Traceback (most recent call last):
        ...
        loose_env.errors.InvalidData: a result of the format 'loose-gap/1' is needed, ...
        """
        whole = whole_of(text, format=FORMAT, noun="result")
        return restored(cls, whole, "result")

    def write(self, path: str | Path) -> Path:
        """Write ``result.json`` atomically, by renaming a temporary file."""
        return write_text(Path(path), self.to_json())


def read_result(path: str | Path) -> GapResult:
    """Read a result file, or that of a folder.

    Raises
    ------
    InvalidData
        If there is none, or it is none of the format.

    Examples
    --------
    >>> read_result("no/such/folder")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: ...
    """
    return read_result_file(path, GapResult.from_json, noun="result")
