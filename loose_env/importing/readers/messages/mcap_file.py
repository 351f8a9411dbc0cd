"""Channels read from the topics of an MCAP file or of any messages, or listed."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.mapping.mapping import TimeSource
from loose_env.importing.mapping.units import unit_named
from loose_env.importing.readers.messages.field_path import FieldPath, fields_of, leaves, stamp_ns
from loose_env.importing.readers.messages.mcap_messages import Decoder, decoder_of, encoding_of
from loose_env.importing.readers.messages.mcap_records import Message, walk
from loose_env.importing.samples import Channel, ChannelKey, FileList, Samples, Stream, checked
from loose_env.recording import MOST_VALUES, nearest

_MOST_LISTED = 200
"""Channels listed of one topic."""
_LATEST_NS = 2**63 - 1
_CLOCKS = ("auto", "log", "publish", "header")


Walk = Callable[[frozenset[str] | None], Iterator[Message]]
"""Goes through the messages of the given topics, or of all."""


def read_mcap(
    path: Path, name: str, keys: Sequence[ChannelKey], times: Mapping[str, TimeSource]
) -> dict[ChannelKey, Samples]:
    """Read channels of an MCAP file, as `read_topics`."""
    return read_topics(lambda topics: walk(path, name, topics), name, keys, times)


def list_mcap(path: Path, name: str) -> FileList:
    """List topics and channels of an MCAP file, as `list_topics`."""
    streams = list_topics(lambda topics: walk(path, name, topics), name)
    return FileList(name=name, kind="mcap", words="MCAP", streams=streams)


def read_topics(
    messages: Walk, name: str, keys: Sequence[ChannelKey], times: Mapping[str, TimeSource]
) -> dict[ChannelKey, Samples]:
    """Read channels in one pass over messages; only their numbers are kept."""
    for key in keys:
        if not key.topic:
            raise InvalidData(
                f"{name}: channel {key.channel!r}: its channels lie in topics; say which by "
                "topic = '/...'"
            )
    topics: dict[str, _Topic] = {}
    for key in dict.fromkeys(keys):
        if key.topic not in topics:
            topics[key.topic] = _Topic(f"{name}: topic {key.topic!r}", times[key.topic])
        topics[key.topic].add(key)
    seen: set[str] = set()
    for message in messages(frozenset(topics)):
        topics[message.channel.topic].take(message)
        seen.add(message.channel.topic)
    missing = [topic for topic in topics if topic not in seen]
    if missing:
        there = [stream.topic for stream in list_topics(messages, name, decode=False)]
        raise InvalidData(
            f"{name}: it has no messages of topic {missing[0]!r}; it has "
            f"{', '.join(map(repr, there[:20])) or 'none'}{nearest(missing[0], there)}"
        )
    return {key: topic.samples(key) for topic in topics.values() for key in topic.kept}


class _Kept(NamedTuple):
    """Samples kept of one channel."""

    path: FieldPath
    values: array[float]
    stamps: array[int]
    """Times [ns]."""
    numbers: array[int]
    """Number of each message within its topic, from 1."""


class _Topic:
    """Samples gathered of one topic."""

    def __init__(self, place: str, time: TimeSource) -> None:
        self.place, self.time = place, time
        self.kept: dict[ChannelKey, _Kept] = {}
        self.decoders: dict[int, Decoder] = {}
        self.count = 0
        self.stamp = time.stamp
        self.stamp_path: FieldPath | None = None
        if time.stamp not in _CLOCKS:
            self.stamp_path = FieldPath.parse(time.stamp, f"{place}: time.stamp")
        elif time.stamp in ("auto", "header"):
            self.stamp_path = FieldPath.parse("header.stamp", place)

    def add(self, key: ChannelKey) -> None:
        path = FieldPath.parse(key.channel, self.place)
        self.kept[key] = _Kept(path, array("d"), array("q"), array("q"))

    def take(self, message: Message) -> None:
        self.count += 1
        channel = message.channel
        if channel.id not in self.decoders:
            self.decoders[channel.id] = decoder_of(channel, message.schema, self.place)
        try:
            decoded = self.decoders[channel.id](message.data)
        except Exception as error:  # whatever a library raises on damaged bytes
            raise self._refused(f"it is damaged: {type(error).__name__}") from error
        try:
            stamp = self._stamp(message, decoded)
            for path, values, stamps, numbers in self.kept.values():
                value = self._number(path, path.find(decoded))
                if value is None:
                    continue
                if len(values) == MOST_VALUES:
                    raise self._refused(f"more than {MOST_VALUES} samples; cut the file")
                values.append(value)
                stamps.append(stamp)
                numbers.append(self.count)
        except KeyError as error:
            raise self._refused(str(error.args[0])) from None

    def samples(self, key: ChannelKey) -> Samples:
        place = f"{self.place}, channel {key.channel!r}"
        kept = self.kept[key]
        stamps = np.frombuffer(kept.stamps, dtype=np.int64)
        values = np.frombuffer(kept.values, dtype=np.float64)
        if not stamps.size:
            raise InvalidData(
                f"{place}: none of its {self.count} messages has this entry; "
                "loose import --describe lists those that are there"
            )
        origin = int(stamps.min())
        if self.time.rate_hz is not None:
            time = np.arange(stamps.size, dtype=np.float64) / self.time.rate_hz
        else:
            time = np.asarray((stamps - origin) * 1e-9, dtype=np.float64)
        rows = np.frombuffer(kept.numbers, dtype=np.int64)
        return checked(place, time, values, origin_ns=origin, rows=rows, row_word="message")

    def _stamp(self, message: Message, decoded: Any) -> int:
        if self.stamp == "auto":  # the first message decides for its topic
            self.stamp = "header" if _header_ns(decoded, self.place) else "log"
        if self.stamp == "log":
            found = message.log_ns
        elif self.stamp == "publish":
            found = message.publish_ns
        else:
            assert self.stamp_path is not None
            told = self._told(self.stamp_path.find(decoded))
            if told is None:
                raise self._refused(f"{self.stamp_path.words!r} holds no time")
            found = told
        if not 0 <= found <= _LATEST_NS:
            raise self._refused(f"its time is {found} ns, which is no date")
        return found

    def _told(self, raw: Any) -> int | None:
        """Time that a field holds [ns]: a stamp, or a number in the unit of the mapping."""
        if isinstance(raw, bool) or not isinstance(raw, (int, float)):
            return None if raw is None else stamp_ns(raw)
        nanos = round(unit_named(self.time.unit, f"{self.place}: time.unit").factor * 1e9)
        return round(raw * nanos) if math.isfinite(raw) else None

    def _number(self, path: FieldPath, value: Any) -> float | None:
        if value is None:
            return None
        if not isinstance(value, (bool, int, float)):
            held = f"; it holds {', '.join(fields_of(value)[:12])}" if fields_of(value) else ""
            raise self._refused(f"{path.words!r} is no number{held}")
        try:
            return float(value)
        except OverflowError:
            raise self._refused(f"{path.words!r} is too large a number") from None

    def _refused(self, why: str) -> InvalidData:
        return InvalidData(f"{self.place}: message {self.count}: {why}")


@dataclass
class _Seen:
    """Summary of a topic while it is listed."""

    kind: str
    encoding: str
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    channels: tuple[Channel, ...] = ()
    note: str = ""
    decoders: dict[int, Decoder] = field(default_factory=dict)


def list_topics(messages: Walk, name: str, *, decode: bool = True) -> tuple[Stream, ...]:
    """List topics and their channels, with rates and first values."""
    seen: dict[str, _Seen] = {}
    for message in messages(None):
        topic = message.channel.topic
        each = seen.get(topic)
        if each is None:
            kind = "" if message.schema is None else message.schema.name
            each = _Seen(kind, encoding_of(message.channel, message.schema))
            each.first_ns = each.last_ns = message.log_ns
            seen[topic] = each
            if decode:
                each.channels, each.note = _first(message, f"{name}: topic {topic!r}")
        each.count += 1
        each.first_ns = min(each.first_ns, message.log_ns)
        each.last_ns = max(each.last_ns, message.log_ns)
    return tuple(
        Stream(
            topic=topic,
            kind=f"{each.kind or 'no schema'}, {each.encoding}",
            samples=each.count,
            start_ns=each.first_ns,
            seconds=(each.last_ns - each.first_ns) * 1e-9,
            channels=each.channels,
            note=each.note,
        )
        for topic, each in sorted(seen.items())
    )


def _first(message: Message, place: str) -> tuple[tuple[Channel, ...], str]:
    try:
        decoder = decoder_of(message.channel, message.schema, place)
    except InvalidData as error:
        return (), str(error).removeprefix(f"{place}: ")
    try:
        decoded = decoder(message.data)
        found = [
            Channel(key=ChannelKey(words, message.channel.topic), first=(value,))
            for words, value in leaves(decoded, _MOST_LISTED + 1)
        ]
    except Exception as error:  # whatever a library raises on damaged bytes
        return (), f"its first message cannot be decoded: {type(error).__name__}"
    note = ""
    if len(found) > _MOST_LISTED:
        note = f"more than {_MOST_LISTED} numbers a message; the first are listed"
    if _header_ns(decoded, place):
        words = "times by header.stamp; stamp = 'log' takes the recorder's"
        note = "; ".join(filter(None, (note, words)))
    return tuple(found[:_MOST_LISTED]), note


def _header_ns(decoded: Any, place: str) -> int | None:
    """Stamp of a message's header [ns]; None where it has none, or 0 where it was not set."""
    try:
        stamp = FieldPath.parse("header.stamp", place).find(decoded)
    except KeyError:
        return None
    return None if stamp is None else stamp_ns(stamp)
