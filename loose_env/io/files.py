"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

__all__ = ["write_text", "written_beside"]


def written_beside(path: Path, write: Callable[[Path], None]) -> Path:
    """Let a file be written beside its place, and rename it into place.

    Parameters
    ----------
    path : Path
        Where the file goes; its folder is made where there is none.
    write : callable
        Told where to write.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        write(beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write a text as utf-8.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     write_text(Path(place, "a", "b.txt"), "words").read_text("utf-8")
    'words'
    """

    def write(beside: Path) -> None:
        beside.write_bytes(text.encode("utf-8"))

    return written_beside(path, write)
