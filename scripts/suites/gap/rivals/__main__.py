"""Table of `loose gap` and other methods on the same cases, from the rows that are stored.

Usage: python -m scripts.suites.gap.run --tool stepwise_bic --numbers 1601-1633   (makes rows)
       python -m scripts.suites.gap.rivals [--docs]                               (the table)
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.execution.study import write_between

from loose_env.errors import InvalidSetting
from scripts.suites.gap.cases.cases import LAST
from scripts.suites.gap.grading.one_case import Row
from scripts.suites.gap.rivals.comparison import table
from scripts.suites.gap.run import DOCS, TOOLS, folder_of, store_in, stored

__all__ = ["main", "rows_of_tools"]


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


def main(words: Sequence[str] | None = None) -> None:
    """Print the table, and write it into the docs."""
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
    given = parser.parse_args(words)
    with errors_in_one_line("rivals"):
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
