"""ROS bags, version 1 and 2, and MCAP files: numbers of the messages of each topic.

A folder is read by the files in it, compressed or not, whatever its metadata say.
"""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData, LooseEnvError, MissingExtra
from loose_env.importing.samples import ChannelKey, Log, Table, natural
from loose_env.recording import MOST_VALUES

STORAGES = (".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd")
"""Endings of the files of a bag."""
_PACKED = b"\x28\xb5\x2f\xfd"
"""First bytes of what zstd compressed."""
_LARGEST = 2**28  # bytes of one message, packed or not
_IMAGE = 2**16
"""Bytes of a message from which it holds images or clouds and no signals of joints."""
_MOST_ENTRIES = 256
"""Entries of an array that are read; longer ones are images and scans."""
_DEEPEST = 12
_LABELS = ("name", "names", "joint_names", "label", "labels")
"""Fields that may name the entries of the arrays beside them."""
_SECONDS, _NANOSECONDS = ("sec", "seconds", "secs"), ("nanosec", "nsec", "nanos", "nsecs")
_READ = ("cdr with ros2msg", "json", "protobuf with protobuf")
_ADVICE = {
    "ros1": "convert the bag to ROS 2 first",
    "cdr": "record with a version of ROS 2 that stores 'ros2msg' schemas",
}
Decoder = Callable[[bytes], Any]


class _Channel(NamedTuple):
    """Topic of one file, with what decodes its messages."""

    topic: str
    kind: str
    encoding: str
    decoder: Callable[[], Decoder]


class _Message(NamedTuple):
    channel: _Channel
    log_ns: int
    publish_ns: int
    data: bytes


def open_messages(path: Path, name: str) -> Log:
    """Open a bag or an MCAP file."""

    def tables(_: str, keys: Sequence[ChannelKey] | None) -> list[Table]:
        return _tables(path, name, None if keys is None else {key.topic for key in keys})

    mcap = path.is_file() and path.suffix == ".mcap"
    words = "MCAP" if mcap else "ROS bag"
    return Log(name=name, kind="mcap" if mcap else "rosbag2", words=words, tables=tables)


def storages(folder: Path) -> list[Path]:
    """Files of a bag in a folder, in the order in which they were recorded."""
    found = (p for p in folder.iterdir() if p.name.endswith(STORAGES))
    return sorted(found, key=lambda path: natural(path.name))


def _tables(path: Path, name: str, topics: set[str] | None) -> list[Table]:
    """Numbers of all topics, or of those asked for, which alone are refused when damaged."""
    files = [path] if path.is_file() else storages(path)
    if not files:
        raise InvalidData(f"{name}: it has no files of a ROS bag, {', '.join(STORAGES)}")
    found: dict[str, _Topic] = {}
    for file in files:
        place = name if file == path else f"{name}/{file.name}"
        for message in _messages(file, place):
            topic = message.channel.topic
            if topics is not None and topic not in topics:
                found.setdefault(topic, _Topic(f"{name}: topic {topic!r}", message.channel))
                continue
            if topic not in found:
                found[topic] = _Topic(f"{name}: topic {topic!r}", message.channel)
            found[topic].take(message, strict=topics is not None)
    return [topic.table() for topic in found.values()]


class _Topic:
    """Numbers gathered of one topic."""

    def __init__(self, place: str, channel: _Channel) -> None:
        self.place, self.channel = place, channel
        self.decoders: dict[int, Decoder] = {}
        self.found: dict[tuple[str, tuple[str, ...] | None], tuple[list[int], list[Any]]] = {}
        """Field, and names of the entries of an array -> messages that have it, and values."""
        self.stamps: dict[str, list[int]] = {}
        self.count, self.values = 0, 0
        self.note = ""

    def take(self, message: _Message, *, strict: bool) -> None:
        if self.note:
            return
        self.count += 1
        try:
            if len(message.data) > (_LARGEST if strict else _IMAGE):
                raise InvalidData(f"{self.place}: its messages have {len(message.data)} bytes")
            self._take(message)
        except InvalidData as error:
            if strict:
                raise
            self.note = f"not read: {error}"

    def _take(self, message: _Message) -> None:
        own, here = id(message.channel), f"{self.place}: message {self.count}"
        if own not in self.decoders:
            self.decoders[own] = message.channel.decoder()
        try:
            data = message.data
            decoded = self.decoders[own](_unpacked(data) if data[:4] == _PACKED else data)
            for words, labels, value in _numbers(decoded, "", 0):
                if labels is _STAMP:
                    self.stamps.setdefault(words, []).append(value)
                elif labels is not _TEXT:
                    rows, values = self.found.setdefault((words, labels), ([], []))
                    rows.append(self.count - 1)
                    values.append(value)
                    self.values += 1 if labels is None else len(labels)
                elif (words, None) in self.found:
                    raise InvalidData(f"{here}: {words!r} is no number")
        except InvalidData:
            raise
        except OverflowError:
            raise InvalidData(f"{here}: it holds too large a number") from None
        except Exception as error:  # whatever a library raises on damaged bytes
            raise InvalidData(f"{here}: it is damaged: {type(error).__name__}") from error
        for clock, ns in (("log", message.log_ns), ("publish", message.publish_ns)):
            self.stamps.setdefault(clock, []).append(ns)
        if self.values > MOST_VALUES:
            raise InvalidData(f"{self.place}: more than {MOST_VALUES} samples; cut the file")

    def table(self) -> Table:
        """Columns of all fields; entries of named arrays by their number as well."""
        columns: dict[str, NDArray[np.float64]] = {}
        hidden: dict[str, NDArray[np.float64]] = {}
        for (words, labels), (rows, values) in self.found.items():
            matrix = np.array(values, dtype=np.float64).reshape(len(rows), -1)
            for i, label in enumerate(labels or ("",)):
                names = {words if labels is None else f"{words}[{label}]": columns}
                names |= {f"{words}[{i}]": hidden} if labels and label != str(i) else {}
                for name, into in names.items():
                    column = into.setdefault(name, np.full(self.count, np.nan))
                    column[rows] = matrix[:, i]
        stamps: dict[str, NDArray[np.int64]] = {
            k: np.array(v, dtype=np.uint64).astype(np.int64)
            for k, v in self.stamps.items()
            if len(v) == self.count and columns and max(v, default=0) < 2**64
        }
        header = stamps.get("header.stamp")
        told = header is not None and len(header) and header[0] != 0
        note = "times by header.stamp; stamp = 'log' takes the recorder's" if told else ""
        return Table(
            place=self.place,
            topic=self.channel.topic,
            columns=columns,
            stamps=stamps,
            hidden=hidden,
            row_word="message",
            kind=f"{self.channel.kind}, {self.channel.encoding}".strip(", "),
            note=self.note or note,
        )


# ------------------------------------------------------------------------- structure

_TEXT, _STAMP = ("text",), ("stamp",)
"""Marks of a field that holds a text, or a time."""


def _numbers(here: Any, words: str, depth: int) -> Iterator[tuple[str, Any, Any]]:
    """Fields of a message: name, names of the entries of an array or None or a mark, value."""
    if isinstance(here, (bool, int, float, np.number)):
        yield words, None, float(here)
        return
    if isinstance(here, (str, bytes, bytearray)):
        yield words, _TEXT, None
        return
    if depth == _DEEPEST or here is None:
        return
    fields = _fields(here)
    stamp = _stamp_ns(here, fields)
    if stamp is not None:
        yield words, _STAMP, stamp  # offered as a stamp and not as a value
        return
    label = next(
        (found for name in fields if name in _LABELS and (found := _label(here, name))), ()
    )
    for name in fields:
        value = _field(here, name)
        if name.endswith("covariance") or set(name) & set("[].") or name.startswith("__"):
            continue  # nine numbers that no column takes
        own = f"{words}.{name}" if words else name
        if not _is_array(value):
            yield from _numbers(value, own, depth + 1)
        elif 0 < len(value) <= _MOST_ENTRIES:
            if isinstance(value[0], (bool, int, float, np.number)):
                numbered = tuple(map(str, range(len(value))))
                plain = value.tolist() if isinstance(value, np.ndarray) else [*map(float, value)]
                yield own, label if len(label) == len(value) else numbered, plain
            elif not isinstance(value[0], (str, bytes)):
                for i in range(len(value)):
                    yield from _numbers(value[i], f"{own}[{i}]", depth + 1)


def _fields(holder: Any) -> Sequence[str]:
    """Names of the fields of a decoded message: of JSON, ROS or protobuf."""
    return [*map(str, holder)] if isinstance(holder, dict) else _fields_of(type(holder))  # type: ignore[arg-type]


@cache
def _fields_of(kind: type) -> tuple[str, ...]:
    descriptor = getattr(kind, "DESCRIPTOR", None)
    if descriptor is not None:
        return tuple(field.name for field in descriptor.fields)
    return tuple(n for n in getattr(kind, "__dataclass_fields__", ()) if not n.startswith("__"))


def _field(holder: Any, name: str) -> Any:
    return holder[name] if isinstance(holder, dict) else getattr(holder, name, None)


def _is_array(value: Any) -> bool:
    """True for a list of some kind, not for text, bytes or an object with fields."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return True
    plain = (str, bytes, bytearray, dict, int, float)
    return not isinstance(value, plain) and all(
        hasattr(value, each) for each in ("__len__", "__getitem__")
    )


def _label(holder: Any, name: str) -> tuple[str, ...]:
    """Names that a field gives to the entries of the arrays beside it; none where it is no such."""
    found = _field(holder, name)
    if not _is_array(found) or not all(isinstance(word, str) for word in found):
        return ()
    plain = all(word and not set(word) & set("[]") for word in found)
    return tuple(found) if plain and len(set(found)) == len(found) else ()


def _stamp_ns(value: Any, names: Sequence[str]) -> int | None:
    """Time of a stamp [ns], where a value is one: an object of seconds and nanoseconds."""
    seconds = next((n for n in _SECONDS if n in names), None)
    rest = next((n for n in _NANOSECONDS if n in names), None)
    if seconds is None or rest is None or len(names) > 2:
        return None
    whole, nanos = _field(value, seconds), _field(value, rest)
    if not all(isinstance(n, (int, np.integer)) for n in (whole, nanos)):
        return None
    return int(whole) * 1_000_000_000 + int(nanos)


# ------------------------------------------------------------------------- containers


def _messages(path: Path, place: str) -> Iterator[_Message]:
    """Messages of one file in its order."""
    if path.suffix == ".zstd":
        with tempfile.TemporaryDirectory() as folder:
            whole = Path(folder, path.stem)
            try:
                with path.open("rb") as packed, whole.open("wb") as out:
                    _zstandard().ZstdDecompressor().copy_stream(packed, out)
            except Exception as error:
                raise InvalidData(f"{place}: cut short or damaged ({_plain(error)})") from None
            yield from _messages(whole, place)
            return
    walk = _of_mcap if path.suffix == ".mcap" else _of_bag
    try:
        yield from walk(path, place)
    except LooseEnvError:
        raise
    except Exception as error:  # the libraries raise each their own on damaged bytes
        kind = "an MCAP file" if path.suffix == ".mcap" else "a ROS bag"
        raise InvalidData(
            f"{place}: it cannot be read as {kind}: cut short or damaged ({_plain(error)}); "
            "'mcap recover', or 'ros2 bag reindex' for a bag, may save what is whole"
        ) from None


def _of_mcap(path: Path, place: str) -> Iterator[_Message]:
    try:
        from mcap.records import Channel, Message, Schema
        from mcap.stream_reader import StreamReader
    except ImportError:
        raise MissingExtra("MCAP files need mcap: pip install 'loose-env[import]'") from None
    schemas: dict[int, Any] = {}
    channels: dict[int, _Channel] = {}
    with path.open("rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in channels:
                schema = schemas.get(record.schema_id)
                encoding, own = record.message_encoding, "" if schema is None else schema.encoding
                words = f"{encoding or 'nothing'}{f' with {own}' if own else ''}"
                channels[record.id] = _Channel(
                    record.topic,
                    "" if schema is None else schema.name,
                    words,
                    lambda s=schema, e=encoding, t=record.topic, w=words: _decoder(  # type: ignore[misc]
                        e, s, f"{place}: topic {t!r}", w
                    ),
                )
            elif isinstance(record, Message):
                yield _Message(
                    channels[record.channel_id], record.log_time, record.publish_time, record.data
                )


def _of_bag(path: Path, place: str) -> Iterator[_Message]:
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError:
        raise MissingExtra("ROS bags need rosbags: pip install 'loose-env[import]'") from None
    first = path.suffix == ".bag"
    with Reader1(path) if first else Reader2(path) as reader:
        own: dict[int, _Channel] = {}
        for each in reader.connections:
            text, kind = each.msgdef.data, each.msgtype
            encoding = "ros1" if first else "cdr"
            own[each.id] = _Channel(
                each.topic, kind, encoding,
                lambda k=kind, t=text, idl=each.msgdef.format.name == "IDL",  # type: ignore[misc]
                topic=each.topic: _of_ros(k, t, f"{place}: topic {topic!r}", first=first, idl=idl),
            )  # fmt: skip
        for connection, stamp, data in reader.messages(connections=reader.connections):
            yield _Message(own[connection.id], stamp, stamp, bytes(data))


def _decoder(encoding: str, schema: Any, place: str, words: str) -> Decoder:
    """What decodes the messages of a channel of an MCAP file."""
    own = "" if schema is None else schema.encoding
    if encoding == "json":
        return json.loads
    if encoding in ("cdr", "ros1") and own in ("ros2msg", "ros2idl", "ros1msg"):
        text = schema.data.decode("utf-8", "replace")
        return _of_ros(schema.name, text, place, first=encoding == "ros1", idl=own == "ros2idl")
    if (encoding, own) == ("protobuf", "protobuf"):
        try:
            from mcap_protobuf.decoder import DecoderFactory
        except ImportError:
            raise MissingExtra(
                "protobuf messages need mcap-protobuf-support: pip install 'loose-env[import]'"
            ) from None
        try:
            found = DecoderFactory().decoder_for(encoding, schema)
        except Exception as error:
            raise InvalidData(
                f"{place}: the schema {schema.name[:80]!r} cannot be read: {_plain(error)}"
            ) from None
        if found is not None:
            return found
    advice = next((f"; {a}" for key, a in _ADVICE.items() if key in encoding), "")
    raise InvalidData(
        f"{place}: its messages are {words!r:.80}; read are {', '.join(_READ)}{advice}"
    )


def _of_ros(kind: str, text: str, place: str, *, first: bool, idl: bool) -> Decoder:
    """Decoder of a message type of ROS; standard types need no definition."""
    try:
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    except ImportError:
        raise MissingExtra("ROS messages need rosbags: pip install 'loose-env[import]'") from None
    standard = get_typestore(Stores.ROS1_NOETIC if first else Stores.LATEST)
    full = kind if kind.count("/") == 2 else kind.replace("/", "/msg/", 1)
    try:
        store = get_typestore(Stores.EMPTY)
        told = (get_types_from_idl(text) if idl else get_types_from_msg(text, full)) if text else {}
        store.register({**standard.fielddefs, **told})
        if full not in store.fielddefs:
            raise InvalidData(f"{place}: the bag has no definition of {kind!r}; {_ADVICE['cdr']}")
    except InvalidData:
        raise
    except RecursionError:
        raise InvalidData(f"{place}: the schema is nested too deeply") from None
    except Exception as error:  # whatever a parser raises
        raise InvalidData(
            f"{place}: the schema {kind[:80]!r} cannot be read: {_plain(error)}"
        ) from None
    read = store.deserialize_ros1 if first else store.deserialize_cdr
    return lambda data: read(data, full)


def _unpacked(data: bytes) -> bytes:
    reader = _zstandard().ZstdDecompressor(max_window_size=2**27).stream_reader(io.BytesIO(data))
    whole = bytes(reader.read(_LARGEST + 1))
    if len(whole) > _LARGEST:
        raise ValueError(f"more than {_LARGEST} bytes once expanded")
    return whole


def _zstandard() -> Any:
    try:
        import zstandard
    except ImportError:
        raise MissingExtra(
            "compressed bags need zstandard: pip install 'loose-env[import]'"
        ) from None
    return zstandard


def _plain(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
