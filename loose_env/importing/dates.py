"""Dates as loggers write them: format recognised from a column, and read in nanoseconds."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable

from loose_env.errors import InvalidData

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_FRACTION = re.compile(r"(?<=:\d\d)[.,](\d{1,9})\d*")
_NUMERIC = re.compile(
    r"(?P<a>\d{1,4})(?P<by>[./-])(?P<b>\d{1,2})(?P=by)(?P<c>\d{4}|\d{2})(?P<gap>[T ]\s*|, ?)"
    r"(?P<clock>\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?)(?P<half>\s*[AaPp][Mm])?",
    re.ASCII,
)
_CLOCK = re.compile(r"\d{1,2}:\d{2}:\d{2}([.,]\d+)?", re.ASCII)


def date_ns(words: str, date_format: str, place: str) -> int:
    """Read a date.

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
            fraction = next((end for end in (".%f", ",%f") if end in date_format), None)
            found = _FRACTION.search(given) if fraction else None
            if fraction:  # strptime ends at the microsecond, and whole seconds may lack the rest
                nanos = 0 if found is None else int(found.group(1).ljust(9, "0"))
                given = given if found is None else given[: found.start()] + given[found.end() :]
                date_format = date_format.replace(fraction, "")
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


def looks_like_a_date(words: str) -> bool:
    """Return whether a cell holds a date or a time of day rather than a number.

    Examples
    --------
    >>> looks_like_a_date("04.03.2025 10:11:12.345"), looks_like_a_date("12.5")
    (True, False)
    """
    given = words.strip()
    if _NUMERIC.fullmatch(given) or _CLOCK.fullmatch(given):
        return True
    try:
        date_ns(given, "iso", "")
    except InvalidData:
        return False
    return not given.isdigit()  # 20240501 is a number too


def date_format_of(cells: Iterable[str], place: str) -> str:
    """Recognise the format of a column of dates by all of its cells.

    The order of day and month is the one in which all cells are dates and the log is shortest;
    of equals, dots stand in dates with the day first.

    Examples
    --------
    >>> date_format_of(["04.03.2025 10:11:12.345"], "log.csv")
    '%d.%m.%Y %H:%M:%S.%f'
    >>> date_format_of(["02/13/2025 10:11:12"], "log.csv")
    '%m/%d/%Y %H:%M:%S'
    >>> date_format_of(["04/03/2025 10:11:12"], "log.csv")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: log.csv: '04/03/2025 10:11:12' may be '%d/%m/%Y %H:%M:%S' or ...
    """
    given = [cell.strip() for cell in cells if cell.strip()]
    if not given:
        raise InvalidData(f"{place}: the column of the time is empty")
    found = _NUMERIC.fullmatch(given[0])
    if found is None:
        return _plain_format(given[0], place)
    fraction = next((f"{m[0][0]}%f" for cell in given if (m := _FRACTION.search(cell))), "")
    half, by = found["half"] or "", found["by"]
    tail = f"{found['gap']}{'%I' if half else '%H'}:%M"
    tail += f"{':%S' if found['clock'].count(':') == 2 else ''}{fraction}"
    tail += f"{' ' * half.startswith(' ')}%p" if half else ""
    if len(found["a"]) == 4:
        return by.join(("%Y", "%m", "%d")) + tail
    year = "%Y" if len(found["c"]) == 4 else "%y"
    days = {cell.partition(found["gap"])[0]: cell for cell in given}.values()
    spans: dict[str, int] = {}
    for order in (("%d", "%m", year), ("%m", "%d", year)):
        try:
            own = [date_ns(cell, by.join(order) + tail, place) for cell in days]
        except InvalidData:
            continue
        spans[by.join(order) + tail] = max(own) - min(own)
    if not spans:
        raise InvalidData(f"{place}: {given[0]!r} and others are no dates of one form")
    best = [each for each, span in spans.items() if span == min(spans.values())]
    if len(best) == 1 or by == ".":
        return best[0]
    raise InvalidData(
        f"{place}: {given[0]!r} may be {best[0]!r} or {best[1]!r}; give date_format of them in the "
        "source's time"
    )


def _plain_format(given: str, place: str) -> str:
    """Format of a date that is ISO 8601, or of a time of day."""
    if _CLOCK.fullmatch(given):
        fraction = next((f"{c}%f" for c in ".," if c in given), ".%f")
        return f"%H:%M:%S{fraction}"
    try:
        date_ns(given, "iso", place)
    except InvalidData:
        raise InvalidData(
            f"{place}: {given[:60]!r} is no number and no date that is recognised; give "
            "date_format, such as '%d.%m.%Y %H:%M:%S.%f', or unit where it is a number"
        ) from None
    return "iso"
