"""What a mapping says: sources, their clocks, and the columns and runs made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from loose_env.importing.samples import ChannelKey
from loose_env.recording import Condition

__all__ = [
    "Align",
    "ColumnEntry",
    "CsvLayout",
    "FileKind",
    "ImportMapping",
    "Method",
    "RunPlan",
    "SourceEntry",
    "TimeSource",
]

FileKind = Literal["csv", "mcap", "uff"]
"""Kinds of files that are read."""
Method = Literal["band", "hold"]
"""How a column is brought to the run's times: band-limited, or the last value held."""


@dataclass(frozen=True, kw_only=True)
class TimeSource:
    """Where the time of samples comes from."""

    column: str = ""
    """CSV: column of the time."""
    unit: str = "s"
    """Unit of a time given as a number."""
    date_format: str = ""
    """CSV: "iso", or a format of Python's ``strptime``, where the column holds dates."""
    stamp: str = "log"
    """MCAP: "log", "publish", "header", or the field of the message that holds the time."""
    rate_hz: float | None = None
    """Samples are this far apart, whatever stamps there are [Hz]."""
    even: bool = False
    """Stamps jitter about evenly spaced samples: a straight line through them is taken."""
    from_start: bool = False
    """Time counts from the source's first sample that is taken, not from its dates."""
    offset_s: float = 0.0
    """Added to the source's times [s]."""
    drift_ppm: float = 0.0
    """How much the source's clock runs slow against the others [µs a second]."""


@dataclass(frozen=True, kw_only=True)
class CsvLayout:
    """How a table is written."""

    separator: str = ","
    decimal: str = "."
    encoding: str = "utf-8"
    skip: int = 0
    """Lines before the line of names."""
    header: bool = True
    """Whether there is a line of names; without one columns are called "1", "2" and so on."""
    skip_after_header: int = 0
    """Lines between the names and the numbers, such as a line of units."""
    missing: tuple[str, ...] = ()
    """Words that stand for a missing sample, beside an empty cell and NaN."""


@dataclass(frozen=True, kw_only=True)
class Align:
    """Two channels that show the same motion, by which one source's clock is set by another's."""

    to: str
    """Source whose clock is kept."""
    own: ChannelKey
    other: ChannelKey
    most_s: float = 1.0
    """Largest shift looked for [s]."""
    band_hz: tuple[float, float] | None = None
    """Frequencies compared; all that both have by default [Hz]."""
    sign: int = 1
    """-1 where one channel is the other upside down."""
    least_correlation: float = 0.6
    """Below this the two are not taken for the same motion."""


@dataclass(frozen=True, kw_only=True)
class SourceEntry:
    """One source: a file, or files of one kind that take turns."""

    name: str
    file: str = ""
    """Name of the file; a run may name another."""
    kind: FileKind | None = None
    """By its name and first bytes where it is not said."""
    csv: CsvLayout = field(default_factory=CsvLayout)
    time: TimeSource = field(default_factory=TimeSource)
    topics: Mapping[str, TimeSource] = field(default_factory=dict)
    """MCAP: topics whose time comes from elsewhere."""
    align: Align | None = None

    def time_of(self, topic: str) -> TimeSource:
        """Where the time of a topic comes from."""
        return self.topics.get(topic, self.time)


@dataclass(frozen=True, kw_only=True)
class ColumnEntry:
    """One column of the recording, and the channel that fills it."""

    place: str
    """Where the mapping says so."""
    column: str
    source: str
    key: ChannelKey
    unit: str = ""
    """Unit of the channel's values times ``scale``; SI, or what the file says, by default."""
    scale: float = 1.0
    """How many of the unit one of the channel's values is."""
    sign: int = 1
    offset: float = 0.0
    """Added at the end, in SI units."""
    method: Method | None = None
    """"hold" for ``ctrl.`` columns and "band" for the others by default."""
    delay_s: float = 0.0
    """How long after it happened the channel shows it [s]."""
    gap_s: float | None = None
    """Longest pause between samples that is bridged [s]."""

    @property
    def way(self) -> Method:
        """How it is brought to the run's times."""
        return self.method or ("hold" if self.column.startswith("ctrl.") else "band")


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """One run of the recording."""

    place: str
    file: str
    columns: tuple[ColumnEntry, ...]
    sources: Mapping[str, str] = field(default_factory=dict)
    """Source -> file, for this run alone."""
    pose: Mapping[str, float] | Literal["measured"] | None = None
    """Positions [rad or m], or "measured": the median of the joints' own sensors."""
    excited: tuple[str, ...] = ()
    condition: Condition = "suspect"
    start: float | int | None = None
    """Seconds after the first time that all columns have; an int is a date [ns since 1970]."""
    stop: float | int | None = None
    rate_hz: float | None = None
    """Rate of the rows [Hz]; the samples of the fastest channel by default."""


@dataclass(frozen=True, kw_only=True)
class ImportMapping:
    """All that a mapping file says."""

    name: str
    """Name of the file, as errors give it."""
    model: str
    """MJCF file, from the mapping's folder; may be empty."""
    sources: Mapping[str, SourceEntry]
    runs: tuple[RunPlan, ...]
