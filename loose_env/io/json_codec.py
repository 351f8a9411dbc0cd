"""Plain values of a JSON file: from dataclasses, and back.

The text of a result file, and reading it back with errors that name the file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from loose_env.errors import InvalidData

__all__ = ["json_text", "plain", "read_result_file", "restored", "whole_of"]

T = TypeVar("T")


def plain(value: Any, *, digits: int = 7) -> Any:
    """Make values that JSON has, inside mappings and lists too.

    Parameters
    ----------
    value : object
        Mappings, sequences, strings, paths and numbers, those of numpy too.
    digits : int
        What a number is worth. One that is not finite becomes None.

    Examples
    --------
    >>> plain({"x": (1, 2 / 3), "y": float("nan")}, digits=3)
    {'x': [1, 0.667], 'y': None}
    """
    if isinstance(value, Mapping):
        return {str(k): plain(v, digits=digits) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v, digits=digits) for v in value]
    if value is None or isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, Path):
        return str(value)
    number = float(value)
    return float(f"{number:.{digits}g}") if math.isfinite(number) else None


def restored(kind: type[T], value: Any, place: str) -> T:
    """Restore a dataclass, with those inside it, from mappings and lists.

    Keys that the dataclass does not have are left out, since later versions may write more.

    Parameters
    ----------
    kind : type
        The dataclass.
    value : object
        What was read.
    place : str
        Where it stands in the file, as errors say it.

    Raises
    ------
    InvalidData
        If a value is missing or of another kind.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Point:
    ...     x: float
    ...     names: tuple[str, ...] = ()
    >>> restored(Point, {"x": 1, "names": ["a", "b"]}, "point")
    Point(x=1.0, names=('a', 'b'))
    >>> restored(Point, {"names": []}, "point")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: point: 'x' is missing
    """
    found: T = _restored(kind, value, place)
    return found


def _restored(kind: Any, value: Any, place: str) -> Any:
    origin, inside = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if is_dataclass(kind):
        return _dataclass(kind, value, place)
    if origin in (Union, UnionType):
        if value is None and NoneType in inside:
            return None
        return _restored(next(k for k in inside if k is not NoneType), value, place)
    if origin is Literal:
        if value not in inside:
            raise InvalidData(f"{place}: {value!r:.60} is none of {list(inside)}")
        return value
    if origin is tuple:
        return _tuple(inside, value, place)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise InvalidData(f"{place}: a mapping is needed, not {value!r:.60}")
        return {k: _restored(inside[1], v, f"{place}.{k}") for k, v in value.items()}
    return _scalar(kind, value, place)


def _dataclass(kind: Any, value: Any, place: str) -> Any:
    if not isinstance(value, Mapping):
        raise InvalidData(f"{place}: a mapping is needed, not {value!r:.60}")
    hints = get_type_hints(kind)
    given = {}
    for each in fields(kind):
        if each.name in value:
            given[each.name] = _restored(hints[each.name], value[each.name], f"{place}.{each.name}")
        elif each.default is MISSING and each.default_factory is MISSING:
            raise InvalidData(f"{place}: {each.name!r} is missing")
    return kind(**given)


def _tuple(inside: tuple[Any, ...], value: Any, place: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise InvalidData(f"{place}: a list is needed, not {value!r:.60}")
    if len(inside) == 2 and inside[1] is Ellipsis:
        return tuple(_restored(inside[0], v, f"{place}[{k}]") for k, v in enumerate(value))
    if len(value) != len(inside):
        raise InvalidData(f"{place}: {len(inside)} values are needed, not {len(value)}")
    return tuple(
        _restored(each, v, f"{place}[{k}]")
        for k, (each, v) in enumerate(zip(inside, value, strict=True))
    )


def _scalar(kind: Any, value: Any, place: str) -> Any:
    if kind is float and value is None:
        return math.nan  # JSON has no word for it; the one object, so that results compare equal
    wanted = {float: (int, float), int: (int,), str: (str,), bool: (bool,)}[kind]
    if not isinstance(value, wanted) or (kind is not bool and isinstance(value, bool)):
        raise InvalidData(f"{place}: {kind.__name__} is needed, not {value!r:.60}")
    try:
        return kind(value)
    except OverflowError:
        raise InvalidData(f"{place}: a number of up to 308 digits is needed") from None


def json_text(whole: Mapping[str, Any], *, digits: int = 7) -> str:
    """Text of a file; numbers that are not finite become null.

    Examples
    --------
    >>> print(json_text({"gap": 2 / 3, "after": float("inf")}, digits=3), end="")
    {
     "gap": 0.667,
     "after": null
    }
    """
    values = plain(whole, digits=digits)
    return json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def whole_of(text: str, *, format: str, noun: str) -> dict[str, Any]:
    """Read the text of a file of some format.

    Parameters
    ----------
    text : str
        The text.
    format : str
        What its "format" has to be.
    noun : str
        What errors call it.

    Raises
    ------
    InvalidData
        If it is no JSON, or none of the format.
    """
    try:
        whole = json.loads(text, parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"the {noun} is no JSON: {error}") from None
    if not isinstance(whole, dict) or whole.get("format") != format:
        given = whole.get("format") if isinstance(whole, dict) else whole
        raise InvalidData(f"a {noun} of the format {format!r} is needed, not {given!r:.60}")
    return whole


def read_result_file(path: str | Path, parse: Callable[[str], T], *, noun: str) -> T:
    """Read a file, or ``result.json`` of a folder; errors begin with the file's name.

    Parameters
    ----------
    path : str or Path
        The file, or the folder.
    parse : callable
        Makes of the text what it stands for.
    noun : str
        What errors call it.

    Raises
    ------
    InvalidData
        If it cannot be read, or ``parse`` refuses it.
    """
    file = Path(path)
    if file.is_dir():
        file = file / "result.json"
    try:
        text = file.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise InvalidData(f"{file}: the {noun} cannot be read: {why}") from None
    try:
        return parse(text)
    except InvalidData as error:
        raise InvalidData(f"{file}: {error}") from None


def _refused(word: str) -> float:
    """Refuse the words for numbers that JSON does not have."""
    raise ValueError(f"{word} is no number of JSON; unknown ones are null")
