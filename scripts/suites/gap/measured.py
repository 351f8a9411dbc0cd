"""Run `loose gap` on measured recordings: effects identified, held-out error before and after.

python -m scripts.suites.gap.measured RECORDING [RECORDING ...] --out FILE.jsonl [--each]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tyro.conf import Positional

import loose_env
from loose_env.cli.command import command
from loose_env.errors import InvalidSetting, LooseEnvError
from loose_env.io import plain
from loose_env.recording import read_recording
from scripts.suites.rows import Row, add, kept

_NAMED = 3
"""Held-out runs that are named; more are counted."""
QUANTITY = "joint position [rad]"
"""Error that the table shows: of windows of held-out runs, simulated from the measured state."""


def row_of(folder: Path, settings: dict[str, Any]) -> Row:
    """Result of a recording under some `GapSettings`, and the time it took [s]."""
    begun = time.perf_counter()
    say = partial(print, file=sys.stderr, flush=True)
    try:
        found = loose_env.explain_gap(folder, ignore_doctor=True, say=say, **settings).result
    except LooseEnvError as error:
        return {"recording": folder.name, "error": str(error), "held_out": []}
    return {
        "recording": folder.name,
        "seconds": time.perf_counter() - begun,
        "verdict": found.verdict,
        "held_out": list(found.held_out_runs),
        "error": None,
        "rmse": found.gap.by_quantity.get(QUANTITY),
        "effects": [plain(asdict(effect), digits=17) for effect in found.effects],
        "unexplained": [c.channel for c in found.channels if c.verdict == "unexplained"],
    }


def table(rows: Sequence[Row]) -> str:
    """Rows in Markdown."""
    lines = [
        "| recording | held out | named | error before [rad] | after [rad] | ratio | time [s] |",
        "|---|---|---|---:|---:|---:|---:|",
    ]
    for row in rows:
        if row["error"] is not None:
            lines.append(f"| {row['recording']} | | refused: {row['error']} | | | | |")
            continue
        named = "; ".join(_effect_words(effect) for effect in row["effects"]) or row["verdict"]
        numbers = "| | | "
        if row["rmse"] is not None:
            before, after = row["rmse"]
            numbers = f"| {before:.4f} | {after:.4f} | {after / before:.2f} "
        names = [f"`{Path(name).stem}`" for name in row["held_out"]]
        held = ", ".join(names) if len(names) <= _NAMED else f"{len(names)} runs"
        lines.append(f"| {row['recording']} | {held} | {named} {numbers}| {row['seconds']:.0f} |")
    return "\n".join(lines)


def _effect_words(effect: Row) -> str:
    figures = []
    for name, value in effect["parameters"].items():
        low, high = effect["interval_95"].get(name, (None, None))
        span = "" if low is None or high is None else f" ({low:.3g} to {high:.3g})"
        unit = effect["units"].get(name, "")
        figures.append(f"{name} {value:.3g}{span}{' ' if unit else ''}{unit}")
    return f"`{effect['kind']}` at {effect['where']}: {', '.join(figures)}"


@dataclass(frozen=True, kw_only=True)
class MeasuredSettings:
    """Which recordings, and how."""

    recordings: Positional[tuple[Path, ...]] = ()
    """Folders of recordings."""
    out: Path
    """File of rows (JSON lines)."""
    threads: int = 1
    """Threads of each comparison."""
    each: bool = False
    """Hold out every run in turn, not what the names say."""
    table: bool = False
    """Print the table of the kept rows alone."""


def run(given: MeasuredSettings) -> None:
    """Run the recordings that the file lacks and print the table."""
    rows = kept(given.out)
    if given.table and not rows:
        raise InvalidSetting(f"{given.out} has no rows to make a table of; run some recordings")
    done = {(row["recording"], tuple(row.get("asked", ()))) for row in rows if row["error"] is None}
    for folder in () if given.table else given.recordings:
        # every run in turn, or () for those that the names say
        names = [(run.name,) for run in read_recording(folder).runs] if given.each else [()]
        for held in names:
            if (folder.name, held) in done:
                continue
            row = row_of(folder, {"threads": given.threads, "held_out": held}) | {"asked": held}
            rows.append(row)
            add(given.out, row)
            print(table([row]).splitlines()[-1], flush=True)
    rows.sort(key=lambda row: (row["recording"], row["held_out"]))
    print(table(rows))


if __name__ == "__main__":
    command("measured", __doc__, MeasuredSettings, run, interrupted="the same command goes on")
