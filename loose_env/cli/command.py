"""Command lines from settings dataclasses: parsing by tyro, errors in one line, exit codes.

Every script and every subcommand of ``loose`` goes through here. Exit codes: 0 done; 1 something
given cannot be used; 2 the command line is wrong; 130 interrupted.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, field, fields, is_dataclass, make_dataclass
from functools import cache
from inspect import cleandoc
from types import UnionType
from typing import Annotated, Any, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

import gymnasium
import tyro
from tyro import _errors as rejected  # no public name tells what a command line was refused for
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from loose_env.errors import LooseEnvError, words_of
from loose_env.io import field_words, unmet

REFUSED, WRONG, INTERRUPTED = 1, 2, 130
"""Exit codes beside 0."""

ERRORS = (LooseEnvError, OSError, ImportError, ValueError, gymnasium.error.Error)
"""Errors of what was given; any other is a fault of the program and keeps its trace."""

_CONFIG = (
    tyro.conf.DisallowNone,
    tyro.conf.PositionalMetavarFromFieldName,
)
_REGISTRY = ConstructorRegistry()

S = TypeVar("S")

Actions = Mapping[str, tuple[type[Any], Callable[[Any], object]]]
"""Subcommands: name -> settings and what takes them."""


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

    Each field of the dataclass is an option with the docstring under it as help: a `Literal` is a
    choice (`one_of` makes one at run time), a tuple takes several values, a boolean is
    ``--flag`` or ``--no-flag``, a field without default has to be given.
    ``tyro.conf.Positional[Path]`` has no flag; ``Annotated[int, tyro.conf.arg(aliases=["-n"])]``
    has a further name; ``tyro.conf.UseAppendAction[tuple[str, ...]]`` is given repeatedly;
    ``tuple[str, ...] | None`` is None, or () where the flag stands alone. A field that is a
    dataclass has its options too, ``--field.name``, or ``--name`` as
    ``tyro.conf.OmitArgPrefixes[Kind]``. Values are checked by the rules of
    the annotations, such as `Count`.

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

    Raises
    ------
    SystemExit
        With a line that begins with the name (exit code 1), or 2 or 130 after printing it.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Settings:
    ...     cases: int = 8
    ...     steps: tuple[float, ...] = (0.5,)
    ...     quick: bool = False
    >>> command("study", "A study.", Settings, print, ["--steps", "0.1", "0.2", "--quick"])
    Settings(cases=8, steps=(0.1, 0.2), quick=True)
    """
    with errors_in_one_line(name, interrupted=interrupted):
        action(parsed(name, about, kind, arguments))


def commands(
    name: str,
    about: str | None,
    actions: Actions,
    arguments: Sequence[str] | None = None,
    *,
    interrupted: str = "",
) -> None:
    """Run the subcommand that the command line names first, as `command` does.

    Parameters
    ----------
    name, about, arguments, interrupted
        As in `command`.
    actions : mapping
        Subcommand -> dataclass of its settings, whose docstring is its help, and action.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    if words[:1] in ([], ["-h"], ["--help"]):
        lines = [f"  {each}: {_first_line(kind)}" for each, (kind, _) in actions.items()]
        print(f"usage: {name} COMMAND [OPTIONS]\n\n{(about or '').strip()}\n", *lines, sep="\n")
    elif words[0] in actions:
        kind, action = actions[words[0]]
        said = f"{name} {words[0]}"
        command(said, kind.__doc__, kind, action, words[1:], interrupted=interrupted)
    else:
        refuse(name, f"{words[0]!r} is no command; there are {', '.join(actions)}")


def parsed(
    name: str,
    about: str | None,
    kind: type[S],
    arguments: Sequence[str] | None = None,
    *,
    default: S | None = None,
) -> S:
    """Parse a command line into a settings dataclass; see `command`.

    Parameters
    ----------
    name, about, kind, arguments
        As in `command`.
    default : object, optional
        Settings whose values hold where no option is given, such as those of a quick run or of an
        earlier output; the dataclass's own by default.

    Raises
    ------
    SystemExit
        With exit code 2 after a line on what is wrong, or 0 after the help.
    """
    with rejected.on_parse_error(lambda event: _refuse(name, kind, event)):
        found: S = tyro.cli(
            kind,
            args=arguments,
            prog=name,
            description=cleandoc(about or ""),
            config=_CONFIG,
            registry=_REGISTRY,
            default=tyro.MISSING_NONPROP if default is None else default,
        )
    if words := _unmet(found):
        refuse(name, words)
    return found


def one_of(names: Sequence[str]) -> Any:
    """Annotation of a text that is one of some names: ``Annotated[str, one_of(ARMS)]``.

    In a tuple ``tuple[Annotated[str, one_of(ARMS)], ...]``.
    """
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="{" + ",".join(names) + "}",
        instance_from_str=lambda words: words[0],
        is_instance=lambda value: isinstance(value, str),
        str_from_instance=lambda value: [value],
        choices=tuple(names),
    )


@cache
def kept(kind: type[Any], leave_out: Collection[str] = ()) -> Any:
    """Annotation of a field whose options are None where they are not given; see `settled`.

    ``choice: Annotated[NextSettings, kept(NextSettings)]`` offers the options of the fields of
    `NextSettings`, but for those that are left out, and checks nothing yet.
    """
    hints, optional = get_type_hints(kind), []
    for each in fields(kind):
        usual = each.default
        hidden = [tyro.conf.Suppress] if each.name in leave_out else []
        hint = hints[each.name]
        if get_origin(hint) in (Union, UnionType):
            hint = get_args(hint)[0]
        shown = " ".join(map(str, usual)) if isinstance(usual, tuple) else str(usual)
        about = tyro.conf.arg(
            help_behavior_hint="" if usual in (None, ()) else f"(default: {shown})",
            metavar=f"{get_args(hint)[0].__name__.upper()} ..."
            if get_origin(hint) is tuple
            else None,
        )
        optional.append((each.name, Annotated[(hint | None, about, *hidden)], field(default=None)))
    unchecked = {"__post_init__": lambda self: None}
    made = make_dataclass(
        kind.__name__, optional, bases=(kind,), namespace=unchecked, frozen=True, kw_only=True
    )
    return made


def settled(
    given: S, before: Any = None, whose: str = "", *, only: Collection[str] | None = None
) -> S:
    """Settings of a `kept` field: what was given, else as it was before, else the default.

    Parameters
    ----------
    given : dataclass
        What was parsed.
    before : dataclass, optional
        Settings that hold where nothing is given; a note says those that are not the defaults.
    whose : str
        Where they come from, for the note.
    only : collection of str, optional
        Fields that are kept; all by default.

    Raises
    ------
    InvalidSetting
        If the settings do not go together.
    """
    kind: Any = type(given).__mro__[1]
    new = {n: v for n, v in _values(given) if v is not None}
    old = {} if before is None else {n: v for n, v in _values(before) if n not in new}
    old = {n: v for n, v in old.items() if only is None or n in only}
    usual = kind()
    if unusual := {n: v for n, v in old.items() if v != getattr(usual, n)}:
        print(f"note: as {whose} has it:{option_words(unusual)}", file=sys.stderr)
    found: S = kind(**old, **new)
    return found


def option_words(settings: Mapping[str, Any]) -> str:
    """Settings as options, each after a blank.

    Examples
    --------
    >>> option_words({"most_tool": 2.0, "payload_at_m": (0.0, 0.1, 0.0), "tool": "my site"})
    " --most-tool 2 --payload-at-m 0 0.1 0 --tool 'my site'"
    >>> option_words({"reference": True})
    ' --reference'
    """
    words = []
    for name, value in settings.items():
        option = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
            continue
        words.append(f"--{option}")
        for one in value if isinstance(value, tuple | list) else [value]:
            words.append(f"{one:.12g}" if isinstance(one, float) else shlex.quote(str(one)))
    return "".join(f" {word}" for word in words)


@contextmanager
def errors_in_one_line(
    name: str,
    *,
    interrupted: str = "",
    errors: tuple[type[BaseException], ...] = ERRORS,
    verbose: bool = False,
) -> Iterator[None]:
    """End the process with a one-line message on invalid input or an interrupt.

    Parameters
    ----------
    name : str
        Name that the line begins with.
    interrupted : str
        What follows after Ctrl-C.
    errors : tuple of type
        Errors of what was given; others keep their trace.
    verbose : bool
        Print the trace of an error too.

    Examples
    --------
    >>> with errors_in_one_line("train"):
    ...     raise LooseEnvError("there is no arm 'vero'")
    Traceback (most recent call last):
        ...
    SystemExit: train: there is no arm 'vero'
    """
    try:
        yield
    except KeyboardInterrupt:
        print(f"{name}: interrupted" + (f"; {interrupted}" if interrupted else ""), file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:  # whoever read the output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(REFUSED)
    except errors as error:
        if verbose:
            traceback.print_exc()
        sys.exit(f"{name}: {words_of(error)}")


def refuse(name: str, words: str) -> NoReturn:
    """End the process because the command line is wrong."""
    print(f"{name}: {words}; --help lists the options", file=sys.stderr)
    sys.exit(WRONG)


@_REGISTRY.struct_rule
def _options(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Options of a dataclass, with the docstrings under its fields and those of its bases."""
    kind: Any = info.type
    if not hasattr(kind, "__dataclass_fields__"):
        return None
    hints, words = get_type_hints(kind, include_extras=True), {}
    for base in reversed(kind.__mro__[:-1]):
        words.update(field_words(base))
    options = []
    for each in filter(lambda one: one.init, fields(kind)):
        default = MISSING if each.default_factory is MISSING else each.default_factory()
        default = each.default if default is MISSING else default
        if is_dataclass(info.default):
            default = getattr(info.default, each.name)
        given = hints[each.name]
        about = getattr(given, "__metadata__", ())
        made_by_kept = [one for one in about if isinstance(one, type)]
        base = made_by_kept[0] if made_by_kept else given.__origin__ if about else given
        says_default = tyro.conf.arg(help_behavior_hint="" if default in (None, ()) else None)
        hint: Any = Annotated[(base, says_default, *about)]
        default = tyro.MISSING_NONPROP if default is MISSING else default
        options.append(StructFieldSpec(each.name, hint, default, words.get(each.name)))
    return StructConstructorSpec(instantiate=kind, fields=tuple(options))


def _by_option(words: str, kind: Any, prefix: str = "--") -> str:
    """Words on a field of settings (Class.field must be ...) by the name of its option."""
    owner, dot, rest = words.partition(".")
    if dot and owner in (base.__name__ for base in kind.__mro__):
        field_name, _, more = rest.partition(" ")
        return f"{prefix}{field_name.replace('_', '-')} {more}"
    for name, hint in get_type_hints(kind, include_extras=True).items():
        inner = getattr(hint, "__origin__", hint)
        if is_dataclass(inner):
            bare = tyro.conf.OmitArgPrefixes in getattr(hint, "__metadata__", ())
            own = "" if bare else f"{name.replace('_', '-')}."
            if (found := _by_option(words, inner, f"{prefix}{own}")) != words:
                return found
    return words


def _refuse(name: str, kind: type[Any], event: Any) -> None:
    """Say in one line why tyro refuses a command line."""
    if isinstance(event, rejected.InstantiationFailure) and event.argument is None:
        refuse(name, _by_option(str(event.message), kind))
    if isinstance(event, rejected.InvalidChoice):
        words = f"{_flag(event.argument)} must be one of {', '.join(event.choices)}"
        refuse(name, f"{words}; got {event.value!r}")
    if isinstance(event, rejected.UnrecognizedArgs):
        refuse(name, f"unrecognized: {' '.join(event.tokens)}")
    if isinstance(event, rejected.MissingArgs):
        if event.unrecognized_tokens:
            refuse(name, f"unrecognized: {' '.join(event.unrecognized_tokens)}")
        refuse(
            name, f"{', '.join(_flag(each.arg) for each in event.missing_arguments)} must be given"
        )
    if isinstance(event, rejected.MutexConflict):
        refuse(name, f"{event.first_token} and {event.second_token} exclude each other")
    argument = getattr(event, "argument", None)
    if argument is None:
        refuse(name, "the command line is incomplete")
    given = re.search(r"instantiated from \[(.*)\]|('[^']*')$", str(getattr(event, "message", "")))
    if given is None and argument.is_positional():
        refuse(name, f"{_flag(argument)} must be given")
    takes = f"{_flag(argument)} takes {argument.lowered.metavar}"
    refuse(name, takes + (f"; got {given[1] or given[2]}" if given else ""))


def _flag(argument: Any) -> str:
    """Longest name of an option, or the metavar of a positional argument."""
    if argument.is_positional():
        return str(argument.lowered.metavar)
    return str(max(argument.lowered.name_or_flags, key=len))


def _unmet(settings: Any) -> str:
    """The first value that the annotations do not allow, by the name of its option; "" if none."""
    hints, found = get_type_hints(type(settings), include_extras=True), ""
    for name, value in _values(settings):
        if is_dataclass(value):
            found = found or _unmet(value)
        elif words := unmet(hints[name], value):
            found = found or f"--{name.replace('_', '-')} must be {words}; got {value}"
    return found


def _values(settings: Any) -> list[tuple[str, Any]]:
    return [(each.name, getattr(settings, each.name)) for each in fields(settings)]


def _first_line(kind: type[Any]) -> str:
    return (kind.__doc__ or "").strip().partition("\n")[0]
