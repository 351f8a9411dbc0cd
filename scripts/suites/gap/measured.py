"""Run `loose gap` on measured recordings: verdicts, CPU time, held-out error before and after.

python -m scripts.suites.gap.measured RECORDING [RECORDING ...] [--each] [--out FILE.jsonl]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from tyro.conf import Positional

from loose_env.cli.command import command
from loose_env.errors import LooseEnvError
from loose_env.gap import GapSettings, NamedEffect, solve_gap
from loose_env.io import plain
from loose_env.recording import Recording, read_recording
from loose_env.report import gap_text
from scripts.suites.rows import Row, add, kept

_NAMED = 3
"""Held-out runs that are named; more are counted."""
QUANTITY = "joint position [rad]"
"""Error that the table shows: of windows of held-out runs, simulated from the measured state."""


def row_of(recording: Recording, settings: GapSettings) -> Row:
    """Result of a recording, and the processor time it took [s]; prints what was found."""
    begun, row = time.process_time(), {"recording": recording.folder.name}
    try:
        say = partial(print, file=sys.stderr, flush=True)
        found = solve_gap(recording, settings, say=say).result
    except LooseEnvError as error:
        return row | {"error": str(error), "held_out": []}
    seconds = time.process_time() - begun
    print(f"== {row['recording']}: {seconds:.1f} s\n{gap_text(found, warnings=False)}", flush=True)
    return row | {
        "seconds": seconds, "held_out": list(found.held_out_runs), "error": None,
        "rmse": found.gap.by_quantity.get(QUANTITY),
        "named": "; ".join(map(_words, found.effects)) or found.verdict,
        "result": plain(asdict(found), digits=17),
    }  # fmt: skip


def _words(effect: NamedEffect) -> str:
    """Kind and location with the values and their intervals."""
    values = ", ".join(f"{name} {effect.value_in_words(name)}" for name in effect.parameters)
    return f"`{effect.kind}` at {effect.where}: {values}"


def table(rows: Sequence[Row]) -> str:
    """Rows in Markdown."""
    lines = [
        "| recording | held out | named | error before [rad] | after [rad] | ratio | CPU [s] |",
        "|---|---|---|---:|---:|---:|---:|",
    ]
    for row in rows:
        if row["error"] is not None:
            lines.append(f"| {row['recording']} | | refused: {row['error']} | | | | |")
            continue
        names = [f"`{Path(name).stem}`" for name in row["held_out"]]
        held = ", ".join(names) if len(names) <= _NAMED else f"{len(names)} runs"
        errors = " |  | "
        if row["rmse"] is not None:
            before, after = row["rmse"]
            errors = f"{before:.4f} | {after:.4f} | {after / before:.2f}"
        cells = (row["recording"], held, row["named"], errors, f"{row['seconds']:.0f}")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class MeasuredSettings:
    """Which recordings, and how."""

    recordings: Positional[tuple[Path, ...]] = ()
    """Folders of recordings."""
    out: Path | None = None
    """File of rows (JSON lines); those that it has already are not run again."""
    threads: int = 1
    """Threads of each comparison."""
    each: bool = False
    """Hold out every run in turn, not what the tool holds out."""


def run(given: MeasuredSettings) -> None:
    """Run the recordings that the file lacks and print the table."""
    rows = [] if given.out is None else kept(given.out)
    done = {(row["recording"], tuple(row["asked"])) for row in rows if row["error"] is None}
    for folder in given.recordings:
        recording = read_recording(folder)
        for held in [(run.name,) for run in recording.runs] if given.each else [()]:
            if (recording.folder.name, held) in done:
                continue
            settings = GapSettings(threads=given.threads, held_out=held)
            row = row_of(recording, settings) | {"asked": held}
            rows.append(row)
            if given.out is not None:
                add(given.out, row)
    print(table(sorted(rows, key=lambda row: (row["recording"], row["held_out"]))))


if __name__ == "__main__":
    command("measured", __doc__, MeasuredSettings, run, interrupted="the same command goes on")
