"""The command ``loose`` and what all its subcommands share.

Exit codes: 0 when the work was done, whatever it found; 1 when something that was given cannot be
used, said in one line; 2 for a command line that makes no sense; 130 when interrupted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from keyword import iskeyword

from loose_env.errors import LooseEnvError, words_of

COMMANDS = {
    "inspect": "show an arm's joints, tool and modes, and what faults could be found",
    "plan": "say what to measure next: pose, joint and signal",
    "doctor": "check a recording: units, ranges, signs, sampling, channels, clocks",
    "diagnose": "say what is loose in an arm, by measured runs, and what to measure next",
    "gap": "name what a simulation model lacks, by measured runs",
    "import": "make a recording of what loggers wrote: MCAP, CSV, universal files",
}
"""Subcommand -> what it does. The module beside this file has its name, with an underscore after a
word that Python keeps for itself."""

_GOES_ON = frozenset({"gap"})
"""Subcommands that keep finished stages."""

DONE, REFUSED, INTERRUPTED = 0, 1, 130
"""Exit codes; argparse has 2."""


def parser() -> argparse.ArgumentParser:
    """Parser of the whole command line."""
    found = argparse.ArgumentParser(
        prog="loose", description="Diagnoses robot arms by measured data."
    )
    found.add_argument("--version", action="version", version=_version())
    commands = found.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, summary in COMMANDS.items():
        module = import_module(f"loose_env.cli.{name}{'_' if iskeyword(name) else ''}")
        own = commands.add_parser(
            name,
            help=summary,
            description=module.__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_options(own)
        own.set_defaults(run=module.run)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; by default that of the process.

    Returns
    -------
    int
        The exit code.
    """
    options = parser().parse_args(arguments)
    run: Callable[[argparse.Namespace], None] = options.run
    said = f"loose {options.command}"
    try:
        run(options)
    except KeyboardInterrupt:
        how = "goes on from there" if options.command in _GOES_ON else "begins anew"
        print(f"{said}: interrupted; the same command {how}", file=sys.stderr)
        return INTERRUPTED
    except (LooseEnvError, OSError) as error:
        # Anything else is a fault of the program and keeps its trace.
        print(f"{said}: {words_of(error)}", file=sys.stderr)
        return REFUSED
    return DONE


def _version() -> str:
    try:
        return f"loose-env {version('loose-env')}"
    except PackageNotFoundError:
        return "loose-env, not installed"


if __name__ == "__main__":
    sys.exit(main())
