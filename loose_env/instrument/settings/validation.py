"""Whether the values of a settings dataclass are of the types that its fields say."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from numbers import Real
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from loose_env.errors import InvalidData, InvalidSetting

__all__ = ["check_types", "settings_within"]

T = TypeVar("T")


def check_types(settings: Any) -> None:
    """Refuse values of other types: settings come from files and from Python too.

    Parameters
    ----------
    settings : dataclass
        With fields that are numbers, words, lists of numbers, or one of some words.

    Raises
    ------
    InvalidSetting
        Naming the first field that is of another type.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Own:
    ...     most: int = 3
    ...     share: float | None = None
    >>> check_types(Own(share=1))
    >>> check_types(Own(most=2.5))
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: most is a whole number, got 2.5
    """
    hints = get_type_hints(type(settings))
    for each in fields(settings):
        value = getattr(settings, each.name)
        words = _wanted(hints[each.name], value)
        if words:
            raise InvalidSetting(f"{each.name} is {words}, got {value!r:.60}")


def settings_within(kind: type[T], values: Mapping[str, Any], place: str) -> T:
    """Settings that were written to a file; what else it has is left out.

    Parameters
    ----------
    kind : type
        A settings dataclass that checks itself.
    values : mapping
        What the file has.
    place : str
        Where it stands there, as errors say it.

    Raises
    ------
    InvalidData
        If one of them is of another type, or makes no sense.

    Examples
    --------
    >>> from loose_env.instrument.settings.measurement import NextSettings
    >>> settings_within(NextSettings, {"poses": 8, "sure": 0.9}, "settings").poses
    8
    """
    hints, own = get_type_hints(kind), dict[str, Any]()
    for each in fields(kind):  # type: ignore[arg-type]
        if each.name in values:
            value = values[each.name]
            listed = get_origin(hints[each.name]) is tuple and isinstance(value, list)
            own[each.name] = tuple(value) if listed else value
    try:
        return kind(**own)
    except InvalidSetting as error:
        raise InvalidData(f"{place}: {error}") from None


def _wanted(hint: Any, value: Any) -> str:
    """What a value should be; "" if it is that."""
    if get_origin(hint) in (Union, UnionType):
        inside = [one for one in get_args(hint) if one is not NoneType]
        return "" if value is None else _wanted(inside[0], value)
    if get_origin(hint) is Literal:
        allowed = get_args(hint)
        return "" if value in allowed else f"one of {', '.join(map(repr, allowed))}"
    if get_origin(hint) is tuple:
        good = isinstance(value, tuple | list) and all(map(_is_number, value))
        return "" if good else "a list of numbers"
    words, fits = _PLAIN[hint]
    return "" if fits(value) else words


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


_PLAIN: dict[type, tuple[str, Callable[[Any], bool]]] = {
    float: ("a number", _is_number),
    int: ("a whole number", lambda value: isinstance(value, int) and not isinstance(value, bool)),
    str: ("a word", lambda value: isinstance(value, str)),
}
