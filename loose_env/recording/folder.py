"""Files of a recording's folder: paths that stay inside, and text that is UTF-8."""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath

from loose_env.errors import InvalidData

__all__ = ["existing_file", "inside", "read_bytes", "read_text"]

_OTHER = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}


def inside(folder: Path, given: str, place: str) -> Path:
    """Find where a path of a recording leads.

    Parameters
    ----------
    folder : Path
        The recording's folder, resolved.
    given : str
        The path, from that folder, with ``/`` between its parts.
    place : str
        Where it was given, as errors say it.

    Returns
    -------
    Path
        The file, resolved, whether it is there or not.

    Raises
    ------
    InvalidData
        If it is no path, is absolute, or leaves the folder, by ``..`` or by a link.

    Examples
    --------
    >>> inside(Path("/data"), "../other.csv", "recording.json: model")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: recording.json: model: '../other.csv' leaves the folder ...
    """
    if not given or not given.isprintable() or "\\" in given:
        raise InvalidData(
            f"{place}: {given!r:.200} is no path; give one from the recording's folder, with / "
            "between its parts"
        )
    if PurePosixPath(given).is_absolute() or PureWindowsPath(given).drive:
        raise InvalidData(f"{place}: {given!r:.200} is absolute; give a path from the folder")
    try:
        found = (folder / given).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidData(f"{place}: {given!r:.200} leads nowhere: {error}") from None
    if not found.is_relative_to(folder):
        raise InvalidData(
            f"{place}: {given!r:.200} leaves the folder of the recording; copy the file into it"
        )
    return found


def existing_file(folder: Path, given: str, place: str) -> Path:
    """Find a file that is there, as `inside`.

    Raises
    ------
    InvalidData
        If there is no such file, or it is a folder or a device.
    """
    found = inside(folder, given, place)
    try:
        there = found.is_file()
    except OSError as error:
        raise InvalidData(f"{place}: {given!r:.200} cannot be read: {error.strerror}") from None
    if not there:
        raise InvalidData(f"{place}: there is no file {given!r:.200} in {folder}")
    return found


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
