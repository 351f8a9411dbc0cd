"""Options of a command line from the fields of a settings dataclass.

Some hold for a session: what is not given is as it was.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from dataclasses import MISSING, Field, asdict, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from loose_env.io import field_words

T = TypeVar("T")

_METAVARS: dict[Any, str] = {int: "INT", float: "FLOAT", str: "NAME"}
"""Types that an option may have -> word for its value in the help."""


def add_settings(
    parser: argparse.ArgumentParser,
    kind: type,
    *,
    title: str = "settings",
    leave_out: Collection[str] = (),
) -> None:
    """Add an option for each field: its type, its default, and the docstring under it as help.

    A field that is a settings dataclass itself adds options of its own, ``--field-name``.

    Parameters
    ----------
    parser : ArgumentParser
        Takes the options.
    kind : type
        A dataclass whose fields have defaults.
    title : str
        Heading of these options in the help.
    leave_out : collection of str
        Fields that get no option; for fields inside others "field-name".

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Own:
    ...     tolerance: float = 0.03
    ...     most: int = 3
    >>> parser = argparse.ArgumentParser()
    >>> add_settings(parser, Own)
    >>> settings_of(parser.parse_args(["--most", "2"]), Own)
    Own(tolerance=0.03, most=2)
    """
    group = parser.add_argument_group(title)
    for name, each, hint, default, words in _flat(kind, ""):
        if name in leave_out:
            continue
        group.add_argument(
            f"--{name}",
            dest=name.replace("-", "_"),
            default=default,
            help=_help(words, each, default),
            **_how(hint, name),
        )


def settings_of(options: argparse.Namespace, kind: type[T], *, prefix: str = "") -> T:
    """Settings from parsed options; fields without an option keep their defaults."""
    hints = get_type_hints(kind)
    given: dict[str, Any] = {}
    for each in fields(kind):  # type: ignore[arg-type]
        name = f"{prefix}{each.name.replace('_', '-')}"
        hint = _bare(hints[each.name])
        if is_dataclass(hint) and isinstance(hint, type):
            given[each.name] = settings_of(options, hint, prefix=f"{name}-")
            continue
        value = getattr(options, name.replace("-", "_"), MISSING)
        if value is not MISSING:
            given[each.name] = tuple(value) if isinstance(value, list) else value
    return kind(**given)


def _flat(kind: type, prefix: str) -> list[tuple[str, Field[Any], Any, Any, str]]:
    """Option name, field, type, default and help of every field, nested ones included."""
    hints, words = get_type_hints(kind), field_words(kind)
    found = []
    for each in fields(kind):
        name = f"{prefix}{each.name.replace('_', '-')}"
        hint = _bare(hints[each.name])
        if is_dataclass(hint) and isinstance(hint, type):
            found += _flat(hint, f"{name}-")
            continue
        default = each.default if each.default_factory is MISSING else each.default_factory()
        found.append((name, each, hint, default, words.get(each.name, "")))
    return found


def _bare(hint: Any) -> Any:
    """Return a type without "or None"."""
    if get_origin(hint) in (Union, UnionType):
        inside = [each for each in get_args(hint) if each is not NoneType]
        return inside[0] if len(inside) == 1 else hint
    return hint


def _how(hint: Any, name: str) -> dict[str, Any]:
    """Keywords by which argparse reads a value of a type."""
    origin, inside = get_origin(hint), get_args(hint)
    if hint is bool:
        return {"action": argparse.BooleanOptionalAction}
    if origin is Literal:
        return {"choices": list(inside)}
    if origin is tuple:
        return {"type": inside[0], "nargs": "+", "metavar": _METAVARS[inside[0]]}
    if hint in _METAVARS:
        return {"type": hint, "metavar": _METAVARS[hint]}
    raise TypeError(f"no option can be made of the field {name!r} of type {hint}")


def _help(words: str, each: Field[Any], default: Any) -> str:
    said = words.rstrip(".").replace("%", "%%")
    if default is None or default is MISSING or default == ():
        return said
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
    return f"{said} (default: {shown})"


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options of how the next measurement is chosen; one that is not given is None."""
    from loose_env.instrument import NextSettings  # loads what other commands do not need

    add_kept(parser, NextSettings, title="poses and excitation")


def add_kept(
    parser: argparse.ArgumentParser, kind: type, *, title: str, only: Collection[str] | None = None
) -> None:
    """Add the options of some settings; one that is not given is None.

    Parameters
    ----------
    parser : ArgumentParser
        Takes the options.
    kind : type
        A settings dataclass.
    title : str
        Heading in the help.
    only : collection of str, optional
        Fields that are kept in this way; all by default.
    """
    add_settings(parser, kind, title=title)
    names = [each.name for each in fields(kind)]
    parser.set_defaults(**{name: None for name in names if only is None or name in only})


def take_over(
    options: argparse.Namespace, before: Any, whose: str, *, only: Collection[str] | None = None
) -> None:
    """Set the options that were not given, and report those that differ from their defaults.

    Parameters
    ----------
    options : Namespace
        What was parsed.
    before : dataclass
        Settings that hold where nothing is given.
    whose : str
        Where they come from, for the words.
    only : collection of str, optional
        Fields that are taken over; all by default.
    """
    from loose_env.instrument import option_words, unlike

    there = {n: v for n, v in asdict(before).items() if only is None or n in only}
    taken = {n: v for n, v in there.items() if getattr(options, n) is None}
    for name, value in taken.items():
        setattr(options, name, value)
    words = option_words({n: v for n, v in unlike(before, type(before)()).items() if n in taken})
    if words:
        print(f"note: as {whose} has it:{words}", file=sys.stderr)
