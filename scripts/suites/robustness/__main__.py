"""Try the commands on generated arms and recordings, and count results, refusals and tracebacks.

    python -m scripts.suites.robustness --examples 500

Each case runs in a process of its own, with its peak memory measured. Rows are kept in the output
folder, and a case that is there is not run again. The
exit code is 1 where a case ended with a traceback, without a clear line, late, or with more memory
than allowed.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loose_env.cli.command import command
from loose_env.errors import InvalidSetting
from scripts.suites.robustness.cases import COMMANDS, Case, case_of, write_case
from scripts.suites.rows import Row, run_cases

OUTCOMES = ("result", "refused", "traceback", "unclear", "late", "died")
"""Outcomes of a case. "unclear" is a refusal of several lines or none."""
MOST_BYTES = 4 * 1024**3
"""Memory that a process may have [byte]; beyond it allocations fail."""


def run_case(case: Case, folder: Path) -> tuple[str, str]:
    """Run a case in this process; return its outcome and what was said."""
    from loose_env.cli.main import main

    words = write_case(case, folder)
    said, shown = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(shown):
            code = main(words)
    except BaseException:
        return "traceback", traceback.format_exc()
    if code == 0 or shown.getvalue().strip():  # findings of the doctor end with 1
        return "result", ""
    head = f"loose {case.command}: "
    lines = [line for line in said.getvalue().splitlines() if line.startswith(head)]
    last = said.getvalue().strip().splitlines()[-1:] or [""]
    clear = len(lines) == 1 and lines == last and len(lines[0]) > len(head)
    return "refused" if clear else "unclear", "\n".join(lines or last)


def tried(case: Case, *, seconds: float) -> dict[str, Any]:
    """Run a case in a forked process with a limit of memory and of time [s]."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _child(case, writing)
    os.close(writing)
    ended, text = _ended(child, reading, seconds)
    status, usage = ended
    found = ("late", f"no end within {seconds:g} s") if status is None else (
        tuple(json.loads(text)) if text else ("died", f"the process ended with status {status}")
    )  # fmt: skip
    return {
        "command": case.command,
        "case": case.words,
        "outcome": found[0],
        "words": found[1],
        "seconds": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss / 1024,
    }


def _child(case: Case, writing: int) -> None:
    """Run the case and end the process."""
    resource.setrlimit(resource.RLIMIT_AS, (3 * MOST_BYTES, 3 * MOST_BYTES))
    sys.stdout.flush()
    with tempfile.TemporaryDirectory() as place:
        try:
            found = run_case(case, Path(place) / "case")
        except BaseException:
            found = ("died", f"the case itself: {traceback.format_exc()}")
    with os.fdopen(writing, "w") as file:
        json.dump(found, file)
    os._exit(0)


def _ended(
    child: int, reading: int, seconds: float
) -> tuple[tuple[int | None, resource.struct_rusage], str]:
    """Wait for a process; kill it where it is late."""
    until = time.monotonic() + seconds
    late = False
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            break
        if time.monotonic() > until and not late:
            os.kill(child, signal.SIGKILL)
            late = True
        time.sleep(0.02)
    with os.fdopen(reading) as file:
        text = file.read()
    return (None if late else status, usage), text


FINE = ("result", "refused")


@dataclass(frozen=True, kw_only=True)
class SuiteSettings:
    """Which cases, and their limits."""

    examples: int = 100
    """Number of cases."""
    first: int = 1
    """Number of the first case."""
    seconds: float = 120.0
    """Limit of one case [s]."""
    commands: tuple[str, ...] = COMMANDS
    """Commands that are tried."""
    out: Path = Path("out/robustness")
    """Folder of the rows."""


def table(rows: Sequence[Row]) -> str:
    """Counts of outcomes by command, as a table in Markdown."""
    head = ["command", "cases", *OUTCOMES, "slowest [s CPU]", "peak memory [MB]"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for name in dict.fromkeys(row["command"] for row in rows):
        own = [row for row in rows if row["command"] == name]
        counts = Counter(row["outcome"] for row in own)
        cells = [f"`loose {name}`", str(len(own)), *(str(counts[o]) for o in OUTCOMES)]
        cells += [f"{max(r['seconds'] for r in own):.1f}", f"{max(r['peak_mb'] for r in own):.0f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def line_of(row: Row) -> str:
    """A case in a line, with what it said where that is not fine."""
    said = "" if row["outcome"] in FINE else f"\n  {row['words'].strip()[-600:]}"
    return f"{row['outcome']}: {row['case']}{said}"


def run(given: SuiteSettings) -> None:
    """Run the cases and print the table."""
    import loose_env.cli.main  # noqa: F401  loaded once, before processes are forked

    if unknown := sorted(set(given.commands) - set(COMMANDS)):
        raise InvalidSetting(f"commands: {', '.join(unknown)}; there are {', '.join(COMMANDS)}")

    def work(number: int) -> Row:
        return tried(case_of(number, given.commands), seconds=given.seconds) | {"number": number}

    numbers = range(given.first, given.first + given.examples)
    rows = run_cases(numbers, work, given.out / "rows.jsonl", say=line_of)
    print(table(rows))
    if any(r["outcome"] not in FINE or r["peak_mb"] * 1024**2 > MOST_BYTES for r in rows):
        sys.exit(1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command("robustness", __doc__, SuiteSettings, run, arguments)


if __name__ == "__main__":
    main()
