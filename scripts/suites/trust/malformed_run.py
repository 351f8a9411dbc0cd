"""Read 10,000 malformed files, each in a process of its own kind, and count what came of it.

Recordings, models, configurations, results and weights are cut, shuffled, given wrong types, huge
numbers, hostile paths and hostile XML. Each has to be refused with a message that names the file,
or read where the damage is harmless; nothing outside may be opened or written, nothing run.

Usage: python -m scripts.suites.trust.malformed_run [--count 10000] [--out out/trust]

The same command goes on where it was stopped; the rows lie in malformed-SEED.jsonl.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from loose_env.cli.command import errors_in_one_line
from scripts.suites.trust.fuzz.cases import KINDS
from scripts.suites.trust.fuzz.watch import BAD

ROOT = Path(__file__).resolve().parents[3]
AT_ONCE = 100
"""Files that one process reads."""
SILENCE = 90.0
"""Longest a process may say nothing; then it hangs [s]."""


def rows_of(kind: str, start: int, stop: int, seed: int) -> Iterator[dict[str, Any]]:
    """Read some files of a kind; a file that kills its process, or stops it, is a row too."""
    while start < stop:
        command = [
            sys.executable,
            "-m",
            "scripts.suites.trust.fuzz.worker",
            kind,
            str(start),
            str(stop),
        ]
        worker = subprocess.Popen(
            [*command, "--seed", str(seed)],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert worker.stdout is not None
        begun, hung = start, threading.Event()

        def end(process: subprocess.Popen[str] = worker, late: threading.Event = hung) -> None:
            late.set()
            process.kill()

        while True:
            timer = threading.Timer(SILENCE, end)
            timer.start()
            line = worker.stdout.readline()
            timer.cancel()
            if not line:
                break
            row = json.loads(line)
            if "begun" in row:
                begun = row["number"]
                continue
            start = row["number"] + 1
            yield {"kind": kind} | row
        worker.stdout.close()
        code = worker.wait()
        if start < stop:
            outcome = "hung" if hung.is_set() else "died"
            words = f"the process ended with code {code}"
            yield {"kind": kind, "number": begun, "damage": "", "outcome": outcome, "words": words}
            start = begun + 1


def missing(
    kind: str, first: int, last: int, done: set[tuple[str, int]]
) -> Iterator[tuple[int, int]]:
    """Spans of numbers that are not done."""
    number = first
    while number < last:
        if (kind, number) in done:
            number += 1
            continue
        begin = number
        while number < last and (kind, number) not in done:
            number += 1
        yield begin, number


def table(rows: list[dict[str, Any]]) -> str:
    """Counts by kind, as a table in Markdown, and every row that must not be."""
    there = {row["kind"] for row in rows}
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS if kind in there}
    for row in rows:
        counts[row["kind"]][row["outcome"]] += 1
    lines = ["| kind | files | refused | read | anything else |", "|---|---:|---:|---:|---:|"]
    whole: Counter[str] = Counter()
    for kind, found in [*counts.items(), ("all", whole)]:
        if kind != "all":
            whole += found
        bad = sum(found[name] for name in BAD)
        total = sum(found.values())
        lines.append(f"| {kind} | {total} | {found['refused']} | {found['read']} | {bad} |")
    bad_rows = [row for row in rows if row["outcome"] in BAD]
    lines += [
        f"\n{row['kind']} {row['number']} ({row['damage']}): {row['outcome']}: {row['words']}"
        for row in bad_rows[:40]
    ]
    return "\n".join(lines)


def main() -> None:
    """Read the options, and the files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10_000, help="files in all")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--seed", type=int, default=1, help="of the damage")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "trust")
    parser.add_argument("--show", action="store_true", help="print what is stored")
    parser.add_argument("--again", action="store_true", help="read anew what was not right")
    options = parser.parse_args()
    with errors_in_one_line("trust_malformed", interrupted="the same command goes on"):
        options.out.mkdir(parents=True, exist_ok=True)
        file = options.out / f"malformed-{options.seed}.jsonl"
        stored = file.read_text().splitlines() if file.is_file() else []
        rows = [json.loads(line) for line in stored if line.endswith("}")]
        if options.again:
            rows = [row for row in rows if row["outcome"] not in BAD]
        if not options.show:
            file.write_text("".join(json.dumps(row) + "\n" for row in rows))
            done = {(row["kind"], row["number"]) for row in rows}
            each = -(-options.count // len(options.kinds))
            with file.open("a") as target:
                for first in range(0, each, AT_ONCE):
                    for kind in options.kinds:
                        last = min(first + AT_ONCE, each)
                        for begin, end in missing(kind, first, last, done):
                            for row in rows_of(kind, begin, end, options.seed):
                                rows.append(row)
                                target.write(json.dumps(row) + "\n")
                                target.flush()
                    print(f"{len(rows)} of {each * len(options.kinds)}", file=sys.stderr)
        print(table(rows))
    if any(row["outcome"] in BAD for row in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
