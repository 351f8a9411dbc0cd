"""Dates as loggers write them."""

from __future__ import annotations

import datetime
import re

from loose_env.errors import InvalidData

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_FRACTION = re.compile(r"(?<=:\d\d)[.,](\d{1,9})\d*")


def date_ns(words: str, date_format: str, place: str) -> int:
    """Read a date.

    Parameters
    ----------
    words : str
        The date.
    date_format : str
        "iso" for ISO 8601, with up to nine digits of a second, or a format of ``strptime``.
        Without a time zone it is taken for UTC.
    place : str
        Where it was given.

    Returns
    -------
    int
        Nanoseconds since 1970.

    Raises
    ------
    InvalidData
        If it is no such date.

    Examples
    --------
    >>> date_ns("1970-01-01T00:00:01.000000250Z", "iso", "here")
    1000000250
    >>> date_ns("02.01.1970 00:00:00", "%d.%m.%Y %H:%M:%S", "here") // 10**9
    86400
    """
    nanos = 0
    given = words.strip()
    try:
        if date_format == "iso":
            found = _FRACTION.search(given)
            if found:  # Python's own dates end at the microsecond
                nanos = int(found.group(1).ljust(9, "0"))
                given = given[: found.start()] + given[found.end() :]
            date = datetime.datetime.fromisoformat(given)
        else:
            date = datetime.datetime.strptime(given, date_format)
        if date.tzinfo is None:
            date = date.replace(tzinfo=datetime.UTC)
        since = date - _EPOCH
    except (ValueError, OverflowError, re.error):
        raise InvalidData(
            f"{place}: {words[:60]!r} is no date of the form "
            f"{'2024-05-01T10:00:03.5Z (ISO 8601)' if date_format == 'iso' else date_format!r}"
        ) from None
    return (since.days * 86400 + since.seconds) * 10**9 + since.microseconds * 1000 + nanos
