"""The command ``loose`` and what all its subcommands share.

Exit codes: 0 when the work was done, whatever it found; 1 when something that was given cannot be
used, said in one line; 2 for a command line that cannot be understood; 130 when interrupted.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from typing import Any

from loose_env.cli.console import Console, Outcome, add_output_options
from loose_env.errors import LooseEnvError, words_of
from loose_env.version import __version__

COMMANDS = {
    "inspect": "joints, modes and detectable faults of an arm, from its model alone",
    "plan": "next measurement: pose, joint to excite and signal to play",
    "doctor": "preflight of a recording: units, ranges, signs, sampling, channels, clocks",
    "diagnose": "loose link or joint of an arm, from measured runs",
    "gap": "effects that a simulation model lacks, from measured runs",
    "export": "identified effects for mujoco.sysid, mjlab, Isaac Lab, URDF, BAM, randomisation",
    "import": "recording from files of loggers: MCAP, CSV, universal files (UFF 58)",
}
"""Subcommand -> what it finds or makes. The module beside this file has its name, with an
underscore after a word that Python keeps for itself."""

_GOES_ON = frozenset({"gap"})
"""Subcommands that keep finished stages."""

DONE, REFUSED, INTERRUPTED = 0, 1, 130
"""Exit codes; argparse has 2."""

_M_MMAP_THRESHOLD = -3
"""Number of this option of glibc's mallopt."""
_BLOCK_BYTES = 256 * 1024
"""Blocks from this size on are the system's again when they are freed [byte]."""

SHELLS = ("bash", "zsh", "tcsh")
"""Shells with completion."""

_DESCRIPTION = """Diagnoses robot arms by measured data.

At a suspect machine, in this order; the last two in turn until the fault is identified:
  loose inspect arm.xml
  loose plan arm.xml --out session
  loose diagnose session/recording --out session/diagnosis
  loose plan arm.xml --out session --known session/diagnosis

Where simulation and machine disagree:
  loose import log.mcap --mapping map.toml --out arm
  loose gap arm --out arm-gap
  loose export arm-gap --to ranges --out exports"""

_EXIT_CODES = """Exit codes: 0 done, whatever was found; 1 something given cannot be used; 2 the
command line is wrong; 130 interrupted."""
_EPILOG = f"'loose COMMAND --help' lists the options of a command.\n{_EXIT_CODES}"


class _PrintCompletion(argparse.Action):
    """Prints the completion script of a shell, made of the options of all commands."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Print and leave."""
        try:
            import shtab
        except ImportError:
            parser.exit(
                REFUSED,
                "loose: completion needs the package shtab, which is not installed: "
                "pip install 'loose-env[completion]'\n",
            )
        whole = _with_kinds_of_paths(globals()["parser"](), shtab.FILE, shtab.DIRECTORY)
        print(shtab.complete(whole, shell=values))
        parser.exit(DONE)


def parser(arguments: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """Parser of the whole command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command line. Only the command that it names gets its options, for the modules of the
        others take a second to load; by default all do.
    """
    found = argparse.ArgumentParser(
        prog="loose",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    found.add_argument("--version", action="version", version=f"loose-env {__version__}")
    found.add_argument(
        "--print-completion",
        action=_PrintCompletion,
        choices=SHELLS,
        metavar="SHELL",
        help=f"print the completion script of a shell ({', '.join(SHELLS)})",
    )
    wanted = set(COMMANDS if arguments is None else arguments)
    commands = found.add_subparsers(dest="command", metavar="COMMAND")
    for name, summary in COMMANDS.items():
        if name not in wanted:
            commands.add_parser(name, help=summary)
            continue
        module = import_module(f"loose_env.cli.{name}{'_' if iskeyword(name) else ''}")
        own = commands.add_parser(
            name,
            help=summary,
            description=module.__doc__,
            epilog=_EXIT_CODES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_options(own)
        add_output_options(own)
        own.set_defaults(run=module.run)
        own.usage = _usage(own)
    return found


def _return_freed_memory() -> None:
    """Have the C library return freed arrays to the system, on Linux.

    By default glibc keeps freed blocks of up to 32 MB, between which others come to lie: the
    process of `loose gap` grew to 1.6 times the memory that it needs.
    """
    if not sys.platform.startswith("linux"):
        return
    # the interpreter's own process, whose C library has it unless it is another one, such as musl
    tune = getattr(ctypes.pythonapi, "mallopt", None)
    if tune is not None:
        tune(_M_MMAP_THRESHOLD, _BLOCK_BYTES)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; by default that of the process.

    Returns
    -------
    int
        The exit code.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    _return_freed_memory()
    made = parser(words)
    options = made.parse_args(words)
    if options.command is None:
        made.print_help()
        return DONE
    run: Callable[[argparse.Namespace, Console], Outcome] = options.run
    said = f"loose {options.command}"
    try:
        console = Console(options)
        outcome = run(options, console)
        console.show(outcome)
    except KeyboardInterrupt:
        how = "goes on from there" if options.command in _GOES_ON else "begins anew"
        print(f"{said}: interrupted; the same command {how}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # whoever read the output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return REFUSED
    except (LooseEnvError, OSError) as error:
        # Anything else is a fault of the program and keeps its trace.
        if options.verbose:
            traceback.print_exc()
        print(f"{said}: {words_of(error)}", file=sys.stderr)
        return REFUSED
    return outcome.code


def _usage(own: argparse.ArgumentParser) -> str:
    """Usage line with what has to be given; the help lists the rest, forty options and more."""
    words = [own.prog]
    for action in own._actions:
        if action.required:
            metavar = "|".join(action.choices) if action.choices else str(action.metavar)
            given = f"{metavar} [{metavar} ...]" if action.nargs == "+" else metavar
            words.append(" ".join([*action.option_strings[:1], given]))
    return " ".join([*words, "[options]"])


def _with_kinds_of_paths(
    whole: argparse.ArgumentParser, file: Any, folder: Any
) -> argparse.ArgumentParser:
    """Mark options that take a path, so that a shell completes files or folders there."""
    groups: list[argparse.ArgumentParser] = [whole]
    while groups:
        for action in groups.pop()._actions:
            if isinstance(action, argparse._SubParsersAction):
                groups += action.choices.values()
            elif action.type is Path or action.dest in ("json", "sources"):
                is_folder = action.metavar in ("DIR", "RECORDING")
                action.complete = folder if is_folder else file  # type: ignore[attr-defined]
    return whole


if __name__ == "__main__":
    sys.exit(main())
