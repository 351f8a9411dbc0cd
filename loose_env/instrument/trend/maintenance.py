"""Maintenance records of an arm from a JSON file, and points in time of ISO 8601 dates."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from loose_env.errors import InvalidData

_EXAMPLE = '[{"date": "2026-05-04", "joint": "elbow", "work": "gear replaced"}]'
_KEYS = ("date", "joint", "link", "work", "note")


@dataclass(frozen=True, kw_only=True)
class Maintenance:
    """One piece of work on an arm.

    Examples
    --------
    >>> Maintenance(date="2026-05-04", joint="elbow", work="gear replaced").where
    'elbow'
    >>> Maintenance(date="4 May", joint="elbow", work="gear replaced")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: a date is as 2026-05-04 or 2026-05-04T10:30, got '4 May'
    """

    date: str
    """Date, or date and time (ISO 8601)."""
    work: str
    """What was done."""
    joint: str | None = None
    """The model's name of the joint."""
    link: str | None = None
    """The model's name of the body, where the work was on a link."""
    note: str = ""
    """Further words."""

    def __post_init__(self) -> None:
        """Check."""
        time_of(self.date)
        if (self.joint is None) == (self.link is None):
            raise InvalidData(
                "a maintenance record names a joint or a link, one of the two, got joint "
                f"{self.joint!r:.60} and link {self.link!r:.60}"
            )

    @property
    def where(self) -> str:
        """Name of the joint or link."""
        return self.joint or self.link or ""


def time_of(date: str) -> datetime:
    """Point in time of an ISO 8601 date; without a time zone it is taken as UTC.

    Raises
    ------
    InvalidData
        If it is none.

    Examples
    --------
    >>> time_of("2026-05-04").isoformat()
    '2026-05-04T00:00:00+00:00'
    """
    try:
        found = datetime.fromisoformat(date)
    except (TypeError, ValueError):
        raise InvalidData(
            f"a date is as 2026-05-04 or 2026-05-04T10:30, got {date!r:.60}"
        ) from None
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def read_maintenance(path: str | Path, names: Sequence[str] = ()) -> tuple[Maintenance, ...]:
    """Read maintenance records.

    Parameters
    ----------
    path : str or Path
        JSON file: a list of objects with "date", "joint" or "link", "work" and "note".
    names : sequence of str
        Joints and links of the arm; others are refused. Any name is taken where it is empty.

    Returns
    -------
    tuple of Maintenance
        By date.

    Raises
    ------
    InvalidData
        If the file cannot be read, or an entry is none; the message names file and entry.

    Examples
    --------
    >>> read_maintenance("no/such/file.json")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: no/such/file.json: the maintenance records cannot be read: No ...
    """
    file = Path(path)
    try:
        whole = json.loads(file.read_text("utf-8-sig"))
    except OSError as error:
        why = error.strerror or error
        raise InvalidData(f"{file}: the maintenance records cannot be read: {why}") from None
    except (ValueError, RecursionError) as error:
        where = f" from line {error.lineno} on" if isinstance(error, json.JSONDecodeError) else ""
        raise InvalidData(f"{file}: no JSON{where}; records are as {_EXAMPLE}") from None
    if not isinstance(whole, list):
        raise InvalidData(f"{file}: a list of records is needed, as {_EXAMPLE}, not {whole!r:.60}")
    found = []
    for k, entry in enumerate(whole):
        try:
            found.append(_record(entry, names))
        except InvalidData as error:
            raise InvalidData(f"{file}: record {k + 1}: {error}") from None
    return tuple(sorted(found, key=lambda record: time_of(record.date)))


def _record(entry: Any, names: Sequence[str]) -> Maintenance:
    if not isinstance(entry, dict):
        raise InvalidData(f"an object is needed, not {entry!r:.60}")
    unknown = sorted(set(entry) - set(_KEYS))
    if unknown:
        raise InvalidData(f"{unknown[0]!r:.60} is none of its keys: {', '.join(_KEYS)}")
    for key in ("date", "work"):
        if not isinstance(entry.get(key), str) or not entry[key].strip():
            raise InvalidData(f"{key!r} is a text that is not empty, got {entry.get(key)!r:.60}")
    for key in ("joint", "link", "note"):
        if not isinstance(entry.get(key, ""), str):
            raise InvalidData(f"{key!r} is a text, got {entry[key]!r:.60}")
    record = Maintenance(**entry)
    if names and record.where not in names:
        raise InvalidData(
            f"the arm has no joint or link {record.where!r:.60}; it has {', '.join(names)}"
        )
    return record
