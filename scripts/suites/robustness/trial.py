"""One case in a process of its own: outcome, time and peak memory."""

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
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scripts.suites.robustness.cases import Case, write_case

__all__ = ["MOST_BYTES", "OUTCOMES", "Outcome", "as_row", "outcome_of", "run_case", "tried"]

OUTCOMES = ("result", "refused", "traceback", "unclear", "late", "died")
"""Outcomes of a case. "unclear" is a refusal of several lines or none."""
MOST_BYTES = 4 * 1024**3
"""Memory that a process may have [byte]; beyond it allocations fail."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of one case."""

    command: str
    case: str
    """Short description of the case."""
    outcome: str
    """One of `OUTCOMES`."""
    words: str = ""
    """Refusal, or the traceback."""
    seconds: float = 0.0
    """CPU time [s]."""
    peak_mb: float = 0.0
    """Peak resident memory of the process [MB]."""


def run_case(case: Case, folder: Path) -> tuple[str, str]:
    """Run a case in this process; return its outcome and what was said.

    Anything but an exit code is a traceback, as a user would see it.
    """
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


def tried(case: Case, *, seconds: float) -> Outcome:
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
    return Outcome(
        command=case.command,
        case=case.words,
        outcome=found[0],
        words=found[1],
        seconds=usage.ru_utime + usage.ru_stime,
        peak_mb=usage.ru_maxrss / 1024,
    )


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


def as_row(outcome: Outcome, number: int) -> dict[str, Any]:
    """Row of a numbered case."""
    return {"number": number} | asdict(outcome)


def outcome_of(row: Mapping[str, Any]) -> Outcome:
    """Outcome of a row."""
    return Outcome(**{name: value for name, value in row.items() if name != "number"})
