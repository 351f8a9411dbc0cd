"""Atomic writing of files: written under another name, then renamed."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

__all__ = ["write_bytes", "write_text", "written_beside"]


def written_beside(path: Path, write: Callable[[Path], object]) -> Path:
    """Write a file under another name in its folder, then rename it into place.

    Parameters
    ----------
    path : Path
        The file; its folder is made if it is missing.
    write : callable
        Writes the path it is called with.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        write(beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    return path


def write_bytes(path: Path, data: bytes) -> Path:
    """Write bytes, flushed to the disk before the file is renamed into place."""

    def write(beside: Path) -> None:
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())

    return written_beside(path, write)


def write_text(path: Path, text: str) -> Path:
    """Write a text as utf-8, as `write_bytes`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     write_text(Path(place, "a", "b.txt"), "words").read_text("utf-8")
    'words'
    """
    return write_bytes(path, text.encode("utf-8"))
