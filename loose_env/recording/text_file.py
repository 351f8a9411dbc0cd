"""Reading a file as UTF-8, or saying where it is not."""

from __future__ import annotations

from pathlib import Path

from loose_env.errors import InvalidData

__all__ = ["read_bytes", "read_text"]

_OTHER = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}


def read_bytes(file: Path, name: str, most: int) -> bytes:
    """Read a file of at most ``most`` bytes.

    Raises
    ------
    InvalidData
        If it is longer or cannot be read.
    """
    try:
        size = file.stat().st_size
        if size > most:
            raise InvalidData(f"{name}: {size} bytes; at most {most} are read")
        return file.read_bytes()
    except OSError as error:
        raise InvalidData(f"{name}: it cannot be read: {error.strerror or error}") from None


def read_text(file: Path, name: str, most: int) -> str:
    """Read a file of UTF-8, with or without the byte order mark that some programs put first.

    Raises
    ------
    InvalidData
        If it is not UTF-8, longer than ``most`` bytes, or cannot be read.
    """
    raw = read_bytes(file, name, most)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        other = _OTHER.get(raw[:2])
        raise InvalidData(
            f"{name}: line {line} is not UTF-8{f', the file looks like {other}' if other else ''}: "
            f"byte {error.start + 1} is 0x{raw[error.start]:02x}; save the file as UTF-8"
        ) from None
