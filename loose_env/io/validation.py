"""Validation of settings: types and ranges stated in the annotations of a dataclass.

A field is annotated with its type, or with one of the rules below, such as
``rate: Positive = 1000.0``; `Checked` refuses values that do not satisfy it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from loose_env.errors import InvalidSetting

__all__ = [
    "Checked",
    "Count",
    "NonNegative",
    "NonNegativeCount",
    "Positive",
    "Probability",
    "Rule",
    "all_of",
    "check_fields",
    "is_finite",
    "is_whole",
    "positive",
    "unmet",
]


@dataclass(frozen=True)
class Rule:
    """Condition on a value, written as metadata of an annotated field."""

    words: str
    """Allowed values, as an error states them."""
    allows: Callable[[Any], bool]
    """Function that returns True for an allowed value."""


def is_finite(value: object) -> bool:
    """Return whether a value is one finite real number; truth values are none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def is_whole(value: object) -> bool:
    """Return whether a value is a whole number; truth values are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


NonNegative = Annotated[
    float, Rule("a finite number, zero or more", lambda x: is_finite(x) and x >= 0)
]
"""Number from zero."""
Positive = Annotated[float, Rule("positive and finite", lambda x: is_finite(x) and x > 0)]
"""Number above zero."""
Probability = Annotated[
    float, Rule("a probability between 0 and 1", lambda x: is_finite(x) and 0 < x < 1)
]
"""Number above 0 and below 1."""
Count = Annotated[int, Rule("a whole number, 1 or more", lambda x: is_whole(x) and x >= 1)]
"""Whole number from 1."""
NonNegativeCount = Annotated[
    int, Rule("a whole number, 0 or more", lambda x: is_whole(x) and x >= 0)
]
"""Whole number from 0."""


def positive(unit: str) -> Rule:
    """Rule of a number above zero, with its unit."""
    return Rule(f"positive {unit}", lambda value: is_finite(value) and value > 0)


def all_of(values: object, allows: Callable[[Any], bool], *, least: int = 0) -> bool:
    """Return whether a value is a sequence of so many entries that a condition allows."""
    return (
        isinstance(values, Sequence)
        and not isinstance(values, str)
        and len(values) >= least
        and all(map(allows, values))
    )


class Checked:
    """Base of settings dataclasses that check their fields when they are made."""

    def __post_init__(self) -> None:
        check_fields(self)


def check_fields(settings: Any) -> None:
    """Refuse values that the annotations of a dataclass do not allow.

    Numbers, words, one of several words, tuples, dataclasses and optional fields are checked;
    fields of any other type are not.

    Raises
    ------
    InvalidSetting
        Naming the first such field, the allowed values and the value given.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Own(Checked):
    ...     most: int = 3
    ...     share: NonNegative | None = None
    >>> Own(share=1).share
    1
    >>> Own(most=2.5)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: Own.most must be a whole number; got 2.5
    """
    kind: Any = type(settings)
    for name, check in _checks(kind):
        value = getattr(settings, name)
        words = check(value)
        if words:
            raise InvalidSetting(f"{kind.__name__}.{name} must be {words}; got {value!r:.200}")


_Check = Callable[[Any], str]
"""Function of a value: allowed values where it is none of them; "" where it is one."""


@cache
def _checks(kind: Any) -> tuple[tuple[str, _Check], ...]:
    hints = get_type_hints(kind, include_extras=True)
    return tuple((each.name, _check(hints[each.name])) for each in fields(kind))


def unmet(hint: Any, value: Any) -> str:
    """Allowed values where a value is none of them; "" where it is one."""
    return _check(hint)(value)


def _check(hint: Any) -> _Check:
    """Turn a type hint into its check, so that it is taken apart once."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        rules = [rule for rule in inside[1:] if isinstance(rule, Rule)]
        return lambda value: next((rule.words for rule in rules if not rule.allows(value)), "")
    if origin in (Union, UnionType):
        return _check_union(inside)
    if origin is Literal:
        words = f"one of {', '.join(map(repr, inside))}"
        return lambda value: "" if value in inside else words
    if origin is tuple:
        return _check_entries(inside)
    if hint in _PLAIN:
        plain, fits = _PLAIN[hint]
        return lambda value: "" if fits(value) else plain
    if isinstance(hint, type) and hasattr(hint, "__dataclass_fields__"):
        name = f"a {hint.__name__}"
        return lambda value: "" if isinstance(value, hint) else name
    return lambda value: ""


def _check_union(inside: Sequence[Any]) -> _Check:
    optional = NoneType in inside
    checks = [_check(one) for one in inside if one is not NoneType]

    def check(value: Any) -> str:
        if value is None and optional:
            return ""
        found = [one(value) for one in checks]
        return "" if "" in found else " or ".join(found)

    return check


def _check_entries(inside: Sequence[Any]) -> _Check:
    """Check of a tuple, list or array."""
    if len(inside) == 2 and inside[1] is Ellipsis:
        count, each = None, _check(inside[0])
    else:
        count, each = len(inside), _check(inside[0])

    def check(value: Any) -> str:
        try:
            entries = None if isinstance(value, str | Mapping) else tuple(value)
        except TypeError:
            entries = None
        found = None
        if entries is not None and count in (None, len(entries)):
            found = next(filter(None, map(each, entries)), "")
        if found is None:
            found = each(object()) or "of the right type"
        return found and f"{'several' if count is None else count} values, each {found}"

    return check


_PLAIN: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    float: ("a finite number", is_finite),
    int: ("a whole number", is_whole),
    bool: ("true or false", lambda value: isinstance(value, bool | np.bool_)),
    str: ("text", lambda value: isinstance(value, str)),
}
