"""The command ``loose`` and its subcommands.

Exit codes: 0 when the work was done, whatever it found; 1 when something that was given cannot be
used, said in one line; 2 for a command line that cannot be understood; 130 when interrupted.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from inspect import cleandoc
from typing import TYPE_CHECKING, Annotated, Any, Union

from loose_env.version import __version__

if TYPE_CHECKING:
    from loose_env.cli.console import Output

COMMANDS = {
    "inspect": "what a session could test in an arm, from its model alone",
    "plan": "session to shake an arm: poses, limits and the commands to play",
    "doctor": "preflight of a recording: units, ranges, signs, sampling, channels, clocks",
    "diagnose": "loose link or joint of an arm, from measured runs",
    "trend": "change of an arm over sessions of several months, and since when",
    "gap": "effects that a simulation model lacks, from measured runs",
    "export": "identified effects for mujoco.sysid, mjlab, Isaac Lab, URDF, BAM, randomisation",
    "import": "recording from files of loggers: ROS bags, tables, arrays, LeRobot",
}
"""Subcommand -> what it finds or makes."""

_MODULES = {
    "inspect": "instrument",
    "plan": "instrument",
    "diagnose": "instrument",
    "trend": "instrument",
    "doctor": "doctor",
    "import": "recordings",
    "gap": "gap",
    "export": "gap",
}
"""Subcommand -> module with its options, a class of its name."""

_NO_PICTURES = ("doctor", "import")
"""Commands that draw no arms: MuJoCo need not start a display's library for them, 0.2 s."""
_M_MMAP_THRESHOLD = -3
"""Number of this option of glibc's mallopt."""
_BLOCK_BYTES = 256 * 1024
"""Blocks from this size on are the system's again when they are freed [byte]."""

SHELLS = ("bash", "zsh", "tcsh", "fish")
"""Shells with completion."""

_HELP = """usage: loose COMMAND [OPTIONS]

Diagnoses robot arms by measured data.

At a suspect machine, in this order; the last two in turn until the fault is identified:
  loose inspect arm.xml
  loose plan arm.xml --out session
  loose diagnose session/recording --out session/diagnosis
  loose plan arm.xml --out session --known session/diagnosis

Where simulation and machine disagree:
  loose import log.mcap --mapping map.toml --out arm
  loose gap arm --out arm-gap
  loose export arm-gap --to ranges --out exports

commands:
{commands}

options:
  -h, --help                 print this
  --version                  print the version
  --print-completion SHELL   print the completion script of a shell ({shells})

'loose COMMAND --help' lists the options of a command.
"""
_EXIT_CODES = """Exit codes: 0 done, whatever was found; 1 something given cannot be used; 2 the
command line is wrong; 130 interrupted."""


def options_class(command: str) -> type[Output]:
    """Dataclass of a subcommand's options, with its work as the method ``run``."""
    module = import_module(f"loose_env.cli.{_MODULES[command]}")
    found: type[Output] = getattr(module, command.capitalize())
    return found


def options_of(words: Sequence[str]) -> Output:
    """Parse the command line of a subcommand, its name first.

    Raises
    ------
    SystemExit
        With exit code 2 after a line on what is wrong, or 0 after the help.
    """
    from loose_env.cli.command import parsed

    kind = options_class(words[0])
    about = f"{cleandoc(kind.__doc__ or '')}\n\n{_EXIT_CODES}"
    return parsed(f"loose {words[0]}", about, kind, words[1:])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; by default that of the process.

    Returns
    -------
    int
        The exit code.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    if arguments is None and words[:1] and words[0] in _NO_PICTURES:
        os.environ.setdefault("MUJOCO_GL", "disable")
    if words[:1] in ([], ["-h"], ["--help"]):
        listed = "\n".join(f"  {name:<10}{about}" for name, about in COMMANDS.items())
        return _shown((_HELP + _EXIT_CODES).format(commands=listed, shells=", ".join(SHELLS)))
    if words[0] == "--version":
        return _shown(f"loose-env {__version__}")
    from loose_env.cli import command

    if words[0] == "--print-completion":
        if words[1:2] == [] or words[1] not in SHELLS:
            command.refuse("loose", f"--print-completion takes one of {', '.join(SHELLS)}")
        with command.errors_in_one_line("loose"):
            _print_completion(words[1])
        return 0
    if words[0] not in COMMANDS:
        command.refuse("loose", f"{words[0]!r} is no command; there are {', '.join(COMMANDS)}")
    return _run(words)


def _shown(text: str) -> int:
    """Print a text, also to a reader who has gone, as `head` does; return the exit code."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _run(words: Sequence[str]) -> int:
    """Run a subcommand, and return its exit code."""
    from loose_env.cli.command import WRONG, errors_in_one_line
    from loose_env.cli.console import Console
    from loose_env.errors import LooseEnvError

    if words[0] == "gap":
        _return_freed_memory()
    try:
        with errors_in_one_line(
            f"loose {words[0]}",
            interrupted="the same command begins anew",
            errors=(LooseEnvError, OSError),
            verbose="--verbose" in words,
        ):
            options = options_of(words)
            console = Console(options)
            outcome = options.run(console)
            console.show(outcome)
            return outcome.code
    except SystemExit as end:
        if end.code in (0, WRONG):
            raise
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
        return end.code if isinstance(end.code, int) else 1


def _return_freed_memory() -> None:
    """Have the C library return freed arrays to the system, on Linux.

    By default glibc keeps freed blocks of up to 32 MB, between which others come to lie: the
    process of `loose gap` grew to 1.6 times the memory that it needs. Commands that go through long
    arrays once are faster without: each array would be zeroed by the system anew.
    """
    if not sys.platform.startswith("linux"):
        return
    # the interpreter's own process, whose C library has it unless it is another one, such as musl
    tune = getattr(ctypes.pythonapi, "mallopt", None)
    if tune is not None:
        tune(_M_MMAP_THRESHOLD, _BLOCK_BYTES)


def _print_completion(shell: str) -> None:
    """Print the completion script of a shell, made of the options of all commands."""
    import tyro

    kinds: list[Any] = [
        Annotated[
            (options_class(name), tyro.conf.subcommand(name, description=about, prefix_name=False))
        ]
        for name, about in COMMANDS.items()
    ]
    with_all: Any = Union[tuple(kinds)]  # noqa: UP007 - made at run time
    with suppress(SystemExit):  # tyro ends the process after the script
        tyro.cli(
            with_all,
            prog="loose",
            args=["--tyro-write-completion", shell, "-"],
            config=(tyro.conf.DisallowNone, tyro.conf.OmitArgPrefixes),
        )


if __name__ == "__main__":
    sys.exit(main())
