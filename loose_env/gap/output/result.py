"""Result file of `loose gap`: verdict, effects with intervals, residuals, and identifiability.

The format of the file is ``loose-gap/1``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from math import isfinite, nan
from pathlib import Path
from typing import Any, Literal

from loose_env.doctor import Finding, graded_findings
from loose_env.io import JsonFile, read_result_file
from loose_env.recording import CommandTiming

FORMAT = "loose-gap/1"
UNIT = "RMS over held-out data, in noise standard deviations"
Verdict = Literal["named", "no_gap", "unexplained"]
"""What a comparison came to."""
ChannelWord = Literal["named", "not needed", "cannot tell", "unexplained"]
"""What it came to at one joint or reading."""


@dataclass(frozen=True, kw_only=True)
class EffectLocation:
    """A kind of effect at a location."""

    kind: str
    """Identifier of the catalogue."""
    where: str
    """The model's own name of the joint, body, actuator or sensor; "tool", "base" or "all"."""


@dataclass(frozen=True, kw_only=True)
class FittedEffect(EffectLocation):
    """An effect with the values that it has in some set."""

    parameters: Mapping[str, float] = field(default_factory=dict)
    """Fitted values; none where the set was not fitted."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Unit of each parameter, "" for a ratio."""

    def values_in_words(self, names: Iterable[str] | None = None) -> str:
        """Format some of its parameters, by default all, with their units."""
        given = self.parameters if names is None else names
        pairs = ((name, self.parameters[name], self.units.get(name, "")) for name in given)
        return ", ".join(f"{name} {value:.4g} {unit}".rstrip() for name, value, unit in pairs)


@dataclass(frozen=True, kw_only=True)
class NamedEffect(FittedEffect):
    """An effect that the model lacks."""

    interval_95: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ends of their 95 % intervals."""
    undetermined: tuple[str, ...] = ()
    """Parameters whose interval reaches an end of what is possible, or spans a factor of ten."""
    ambiguous_with: tuple[FittedEffect, ...] = ()
    """Effects that explain the data nearly as well in its place, with their values there."""
    note: str = ""
    """What else looks the same and is no effect of a model; "" if nothing."""
    variant: str = ""
    """Variant of the effect, "" for the default."""
    mountings: tuple[tuple[str, ...], ...] = ()
    """Files of the runs of each way in which it is mounted, where runs differ; ``model.xml`` has
    the way of most runs, or none."""
    in_model: bool = True
    """Whether ``model.xml`` carries it; if not, ``code`` of the result applies it where it can."""
    probability: float | None = None
    """Probability that the machine has it, or one of `ambiguous_with` in its place."""
    probability_alone: float | None = None
    """Probability that the machine has this very one."""
    z: float | None = None
    """Largest coefficient over its standard deviation."""
    held_out_gain: Mapping[str, float] = field(default_factory=dict)
    """Rise of twice the log likelihood of held-out data with it: by "run", where whole runs were
    held out, and by "stretch" of them."""
    doubt: str = ""
    """Reason why it is not named; "" of one that is."""

    def value_in_words(self, name: str) -> str:
        """Format the value of a parameter, where it is determined, with interval and unit."""
        ends, unknown = self.interval_95.get(name), name in self.undetermined
        value = "not determined" if unknown else _digits(self.parameters[name])
        between = "" if ends is None else f" ({_digits(ends[0])} to {_digits(ends[1])})"
        return f"{value}{between} {self.units.get(name, '')}".rstrip()


def _digits(value: float) -> str:
    """Three digits, without an exponent below a million."""
    return f"{float(f'{value:.3g}'):g}"


@dataclass(frozen=True, kw_only=True)
class RankedSet:
    """A set of effects that was fitted, by what chose among the sets."""

    effects: tuple[FittedEffect, ...]
    """The effects; none for the nominal model."""
    behind: float
    """Minus twice its log posterior probability above the best set's."""
    probability: float
    """Probability among the sets that were visited."""
    source: Literal["force balance", "simulation"] = "force balance"
    """What fitted it."""


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Residual on held-out data, before and after the correction."""

    before: float
    """Residual of the nominal model, fitted within its tolerances."""
    after: float
    """Residual of the corrected model."""
    by_channel: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Joint (its force balance) or reading -> before and after."""
    by_quantity: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Quantity and unit, such as "joint position [rad]" -> error in that unit of simulations of
    one second from the measured state, by the nominal model and by ``model.xml``."""
    noise_floor: float = 1.0
    """Residual level of sensor noise alone."""
    unit: str = UNIT
    """Unit of all of these but `by_quantity`."""


@dataclass(frozen=True, kw_only=True)
class ChannelVerdict:
    """What is said of one joint or reading."""

    channel: str
    """Joint, or reading with its axis."""
    verdict: ChannelWord
    """ "named"; "not needed": at the noise without a further effect; "cannot tell": one of several
    effects; "unexplained": much is left by all that was tried."""
    effects: tuple[EffectLocation, ...] = ()
    """Effects named there, or that cannot be told apart."""
    before: float
    """Residual of the nominal model on held-out data [noise standard deviations]."""
    after: float
    """Residual of the corrected model there."""
    advice: str = ""
    """Motion or measurement that would tell, or where most of the residual is."""


@dataclass(frozen=True, kw_only=True)
class TolerancePull:
    """A tolerance that the data pull by more than two standard deviations."""

    name: str
    """What the model states, such as "mass of link2"."""
    deviations: float
    """Pull in standard deviations of the tolerance."""
    value: float = nan
    """The same in its unit, above nominal; NaN of what has no size that one could look up."""
    tolerance: float = nan
    """The standard deviation in that unit."""
    unit: str = ""
    """The unit, "%" of a share of the nominal value."""

    @property
    def words(self) -> str:
        """What the data say of it."""
        if not isfinite(self.value):
            return f"{self.name}: {self.deviations:+.1f} times its tolerance"
        off, width = f"{self.value:+.2g} {self.unit}", f"{self.tolerance:.2g} {self.unit}"
        return f"{self.name}: {off.rstrip()} (tolerance {width.rstrip()})"


@dataclass(frozen=True, kw_only=True)
class ResidualTest:
    """Whiteness of one channel's residual on held-out data."""

    channel: str
    """Joint, or reading with its axis."""
    rms: float
    """Root mean square over the noise; 1: noise alone."""
    autocorrelation: float
    """Autocorrelation at the first lag, half a period of the band's end; 0 for white noise."""
    whiteness_95: float
    """95 % bound of the largest autocorrelation of white noise."""
    largest_autocorrelation: float
    """Largest autocorrelation over all lags tested."""
    correlation_time: float
    """Correlation time of the residual [s]; that of one lag for white noise."""

    @property
    def white(self) -> bool:
        """Return whether the autocorrelation is that of white noise."""
        return self.largest_autocorrelation <= self.whiteness_95


@dataclass(frozen=True, kw_only=True)
class JointExcitation:
    """How much a recording moves one joint."""

    joint: str
    """Name of the joint."""
    unit: str
    """Unit of its position: "rad" or "m"."""
    travel: float
    """Range of its positions."""
    speed: float
    """95th percentile of its speed [unit/s]."""
    acceleration: float
    """95th percentile of its acceleration [unit/s²]."""
    used: float
    """Share of the time that is compared: not at rest, not knocked; 0 for a joint that stands."""


@dataclass(frozen=True, kw_only=True)
class VisibleEffect(EffectLocation):
    """The smallest size of an effect that a recording shows."""

    smallest: Mapping[str, float]
    """Smallest visible change of each parameter, beyond the tolerances."""
    units: Mapping[str, str]
    """Unit of each parameter."""
    visible: bool
    """Whether that is below the size that is usual."""
    below: bool = False
    """Whether the effect shows below that value, not above: a spring, a limit."""
    confusable_with: EffectLocation | None = None
    """Effect beside which it would not be visible at its usual size."""


@dataclass(frozen=True, kw_only=True)
class Identifiability:
    """What a recording could show, before anything is selected."""

    joints: tuple[JointExcitation, ...] = ()
    """Excitation of each joint."""
    effects: tuple[VisibleEffect, ...] = ()
    """Every effect at every location that the motion reaches."""


@dataclass(frozen=True, kw_only=True)
class GapResult(JsonFile):
    """The content of ``result.json``."""

    noun = "result"

    verdict: Verdict
    """ "named", "no_gap" or "unexplained"."""
    gap: Gap
    """Residual before and after."""
    effects: tuple[NamedEffect, ...] = ()
    """Effects that the model lacks."""
    doubtful: tuple[NamedEffect, ...] = ()
    """Effects that reduce the error and did not pass all tests; ``model`` lacks them."""
    channels: tuple[ChannelVerdict, ...] = ()
    """Verdict of every joint and reading."""
    pulled: tuple[TolerancePull, ...] = ()
    """Tolerances of the model that the data pull by more than two standard deviations."""
    held_out_runs: tuple[str, ...] = ()
    """Files of the runs that were kept out; empty where every run was held out once, in turn."""
    ranking: tuple[RankedSet, ...] = ()
    """Best sets of effects that were fitted, the best first."""
    model: str | None = "model.xml"
    """The corrected model, beside the file."""
    code: str = ""
    """Python lines that apply effects which MJCF cannot express; "" if none."""
    residual_tests: tuple[ResidualTest, ...] = ()
    """Residual tests on held-out data."""
    identifiability: Identifiability = field(default_factory=Identifiability)
    """What the recorded motions could show."""
    commands: Mapping[str, CommandTiming] = field(default_factory=dict)
    """Commands that act otherwise than held from sample to sample, by actuator."""
    warnings: tuple[str, ...] = ()
    """Cautions for the reader."""
    preflight: tuple[Finding, ...] = ()
    """Findings of `loose_env.doctor` in the recording, errors first; empty in files of versions
    that did not say."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Provenance: all inputs of the result besides the recording."""
    format: str = FORMAT
    """Format of the file."""

    @property
    def graded_warnings(self) -> tuple[tuple[str, str], ...]:
        """Warnings and findings of the preflight with their severity, the most severe first."""
        pairs = (*(("warning", words) for words in self.warnings), *graded_findings(self.preflight))
        return tuple(sorted(pairs, key=lambda pair: ("critical", "warning", "note").index(pair[0])))


def read_result(path: str | Path) -> GapResult:
    """Read a result file, or that of a folder.

    Raises
    ------
    InvalidData
        If there is none, or it is none of the format.

    Examples
    --------
    >>> GapResult.from_json('{"format": "loose-gap/2"}')
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: a result of the format 'loose-gap/1' is needed, ...
    >>> read_result("no/such/folder")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: ...
    """
    return read_result_file(path, GapResult.from_json, noun="result")


# Effects in words, and motions and sensors that make one visible, or tell two apart


@cache
def _words() -> dict[str, Any]:
    """Tables of the words, as the file says."""
    return tomllib.loads(files("loose_env.gap.output").joinpath("advice.toml").read_text("utf-8"))


def _found(table: str, *keys: str) -> str:
    """Words of the first key that a table has; "" if it has none."""
    words = _words()[table]
    first = next((words[key] for key in keys if key in words), "")
    return str(words.get(first, first))


def how_to_separate(kind: str, where: str, other: str, elsewhere: str) -> str:
    """Name a motion or a measurement that tells two effects apart.

    Examples
    --------
    >>> how_to_separate("payload", "tool", "link_mass", "link3").split(":")[0]
    'Move the last joint by itself, with its axis level'
    >>> how_to_separate("viscous_friction", "joint1", "viscous_friction", "joint2")
    'Move joint1 while joint2 is held, and the other way round.'
    >>> how_to_separate("command_delay", "motor1", "command_delay", "all")
    'Command the drives one at a time.'
    """
    if known := _found("separate", f"{kind} {other}", f"{other} {kind}"):
        return known
    if kind == other and "all" in (where, elsewhere):
        return "Command the drives one at a time."
    if where != elsewhere and kind == other:
        return f"Move {where} while {elsewhere} is held, and the other way round."
    return _found("otherwise", kind.split("_")[0], other.split("_")[0], "any")


def how_to_see(kind: str) -> str:
    """Name a motion that shows an effect.

    Examples
    --------
    >>> how_to_see("coulomb_friction")
    'reverse the joint slowly, many times'
    >>> how_to_see("own_effect")
    'move the joint alone, slowly and fast, both ways, over its whole range'
    """
    general = _found("otherwise", "any").rstrip(".")
    return _found("see", kind) or general[0].lower() + general[1:]


def kind_words(kind: str) -> str:
    """A kind of effect, as one says it."""
    return _found("name", kind) or kind.replace("_", " ")


def effect_words(kind: str, where: str) -> str:
    """An effect and its location, as one says it.

    Examples
    --------
    >>> effect_words("coulomb_friction", "joint2")
    'dry friction (joint2)'
    """
    place = _words()["location"].get(f"{kind} {where}", f"({where})")
    return f"{kind_words(kind)} {place}".rstrip()
