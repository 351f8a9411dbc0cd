"""Verdicts on a healthy and a loose arm that each have one disturbance alone.

python -m scripts.suites.machines.disturbances_shown --out FILE.jsonl [--docs]
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from scripts.study import write_between
from scripts.suites.machines.__main__ import DOCS
from scripts.suites.machines.case import Case, draw
from scripts.suites.machines.disturbances import KINDS, Disturbances
from scripts.suites.machines.plans import CaseSettings
from scripts.suites.machines.run import Row, examined
from scripts.suites.row_files import add, kept

NUMBER, SEED = 33, 1
"""Case whose arm and fault are played: a fault that opens on the arm without disturbances."""


def case_with(
    name: str, settings: CaseSettings, *, healthy: bool, reference: bool, strength: float
) -> Case:
    """Return the arm with one disturbance, or with none by the name "none"."""
    own = Disturbances.none() if name == "none" else Disturbances.only(name, strength)
    case = draw(NUMBER, SEED, settings, disturbances=own, healthy=healthy)
    return dataclasses.replace(case, reference=reference)


def table(rows: Sequence[Row]) -> str:
    """Verdicts by disturbance in Markdown."""
    columns = [(h, r) for h in (True, False) for r in (False, True)]
    titles = ["disturbance"] + [
        f"{'healthy' if h else 'loose'} arm{', reference' if r else ''}" for h, r in columns
    ]
    lines = ["| " + " | ".join(titles) + " |", "|---|" + "---|" * len(columns)]
    for name in ("none", *KINDS):
        said = []
        for healthy, reference in columns:
            own = [
                row for row in rows
                if row["only"] == name and row["reference"] == reference
                and (row["link"] is None) == healthy
            ]  # fmt: skip
            said.append("; ".join(_said(row) for row in own))
        if any(said):
            lines.append("| " + " | ".join([f"`{name}`", *said]) + " |")
    return "\n".join(lines)


def _said(row: Row) -> str:
    if "error" in row:
        return "refused"
    if "unplayed" in row:
        return "held no pose"
    right = "" if row["named"] == row["truth"] else ", wrong"
    return f"{row['verdict']}: {row['named']} {row['probability']:.3f}{right}"


def main(words: Sequence[str] | None = None) -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(prog="disturbances_shown", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="file of rows (JSON lines)")
    parser.add_argument(
        "--only", choices=("none", *KINDS), action="append", help="these disturbances alone"
    )
    parser.add_argument("--strength", type=float, default=0.75, help="place in the range, 0 to 1")
    parser.add_argument("--reference", choices=("with", "without", "both"), default="both")
    parser.add_argument("--runs", type=int, default=6, help="suspect runs of a recording")
    parser.add_argument("--docs", action="store_true", help="write the table into the page")
    given = parser.parse_args(words)
    settings = CaseSettings(runs=given.runs)
    rows = kept(given.out)
    done = {(row["only"], row["link"] is None, row["reference"]) for row in rows}
    references = {"with": (True,), "without": (False,), "both": (False, True)}[given.reference]
    given.out.parent.mkdir(parents=True, exist_ok=True)
    for name in given.only or ("none", *KINDS):
        for healthy in (True, False):
            for reference in references:
                if (name, healthy, reference) in done:
                    continue
                case = case_with(
                    name, settings, healthy=healthy, reference=reference, strength=given.strength
                )
                row = examined(case) | {"only": name}
                add(given.out, row)
                print(f"{name}: {row['truth']} -> {_said(row)}", flush=True)
    made = table(kept(given.out))
    print(made)
    if given.docs:
        write_between(DOCS, made, name="shown")


if __name__ == "__main__":
    main()
