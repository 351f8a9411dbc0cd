"""Messages of an MCAP file one after the other, with limits on the sizes that it declares.

Records are taken apart by the ``mcap`` library. Which bytes it is given is decided here: its own
reader trusts the sizes that a file declares, and a chunk of a few bytes can declare any.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

from loose_env.errors import InvalidData, MissingExtra
from loose_env.importing.samples import unreadable

MAGIC = b"\x89MCAP0\r\n"

_HEADER = struct.Struct("<BQ")  # opcode and length before each record
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQI")  # start, end, size once expanded, checksum of that
_SCHEMA, _CHANNEL, _MESSAGE_OP, _CHUNK_OP, _DATA_END, _FOOTER = 0x03, 0x04, 0x05, 0x06, 0x0F, 0x02
_READ = {_SCHEMA: 2**24, _CHANNEL: 2**20, _MESSAGE_OP: 2**28, _CHUNK_OP: 2**29,
         _DATA_END: 2**10, _FOOTER: 2**10}  # fmt: skip
"""Records that are read -> the most bytes of one; all others are passed over."""
_MOST_EXPANDED = 2**29
_BLOCK = 2**20
_WINDOW = 2**27  # most that a zstd frame may make its reader keep
_NAMES = {_SCHEMA: "schema", _CHANNEL: "channel", _MESSAGE_OP: "message", _CHUNK_OP: "chunk",
          _DATA_END: "end of data", _FOOTER: "footer"}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Message:
    """A message as it stands in the file, not decoded."""

    channel: Any
    """Record of its channel, with ``topic`` and ``message_encoding``."""
    schema: Any
    """Record of its schema, or None where it has none."""
    log_ns: int
    publish_ns: int
    data: bytes


def require_mcap() -> None:
    """Refuse to go on without the libraries for MCAP."""
    for module in ("mcap", "lz4", "zstandard"):
        if find_spec(module) is None:
            raise MissingExtra(f"MCAP files need {module}: pip install 'loose-env[import]'")


def walk(path: Path, name: str, topics: frozenset[str] | None = None) -> Iterator[Message]:
    """Go through the messages of a file from its beginning to its end."""
    require_mcap()
    try:
        with path.open("rb") as file:
            yield from _Walk(file, path.stat().st_size, name, topics).messages()
    except OSError as error:
        raise unreadable(name, error) from None


class _Walk:
    def __init__(self, file: IO[bytes], size: int, name: str, topics: frozenset[str] | None):
        self.file, self.size, self.name, self.topics = file, size, name, topics
        self.position = 0
        self.crc = 0
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, tuple[Any, Any, bool]] = {}

    def messages(self) -> Iterator[Message]:
        if self.size < len(MAGIC) or self._take(len(MAGIC), "start") != MAGIC:
            raise InvalidData(f"{self.name}: no MCAP file: it does not start with {MAGIC!r}")
        ended = False
        while True:
            place = f"byte {self.position}"
            crc = self.crc
            code, length = _HEADER.unpack(self._take(_HEADER.size, "record"))
            what = _NAMES.get(code, f"record of kind {code:#04x}")
            if length > self.size - self.position:
                raise self._cut(f"the {what} at {place} is {length} bytes long")
            if code not in _READ or (ended and code != _FOOTER):
                self._pass(length)
                continue
            if length > _READ[code]:
                raise InvalidData(
                    f"{self.name}: {place}: the {what} is {length} bytes; at most {_READ[code]} "
                    "are read"
                )
            data = self._take(length, what)
            if code == _FOOTER:
                if self._take(len(MAGIC), "end") != MAGIC or self.position != self.size:
                    raise InvalidData(
                        f"{self.name}: byte {self.position}: the footer is not the end of the file"
                    )
                return
            if code == _DATA_END:
                ended = True
                told = int.from_bytes(data[:4], "little")
                if told not in (0, crc):
                    raise InvalidData(
                        f"{self.name}: {place}: damaged: the checksum of the data is {crc:#x}, "
                        f"the file says {told:#x}"
                    )
            elif code == _CHUNK_OP:
                yield from self._inside(self._expanded(data, place), place)
            else:
                found = self._record(code, data, 0, len(data), place)
                if found is not None:
                    yield found

    def _take(self, length: int, what: str) -> bytes:
        if length > self.size - self.position:
            raise self._cut(f"{length} bytes of a {what} should follow")
        data = self.file.read(length)
        if len(data) != length:
            raise self._cut("it became shorter while it was read")
        self.position += length
        self.crc = zlib.crc32(data, self.crc)
        return data

    def _pass(self, length: int) -> None:
        end = self.position + length
        while self.position < end:
            self._take(min(_BLOCK, end - self.position), "record")

    def _cut(self, why: str) -> InvalidData:
        return InvalidData(
            f"{self.name}: byte {self.position}: the file was cut short or damaged: {why}, and it "
            f"is {self.size} bytes long; 'mcap recover' (of the mcap command line tool) saves what "
            "is whole"
        )

    def _expanded(self, data: bytes, place: str) -> bytes:
        """Contents of a chunk; never more memory than the limit, whatever is declared."""
        try:
            _, _, size, crc = _CHUNK.unpack_from(data)
            at = _CHUNK.size
            (length,) = struct.unpack_from("<I", data, at)
            kind = data[at + 4 : at + 4 + length].decode("ascii")[:40]
            at += 4 + length
            (length,) = struct.unpack_from("<Q", data, at)
        except (struct.error, UnicodeDecodeError):
            raise InvalidData(f"{self.name}: {place}: the chunk is damaged") from None
        packed = data[at + 8 :]
        if length != len(packed):
            raise InvalidData(
                f"{self.name}: {place}: the chunk is damaged: {length} bytes declared, "
                f"{len(packed)} there"
            )
        if size > _MOST_EXPANDED:
            raise InvalidData(
                f"{self.name}: {place}: the chunk declares {size} bytes once expanded; at most "
                f"{_MOST_EXPANDED} are read"
            )
        whole = _expand(kind, packed, size, f"{self.name}: {place}")
        if len(whole) != size or (crc and zlib.crc32(whole) != crc):
            raise InvalidData(
                f"{self.name}: {place}: the chunk is damaged: its "
                f"{'size' if len(whole) != size else 'checksum'} is not the one declared"
            )
        return whole

    def _inside(self, data: bytes, place: str) -> Iterator[Message]:
        at, end = 0, len(data)
        while at < end:
            if end - at < _HEADER.size:
                raise InvalidData(f"{self.name}: {place}: the last record of the chunk is cut")
            code, length = _HEADER.unpack_from(data, at)
            at += _HEADER.size
            if length > end - at:
                raise InvalidData(
                    f"{self.name}: {place}: a record inside the chunk is {length} bytes long, "
                    f"and {end - at} are left"
                )
            if code in (_SCHEMA, _CHANNEL, _MESSAGE_OP):
                found = self._record(code, data, at, length, place)
                if found is not None:
                    yield found
            at += length

    def _record(self, code: int, data: bytes, at: int, length: int, place: str) -> Message | None:
        if code == _MESSAGE_OP:
            if length < _MESSAGE.size:
                raise InvalidData(f"{self.name}: {place}: a message of {length} bytes is damaged")
            number, _, log_ns, publish_ns = _MESSAGE.unpack_from(data, at)
            known = self.channels.get(number)
            if known is None:
                raise InvalidData(
                    f"{self.name}: {place}: a message of channel {number}, which the file does "
                    "not introduce; it is damaged"
                )
            channel, schema, wanted = known
            if not wanted:
                return None
            body = data[at + _MESSAGE.size : at + length]
            return Message(channel, schema, log_ns, publish_ns, body)
        self._introduce(code, data[at : at + length], place)
        return None

    def _introduce(self, code: int, data: bytes, place: str) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError
        from mcap.records import Channel, Schema

        kind = Schema if code == _SCHEMA else Channel
        try:
            record = kind.read(ReadDataStream(io.BytesIO(data)))
        except (McapError, struct.error, ValueError, OverflowError):
            raise InvalidData(f"{self.name}: {place}: the {_NAMES[code]} is damaged") from None
        if code == _SCHEMA:
            self.schemas[record.id] = record
            return
        schema = self.schemas.get(record.schema_id)
        if record.schema_id and schema is None:
            raise InvalidData(
                f"{self.name}: {place}: topic {record.topic[:80]!r} names schema "
                f"{record.schema_id}, which the file does not introduce; it is damaged"
            )
        before = self.channels.get(record.id)
        if before is not None and before[0] != record:
            raise InvalidData(
                f"{self.name}: {place}: channel {record.id} is introduced twice, as "
                f"{before[0].topic[:80]!r} and as {record.topic[:80]!r}; the file is damaged"
            )
        wanted = self.topics is None or record.topic in self.topics
        self.channels[record.id] = (record, schema, wanted)


def _expand(kind: str, packed: bytes, size: int, place: str) -> bytes:
    if kind == "":
        return packed
    if kind == "zstd":
        import zstandard

        try:
            reader = zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(
                io.BytesIO(packed), read_across_frames=True
            )
            return bytes(reader.read(size + 1))
        except (zstandard.ZstdError, MemoryError) as error:
            raise InvalidData(f"{place}: the chunk is damaged: {error}") from None
    if kind == "lz4":
        import lz4.frame

        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
        except (RuntimeError, EOFError, ValueError, MemoryError) as error:
            raise InvalidData(f"{place}: the chunk is damaged: {error}") from None
    raise InvalidData(
        f"{place}: the chunk is compressed as {kind!r}; read are '', 'zstd' and 'lz4'. "
        "'mcap compress' (of the mcap command line tool) writes it anew"
    )
