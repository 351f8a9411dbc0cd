"""What suites and studies share: settings, tools in their own processes, rows that are resumed.

Rows are JSON lines, run and resumed case by case, with a hash of the code.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

from loose_agents.jobs import BackendSettings, canonical, results_of

import loose_env
from loose_env.errors import InvalidSetting
from loose_env.evaluation import configuration_hash
from loose_env.io import Checked, Count

Row = dict[str, Any]
ALONE = BackendSettings(workers=1)
"""Cases one after the other in this process."""


@dataclass(frozen=True, kw_only=True)
class BlindSettings(Checked):
    """Settings of every blind suite."""

    numbers: tuple[str, ...] = ("0-59",)
    """Cases, as in 7 or 0-59; from 10000 on they are for judging and need a phrase."""
    phrase: str = ""
    """Words of which cases for judging are drawn; choose new ones when you judge."""
    out: Path | None = None
    """Folder of rows and results; out/gap_suite/TOOL or out/instrument_suite/TOOL by default."""
    blind: Path | None = None
    """Folder of recordings and truth, made where they lack; by default beside those of tools."""
    make: Path | None = None
    """Write recordings, truth, protocol and commitments into this folder and run nothing."""
    answers: Path | None = None
    """Folder of answers, CASE.json each, that are graded in place of a tool's."""
    show: bool = False
    """Run nothing, print the table of the kept rows."""
    afresh: bool = False
    """Remove kept rows first."""
    workers: Count = 1
    """Processes side by side."""


def named(name: str, known: str) -> Any:
    """What stands at ``module:object``; ``known`` are other names that could have been given."""
    module, colon, place = name.partition(":")
    if not colon:
        raise InvalidSetting(f"no tool {name!r}; give {known} or module:object")
    try:
        return getattr(importlib.import_module(module), place)
    except (ImportError, AttributeError) as error:
        raise InvalidSetting(f"no tool {name!r}: {error}") from error


def asked_apart(module: str, words: Sequence[str], log: Path, seconds: float) -> tuple[bool, str]:
    """Run a module in a process of its own; whether it ended in time, and its last words."""
    with log.open("w", encoding="utf-8") as said:
        try:
            done = subprocess.run(
                [sys.executable, "-m", module, *words], stdout=said, stderr=said, check=False,
                timeout=seconds, env=os.environ | {"PYTHONUNBUFFERED": "1"},
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return False, f"longer than {seconds:.0f} s"
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return True, lines[-1] if lines else f"exit code {done.returncode}"


def kept(path: Path) -> list[Row]:
    """Rows of a file, none where there is none; a line that was cut off is left out."""
    rows = []
    for line in path.read_text("utf-8").splitlines() if path.is_file() else ():
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def add(path: Path, row: Row) -> None:
    """Append a row, on a line of its own also after one that was cut off."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cut = path.is_file() and not path.read_bytes().endswith(b"\n") and path.stat().st_size > 0
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" * cut + json.dumps(row) + "\n")


def run_cases(
    cases: Iterable[Any],
    work: Callable[[Any], Row],
    path: Path,
    *,
    key: Callable[[Row], Any] = itemgetter("number"),
    code: str = "",
    backend: BackendSettings = ALONE,
    say: Callable[[Row], str] = str,
    afresh: bool = False,
    show: bool = False,
) -> list[Row]:
    """Rows of the cases asked for, in order; those that the file lacks are run and appended.

    ``key`` gives the case of a row, ``code`` stands for all that rows rest on: rows of other code
    are refused. ``show`` runs nothing, ``afresh`` removes kept rows first.
    """
    if afresh:
        path.unlink(missing_ok=True)
    rows = {key(row): row for row in kept(path)}
    if others := {row.get("code", "") for row in rows.values()} - {code}:
        raise InvalidSetting(f"{path} has rows of other code or settings "
                             f"({', '.join(sorted(others))}); --afresh removes them")  # fmt: skip
    asked = list(dict.fromkeys(cases))
    missing = [case for case in asked if case not in rows and not show]
    for count, (_, row) in enumerate(results_of(work, missing, backend), start=1):
        rows[key(row)] = {**row, "code": code}
        add(path, rows[key(row)])
        print(f"{count}/{len(missing)} {say(row)}", flush=True)
    return [rows[case] for case in asked if case in rows]


def blind_rows(
    given: BlindSettings,
    file: Path,
    code: str,
    numbers: Sequence[int],
    work: Callable[[int], Row],
    say: Callable[[Row], str],
) -> list[Row]:
    """Rows of cases of a blind suite, kept in a file."""
    if not given.afresh and {row["phrase"] for row in kept(file)} - {given.phrase, ""}:
        raise InvalidSetting(f"{file} has rows of another phrase; give another --out")
    backend = BackendSettings(workers=given.workers)
    return run_cases(numbers, work, file, code=code, backend=backend, say=say,
                     afresh=given.afresh, show=given.show)  # fmt: skip


def code_hash(*places: Path) -> str:
    """Hash of Python files and of those in folders."""
    digest = hashlib.sha256()
    for place in places:
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def code_of_study(settings: Any) -> str:
    """Version of the package and hash of the settings on which the rows of a study rest."""
    return f"{loose_env.__version__}-{configuration_hash(canonical(settings))[:8]}"
