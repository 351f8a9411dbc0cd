"""Data that readers return: tables of named columns, one of them the time; samples of a channel.

Every reader gives a `Log` of `Table`s as the file holds them; which column is the time, and
whether it can be one, is decided in `clocks`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.recording import nearest
from loose_env.typing import Array


@dataclass(frozen=True, order=True)
class ChannelKey:
    """Identifier of a channel in a file."""

    channel: str
    """Column of a table, field of a message, or entry of a vector of a dataset."""
    topic: str = ""
    """Topic of a ROS bag or MCAP file; empty elsewhere."""

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

    def since(self, origin_ns: int) -> Array:
        """Times [s] after another origin, shape (T,)."""
        return self.time + (self.origin_ns - origin_ns) * 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns that share their rows, as a file holds them."""

    place: str
    """File and topic, as errors say it."""
    columns: Mapping[str, NDArray[Any]]
    """Numbers by channel, each of shape (T,); NaN where a sample is missing. Dates are int64, in
    nanoseconds since 1970."""
    topic: str = ""
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Columns that are no numbers."""
    time: str = ""
    """Column that is the time by the format, where it has one."""
    rate_hz: float | None = None
    """Rate that the file states, where rows have no times [Hz]."""
    units: Mapping[str, str] = field(default_factory=dict)
    rows: NDArray[np.int64] | None = None
    """Numbers of the rows, as errors count them; from 1 by default."""
    row_word: str = "row"
    column_word: str = "channel"
    done: tuple[str, ...] = ()
    """What the reader mended, with counts."""

    def __len__(self) -> int:
        return len(next(iter([*self.columns.values(), *self.texts.values()]), ()))

    def row(self, i: int) -> str:
        """Place of a row, as errors say it."""
        return f"{self.place}: {self.row_word} {i + 1 if self.rows is None else self.rows[i]}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """One file or folder, and its tables."""

    name: str
    tables: Callable[[str, Sequence[ChannelKey] | None], list[Table]]
    """Tables of an episode, "" where there are none, with all channels or those asked for."""
    episodes: tuple[str, ...] = ()
    """Names of its episodes, each of which becomes a run; empty where it has none."""
    angle: str = ""
    """Unit of angles that its format defines."""
    ambiguous: str = ""
    """Units that its columns may have, where every column of a mapping has to state one."""

    def first(self) -> list[Table]:
        """Tables of the file, or of its first episode."""
        return self.tables(self.episodes[0] if self.episodes else "", None)


def topic_table(tables: Iterable[Table], key: ChannelKey, name: str) -> Table:
    """Table of the topic of a channel that a mapping asks for."""
    topics = {table.topic: table for table in tables}
    if key.topic in topics:
        return topics[key.topic]
    if "" in topics:
        raise InvalidData(f"{name}: it has no topics; leave out topic = {key.topic!r:.60}")
    what = f"it has no {key.topic[:60]!r}" if key.topic else "its channels lie in topics"
    raise InvalidData(
        f"{name}: channel {key.channel[:60]!r}: {what}; say which by topic, one of "
        f"{', '.join(map(repr, topics))[:600]}{nearest(key.topic, [*topics])}"
    )


def entry_names(found: Any, width: int, *, unique: bool = True) -> tuple[str, ...]:
    """Texts that a list gives to each of so many entries of an array; else none."""
    texts = found if isinstance(found, (list, np.ndarray)) and len(found) == width else ()
    if not all(isinstance(text, str) for text in texts):
        return ()
    plain = [text.strip() for text in texts]
    good = all(text.isprintable() and text and not set(text) & {*"[]"} for text in plain)
    return tuple(plain) if good and (len(set(plain)) == width or not unique) else ()


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts names with numbers by the numbers.

    Examples
    --------
    >>> sorted(["run10", "run9"], key=natural)
    ['run9', 'run10']
    """
    return [(int(p), "") if p.isdigit() else (0, p) for p in re.split(r"(\d+)", name)]


def damaged(place: str, kind: str, error: Exception, more: str = "") -> InvalidData:
    """Error for a file on which its library gives up."""
    words = " ".join(str(error).split())[:120] or type(error).__name__
    return InvalidData(f"{place}: no whole {kind}, cut short or damaged ({words}){more}")


def quoted(words: str) -> str:
    """Quote text for TOML, whose strings are JSON's but for one control character."""
    return json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")


def printable(words: str) -> str:
    """Words for a comment of a mapping."""
    return "".join(c if c.isprintable() else " " for c in words)
