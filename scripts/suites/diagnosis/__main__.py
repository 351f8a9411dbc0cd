"""Run the blind suite and print its table; finished cases are kept."""

from __future__ import annotations

import argparse
from pathlib import Path

from scripts.suites.diagnosis.blind import in_session, recorded
from scripts.suites.diagnosis.cases import draw
from scripts.suites.diagnosis.grade import table
from scripts.suites.row_files import add, kept

SEED = 60_713
"""Of the printed tables; nothing was developed on it."""


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(prog="diagnosis_suite", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of finished cases")
    parser.add_argument("--cases", type=int, default=80, help="number of cases")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=SEED, help="of the draw")
    parser.add_argument("--runs", type=int, default=4, help="runs of a recording, at most")
    parser.add_argument("--form", choices=("recorded", "session", "both"), default="both")
    parser.add_argument("--table", action="store_true", help="print the table alone")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    forms = ("recorded", "session") if given.form == "both" else (given.form,)
    for form in forms:
        file = given.out / f"{form}-{given.seed}.jsonl"
        done = {row["case"] for row in kept(file)}
        for number in range(given.first, given.first + given.cases):
            if number in done or given.table:
                continue
            case = draw(number, given.seed)
            if form == "recorded":
                row = recorded(case, given.runs)
            else:
                row = in_session(case, 2 * given.runs)
            add(file, row)
            print(
                f"{form} {number} {row['arm']}: {row['true']} -> {row['said']} "
                f"({row['probability']:.3f}) {'' if row['true'] == row['said'] else 'WRONG'}",
                flush=True,
            )
        print(table(kept(file), f"{form}, seed {given.seed}"))


if __name__ == "__main__":
    main()
