"""Contents of a mapping: sources, their clocks, and the columns and runs made of them.

The scalar fields are keys of the mapping file; their types and metadata are its schema.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from loose_env.importing.checked_fields import among, within
from loose_env.importing.samples import ChannelKey, FileKind
from loose_env.importing.units import unit_named
from loose_env.recording import Condition

Sign = Literal[1, -1]
Method = Literal["band", "hold"]
"""Resampling to the run's times: band-limited, or zero-order hold."""


@dataclass(frozen=True, kw_only=True)
class TimeSource:
    """Source of the sampling times."""

    column: str = ""
    """CSV, HDF5, LeRobot: column of the time; "timestamp" by default in a LeRobot dataset."""
    unit: str = "s"
    """Unit of a time given as a number."""
    fine: str = ""
    """Column of the nanoseconds within each second of ``column``, where there are two."""
    date_format: str = ""
    """CSV: "iso", or a format of Python's ``strptime``, where the column holds dates; recognised
    from the column by default."""
    stamp: str = "auto"
    """MCAP: "auto", the stamp of the header where messages have one that is set, else the log time;
    or "log", "publish", "header", or the field of the message that holds the time."""
    rate_hz: float | None = field(default=None, metadata=within(1e-6, 1e9))
    """Sampling rate, in the place of any stamps [Hz]."""
    even: bool = False
    """Stamps jitter about evenly spaced samples: a straight line through them is taken."""
    from_start: bool = False
    """Time counts from the source's first sample that is taken, not from its dates."""
    offset_s: float = field(default=0.0, metadata=within(-1e10, 1e10))
    """Added to the source's times [s]."""
    drift_ppm: float = field(default=0.0, metadata=within(-1e5, 1e5))
    """Rate error of the source's clock, positive where it runs slow [µs/s]."""


@dataclass(frozen=True, kw_only=True)
class CsvLayout:
    """Layout of a text table."""

    separator: str = field(default=",", metadata=among(",", ";", "\t", " ", "|"))
    decimal: str = field(default=".", metadata=among(".", ","))
    encoding: str = field(default="utf-8", metadata=among("utf-8", "utf-16", "latin-1", "cp1252"))
    skip: int = field(default=0, metadata=within(0, 10_000))
    """Lines before the line of names."""
    header: bool = True
    """True if there is a line of names; else columns are called "1", "2" and so on."""
    names: tuple[str, ...] = ()
    """Names of the columns where ``header`` is false; a vector of UR's RTDE counts as its
    entries, so that the list is the recipe of the recorder."""
    skip_after_header: int = field(default=0, metadata=within(0, 100))
    """Lines between the names and the numbers, such as a line of units."""
    missing: tuple[str, ...] = ()
    """Words that stand for a missing sample, beside an empty cell and NaN."""


@dataclass(frozen=True, kw_only=True)
class Align:
    """Two channels of the same motion, from which one clock is aligned to the other."""

    to: str
    """Source whose clock is kept."""
    own: ChannelKey
    other: ChannelKey
    most_s: float = field(default=1.0, metadata=within(1e-6, 1e5))
    """Largest shift searched [s]."""
    band_hz: tuple[float, float] | None = None
    """Frequencies compared; all that both have by default [Hz]."""
    sign: Sign = 1
    """-1 where one channel is the negative of the other."""
    least_correlation: float = field(default=0.6, metadata=within(0.0, 1.0))
    """Least correlation at which the two count as the same motion [1]."""


@dataclass(frozen=True, kw_only=True)
class SourceEntry:
    """One source: a file, or one file of a kind in each run."""

    name: str
    file: str = ""
    """Name of the file; a run may name another."""
    kind: FileKind | None = None
    """Detected from name and first bytes by default."""
    csv: CsvLayout = field(default_factory=CsvLayout)
    time: TimeSource = field(default_factory=TimeSource)
    topics: Mapping[str, TimeSource] = field(default_factory=dict)
    """MCAP: topics whose time comes from elsewhere."""
    align: Align | None = None

    def time_of(self, topic: str) -> TimeSource:
        """Time source of a topic."""
        return self.topics.get(topic, self.time)


@dataclass(frozen=True, kw_only=True)
class ColumnEntry:
    """One column of the recording, and the channel that fills it."""

    place: str
    """Location in the mapping, for errors."""
    column: str
    source: str
    key: ChannelKey
    unit: str = ""
    """Unit of the channel's values times ``scale``; SI, or what the file says, by default."""
    scale: float = 1.0
    """Factor from the channel's values to the unit; not 0."""
    sign: Sign = 1
    offset: float = 0.0
    """Added last [SI unit]."""
    method: Method | None = None
    """"hold" for ``ctrl.`` columns and "band" for the others by default."""
    delay_s: float = field(default=0.0, metadata=within(-1e4, 1e4))
    """Latency of the channel [s]."""
    period: float | None = field(default=None, metadata=within(1e-9, 1e18))
    """Period at which the values wrap around, such as 360 or 65536 [channel's own unit]; whole
    periods are added until neighbours are less than half of one apart, from the one about 0."""
    sign_bit: int | None = field(default=None, metadata=within(1, 62))
    """Bit that holds the sign of a word whose other bits are its magnitude."""
    gap_s: float | None = field(default=None, metadata=within(1e-9, 1e9))
    """Longest pause between samples that is bridged [s]."""

    @property
    def factor(self) -> float:
        """Factor from the channel's values to SI units, as far as the mapping states it."""
        unit = unit_named(self.unit, self.place).factor if self.unit else 1.0
        return self.sign * self.scale * unit

    @property
    def way(self) -> Method:
        """Resampling method, with its default."""
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
    rate_hz: float | None = field(default=None, metadata=within(1e-6, 1e9))
    """Rate of the rows [Hz]; the samples of the fastest channel by default."""
    episodes: str = "all"
    """Episodes of a dataset, each of which becomes a run: "all", or names, numbers and ranges of
    numbers such as "0, 3-5"; no meaning for sources without episodes."""
    episode: str = ""
    """Name of the episode of this run; set when runs are made of ``episodes``, no key."""


@dataclass(frozen=True, kw_only=True)
class ImportMapping:
    """Contents of a mapping file."""

    name: str
    """Name of the file, as errors give it."""
    model: str
    """MJCF file, from the mapping's folder; may be empty."""
    sources: Mapping[str, SourceEntry]
    runs: tuple[RunPlan, ...]
    unused: tuple[str, ...] = ()
    """Files that may be given, and are not read."""
