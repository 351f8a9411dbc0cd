"""ROS bags, version 1 and 2, and MCAP files of ROS 2: numbers of the messages of each topic.

A folder is read by the files in it, whatever its metadata say; of compressed ones they say how.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData, LooseEnvError, MissingExtra
from loose_env.importing.samples import ChannelKey, Log, Table, damaged, entry_names, natural
from loose_env.recording import MOST_VALUES

STORAGES = (".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd")
"""Endings of the files of a bag."""
LOG_TIME = "log_time"
"""Column of the recorder's stamps."""
_HEADER = "header.stamp"
_IMAGE = 2**16
"""Bytes of a message from which it holds images or clouds and no signals of joints."""
_MOST_ENTRIES = 256
"""Entries of an array that are read; longer ones are images and scans."""
_DEEPEST = 12
_COMPRESSED = re.compile(r"compression_mode:\s*['\"]?(file|message)", re.IGNORECASE)
_LABELS = ("name", "names", "joint_names", "interface_names", "label", "labels")
"""Fields that may name the entries of the arrays beside them."""
Decoder = Callable[[bytes], Any]


def open_messages(path: Path, name: str) -> Log:
    """Open a bag or an MCAP file."""

    def tables(_: str, keys: Sequence[ChannelKey] | None) -> list[Table]:
        return _tables(path, name, None if keys is None else {key.topic for key in keys})

    return Log(name=name, tables=tables, angle="rad")


def storages(folder: Path) -> list[Path]:
    """Files of a bag in a folder, in the order in which they were recorded."""
    found = (p for p in folder.iterdir() if p.name.endswith(STORAGES))
    return sorted(found, key=lambda path: natural(path.name))


def _tables(path: Path, name: str, topics: set[str] | None) -> list[Table]:
    """Numbers of all topics, or of those asked for, which alone are refused when damaged."""
    found: dict[str, _Topic] = {}
    metadata = path / "metadata.yaml"
    packed = metadata.is_file() and _COMPRESSED.search(metadata.read_text("utf-8", "replace"))
    files = [path] if path.is_file() or packed else storages(path)
    for topic, decoder, stamp_ns, data in _messages(files, name):
        own = found.setdefault(topic, _Topic(f"{name}: topic {topic!r}", topic))
        if topics is None or topic in topics:
            own.take(decoder, stamp_ns, data, strict=topics is not None)
    return [topic.table() for topic in found.values()]


class _Topic:
    """Numbers gathered of one topic."""

    def __init__(self, place: str, topic: str) -> None:
        self.place, self.topic = place, topic
        self.found: dict[tuple[str, tuple[str, ...] | None], tuple[list[int], list[Any]]] = {}
        """Field, and names of the entries of an array -> messages that have it, and values."""
        self.stamps: dict[str, list[int]] = {}
        self.count, self.values = 0, 0
        self.note = ""

    def take(self, decoder: Decoder, stamp_ns: int, data: bytes, *, strict: bool) -> None:
        """Take a message; what cannot be read is refused, or noted where nobody asked for it."""
        if self.note:
            return
        self.count += 1
        try:
            if len(data) > _IMAGE and not strict:
                raise InvalidData(f"{self.place}: its messages have {len(data)} bytes")
            for words, labels, value in _numbers(decoder(data), "", ()):
                if labels is _STAMP:
                    self.stamps.setdefault(words, []).append(value)
                    continue
                rows, values = self.found.setdefault((words, labels), ([], []))
                rows.append(self.count - 1)
                values.append(value)
                self.values += 1 if labels is None else len(labels)
            self.stamps.setdefault(LOG_TIME, []).append(stamp_ns)
            if self.values > MOST_VALUES:
                raise InvalidData(f"{self.place}: more than {MOST_VALUES} samples; cut the file")
        except Exception as error:  # whatever a library raises on damaged bytes
            damage = f"{self.place}: message {self.count}: it is damaged: {type(error).__name__}"
            told = error if isinstance(error, InvalidData) else InvalidData(damage)
            if strict:
                raise told from None
            self.note = f"not read: {told}"

    def table(self) -> Table:
        """Columns of all fields, and the stamps of each message [ns]."""
        columns: dict[str, NDArray[Any]] = {}
        for (words, labels), (rows, values) in self.found.items():
            matrix = np.array(values, dtype=np.float64).reshape(len(rows), -1)
            for i, label in enumerate(labels or ("",)):
                name = words if labels is None else f"{words}[{label}]"
                column = columns.setdefault(name, np.full(self.count, np.nan))
                column[rows] = matrix[:, i]
        stamps = {
            k: np.array(v, dtype=np.int64)
            for k, v in self.stamps.items()
            if len(v) == self.count and columns
        }
        header = stamps.get(_HEADER)
        return Table(
            place=self.place,
            topic=self.topic,
            columns={**columns, **stamps},
            units=dict.fromkeys(stamps, "ns"),
            time=LOG_TIME if header is None or header[0] == 0 else _HEADER,
            row_word="message",
            done=(self.note,) if self.note else (),
        )


# ------------------------------------------------------------------------- structure

_STAMP = ("stamp",)
"""Mark of a field that holds a time."""


def _numbers(here: Any, words: str, label: tuple[str, ...]) -> Iterator[tuple[str, Any, Any]]:
    """Fields of a message: name, names of the entries of an array or None or a mark, value.

    Names of entries hold for all arrays of their length, at whatever depth below.
    """
    if isinstance(here, (bool, int, float, np.number)):
        yield words, None, float(here)
        return
    fields = _fields_of(type(here))  # type: ignore[arg-type]
    if words.count(".") == _DEEPEST or not fields:
        return
    if fields in (("sec", "nanosec"), ("secs", "nsecs")):
        yield words, _STAMP, getattr(here, fields[0]) * 10**9 + getattr(here, fields[1])
        return
    lists = (getattr(here, name, None) for name in _LABELS)
    told = (entry_names(each, len(each)) for each in lists if isinstance(each, list))
    label = next(filter(None, told), label)
    for name in fields:
        value = getattr(here, name)
        if name.endswith("covariance"):
            continue  # nine numbers that no column takes
        own = f"{words}.{name}" if words else name
        if not isinstance(value, (list, np.ndarray)):
            yield from _numbers(value, own, label)
        elif 0 < len(value) <= _MOST_ENTRIES:
            entries = label if len(label) == len(value) else tuple(map(str, range(len(value))))
            if isinstance(value, np.ndarray):
                yield own, entries, value.tolist()
            else:
                for entry, each in zip(entries, value, strict=True):
                    yield from _numbers(each, f"{own}[{entry}]", label)


@cache
def _fields_of(kind: type) -> tuple[str, ...]:
    return tuple(n for n in getattr(kind, "__dataclass_fields__", ()) if not n.startswith("__"))


# ------------------------------------------------------------------------- containers


def _messages(paths: Sequence[Path], name: str) -> Iterator[tuple[str, Decoder, int, bytes]]:
    """Topic, decoder, stamp [ns] and bytes of the messages of the files of one bag."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtra(
            "ROS bags and MCAP files need rosbags: pip install 'loose-env[import]'"
        ) from None

    def refuse(kind: str) -> Decoder:
        raise InvalidData(
            f"{name}: the bag has no definition of {kind!r}; record with a version of ROS 2 that "
            "stores 'ros2msg' schemas"
        )

    standard = get_typestore(Stores.ROS1_NOETIC if paths[0].suffix == ".bag" else Stores.LATEST)
    try:
        with AnyReader(paths, default_typestore=standard) as reader:
            known = reader.typestore.fielddefs
            for connection, stamp, data in reader.messages():
                kind = connection.msgtype
                decode = partial(reader.deserialize, typ=kind) if kind in known else (
                    lambda _, kind=kind: refuse(kind))  # fmt: skip
                yield connection.topic, decode, stamp, data
    except LooseEnvError:
        raise
    except Exception as error:  # the library raises errors of many kinds on damaged bytes
        more = "; 'ros2 bag reindex', or 'mcap recover', may save what is whole"
        raise damaged(name, "ROS bag", error, more) from None
