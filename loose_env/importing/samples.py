"""Data that readers return: samples of a channel, and a file's list of streams and channels.

What a file holds, as ``loose import --describe`` shows it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.typing import Array


@dataclass(frozen=True, order=True)
class ChannelKey:
    """Identifier of a channel in a file."""

    channel: str
    """Column of a table, field of a message, entry of a vector of a dataset, or measured point of
    a universal file."""
    topic: str = ""
    """Topic of an MCAP file or ROS bag, or part of a trajectory; empty elsewhere."""

    def __str__(self) -> str:
        return f"{self.topic} {self.channel}".strip()


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """One channel of one file; missing samples are left out."""

    place: str
    """File and channel, as errors say it."""
    origin_ns: int
    """Origin of its time [ns since 1970], or 0 where the file has no date."""
    time: Array
    """Times [s] after the origin, shape (T,), increasing strictly."""
    values: Array
    """Values as the file holds them, shape (T,)."""
    unit: str = ""
    """Unit that the file itself gives, where it does."""

    @property
    def step(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    def since(self, origin_ns: int) -> Array:
        """Times [s] after another origin, shape (T,)."""
        return self.time + (self.origin_ns - origin_ns) * 1e-9


def unreadable(name: str, error: OSError) -> InvalidData:
    """Error for a file that the system does not read."""
    return InvalidData(f"{name}: it cannot be read: {error.strerror or error}")


def file_within(folder: Path, given: str, place: str) -> Path:
    """Find a file that a dataset names, in the folder that the user gave.

    Links are followed, since downloaded datasets consist of them; the name itself may not lead
    out of the folder.

    Examples
    --------
    >>> file_within(Path("bag"), "../other.mcap", "bag/metadata.yaml")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: bag/metadata.yaml: '../other.mcap' is no path within the folder
    """
    path = PurePosixPath(given)
    if not given.isprintable() or "\\" in given or path.is_absolute() or ".." in path.parts:
        raise InvalidData(f"{place}: {given!r:.200} is no path within the folder")
    found = folder / path
    if not found.is_file():
        raise InvalidData(f"{place}: there is no file {given!r:.200} in {folder.name}")
    return found


def checked(
    place: str,
    time: Array,
    values: Array,
    *,
    origin_ns: int = 0,
    unit: str = "",
    rows: Sequence[int] | NDArray[np.int64] | None = None,
    row_word: str = "row",
) -> Samples:
    """Samples of a channel, refused where time runs backwards or a value is infinite."""

    def row(i: int) -> str:
        return f"{place}: {row_word} {i + 1 if rows is None else rows[i]}"

    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise InvalidData(f"{row(int(bad[0]))}: the time is missing or not finite")
    still = np.flatnonzero(np.diff(time) <= 0)
    if still.size:
        i = int(still[0]) + 1
        same = time[i] == time[i - 1]
        raise InvalidData(
            f"{row(i)}: time {'stands still' if same else 'runs backwards'}: {time[i]:.9g} s "
            f"follows {time[i - 1]:.9g} s; choose another time for this source (a finer stamp, "
            "or rate_hz where the samples are evenly spaced)"
        )
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        raise InvalidData(f"{row(int(infinite[0]))}: the value is infinite")
    there = ~np.isnan(values)
    if np.count_nonzero(there) < 2:
        raise InvalidData(f"{place}: it has {np.count_nonzero(there)} samples; at least 2 needed")
    return Samples(
        place=place, origin_ns=origin_ns, time=time[there], values=values[there], unit=unit
    )


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One channel."""

    key: ChannelKey
    """Its identifier in a mapping."""
    first: tuple[float, ...] = ()
    """First values, as the file holds them."""
    unit: str = ""
    """Unit that the file itself gives."""
    words: str = ""
    """Further description in the file."""


@dataclass(frozen=True, kw_only=True)
class Stream:
    """Channels that share their times."""

    topic: str = ""
    """Topic of an MCAP file."""
    kind: str = ""
    """Type and encoding."""
    samples: int = 0
    start_ns: int | None = None
    """First sample [ns since 1970], where the file knows the date."""
    seconds: float | None = None
    """From the first to the last sample [s], where that is known."""
    channels: tuple[Channel, ...] = ()
    note: str = ""

    @property
    def rate_hz(self) -> float | None:
        """Mean rate [Hz]."""
        return (self.samples - 1) / self.seconds if self.seconds and self.samples > 1 else None


@dataclass(frozen=True, kw_only=True)
class FileList:
    """One file."""

    name: str
    kind: str
    """Kind, as `FileKind`."""
    words: str
    """The kind in words."""
    streams: tuple[Stream, ...]
    options: tuple[str, ...] = field(default=())
    """Lines of a mapping that say how to read it."""
    episodes: tuple[str, ...] = ()
    """Names of its episodes, each of which becomes a run; empty where it has none."""
