"""Mapping files: sources, their clocks, and the columns and runs made of them.

The fields of the dataclasses are the keys of the file, their types its rules; pydantic checks
them. Nothing in a mapping is executed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Le, MaxLen, MinLen, Predicate
from pydantic import AfterValidator, ConfigDict

from loose_env.errors import InvalidData
from loose_env.importing.samples import ChannelKey
from loose_env.importing.units import unit_named
from loose_env.io import restored
from loose_env.recording import Condition, nearest, read_text

MAPPING_FORMAT = "loose-mapping/1"
"""The format read here."""

Sign = Literal[1, -1]
Method = Literal["band", "hold"]
"""Resampling to the run's times: along a spline ("band"), or zero-order hold."""

_MOST_BYTES = 2**22
_FORBID = ConfigDict(extra="forbid")


def _time_unit(name: str) -> str:
    if name and unit_named(name, "unit").quantity != "time":
        raise ValueError(f"{name!r} is no unit of time; s, ms, us, ns are")
    return name


_Text = Annotated[str, MinLen(1)]
_Number = Annotated[float, Ge(-1e18), Le(1e18)]
_Rate = Annotated[float, Ge(1e-6), Le(1e9)]
_Seconds = Annotated[float, Ge(1e-9), Le(1e9)]
_Moment = Annotated[float, Ge(0.0), Le(3.2e7)]


@dataclass(frozen=True, kw_only=True)
class TimeSource:
    """Source of the sampling times."""

    __pydantic_config__ = _FORBID

    column: str = ""
    """Column of the time; that of the format by default, where it has one."""
    unit: Annotated[str, AfterValidator(_time_unit)] = ""
    """Unit of the column; the one that the file states, or s, by default."""
    fine: str = ""
    """Column of the nanoseconds within each second of ``column``, where there are two."""
    rate_hz: _Rate | None = None
    """Sampling rate, in the place of any stamps [Hz]."""
    from_start: bool = False
    """Time counts from the source's first sample that is taken, not from its dates."""
    offset_s: Annotated[float, Ge(-1e10), Le(1e10)] = 0.0
    """Added to the source's times [s]."""


@dataclass(frozen=True, kw_only=True)
class SourceEntry:
    """One source: a file, or one file of a kind in each run."""

    __pydantic_config__ = _FORBID

    file: str = ""
    """Name of the file; a run may name another."""
    time: TimeSource = field(default_factory=TimeSource)
    topics: Mapping[_Text, TimeSource] = field(default_factory=dict)
    """Topics whose time comes from elsewhere."""

    def time_of(self, topic: str) -> TimeSource:
        """Time source of a topic."""
        return self.topics.get(topic, self.time)


@dataclass(frozen=True, kw_only=True)
class ColumnKeys:
    """Channel that fills a column, and what is done to it."""

    __pydantic_config__ = _FORBID

    source: str = ""
    """Source of the channel; the only one where there is one."""
    channel: _Text
    topic: str = ""
    unit: str | None = None
    """Unit of the channel's values times ``scale``; SI, or what the file says, by default."""
    scale: Annotated[_Number, Predicate(bool)] = 1.0
    """Factor from the channel's values to the unit; not 0."""
    sign: Sign = 1
    offset: _Number = 0.0
    """Added last [SI unit]."""
    method: Method | None = None
    """"hold" for ``ctrl.`` columns and "band" for the others by default. Of commands it also says
    whether they act held or along lines, which the motion decides by default."""
    delay_s: Annotated[float, Ge(-1e4), Le(1e4)] = 0.0
    """Latency of the channel [s]."""
    period: Annotated[float, Ge(1e-9), Le(1e18)] | None = None
    """Period at which the values wrap around, such as 360 or 65536 [channel's own unit]; whole
    periods are added until neighbours are less than half of one apart, from the one about 0."""
    sign_bit: Annotated[int, Ge(1), Le(62)] | None = None
    """Bit that holds the sign of a word whose other bits are its magnitude."""
    gap_s: _Seconds | None = None
    """Longest pause between samples that is bridged [s]."""


@dataclass(frozen=True, kw_only=True)
class ColumnEntry(ColumnKeys):
    """One column of the recording, and the channel that fills it."""

    place: str
    """Location in the mapping, for errors."""
    column: str

    @property
    def key(self) -> ChannelKey:
        """Identifier of the channel."""
        return ChannelKey(self.channel, self.topic)

    @property
    def factor(self) -> float:
        """Factor from the channel's values to SI units, as far as the mapping states it."""
        unit = unit_named(self.unit, self.place).factor if self.unit else 1.0
        return self.sign * self.scale * unit

    @property
    def is_command(self) -> bool:
        """True for the input of an actuator."""
        return self.column.startswith("ctrl.")

    @property
    def way(self) -> Method:
        """Resampling method, with its default."""
        return self.method or ("hold" if self.is_command else "band")


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """One run of the recording: name, pose, condition and piece of the log."""

    __pydantic_config__ = _FORBID

    file: _Text = ""
    sources: Mapping[_Text, _Text] = field(default_factory=dict)
    """Source -> file, for this run alone."""
    pose: Mapping[str, _Number] | None = None
    """Positions that the joints held [rad or m]."""
    excited: tuple[_Text, ...] = ()
    condition: Condition = "suspect"
    start: _Moment | None = None
    """After the first time that all columns have [s]."""
    stop: _Moment | None = None
    """The same [s]."""
    episodes: tuple[int, ...] | Literal["all"] = "all"
    """Numbers of the episodes of a dataset, each of which becomes a run; no meaning for sources
    without episodes."""

    def __post_init__(self) -> None:
        """Refuse a piece that ends before it begins."""
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise ValueError("start is not before stop")

    @property
    def place(self) -> str:
        """Run, as errors say it."""
        return f"run {self.file!r}"


@dataclass(frozen=True, kw_only=True)
class _MappingFile:
    """Contents of a mapping file as it stands."""

    __pydantic_config__ = _FORBID

    format: Literal["loose-mapping/1"]
    model: str = ""
    """Path of the MJCF file from the mapping's folder; may be empty."""
    sources: Annotated[Mapping[_Text, SourceEntry], MinLen(1)]
    columns: Annotated[Mapping[_Text, ColumnKeys], MinLen(1)]
    runs: Annotated[tuple[RunPlan, ...], MinLen(1), MaxLen(10_000)]
    unused: tuple[str, ...] = ()
    """Files that may be given, and are not read."""


@dataclass(frozen=True, kw_only=True)
class ImportMapping(_MappingFile):
    """Contents of a mapping file, its columns and runs complete."""

    name: str
    """Name of the file, as errors give it."""
    columns: Mapping[str, ColumnEntry]
    """Columns of all runs."""


def read_mapping(file: str | Path) -> ImportMapping:
    """Read a mapping file.

    Parameters
    ----------
    file : str or Path
        A TOML file.

    Returns
    -------
    ImportMapping
        What it says, checked as far as it can be without the sources and the model.

    Raises
    ------
    InvalidData
        If it is no such file; the message says where and what is allowed.

    Examples
    --------
    >>> read_mapping("mapping.yaml")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: mapping.yaml: a mapping is a TOML file and ends in .toml
    """
    path = Path(file)
    name = path.name
    if path.suffix.lower() != ".toml":
        raise InvalidData(f"{name}: a mapping is a TOML file and ends in .toml")
    if not path.is_file():
        raise InvalidData(f"there is no mapping file {str(file)!r}")
    try:
        whole = tomllib.loads(read_text(path, name, _MOST_BYTES))
    except RecursionError:
        raise InvalidData(f"{name}: nested too deeply") from None
    except ValueError as error:
        raise InvalidData(f"{name}: not TOML: {str(error)[:200]}") from None
    found = restored(_MappingFile, whole, f"{name}:")
    sources = [*found.sources]
    columns = {}
    for column, keys in found.columns.items():
        place = f"{name}: columns.{column!r}"
        source = keys.source or (sources[0] if len(sources) == 1 else "")
        if not source:
            raise InvalidData(f"{place}: 'source' is missing")
        _known(f"{place}.source", source, sources)
        own = {**vars(keys), "source": source}
        columns[column] = ColumnEntry(**own, place=place, column=column)
    runs = []
    for i, run in enumerate(found.runs):
        for source in run.sources:
            _known(f"{name}: runs[{i}].sources", source, sources)
        runs.append(replace(run, file=run.file or f"run-{i + 1:02d}"))
    whole = {**vars(found), "columns": columns, "runs": (*runs,)}
    return ImportMapping(**whole, name=name)


def _known(place: str, source: str, sources: Sequence[str]) -> None:
    if source not in sources:
        raise InvalidData(
            f"{place}: there is no source {source[:60]!r}; there are {', '.join(sources)}"
            f"{nearest(source[:60], sources)}"
        )
