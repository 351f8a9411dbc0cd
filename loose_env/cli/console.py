"""Options and output that all commands share: verbosity, progress, text and JSON of the result.

A command returns an `Outcome`; `Console.show` prints it. Results go to the standard output,
progress, notes and warnings to the error stream.
"""

from __future__ import annotations

import argparse
import io
import platform
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from loose_env.cli.output_folder import OutputFolder
from loose_env.errors import InvalidSetting

STDOUT = "-"
"""Value of ``--json`` that stands for the standard output."""

_VERSIONS = ("mujoco", "numpy", "scipy")
"""Packages whose versions ``--verbose`` prints."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a command, for a reader and for programs."""

    text: str
    """Lines for a reader."""
    json: Callable[[], str]
    """Makes the same as a JSON document; called where ``--json`` is given."""
    warnings: tuple[str, ...] = ()
    """Warnings that limit the validity of the result."""
    code: int = 0
    """Exit code of the command; 0 where the work was done, whatever was found."""


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Add --json, --quiet and --verbose."""
    group = parser.add_argument_group("output")
    group.add_argument(
        "--json",
        metavar="FILE",
        help="write the result as JSON to FILE; with '-' to the standard output, which then holds "
        "nothing else (the text goes to the error stream)",
    )
    level = group.add_mutually_exclusive_group()
    level.add_argument(
        "--quiet", action="store_true", help="print results and warnings, without progress"
    )
    level.add_argument(
        "--verbose",
        action="store_true",
        help="print versions, all settings and the time taken too, and the traceback of an error",
    )


def add_recording_options(parser: argparse.ArgumentParser, *, out: bool = True) -> None:
    """Add RECORDING, --model and, for commands that write a folder, --out."""
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="folder of the recording")
    if out:
        parser.add_argument(
            "--out", type=Path, required=True, metavar="DIR", help="folder for what is written"
        )
    parser.add_argument(
        "--model",
        type=Path,
        metavar="OTHER.xml",
        help="MJCF file that takes the place of the recording's model",
    )


def folder_of(options: argparse.Namespace) -> OutputFolder:
    """Output folder, in which the other model must not lie.

    Raises
    ------
    InvalidSetting
        If it does, or the folder cannot be used.
    """
    folder = OutputFolder(options.out, options.command)
    if options.model is not None and options.model.resolve().is_relative_to(folder.path):
        raise InvalidSetting(
            f"--model {options.model} lies in the output folder, where it would be overwritten; "
            "give another --out"
        )
    return folder


class Console:
    """Output of one command: progress with the time that has passed, then the outcome.

    Parameters
    ----------
    options : Namespace
        Parsed options, those of `add_output_options` among them.

    Raises
    ------
    InvalidSetting
        If the file of ``--json`` is a folder, or lies where another file or folder of the command
        line would be overwritten.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self.quiet, self.verbose = bool(options.quiet), bool(options.verbose)
        self.start = time.monotonic()
        self.json: str | None = options.json
        if self.json not in (None, STDOUT):
            _check_json(Path(str(self.json)), options)
        if self.verbose:
            self.say(_versions())
            self.say(f"options: {_given(options)}")

    def say(self, line: str) -> None:
        """Print a line of progress, unless asked to be quiet."""
        if not self.quiet:
            print(f"{time.monotonic() - self.start:7.1f} s  {line}", file=sys.stderr, flush=True)

    def show(self, outcome: Outcome) -> None:
        """Print warnings and text, and write the JSON document where one is asked for."""
        for warning in outcome.warnings:
            print(f"warning: {warning}", file=sys.stderr)
        document = None if self.json is None else outcome.json()
        text = outcome.text.rstrip("\n")
        if self.json == STDOUT and document is not None:
            if not self.quiet:
                print(text, file=sys.stderr)
            if isinstance(sys.stdout, io.TextIOWrapper):
                sys.stdout.reconfigure(encoding="utf-8")  # as JSON is, whatever the locale
            sys.stdout.write(document if document.endswith("\n") else document + "\n")
        else:
            if self.json is not None and document is not None:
                from loose_env.io import write_text

                write_text(Path(self.json), document)
            print(text)
        sys.stdout.flush()
        if self.verbose:
            self.say("done")


def _check_json(file: Path, options: argparse.Namespace) -> None:
    """Refuse a file of ``--json`` that would overwrite what the command reads or writes."""
    if file.is_dir():
        raise InvalidSetting(f"--json {file} is a folder; give a file, or '-' for standard output")
    place = file.resolve()
    for name, path in _paths(options):
        if place.is_relative_to(path.resolve()):
            raise InvalidSetting(
                f"--json {file} lies in {path} ({name}), which this command reads or writes "
                "itself; give another file, or '-' for standard output"
            )


def _paths(options: argparse.Namespace) -> Iterator[tuple[str, Path]]:
    """Files and folders that the command line names, beside that of ``--json``."""
    for name, value in vars(options).items():
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, Path):
                yield name, each
            elif name == "sources":  # NAME=PATH
                yield name, Path(str(each).rpartition("=")[2])


def _versions() -> str:
    """Versions of package, Python and the libraries that compute."""
    from loose_env.version import __version__

    found = [f"loose-env {__version__}", f"Python {platform.python_version()}"]
    for name in _VERSIONS:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def _given(options: argparse.Namespace) -> str:
    """All options with their values, defaults included."""
    words = []
    for name, value in vars(options).items():
        if callable(value) or value is None or name in ("command", "verbose", "quiet"):
            continue
        shown = value if isinstance(value, list | tuple) else [value]
        words.append(f"{name}={','.join(shlex.quote(str(each)) for each in shown)}")
    return " ".join(words)
