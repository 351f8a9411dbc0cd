"""The messages of a ROS 2 bag in SQLite (``.db3``), as those of an MCAP file."""

from __future__ import annotations

import io
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from loose_env.errors import InvalidData, MissingExtra
from loose_env.importing.readers.messages.mcap_records import Message, require_mcap

_LARGEST = 2**28  # bytes of one message, packed or not
_LATEST_NS = 2**63 - 1


def walk_sqlite(
    path: Path, name: str, topics: frozenset[str] | None = None, *, packed: bool = False
) -> Iterator[Message]:
    """Go through the messages of a ``.db3`` file in the order of their times.

    A bag of ROS 2 Iron or later holds the definitions of its messages. For an older one those of
    the standard message types are taken from the ``rosbags`` library.
    """
    require_mcap()
    uri = f"{path.resolve().as_uri()}?mode=ro"
    try:
        with closing(sqlite3.connect(uri, uri=True)) as database:
            yield from _messages(database, name, topics, packed)
    except sqlite3.Error as error:
        words = " ".join(str(error).split())[:100]
        raise InvalidData(
            f"{name}: it cannot be read as a ROS 2 bag in SQLite, or was cut short ({words}); "
            "'ros2 bag reindex' or 'ros2 bag convert' may save what is whole"
        ) from None


def _messages(
    database: sqlite3.Connection, name: str, topics: frozenset[str] | None, packed: bool
) -> Iterator[Message]:
    known = _channels(database, name)
    wanted = {i: each for i, each in known.items() if topics is None or each[0].topic in topics}
    rows = database.execute(
        "SELECT id, topic_id, timestamp, data FROM messages ORDER BY timestamp, id"
    )
    for number, topic, stamp, data in rows:
        if topic not in wanted:
            if topic not in known:
                raise InvalidData(
                    f"{name}: message {number} is of topic {topic!r:.40}, which the bag does not "
                    "introduce; it is damaged"
                )
            continue
        channel, schema = wanted[topic]
        place = f"{name}: message {number} of topic {channel.topic!r}"
        if not isinstance(stamp, int) or not isinstance(data, bytes) or len(data) > _LARGEST:
            raise InvalidData(f"{place} is damaged: no time or no bytes, or more than {_LARGEST}")
        if not 0 <= stamp <= _LATEST_NS:
            raise InvalidData(f"{place}: its time is {stamp} ns, which is no date")
        body = _unpacked(data, place) if packed else data
        yield Message(channel, schema, stamp, stamp, body)


def _channels(database: sqlite3.Connection, name: str) -> dict[int, tuple[Any, Any]]:
    """Channel and schema of each topic by its number in the file."""
    from mcap.records import Channel, Schema

    definitions = _definitions(database)
    found: dict[int, tuple[Any, Any]] = {}
    rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
    for i, topic, kind, encoding in rows.fetchall():
        if not all(isinstance(each, str) for each in (topic, kind, encoding)):
            raise InvalidData(f"{name}: topic {i!r:.40} is damaged: its name or type is no text")
        language, text = definitions.get(kind, ("", ""))
        if not text.strip():
            language, text = "ros2msg", _standard(kind)
        # A type that nothing defines is refused by the decoder, where its topic is asked for.
        schema = Schema(
            id=i, data=text.encode(), encoding=language if text else "no definition", name=kind
        )
        channel = Channel(
            id=i, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema.id
        )
        found[i] = (channel, schema)
    return found


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Language and text of the definition of each type that the bag holds itself."""
    there = database.execute(
        "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'message_definitions'"
    ).fetchone()
    if there is None:
        return {}
    rows = database.execute(
        "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    )
    return {str(kind): (str(language), str(text)) for kind, language, text in rows.fetchall()}


def _standard(kind: str) -> str:
    """Definition of a standard message type; empty where it is none."""
    try:
        from rosbags.typesys import Stores, TypesysError, get_typestore
    except ImportError:
        raise MissingExtra(
            "bags in SQLite without definitions of their messages need rosbags: "
            "pip install 'loose-env[import]'"
        ) from None
    try:
        text, _ = get_typestore(Stores.LATEST).generate_msgdef(kind, ros_version=2)
    except (TypesysError, KeyError, ValueError):
        return ""
    return str(text)


def _unpacked(data: bytes, place: str) -> bytes:
    import zstandard

    try:
        reader = zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(io.BytesIO(data))
        whole = bytes(reader.read(_LARGEST + 1))
    except (zstandard.ZstdError, MemoryError) as error:
        raise InvalidData(f"{place} is damaged: {error}") from None
    if len(whole) > _LARGEST:
        raise InvalidData(f"{place}: more than {_LARGEST} bytes once expanded")
    return whole
