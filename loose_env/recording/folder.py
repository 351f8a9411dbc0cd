"""Paths that stay inside a recording's folder."""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath

from loose_env.errors import InvalidData

__all__ = ["existing_file", "inside"]


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
