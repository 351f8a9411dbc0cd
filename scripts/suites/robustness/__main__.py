"""Try the commands on generated arms and recordings, and count results, refusals and tracebacks.

Usage: python -m scripts.suites.robustness [--examples 500] [--first 1] [--out out/robustness]
           [--docs]

Each case runs in a process of its own, with its peak memory measured. Rows are appended to
rows.jsonl in the output folder, and a case that is there is not run again; table.md has the counts,
and --docs writes them to docs/trust.md. The exit code is 1 where a case ended with a traceback,
without a clear line, late, or with more memory than allowed.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from loose_env.io import write_text
from scripts.study import write_between
from scripts.suites.robustness.cases import COMMANDS, case_of
from scripts.suites.robustness.trial import MOST_BYTES, OUTCOMES, Outcome, as_row, outcome_of, tried
from scripts.suites.row_files import add, kept

__all__ = ["main", "table"]

DOCS = Path(__file__).resolve().parents[3] / "docs" / "trust.md"
_FINE = ("result", "refused")


def table(rows: Sequence[Outcome]) -> str:
    """Counts of outcomes by command, as a table in Markdown."""
    head = ["command", "cases", *OUTCOMES, "slowest [s CPU]", "peak memory [MB]"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for command in dict.fromkeys(row.command for row in rows):
        own = [row for row in rows if row.command == command]
        counts = Counter(row.outcome for row in own)
        cells = [f"`loose {command}`", str(len(own)), *(str(counts[o]) for o in OUTCOMES)]
        cells += [f"{max(r.seconds for r in own):.1f}", f"{max(r.peak_mb for r in own):.0f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the suite; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--examples", type=int, default=100, help="number of cases")
    parser.add_argument("--first", type=int, default=1, help="number of the first case")
    parser.add_argument("--seconds", type=float, default=120.0, help="limit of one case [s]")
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=COMMANDS)
    parser.add_argument("--out", type=Path, default=Path("out/robustness"))
    parser.add_argument("--docs", action="store_true", help="write the table to docs/trust.md")
    options = parser.parse_args(arguments)
    import loose_env.cli.main  # noqa: F401  loaded once, before processes are forked

    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "rows.jsonl"
    done = {row["number"]: row for row in kept(file)}
    rows: list[Outcome] = []
    for number in range(options.first, options.first + options.examples):
        if number in done:
            rows.append(outcome_of(done[number]))
            continue
        row = tried(case_of(number, tuple(options.commands)), seconds=options.seconds)
        rows.append(row)
        add(file, as_row(row, number))
        if row.outcome not in _FINE:
            last = row.words.strip()[-600:]
            print(f"case {number}, {row.outcome}: {row.case}\n  {last}", flush=True)
    counts = table(rows)
    write_text(options.out / "table.md", counts)
    print(counts)
    if options.docs:
        write_between(DOCS, counts, name="robustness")
    wrong = [r for r in rows if r.outcome not in _FINE or r.peak_mb * 1024**2 > MOST_BYTES]
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
