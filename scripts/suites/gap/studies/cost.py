"""Time and memory of `loose gap`: each recording in a process of its own, on one thread.

python -m scripts.suites.gap.studies.cost [--cases 101 1636 1270] [--recordings FOLDER ...] [--docs]

Cases are those of the suite, by number; what their arms lack is in the table. Seconds are of the
processor, start included; memory is the largest resident set.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from loose_env.cli.command import errors_in_one_line
from loose_env.errors import InvalidData
from loose_env.recording import Recording, read_recording
from scripts.study import write_between
from scripts.suites.gap.cases.draw import draw_case, tolerance_of
from scripts.suites.gap.cases.recordings import runs_of, write_runs

__all__ = ["Cost", "cost_of", "main", "table"]

DOCS = Path(__file__).resolve().parents[4] / "docs" / "gap_suite.md"


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one run of `loose gap` took."""

    name: str
    """What was given to it."""
    size: str
    """Joints, runs, lengths and rates."""
    said: str
    """What it said."""
    seconds: float
    """Processor time [s]."""
    peak_mb: float
    """Largest resident set [MB]."""


def cost_of(folder: Path, out: Path, *, name: str, tolerance: float | None = None) -> Cost:
    """Run `loose gap` on a recording and measure its process.

    Parameters
    ----------
    folder : Path
        The recording.
    out : Path
        Folder for the result.
    name : str
        What it is called in the table.
    tolerance : float, optional
        Largest relative error of the nominal figures; by default the tool's.

    Raises
    ------
    InvalidData
        If the tool gives no result.
    """
    words = [sys.executable, "-m", "loose_env", "gap", str(folder), "--out", str(out)]
    words += ["--threads", "1", "--ignore-doctor"]
    words += [] if tolerance is None else ["--tolerance", str(tolerance)]
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(words, stdout=said, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        last = said.read().decode(errors="replace").strip().splitlines()[-1:]
    if process.returncode:
        raise InvalidData(f"loose gap gives no result for {name}: {' '.join(last)}")
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    effects = [f"{e['kind']} at {e['where']}" for e in result["effects"]]
    return Cost(
        name=name,
        size=_size(read_recording(folder)),
        said=", ".join(effects[:3]) + (f" and {len(effects) - 3} more" if len(effects) > 3 else "")
        or result["verdict"],
        seconds=usage.ru_utime + usage.ru_stime,
        peak_mb=usage.ru_maxrss / 1024,
    )


def _size(recording: Recording) -> str:
    runs = recording.runs
    seconds = sum(float(run.time[-1] - run.time[0]) for run in runs)
    rate = (len(runs[0].time) - 1) / float(runs[0].time[-1] - runs[0].time[0])
    form = "torque against motion" if runs[0].torques else "commands and motion"
    joints = recording.model().njnt
    return f"{joints} joints, {len(runs)} runs, {seconds:.0f} s at {rate:.0f} Hz, {form}"


def table(costs: Sequence[Cost]) -> str:
    """Costs in Markdown."""
    lines = [
        "| recording | size | said | processor time [s] | memory [MB] |",
        "|---|---|---|---:|---:|",
    ]
    for cost in costs:
        lines.append(
            f"| {cost.name} | {cost.size} | {cost.said} | {cost.seconds:.0f} | {cost.peak_mb:.0f} |"
        )
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, nargs="*", default=[], help="numbers of the suite")
    parser.add_argument("--recordings", type=Path, nargs="*", default=[], help="folders")
    parser.add_argument("--docs", action="store_true", help="write the table into the docs")
    given = parser.parse_args(words)
    if not (given.cases or given.recordings):
        parser.error("give cases of the suite, or recordings")
    with (
        errors_in_one_line("cost", interrupted="nothing was written"),
        tempfile.TemporaryDirectory() as place,
    ):
        found = []
        for number in given.cases:
            case = draw_case(number)
            folder = write_runs(Path(place) / f"{number}", case, runs_of(case))
            lacks = ", ".join(f"{e.kind} at {e.place.name}" for e in case.arm.effects)
            name = f"case {number}: {lacks or 'nothing missing'}"
            tolerance = tolerance_of(number)
            out = Path(place) / f"{number}-out"
            found.append(cost_of(folder, out, name=name, tolerance=tolerance))
            print(table(found).splitlines()[-1], flush=True)
        for folder in given.recordings:
            found.append(cost_of(folder, Path(place) / f"{folder.name}-out", name=folder.name))
            print(table(found).splitlines()[-1], flush=True)
        if given.docs:
            write_between(DOCS, table(found), name="cost")


if __name__ == "__main__":
    main()
