"""Options, outcome, printed output and output folder that all commands of ``loose`` share.

A command returns an `Outcome`; `Console.show` prints it. Results go to the standard output,
progress, notes and warnings to the error stream.
"""

from __future__ import annotations

import io
import json
import platform
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import FlagCreatePairsOff, Positional, arg, create_mutex_group

from loose_env.errors import InvalidSetting, LooseEnvError
from loose_env.io import write_text

STDOUT = "-"
"""Value of ``--json`` that stands for the standard output."""
KEPT = ".gap"
"""Folder in an output for what is kept between runs."""

_VERSIONS = ("mujoco", "numpy", "scipy")
"""Packages whose versions ``--verbose`` prints."""
_LIST, _WHOSE = "written.json", "command"
_FORMATS = {"loose-gap": "gap", "loose-diagnosis": "diagnose"}
"""Whose a result is, by its format: folders of earlier versions note nothing."""
_OWN = frozenset({KEPT, "model.xml", "result.json", "report.html"})
_LEVEL = create_mutex_group(required=False, title="level of detail")


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


@dataclass(frozen=True, kw_only=True)
class Output:
    """Options of every command; a command adds its own and the method ``run``."""

    json: Annotated[str | None, arg(metavar="FILE")] = None
    """Write the result as JSON to FILE; with '-' to the standard output, which then holds
    nothing else (the text goes to the error stream)."""
    quiet: Annotated[bool, _LEVEL, FlagCreatePairsOff] = False
    """Print results and warnings, without progress."""
    verbose: Annotated[bool, _LEVEL, FlagCreatePairsOff] = False
    """Print versions, all settings and the time taken too, and the traceback of an error."""

    def run(self, console: Console) -> Outcome:
        """Do the work of the command."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class OnRecording(Output):
    """Options of a command that reads a recording."""

    recording: Positional[Path]
    """Folder of the recording."""
    model: Annotated[Path | None, arg(metavar="OTHER.xml")] = None
    """MJCF file that takes the place of the recording's model."""


class Console:
    """Output of one command: progress with the time that has passed, then the outcome.

    Parameters
    ----------
    options : Output
        Parsed options.

    Raises
    ------
    InvalidSetting
        If the file of ``--json`` is a folder, or lies where another file or folder of the command
        line would be overwritten.
    """

    def __init__(self, options: Output) -> None:
        self.quiet, self.verbose, self.json = options.quiet, options.verbose, options.json
        self.start = time.monotonic()
        if self.json not in (None, STDOUT):
            _check_json(Path(str(self.json)), options)
        if self.verbose:
            self.say(_versions())
            words = [f"{n}={shlex.quote(v)}" for n, v in _given(options)]
            self.say(f"options: {' '.join(words)}")

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


class OutputFolder:
    """A new folder, an empty one, or one that an earlier run wrote and nothing else lies in.

    Commands write files of the same names, so the folder notes whose they are.

    Parameters
    ----------
    path : Path
        The folder.
    command : str
        The command of ``loose`` that writes.
    reads : Path, optional
        File of the command line that must not lie in the folder, as ``option``.

    Raises
    ------
    InvalidSetting
        If it is a file, or holds other files, what another command wrote, or what is read.
    """

    def __init__(
        self, path: Path, command: str, *, reads: Path | None = None, option: str = "--model"
    ) -> None:
        self.path, self.command = path.resolve(), command
        if self.path.exists() and not self.path.is_dir():
            raise InvalidSetting(f"--out {path} is a file; give a folder")
        there = sorted(p.name for p in self.path.iterdir()) if self.path.is_dir() else []
        known = _OWN | self._written() if KEPT in there else frozenset()
        other = [name for name in there if name not in known and not _half_written(name)]
        if other:
            raise InvalidSetting(
                f"--out {path} holds other files ({', '.join(other[:3])}"
                f"{', ...' if len(other) > 3 else ''}); give a new or empty folder, or that of an "
                "earlier run"
            )
        whose = self._whose() if there else command
        if whose not in (command, ""):
            raise InvalidSetting(
                f"--out {path} holds what 'loose {whose}' wrote, and 'loose {command}' would "
                "overwrite it; give another folder"
            )
        if reads is not None and reads.resolve().is_relative_to(self.path):
            raise InvalidSetting(
                f"{option} {reads} lies in the output folder, where it would be overwritten; give "
                "another --out"
            )

    def prepared(self) -> Path:
        """Make the folder, and return the one inside it for what is kept between runs."""
        kept = self.path / KEPT
        kept.mkdir(parents=True, exist_ok=True)
        kept.joinpath(_WHOSE).write_text(self.command, encoding="utf-8")
        return kept

    @contextmanager
    def worked_in(self) -> Iterator[Path]:
        """Work with the folder prepared; what is new in it goes after a user's mistake."""
        before = self.path.exists()
        kept = self.prepared()
        try:
            yield kept
        except LooseEnvError:
            if not before:
                shutil.rmtree(self.path)
            elif not any(p.is_file() and p.name != _WHOSE for p in self.path.rglob("*")):
                shutil.rmtree(kept)
            raise

    def note(self, written: Iterable[Path]) -> None:
        """Note what was written, so that a later run knows it as its own."""
        inside = (path.relative_to(self.path) for path in written)
        names = sorted({path.parts[0] for path in inside} | self._written())
        write_text(self.prepared() / _LIST, json.dumps(names) + "\n")

    def _written(self) -> frozenset[str]:
        names = _read_json(self.path / KEPT / _LIST)
        return frozenset(str(name) for name in names) if isinstance(names, list) else frozenset()

    def _whose(self) -> str:
        """Command that wrote here before; "" if that is not known."""
        try:
            return self.path.joinpath(KEPT, _WHOSE).read_text("utf-8").strip()
        except (OSError, ValueError):
            whole = _read_json(self.path / "result.json")
            kind = str(whole.get("format", "")) if isinstance(whole, dict) else ""
            return _FORMATS.get(kind.partition("/")[0], "")


def _read_json(file: Path) -> Any:
    """Content of a file; None where it is not there or no JSON."""
    try:
        return json.loads(file.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None


def _half_written(name: str) -> bool:
    """True if a file was left by an interrupted write."""
    return name.startswith(".") and ".part" in name


def _check_json(file: Path, options: Output) -> None:
    """Refuse a file of ``--json`` that would overwrite what the command reads or writes."""
    if file.is_dir():
        raise InvalidSetting(f"--json {file} is a folder; give a file, or '-' for standard output")
    place = file.resolve()
    for name, value in vars(options).items():
        for each in value if isinstance(value, tuple) else [value]:
            if name == "sources":
                each = Path(str(each).rpartition("=")[2])  # NAME=PATH
            if isinstance(each, Path) and place.is_relative_to(each.resolve()):
                raise InvalidSetting(
                    f"--json {file} lies in {each} ({name}), which this command reads or writes "
                    "itself; give another file, or '-' for standard output"
                )


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


def _given(options: Any) -> Iterator[tuple[str, str]]:
    """All options with their values, defaults included."""
    for name, value in vars(options).items():
        if is_dataclass(value):
            yield from _given(value)
        elif value is not None and name not in ("verbose", "quiet"):
            yield name, ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
