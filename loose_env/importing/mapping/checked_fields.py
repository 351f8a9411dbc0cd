"""Values of a mapping file, each checked where it is taken out, with its place in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from loose_env.errors import InvalidData
from loose_env.recording import nearest

__all__ = ["Fields", "got", "number"]


class Fields:
    """A table of a mapping file.

    Parameters
    ----------
    place : str
        Where it stands.
    given : object
        What the file holds there.
    known : sequence of str
        Its keys. Others are refused.

    Raises
    ------
    InvalidData
        If it is no table or has another key.

    Examples
    --------
    >>> Fields("map.toml: runs[0]", {"fil": "a"}, ("file", "pose"))
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: map.toml: runs[0]: unknown key 'fil'; known are file, pose; did
    you mean 'file'?
    """

    def __init__(self, place: str, given: Any, known: Sequence[str]) -> None:
        if not isinstance(given, dict):
            raise InvalidData(f"{place} is a table with the keys {', '.join(known)}, {got(given)}")
        for key in given:
            if key not in known:
                raise InvalidData(
                    f"{place}: unknown key {str(key)[:60]!r}; known are {', '.join(known)}"
                    f"{nearest(str(key)[:60], known)}"
                )
        self.place, self.given = place, given

    def at(self, key: str) -> str:
        """Place of a key."""
        return f"{self.place}.{key}"

    def has(self, key: str) -> bool:
        """Whether a key is given."""
        return key in self.given

    def text(self, key: str, default: str | None = None, among: Sequence[str] = ()) -> str:
        """Text, one of some where they are given; needed where there is no default."""
        if key not in self.given:
            if default is None:
                raise InvalidData(f"{self.place}: {key!r} is missing")
            return default
        value = self.given[key]
        if not isinstance(value, str) or not (value.isprintable() or value == "\t") or not value:
            raise InvalidData(f"{self.at(key)} is a text in quotes, {got(value)}")
        if among and value not in among:
            raise InvalidData(
                f"{self.at(key)} is {value[:40]!r}; it is one of {', '.join(map(repr, among))}"
                f"{nearest(value[:40], among)}"
            )
        return value

    def number(
        self, key: str, default: float | None = None, low: float = -1e18, high: float = 1e18
    ) -> float:
        """Finite number within bounds; needed where there is no default."""
        if key not in self.given:
            if default is None:
                raise InvalidData(f"{self.place}: {key!r} is missing")
            return default
        return number(self.at(key), self.given[key], low, high)

    def optional(self, key: str, low: float, high: float) -> float | None:
        """Number, or None where the key is not there."""
        return self.number(key, low=low, high=high) if key in self.given else None

    def whole(self, key: str, default: int, high: int) -> int:
        """Whole number from 0 on."""
        value = self.given.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= high:
            raise InvalidData(f"{self.at(key)} is a whole number from 0 to {high}, {got(value)}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Truth value."""
        value = self.given.get(key, default)
        if not isinstance(value, bool):
            raise InvalidData(f"{self.at(key)} is true or false, {got(value)}")
        return value

    def sign(self, key: str) -> int:
        """1 or -1."""
        value = self.given.get(key, 1)
        if isinstance(value, bool) or value not in (1, -1):
            raise InvalidData(f"{self.at(key)} is 1 or -1, {got(value)}")
        return int(value)

    def table(self, key: str) -> Mapping[str, Any]:
        """Table with keys of the user's choice; empty where it is not there."""
        value = self.given.get(key, {})
        if not isinstance(value, dict):
            raise InvalidData(f"{self.at(key)} is a table, {got(value)}")
        for name in value:
            if not isinstance(name, str) or not name or not name.isprintable():
                raise InvalidData(f"{self.at(key)}: {name!r:.60} is no name")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Texts, none of them twice."""
        value = self.given.get(key, [])
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            raise InvalidData(f"{self.at(key)} is a list of texts, {got(value)}")
        if len(set(value)) < len(value):
            raise InvalidData(f"{self.at(key)} names something twice: {value!r:.80}")
        return tuple(value)


def number(place: str, value: Any, low: float = -1e18, high: float = 1e18) -> float:
    """Check a finite number within bounds."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InvalidData(f"{place} is a number, {got(value)}")
    try:
        found = float(value)
    except OverflowError:
        found = math.inf
    if not math.isfinite(found) or not low <= found <= high:
        raise InvalidData(f"{place} is a number from {low:g} to {high:g}, got {value!s:.30}")
    return found


def got(value: Any) -> str:
    """Words for what was found in the place of something else."""
    try:
        words = repr(value)
    except (RecursionError, ValueError):  # a number of thousands of digits has no words
        words = type(value).__name__
    return f"got {words if len(words) <= 60 else words[:60] + '...'}"
