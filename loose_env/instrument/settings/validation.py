"""Type checks of a settings dataclass, and settings read from a mapping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar, get_origin, get_type_hints

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import unmet

T = TypeVar("T")


def check_types(settings: Any) -> None:
    """Refuse values of other types: settings come from files and from Python too.

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
        words = unmet(hints[each.name], value)
        if words:
            raise InvalidSetting(f"{each.name} is {words}, got {value!r:.60}")


def settings_within(kind: type[T], values: Mapping[str, Any], place: str) -> T:
    """Settings read from a mapping; unknown keys are ignored.

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
