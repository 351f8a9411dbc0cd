"""Data that readers return: tables of named columns with their times, and samples of a channel.

Every reader gives a `Log` of `Table`s as the file holds them; which column is the time, and
whether it can be one, is decided in `clocks`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.recording import nearest
from loose_env.typing import Array

FileKind = Literal["csv", "mcap", "rosbag2", "lerobot", "hdf5", "sysid", "arrays"]
"""Kinds of files and folders that are read."""


@dataclass(frozen=True, order=True)
class ChannelKey:
    """Identifier of a channel in a file."""

    channel: str
    """Column of a table, field of a message, or entry of a vector of a dataset."""
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
    done: tuple[str, ...] = ()
    """What was done to the times, with counts."""

    @property
    def step(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    def since(self, origin_ns: int) -> Array:
        """Times [s] after another origin, shape (T,)."""
        return self.time + (self.origin_ns - origin_ns) * 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns that share their rows, as a file holds them."""

    place: str
    """File and topic, as errors say it."""
    columns: Mapping[str, NDArray[Any]]
    """Numbers by channel, each of shape (T,); NaN where a sample is missing."""
    topic: str = ""
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Columns that are no numbers, such as dates."""
    stamps: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    """Times that the container keeps of each row [ns since 1970]: header, log, publish."""
    times: Array | None = None
    """Times that belong to the columns by the format [s], where it has them."""
    rate_hz: float | None = None
    """Rate that the file states, where rows have no times [Hz]."""
    units: Mapping[str, str] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    """Further description of channels."""
    aliases: Mapping[str, str] = field(default_factory=dict)
    """Other names by which a mapping may call channels."""
    hidden: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Columns that are not listed, as they are others in another order."""
    doubles: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Names that several channels have, and their numbers."""
    rows: NDArray[np.int64] | None = None
    """Numbers of the rows, as errors count them; from 1 by default."""
    row_word: str = "row"
    column_word: str = "channel"
    kind: str = ""
    """Type and encoding."""
    note: str = ""
    done: tuple[str, ...] = ()
    """What the reader mended, with counts."""

    def __len__(self) -> int:
        held = [*self.columns.values(), *self.texts.values(), *self.stamps.values()]
        return len(held[0]) if held else 0

    @property
    def has_times(self) -> bool:
        """True if its times follow from the format."""
        return self.times is not None or self.rate_hz is not None

    def row(self, i: int) -> str:
        """Place of a row, as errors say it."""
        return f"{self.place}: {self.row_word} {i + 1 if self.rows is None else self.rows[i]}"

    def named(self, channel: str) -> str | None:
        """Own name of a channel; None where the table lacks it."""
        own = self.aliases.get(channel, channel)
        there = own in self.columns or own in self.texts or own in self.hidden
        return own if there else None

    def numbers(self, own: str) -> NDArray[Any]:
        """Values of a channel by its own name."""
        return self.columns[own] if own in self.columns else self.hidden[own]


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """One file or folder: how it is read, and its tables."""

    name: str
    kind: FileKind
    words: str
    """The kind in words."""
    tables: Callable[[str, Sequence[ChannelKey] | None], list[Table]]
    """Tables of an episode, "" where there are none, with all channels or those asked for."""
    options: tuple[str, ...] = ()
    """Lines of a mapping that say how to read it."""
    episodes: tuple[str, ...] = ()
    """Names of its episodes, each of which becomes a run; empty where it has none."""

    def first(self) -> list[Table]:
        """Tables of the file, or of its first episode."""
        return self.tables(self.episodes[0] if self.episodes else "", None)


def found_in(tables: Iterable[Table], key: ChannelKey, name: str) -> tuple[Table, str]:
    """Table and own name of a channel that a mapping asks for."""
    topics: dict[str, None] = {}
    known: list[str] = []
    for table in tables:
        topics[table.topic] = None
        if table.topic != key.topic:
            continue
        own = table.named(key.channel)
        if own is not None:
            return table, own
        known += [*table.columns, *table.texts]
        if key.channel in table.doubles:
            numbers = table.doubles[key.channel]
            raise InvalidData(
                f"{name}: {key.channel!r} is there {len(numbers)} times; take one by its number, "
                f"{' or '.join(numbers)}"
            )
    if key.topic not in topics:
        if "" in topics:
            raise InvalidData(f"{name}: it has no topics; leave out topic = {key.topic!r:.60}")
        what = f"it has no {key.topic[:60]!r}" if key.topic else "its channels lie in topics"
        raise InvalidData(
            f"{name}: channel {key.channel[:60]!r}: {what}; say which by topic, one of "
            f"{', '.join(map(repr, topics))[:600]}{nearest(key.topic, [*topics])}"
        )
    place = f"{name}: topic {key.topic!r}" if key.topic else name
    raise InvalidData(
        f"{place}: there is no {'channel' if key.topic else 'column'} {key.channel[:60]!r}; "
        f"there are {', '.join(map(repr, known[:30]))[:600] or 'none'}"
        f"{nearest(key.channel, known)}"
    )


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts names with numbers by the numbers.

    Examples
    --------
    >>> sorted(["run10", "run9"], key=natural)
    ['run9', 'run10']
    """
    return [(int(p), "") if p.isdigit() else (0, p) for p in re.split(r"(\d+)", name)]


def unreadable(name: str, error: OSError) -> InvalidData:
    """Error for a file that the system does not read."""
    return InvalidData(f"{name}: it cannot be read: {error.strerror or error}")
