"""Exceptions raised by loose-env, and the message of any error in one line."""

from __future__ import annotations

import errno

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS)


class LooseEnvError(Exception):
    """Base of every error raised by loose-env."""


class InvalidSetting(LooseEnvError, ValueError):
    """A setting lies outside what is allowed."""


class UnknownName(LooseEnvError, ValueError):
    """A name is none of those that exist."""


class InvalidAction(LooseEnvError, ValueError):
    """An action lies outside the action space."""


class MissingExtra(LooseEnvError, ImportError):
    """An optional package is needed and not installed."""


class InvalidData(LooseEnvError, ValueError):
    """Measured data has a shape, a length or values that cannot be used."""


def words_of(error: BaseException) -> str:
    """Error message in one line; for errors of the operating system with a remedy.

    Examples
    --------
    >>> words_of(OSError(errno.ENOSPC, "No space left on device", "out/rows.parquet"))
    "the disk is full, or the file too large for it: 'out/rows.parquet'; free some ..."
    >>> words_of(OSError(errno.EACCES, "Permission denied", "run-01.csv"))
    "no permission: 'run-01.csv'; choose another folder, or change who may read or write there"
    """
    said = " ".join(str(error).split())
    if not isinstance(error, OSError):
        return said
    where = f": {str(error.filename)!r}" if error.filename else ""
    if error.errno in _FULL:
        return (
            f"the disk is full, or the file too large for it{where}; free some space or write "
            "elsewhere"
        )
    if error.errno in _CLOSED:
        return f"no permission{where}; choose another folder, or change who may read or write there"
    if error.errno in (errno.ENOTDIR, errno.EEXIST):
        return f"a file lies where a folder is needed{where}; choose another folder"
    return said
