"""Command lines generated from settings dataclasses."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, field, fields
from types import NoneType, UnionType
from typing import Any, Literal, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

from loose_agents.execution.script_errors import errors_in_one_line
from loose_env.errors import InvalidSetting
from loose_env.io import field_words, unmet

__all__ = [
    "OneLineParser",
    "add_options",
    "command",
    "new_parser",
    "option",
    "options_of",
    "parsed",
]

S = TypeVar("S")


class OneLineParser(argparse.ArgumentParser):
    """Argument parser with one-line error messages."""

    def error(self, message: str) -> NoReturn:
        """Exit with the message."""
        self.exit(2, f"{self.prog.removesuffix('.py')}: {message}; --help lists the options\n")


def new_parser(about: str | None) -> OneLineParser:
    """Parser of a script with its documentation as the help's text."""
    return OneLineParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)


def option(default: Any, words: str, *flags: str, **how: Any) -> Any:
    """Field of a settings dataclass with the help of its option.

    Parameters
    ----------
    default : object
        Default of the field; `dataclasses.MISSING` for an option that has to be given.
    words : str
        Help of the option. Without it, the docstring below a field is its help.
    *flags : str
        Names of the option in place of ``--name-of-the-field``.
    **how
        Arguments of `argparse.ArgumentParser.add_argument` in place of those that follow from the
        field's type.
    """
    given = {} if default is MISSING else {"default": default}
    metadata = {"help": words, "flags": flags, **how}
    found: Any = field(**given, metadata=metadata)
    return found


def add_options(parser: argparse.ArgumentParser, kind: type[Any]) -> None:
    """Add an option for each field of a dataclass, with those of its bases in their own groups.

    A boolean becomes a switch, a tuple an option of several values, a `Literal` a choice. What is
    not given is not set, so that the dataclass's own default holds.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of a script; read its options with `options_of`.
    kind : type
        The dataclass.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Settings:
    ...     cases: int = option(8, "arms under test")
    ...     steps: tuple[float, ...] = option((0.5,), "steps [ms]")
    ...     quick: bool = option(False, "a rough look")
    >>> parser = argparse.ArgumentParser()
    >>> add_options(parser, Settings)
    >>> options_of(Settings, parser.parse_args(["--steps", "0.1", "0.2"]))
    Settings(cases=8, steps=(0.1, 0.2), quick=False)
    """
    hints, known = get_type_hints(kind), {each.name: each for each in fields(kind)}
    for home in kind.__mro__[:-1]:
        own = [known.pop(name) for name in inspect.get_annotations(home) if name in known]
        shown = [each for each in own if each.init and not each.metadata.get("hidden")]
        title = (home.__doc__ or "").partition("\n")[0].rstrip(".")
        target: Any = parser if home is kind or not shown else parser.add_argument_group(title)
        words = field_words(home)
        for each in shown:
            _add_option(target, each, hints[each.name], words.get(each.name, "").rstrip("."))


def options_of(
    kind: type[S], given: argparse.Namespace, base: Mapping[str, Any] | None = None
) -> S:
    """Build a dataclass from options parsed after `add_options`.

    Parameters
    ----------
    kind : type
        The dataclass.
    given : argparse.Namespace
        The options.
    base : mapping, optional
        Values in place of the defaults, such as those of a quick run.

    Raises
    ------
    InvalidSetting
        Naming the first option whose value its field does not allow, as 0 for a `Count`.
    """
    hints = get_type_hints(kind, include_extras=True)
    values = {
        each.name: tuple(value) if isinstance(value, list) else value
        for each in fields(kind)  # type: ignore[arg-type]
        if (value := getattr(given, each.name, MISSING)) is not MISSING
    }
    for each in fields(kind):  # type: ignore[arg-type]
        words = unmet(hints[each.name], values[each.name]) if each.name in values else ""
        if words:
            raise InvalidSetting(f"{_flags(each)[0]} must be {words}; got {values[each.name]}")
    return kind(**{**(base or {}), **values})


def parsed(kind: type[S], arguments: Sequence[str] | None, about: str | None = None) -> S:
    """Parse a command line into a settings dataclass."""
    parser = new_parser(about)
    add_options(parser, kind)
    return options_of(kind, parser.parse_args(arguments))


def command(
    name: str,
    about: str | None,
    kind: type[S],
    action: Callable[[S], object],
    arguments: Sequence[str] | None = None,
    *,
    interrupted: str = "",
) -> None:
    """Run a script: settings from the command line, then its action, with errors in one line.

    Parameters
    ----------
    name : str
        Name that an error begins with.
    about : str
        Text of the help.
    kind : type
        Dataclass of the settings.
    action : callable
        Takes the settings.
    arguments : sequence of str, optional
        The command line; that of the process if None.
    interrupted : str
        What follows after Ctrl-C, such as how the work goes on.
    """
    with errors_in_one_line(name, interrupted=interrupted):
        action(parsed(kind, arguments, about))


def _add_option(target: Any, each: Field[Any], hint: Any, docstring: str) -> None:
    how: dict[str, Any] = {"help": docstring, **each.metadata}
    how.pop("flags", None)
    if get_origin(hint) in (Union, UnionType):
        hint = next(k for k in get_args(hint) if k is not NoneType)
    if get_origin(hint) is tuple:
        inside = get_args(hint)
        how = {"nargs": "+" if inside[-1] is Ellipsis else len(inside), **how}
        hint = inside[0]
    if get_origin(hint) is Literal:
        how = {"choices": get_args(hint), **how}
        hint = type(get_args(hint)[0])
    if hint is bool:
        how = {"action": "store_true", **how}
    elif "action" not in how:
        how = {"type": hint, **how}
    if each.default is MISSING and each.default_factory is MISSING:
        how = {"required": True, **how}
    how["help"] = (how["help"] + _default_words(each, how["help"])).replace("%", "%%")
    target.add_argument(*_flags(each), dest=each.name, default=argparse.SUPPRESS, **how)


def _flags(each: Field[Any]) -> tuple[str, ...]:
    return each.metadata.get("flags") or (f"--{each.name.replace('_', '-')}",)


def _default_words(each: Field[Any], words: str) -> str:
    if each.default in (MISSING, None, False, "") or "default" in words:
        return ""
    value = each.default
    shown = value if isinstance(value, tuple) else (value,)
    words = " ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in shown)
    return f"; default: {words or 'none'}"
