"""Table of `loose gap` and other methods on the same cases, from the rows that are stored.

Usage: python -m scripts.suites.gap.run --tool stepwise_bic --numbers 1601-1633   (makes rows)
       python -m scripts.suites.gap.rivals [--docs]                               (the table)
       python -m scripts.suites.gap.rivals --recording FOLDER [--tool sysid]      (one recording)
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loose_env.cli.command import errors_in_one_line
from loose_env.errors import InvalidSetting
from loose_env.gap import read_result
from scripts.study import write_between
from scripts.suites.gap.cases.cases import LAST
from scripts.suites.gap.grading.grade import NAMED, Grade
from scripts.suites.gap.grading.one_case import Row, grade_of
from scripts.suites.gap.grading.tables import share
from scripts.suites.gap.rivals import METHODS, run_method
from scripts.suites.gap.run import DOCS, TOOLS, folder_of, store_in, stored

__all__ = ["LABELS", "MethodRow", "common_cases", "main", "method_row", "rows_of_tools", "table"]

LABELS: Mapping[str, str] = {
    "loose_gap": "`loose gap`",
    "sysid": "`mujoco.sysid`, all parameters free",
    "least_squares": "dense least squares, t-tests",
    "stepwise_bic": "stepwise selection, BIC",
    "group_lasso": "group lasso",
    "residual_network": "residual network",
}
"""Names in the table."""
_HEAD = (
    "method", "single effects correct", "effects found", "named effects that are there",
    "false alarms, nothing missing", "outside the catalogue, nothing named",
    "error of parameters, median", "held-out RMS residual after, median [noise sd]",
    "time, median [s]",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MethodRow:
    """What one tool came to on the cases."""

    name: str
    cells: tuple[str, ...]
    """Cells of the table after the name."""


def common_cases(rows: Mapping[str, Sequence[Row]]) -> list[int]:
    """Numbers of the cases that every tool has a row of, in their order."""
    numbers = [{int(row["number"]) for row in own} for own in rows.values() if own]
    return sorted(set.intersection(*numbers)) if numbers else []


def method_row(name: str, rows: Sequence[Row]) -> MethodRow:
    """Marks of one tool.

    Parameters
    ----------
    name : str
        Name of the tool.
    rows : sequence of Row
        Its rows of the cases that are compared.
    """
    grades = [grade_of(row) for row in rows]
    single = _of(grades, "single")
    true = [g for g in grades if g.truth and g.role != "outside"]
    none, outside = _of(grades, "none"), _of(grades, "outside")
    errors = [error for g in grades for error in g.parameter_error]
    after = [g.gap_after for g in true if np.isfinite(g.gap_after)]
    seconds = [g.seconds for g in grades if np.isfinite(g.seconds)]
    named = sum(len(g.said) for g in grades)
    return MethodRow(
        name=name,
        cells=(
            share(sum(g.right for g in single), len(single)),
            share(sum(g.found for g in true), sum(len(g.truth) for g in true)),
            share(sum(g.found for g in true), named) if named else "none named",
            # a verdict of its own kind, too, where nothing is missing
            share(sum(not g.right for g in none), len(none)),
            share(sum(g.verdict != NAMED for g in outside), len(outside)),
            f"{100 * np.median(errors):.1f} % of {len(errors)}" if errors else "none",
            f"{np.median(after):.2f}" if after else "none",
            f"{np.median(seconds):.0f}" if seconds else "none",
        ),
    )


def _of(grades: Sequence[Grade], role: str) -> list[Grade]:
    return [g for g in grades if g.role == role]


def table(rows: Mapping[str, Sequence[Row]]) -> str:
    """One line for each tool, on the cases that all of them have, as markdown.

    Parameters
    ----------
    rows : mapping
        Name of a tool -> its rows; tools without rows are left out.
    """
    numbers = set(common_cases(rows))
    lines = [
        f"{len(numbers)} cases that all methods have run: {_ranges(sorted(numbers))}.",
        "",
        "| " + " | ".join(_HEAD) + " |",
        "| --- |" + " --- |" * (len(_HEAD) - 1),
    ]
    for name, own in rows.items():
        if own:
            row = method_row(name, [r for r in own if r["number"] in numbers])
            lines.append("| " + " | ".join((LABELS.get(name, name), *row.cells)) + " |")
    return "\n".join(lines)


def _ranges(numbers: Sequence[int]) -> str:
    """Numbers as ranges.

    Examples
    --------
    >>> _ranges([1, 2, 3, 7])
    '1-3 7'
    """
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return " ".join(f"{p[0]}-{p[-1]}" if len(p) > 1 else f"{p[0]}" for p in parts)


def rows_of_tools(out: Path | None = None) -> dict[str, list[Row]]:
    """Rows of every tool, none where it has not run.

    Parameters
    ----------
    out : Path, optional
        Folder in which those of the tools lie; that of the suite's command by default.
    """
    found: dict[str, list[Row]] = {}
    for tool in TOOLS:
        folder = folder_of(tool) if out is None else out / folder_of(tool).name
        has_run = (folder / "rows").is_dir()
        found[tool] = stored(range(LAST + 1), store_in(folder, tool=tool)) if has_run else []
    return found


def said_of(recording: Path, name: str, tolerance: float) -> str:
    """What a method says of one recording, a line for each effect.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    name : str
        One of `METHODS`.
    tolerance : float
        Largest relative error of the nominal parameters.
    """
    with tempfile.TemporaryDirectory() as place:
        run_method(recording, Path(place), tolerance, name=name)
        result = read_result(place)
    gap = result.gap
    lines = [
        f"{LABELS[name]}: {result.verdict}; residual on the held-out run {gap.before:.2f} noise sd "
        f"before, {gap.after:.2f} after"
    ]
    for effect in (*result.effects, *result.doubtful):
        values = []
        for key, value in effect.parameters.items():
            low, high = effect.interval_95.get(key, (np.nan, np.nan))
            values.append(f"{key} {value:.4g} ({low:.4g} to {high:.4g})")
        lines.append(f"  {effect.kind} at {effect.where}: {', '.join(values)}")
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> None:
    """Print the table, or what a method says of one recording."""
    parser = argparse.ArgumentParser(
        prog="rivals", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, help="folder in which the folders of the tools lie; default: out"
    )
    parser.add_argument(
        "--docs",
        nargs="?",
        type=Path,
        const=DOCS,
        metavar="PAGE",
        help="write the table to a page (docs/gap_suite.md if none is named)",
    )
    parser.add_argument(
        "--recording", type=Path, metavar="FOLDER", help="run a method on one recording instead"
    )
    parser.add_argument("--tool", choices=list(METHODS), default="sysid", help="the method")
    parser.add_argument(
        "--tolerance", type=float, default=0.03, help="error of the nominal parameters"
    )
    given = parser.parse_args(words)
    with errors_in_one_line("rivals"):
        if given.recording is not None:
            print(said_of(given.recording, given.tool, given.tolerance))
            return
        rows = rows_of_tools(given.out)
        if not any(rows.values()):
            raise InvalidSetting(
                "no tool has rows; run python -m scripts.suites.gap.run --tool NAME first"
            )
        text = table(rows)
        print(text)
        if given.docs is not None:
            write_between(given.docs, text, name="methods")


if __name__ == "__main__":
    main()
