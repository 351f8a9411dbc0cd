"""Edit test: an effect is taken off the machine, and off the model that was corrected for it.

python -m scripts.suites.gap.studies.edits 1301 2130 [--docs]

The corrected model without the effect, not refitted, has to predict the motion of the edited
machine. A model that compensates one error by another fits the machine as it was and fails here
(the test of SAPC). The tool is told nothing of the edited machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

from loose_env.cli.command import errors_in_one_line
from loose_env.gap import GapSettings, GapSolution, find_gap, prediction_error
from loose_env.recording import read_recording
from scripts.study import write_between
from scripts.suites.gap.cases.cases import HELD_OUT, Case
from scripts.suites.gap.cases.draw import draw_case, tolerance_of
from scripts.suites.gap.cases.numbers import numbers_of
from scripts.suites.gap.cases.recordings import runs_of, write_runs

__all__ = ["EditRow", "edit_rows", "main"]

DOCS = Path(__file__).resolve().parents[4] / "docs/gap_suite.md"


@dataclasses.dataclass(frozen=True, kw_only=True)
class EditRow:
    """One effect taken off one machine."""

    number: int
    """The case."""
    effect: str
    """Kind and place."""
    left: int
    """True effects that stay on the machine."""
    nominal: float
    """Error of the nominal model on the edited machine [noise sd]."""
    unedited: float
    """The same of the corrected model with the effect still in it."""
    edited: float
    """The same of the corrected model without it."""


def edit_rows(number: int, *, kinds: tuple[str, ...] = ()) -> list[EditRow]:
    """Run the tool on a case, and edit every effect that it named rightly.

    Parameters
    ----------
    number : int
        The case.
    kinds : tuple of str
        Kinds that the tool considers; all by default.
    """
    case = draw_case(number)
    settings = GapSettings(threads=1, tolerance=tolerance_of(number), kinds=kinds)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        as_it_was = write_runs(place / "as-it-was", case, runs_of(case))
        solution = find_gap(read_recording(as_it_was), settings)
        named = {(effect.kind, effect.where) for effect in solution.effects}
        return [
            _row(place / f"edited-{k}", case, k, solution, settings)
            for k, effect in enumerate(case.arm.effects)
            if (effect.kind, effect.place.name) in named
        ]


def _row(
    place: Path, case: Case, number: int, solution: GapSolution, settings: GapSettings
) -> EditRow:
    """Error of three models on the held-out run of the machine without one effect."""
    off = case.arm.effects[number]
    others = tuple(effect for effect in case.arm.effects if effect is not off)
    edited = dataclasses.replace(case, arm=dataclasses.replace(case.arm, effects=others))
    runs = runs_of(case)
    runs[HELD_OUT] = runs_of(edited)[HELD_OUT]
    recording = read_recording(write_runs(place, case, runs))
    key = (off.kind, off.place.name)
    kept = [(e, v) for e, v in solution.corrected.pairs if (e.kind, e.where) != key]
    return EditRow(
        number=case.number,
        effect=f"{off.kind} at {off.place.name}",
        left=len(others),
        nominal=prediction_error(recording, solution.nominal, settings),
        unedited=prediction_error(recording, solution.corrected, settings),
        edited=prediction_error(recording, solution.corrected.with_effects(kept), settings),
    )


def table(rows: Sequence[EditRow]) -> str:
    """Rows in Markdown."""
    lines = [
        "| case | effect taken off | effects left | nominal model | corrected, with it "
        "| corrected, without it |",
        "|---:|---|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {row.number} | {row.effect} | {row.left} | {row.nominal:.2f} | {row.unedited:.2f} | "
        f"{row.edited:.2f} |"
        for row in rows
    ]
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(prog="edits", description=__doc__)
    parser.add_argument("numbers", nargs="+", metavar="CASE", help="cases, as in 1301 or 2130-2135")
    parser.add_argument("--docs", action="store_true", help="write the table into the docs")
    given = parser.parse_args(words)
    with errors_in_one_line("edits"):
        rows = []
        for number in numbers_of(given.numbers):
            found = edit_rows(number)
            rows += found
            lines = table(found).splitlines()[2:] or [f"| {number} | nothing named rightly |"]
            print("\n".join(lines), flush=True)
        print(table(rows))
        if given.docs:
            write_between(DOCS, table(rows), name="edits")


if __name__ == "__main__":
    main()
