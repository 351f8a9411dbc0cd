"""Paths to numbers in a message, such as ``position[elbow]``; fields and time stamps of one."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any

from loose_env.errors import InvalidData
from loose_env.recording import nearest

_PART = re.compile(r"([^.\[\]]+)|\[([^\[\]]+)\]")
_LONGEST = 500
_LABELS = ("name", "names", "joint_names", "label", "labels")
"""Fields that may name the entries of the arrays beside them."""
_SECONDS = ("sec", "seconds", "secs")
_NANOSECONDS = ("nanosec", "nsec", "nanos", "nsecs")
_DEEPEST = 12


@dataclass(frozen=True)
class FieldPath:
    """A way into a message, part by part.

    Examples
    --------
    >>> path = FieldPath.parse("position[elbow]", "here")
    >>> path.find({"name": ["wrist", "elbow"], "position": [0.1, 0.2]})
    0.2
    >>> FieldPath.parse("axes[2]", "here").find({"axes": [0.0, 1.0, 0.5]})
    0.5
    """

    words: str
    """As it was given."""
    parts: tuple[tuple[str, str], ...]
    """Each a field and, where an entry of it is taken, its number or name, else ""."""

    @classmethod
    def parse(cls, words: str, place: str) -> FieldPath:
        """Read a path."""
        parts: list[tuple[str, str]] = []
        end = 0
        if len(words) <= _LONGEST:
            for found in _PART.finditer(words):
                dot = words[end : found.start()]
                name, entry = found.groups()
                if dot != ("." if name and parts else "") or (entry and not parts):
                    break
                if name:
                    parts.append((name, ""))
                elif parts[-1][1]:
                    break
                else:
                    parts[-1] = (parts[-1][0], entry)
                end = found.end()
        if end != len(words) or not parts:
            raise InvalidData(
                f"{place}: {words[:60]!r} is no way to a number in a message; write fields with "
                "dots and entries in brackets, such as 'position[elbow]' or 'data[0]'"
            )
        return cls(words, tuple(parts))

    def find(self, message: Any) -> Any:
        """Follow the path."""
        here = message
        for name, entry in self.parts:
            holder = here
            here = _field(holder, name)
            if entry and here is not None:
                here = _entry(holder, name, here, entry)
            if here is None:
                return None
        return here


def fields_of(holder: Any) -> Sequence[str]:
    """Names of the fields of a decoded message: of JSON, ROS 2 or protobuf."""
    if isinstance(holder, dict):
        return [str(name) for name in holder]
    kind: Any = type(holder)
    return _own_fields(kind)


@lru_cache(maxsize=4096)
def _own_fields(kind: Any) -> tuple[str, ...]:
    descriptor = getattr(kind, "DESCRIPTOR", None)
    if descriptor is not None:
        return tuple(field.name for field in descriptor.fields)
    slots = kind.__dict__.get("__slots__")
    return tuple(str(name) for name in slots) if isinstance(slots, list) else ()


def is_array(value: Any) -> bool:
    """True for a list of some kind, not for text, bytes or an object with fields."""
    if isinstance(value, (list, tuple)):
        return True
    return (
        not isinstance(value, (str, bytes, bytearray, dict, int, float))
        and hasattr(value, "__len__")
        and hasattr(value, "__getitem__")
        and not hasattr(value, "keys")
    )


def leaves(message: Any, most: int) -> Iterator[tuple[str, float]]:
    """Numbers of a message with the paths to them, at most ``most`` of them.

    Entries of an array are named by the array of names beside it, where there is one.
    """
    yield from islice(_walk(message, "", 0), most)


def stamp_ns(value: Any) -> int | None:
    """Time of a stamp [ns], where a value is one: an object of seconds and nanoseconds."""
    names = fields_of(value)
    seconds = next((n for n in _SECONDS if n in names), None)
    rest = next((n for n in _NANOSECONDS if n in names), None)
    if seconds is None or rest is None:
        return None
    whole, nanos = _field(value, seconds), _field(value, rest)
    if not all(isinstance(n, int) and not isinstance(n, bool) for n in (whole, nanos)):
        return None
    return int(whole) * 1_000_000_000 + int(nanos)


def _walk(here: Any, words: str, depth: int) -> Iterator[tuple[str, float]]:
    if isinstance(here, (bool, int, float)):
        yield words, float(here)
        return
    if depth == _DEEPEST or isinstance(here, (str, bytes, bytearray)) or here is None:
        return
    if stamp_ns(here) is not None:
        return  # a time, offered as a stamp and not as a value
    for name in fields_of(here):
        if not _PART.fullmatch(name) or name.endswith("covariance"):
            continue  # nine numbers that no column takes
        value = _field(here, name)
        start = f"{words}.{name}" if words else name
        if not is_array(value):
            yield from _walk(value, start, depth + 1)
            continue
        labels = _labels(here, len(value))
        for i in range(min(len(value), 256)):
            label = labels(i) if labels else str(i)
            yield from _walk(value[i], f"{start}[{label}]", depth + 1)


def _labels(holder: Any, length: int) -> Callable[[int], str] | None:
    found = _label_array(holder)
    if found is None or not 0 < len(found) == length:
        return None
    words = [str(each) for each in found]
    if len(set(words)) < length or any(not w or set(w) & set("[]") for w in words):
        return None
    return words.__getitem__


def _label_array(holder: Any) -> Any:
    """Array that names the entries of the arrays beside it, or None."""
    there = holder if isinstance(holder, dict) else fields_of(holder)
    for label in _LABELS:
        if label in there:
            found = holder[label] if isinstance(holder, dict) else getattr(holder, label)
            if is_array(found):
                return found
    return None


def _field(holder: Any, name: str) -> Any:
    if isinstance(holder, dict):
        if name in holder:
            return holder[name]
    elif name in fields_of(holder):
        return getattr(holder, name, None)
    names = fields_of(holder)
    if not names:
        raise KeyError(f"there is no field {name!r}: what holds it has no fields")
    raise KeyError(
        f"there is no field {name!r}; there are {', '.join(map(repr, names[:12]))}"
        f"{nearest(name, names)}"
    )


def _entry(holder: Any, name: str, array: Any, entry: str) -> Any:
    if not is_array(array) and not isinstance(array, (bytes, bytearray)):
        raise KeyError(f"the field {name!r} is no array; leave out [{entry}]")
    if entry.isascii() and entry.isdigit():
        index = int(entry) if len(entry) < 10 else len(array)
        return array[index] if index < len(array) else None
    labels = _label_array(holder)
    if labels is not None:
        try:
            found = list(labels).index(entry)
        except ValueError:  # a joint that this message does not speak of: others of the topic do
            return None
        return array[found] if found < len(array) else None
    for each in array:
        own = fields_of(each)
        if any(label in own and _field(each, label) == entry for label in _LABELS):
            return each
    if len(array) and fields_of(array[0]):
        return None
    raise KeyError(
        f"the entries of {name!r} have no names; take one by its number, {name}[0] to "
        f"{name}[{max(len(array) - 1, 0)}]"
    )
