"""Validation of a table of a mapping file against the dataclasses that it fills.

A key is a field of the dataclass; type, default and metadata of the field are its rule. Errors
give the location in the file, the rejected value and the allowed ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from loose_env.errors import InvalidData
from loose_env.recording import nearest

_SCALARS = (str, bool, int, float, tuple[str, ...])
_LARGEST = 1e18
"""Bound of a number that states none, in its unit."""


def within(low: float, high: float) -> dict[str, Any]:
    """Metadata of a numeric field: its bounds, both included."""
    return {"within": (low, high)}


def among(*allowed: str) -> dict[str, Any]:
    """Metadata of a text field: the allowed values."""
    return {"among": allowed}


_KNOWN: dict[type[Any], dict[str, tuple[Field[Any], Any]]] = {}


class Fields:
    """A table of a mapping file, checked against dataclasses.

    Examples
    --------
    >>> from loose_env.importing.samples import ChannelKey
    >>> Fields("map.toml: columns.q", {"chanel": "a"}, ChannelKey)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: map.toml: columns.q: unknown key 'chanel'; known are channel,
    topic; did you mean 'channel'?
    """

    def __init__(
        self,
        place: str,
        given: Any,
        *kinds: type[Any],
        also: Sequence[str] = (),
        without: Sequence[str] = (),
    ) -> None:
        self.without = frozenset(without)
        known = [k for kind in kinds for k in _scalars(kind) if k not in self.without] + [*also]
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
        """Location of a key."""
        return f"{self.place}.{key}"

    def values(self, kind: type[Any]) -> dict[str, Any]:
        """Checked values of the scalar fields of a dataclass; defaults are left to it."""
        found = {}
        for key, (field, allowed) in _scalars(kind).items():
            if key in self.without:
                continue
            if key in self.given:
                found[key] = _checked(self.at(key), self.given[key], allowed, field.metadata)
            elif field.default is MISSING and field.default_factory is MISSING:
                raise InvalidData(f"{self.place}: {key!r} is missing")
        return found

    def text(self, key: str, default: str | None = None) -> str:
        """Text of a key; required where there is no default."""
        if key in self.given:
            return text(self.at(key), self.given[key])
        if default is None:
            raise InvalidData(f"{self.place}: {key!r} is missing")
        return default

    def table(self, key: str) -> Mapping[str, Any]:
        """Table with keys of the user's choice; empty where the key is absent."""
        value = self.given.get(key, {})
        if not isinstance(value, dict):
            raise InvalidData(f"{self.at(key)} is a table, {got(value)}")
        for name in value:
            if not isinstance(name, str) or not name or not name.isprintable():
                raise InvalidData(f"{self.at(key)}: {name!r:.60} is no name")
        return value


def _scalars(kind: type[Any]) -> dict[str, tuple[Field[Any], Any]]:
    """Fields of scalar types by name, each with its type less None."""
    if kind in _KNOWN:
        return _KNOWN[kind]
    hints = get_type_hints(kind)
    found: dict[str, tuple[Field[Any], Any]] = {}
    for field in fields(kind):
        hint = hints[field.name]
        if get_origin(hint) in (Union, UnionType):
            rest = [each for each in get_args(hint) if each is not NoneType]
            hint = rest[0] if len(rest) == 1 else hint
        if hint in _SCALARS or get_origin(hint) is Literal:
            found[field.name] = (field, hint)
    return _KNOWN.setdefault(kind, found)


def _checked(place: str, value: Any, kind: Any, rule: Mapping[str, Any]) -> Any:
    choices = get_args(kind) if get_origin(kind) is Literal else rule.get("among", ())
    if kind is bool:
        if not isinstance(value, bool):
            raise InvalidData(f"{place} is true or false, {got(value)}")
        return value
    if kind is float:
        return number(place, value, *rule.get("within", (-_LARGEST, _LARGEST)))
    if kind is int:
        low, high = rule["within"]
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise InvalidData(f"{place} is a whole number from {low} to {high}, {got(value)}")
        return value
    if kind == tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            raise InvalidData(f"{place} is a list of texts, {got(value)}")
        if len(set(value)) < len(value):
            raise InvalidData(f"{place} names something twice: {value!r:.80}")
        return tuple(value)
    if choices and not isinstance(choices[0], str):
        if isinstance(value, bool) or value not in choices:
            raise InvalidData(f"{place} is {' or '.join(map(str, choices))}, {got(value)}")
        return int(value)
    found = text(place, value)
    if choices and found not in choices:
        raise InvalidData(
            f"{place} is {found[:40]!r}; it is one of {', '.join(map(repr, choices))}"
            f"{nearest(found[:40], choices)}"
        )
    return found


def text(place: str, value: Any) -> str:
    """Check a printable text that is not empty."""
    if not isinstance(value, str) or not (value.isprintable() or value == "\t") or not value:
        raise InvalidData(f"{place} is a text in quotes, {got(value)}")
    return value


def number(place: str, value: Any, low: float = -_LARGEST, high: float = _LARGEST) -> float:
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
    """Describe a rejected value."""
    try:
        words = repr(value)
    except (RecursionError, ValueError):  # a number of thousands of digits has no repr
        words = type(value).__name__
    return f"got {words if len(words) <= 60 else words[:60] + '...'}"
