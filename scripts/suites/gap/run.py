"""Grade the gap tool on blind recordings: the table of targets and the confusion matrix.

Each case is made by an arm that is integrated without MuJoCo, given to the tool as a recording and
nothing else, and graded against its sealed truth once the result is written. A case that is done is
stored: the same command goes on where it was stopped. No mark depends on the backend or the number
of workers. Only rows of the same code are put together (comments aside).

Usage: python -m scripts.suites.gap.run [--quick | --numbers 0-9 1004 2001] [--out FOLDER]
           [--tool NAME] [--docs] [--backend loky|threading|ray|dask] [--workers N]
       python -m scripts.suites.gap.run --show     (prints what is stored)
"""

from __future__ import annotations

import functools
import importlib.metadata
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from loose_agents.jobs import BackendSettings, ProgressLine, Store, WorkerDied, results_of

import loose_env
from loose_env.cli.command import command, one_of
from loose_env.errors import InvalidSetting
from scripts.study import write_between
from scripts.suites.gap import rivals
from scripts.suites.gap.cases.cases import SEED, full_list, quick_list
from scripts.suites.gap.cases.numbers import mixed, numbers_of
from scripts.suites.gap.grading.code_hash import code_hash
from scripts.suites.gap.grading.one_case import (
    Folders,
    Row,
    grade_of,
    line_of,
    lost,
    run_case,
    shard_for,
)
from scripts.suites.gap.grading.rows import take_rows, write_rows
from scripts.suites.gap.grading.tables import lines_of_cases, markdown, text
from scripts.suites.gap.grading.tool import Tool, run_tool

ROOT = Path(__file__).resolve().parents[3]
OUT = ROOT / "out" / "gap_suite"
DOCS = ROOT / "docs" / "gap_suite.md"
TOOL = "loose_gap"
"""Name of the tool under test."""
TOOLS = (TOOL, *rivals.METHODS)
"""Names of all tools."""
ROWS = "gap_suite_rows.jsonl"
"""File of the rows, beside the page."""
NEW = "# Identification accuracy of `loose gap`\n\n<!-- tables: begin -->\n<!-- tables: end -->\n"
"""Page that is made where there is none."""


def configuration(tool: str = TOOL) -> dict[str, Any]:
    """Everything that the rows of a tool depend on."""
    package = Path(loose_env.__file__).parent
    if tool == TOOL:
        made = code_hash([package / "gap", package / "recording", package / "statistics"])
    else:
        # methods read recordings and write results by the package, and use nothing else of it
        own = code_hash(
            [package / "recording", Path(rivals.__file__).parent],
            without=("__init__.py", "__main__.py"),
        )
        made = f"{tool} {own}"
    return {
        "study": "gap suite",
        "seed": SEED,
        "tool": made,
        "suite": code_hash(
            [ROOT / "scripts" / "suites" / "gap"],
            without=(
                "__init__.py",
                "__main__.py",
                "tables.py",
                "rows.py",
                "code_hash.py",
                "run.py",
                "rivals",
                "public",
                "studies",
            ),
        ),
        "versions": {
            name: importlib.metadata.version(name) for name in ("mujoco", "numpy", "scipy")
        },
    }


def folder_of(tool: str) -> Path:
    """Default folder of the rows and results of a tool."""
    return OUT if tool == TOOL else OUT.with_name(f"{OUT.name}_{tool}")


def tool_named(name: str) -> Tool:
    """The tool under test, or another method by its name.

    Raises
    ------
    InvalidSetting
        If there is none of the name.
    """
    if name == TOOL:
        return run_tool
    if name not in rivals.METHODS:
        raise InvalidSetting(f"{name!r} is no tool; there are {', '.join(TOOLS)}")
    return functools.partial(rivals.run_method, name=name)


def store_in(out: Path, *, tool: str = TOOL, afresh: bool = False) -> Store:
    """The rows of a tool in a folder.

    Raises
    ------
    InvalidSetting
        If other code made them.
    """
    folder = out / "rows"
    if afresh:
        shutil.rmtree(folder, ignore_errors=True)
    try:
        return Store(folder, configuration(tool))
    except InvalidSetting as error:
        raise InvalidSetting(f"{error} (--afresh removes the rows)") from error


def run_suite(
    numbers: Sequence[int],
    folders: Folders,
    store: Store,
    *,
    tool: Tool = run_tool,
    backend: BackendSettings | None = None,
) -> list[Row]:
    """Run the cases that the store lacks, and say how each went.

    Parameters
    ----------
    numbers : sequence of int
        Cases.
    folders : Folders
        Where recordings and results lie.
    store : Store
        Where rows go as they come.
    tool : callable
        The tool; it travels to the workers.
    backend : BackendSettings, optional
        Where the work runs; no row depends on it, but for its times.

    Returns
    -------
    list of Row
        One for each case, in the order of their numbers.
    """
    work = functools.partial(run_case, folders=folders, tool=tool)
    shards = [shard_for(number) for number in mixed(numbers)]
    missing = store.missing(shards)
    with ProgressLine(len(shards), done=len(shards) - len(missing), unit="cases") as line:

        def keep(shard: range, rows: list[Row]) -> None:
            store.write(shard, rows)
            _say(line_of(rows[0]))
            line.advance(1)

        while missing:
            try:
                for position, rows in results_of(work, missing, backend):
                    keep(missing[position], rows)
                break
            except WorkerDied as failure:
                # one case that ends its process every time must not end the suite
                dead = missing[failure.position]
                keep(dead, [lost(dead.start, str(failure), folders)])
                missing = store.missing(shards)
    return stored(numbers, store)


def stored(numbers: Sequence[int], store: Store) -> list[Row]:
    """Rows that the store has, in the order of their numbers."""
    shards = [shard_for(number) for number in sorted(set(numbers))]
    lacking = {shard.start for shard in store.missing(shards)}
    return [row for s in shards if s.start not in lacking for row in store.read(s)]


def _say(line: str) -> None:
    # on a terminal the progress line stands there already: write over it
    over = sys.stderr.isatty() and sys.stdout.isatty()
    print(f"\r{line:<78}" if over else line, flush=True)


# Showing


def head_of(rows: Sequence[Row], asked: int) -> str:
    """How many cases there are, and what they took.

    Examples
    --------
    >>> head_of([{"times": {"making": 1800.0, "tool": 5400.0}}], 2)
    '1 case of 2; 120 min of work: making 30, tool 90'
    """
    spent: dict[str, float] = {}
    for row in rows:
        for stage, seconds in row["times"].items():
            spent[stage] = spent.get(stage, 0.0) + seconds / 60.0
    parts = ", ".join(f"{stage} {minutes:.0f}" for stage, minutes in spent.items())
    cases = "1 case" if len(rows) == 1 else f"{len(rows)} cases"
    whole = "" if len(rows) == asked else f" of {asked}"
    return f"{cases}{whole}; {sum(spent.values()):.0f} min of work: {parts}"


def report(rows: Sequence[Row], asked: int) -> str:
    """What is printed at the end."""
    failures = [line_of(row) for row in rows if row["error"]]
    parts = [head_of(rows, asked), "", text([grade_of(row) for row in rows])]
    if failures:
        parts += ["failed:", *(f"  {line}" for line in failures)]
    return "\n".join(parts)


def tables(rows: Sequence[Row], asked: int) -> str:
    """The same as markdown, with a line for every case that is not right."""
    marks = [grade_of(row) for row in rows]
    wrong = [(r["number"], g, r["error"]) for r, g in zip(rows, marks, strict=True) if not g.right]
    parts = [head_of(rows, asked) + ".", "", markdown(marks)]
    if wrong:
        parts += [
            "Cases that are not right, with the gap on held-out runs before and after [noise sd]:",
            "",
            lines_of_cases(wrong),
        ]
    return "\n".join(parts).rstrip() + "\n"


@dataclass(frozen=True, kw_only=True)
class Options(BackendSettings):
    """Options of the suite."""

    quick: bool = False
    """20 cases in a quarter of an hour."""
    numbers: tuple[str, ...] = ()
    """Chosen cases, as in 7 or 1000-1022."""
    tool: Annotated[str, one_of(TOOLS)] = TOOL
    """Tool that is graded: loose gap, or another method on the same cases."""
    out: Path | None = None
    """Folder of rows and results; out/gap_suite by default, of other methods with their name."""
    blind: Path | None = None
    """Folder of recordings and truth, made where they lack, never removed; blind in --out by
    default."""
    keep_recordings: bool = False
    """Keep recordings after their case is graded (about 3 MB each)."""
    show: bool = False
    """Run nothing, print what is stored."""
    take: tuple[Path, ...] = ()
    """Files of rows of the same code to take over, as in docs/gap_suite_rows.jsonl."""
    afresh: bool = False
    """Remove stored rows first."""
    retry_failed: bool = False
    """Run cases again that failed, not the wrong ones."""
    docs: tuple[Path, ...] | None = None
    """Write the tables to a page (docs/gap_suite.md if none is named), as a whole run does by
    itself."""
    docs_cases: tuple[Path, ...] | None = None
    """Write a line for every case asked for to a page, between its marks `cases`."""

    def __post_init__(self) -> None:
        if self.quick and self.numbers:
            raise InvalidSetting("--quick and --numbers exclude each other")


def _page(given: tuple[Path, ...] | None) -> Path | None:
    """Page of an option that may stand alone."""
    return None if given is None else (given or (DOCS,))[0]


def grade_suite(chosen: Options) -> None:
    """Run the cases asked for and print how the tool did."""
    if chosen.numbers:
        numbers = numbers_of(chosen.numbers)
    else:
        numbers = quick_list() if chosen.quick else full_list()
    out = (chosen.out or folder_of(chosen.tool)).resolve()
    folders = Folders(
        out=out,
        blind=(chosen.blind or out / "blind").resolve(),
        keep=chosen.keep_recordings or chosen.blind is not None,
    )
    store = store_in(out, tool=chosen.tool, afresh=chosen.afresh)
    for file in chosen.take:
        print(f"{take_rows(file, store)} rows taken from {file}", file=sys.stderr)
    if chosen.retry_failed:
        for row in stored(numbers, store):
            if row["error"]:
                store.path(shard_for(row["number"])).unlink()
    began = time.monotonic()
    if chosen.show:
        rows = stored(numbers, store)
    else:
        rows = run_suite(
            numbers,
            folders,
            store,
            tool=tool_named(chosen.tool),
            backend=chosen,
        )
    print("\n" + report(rows, len(numbers)))
    content = tables(rows, len(numbers))
    (out / "summary.md").write_text(content, encoding="utf-8")
    (out / "cases.txt").write_text("".join(line_of(r) + "\n" for r in rows), encoding="utf-8")
    page = _page(chosen.docs)
    own = chosen.tool == TOOL
    if page is not None and not own:
        raise InvalidSetting("--docs writes the tables of loose gap; see scripts.suites.gap.rivals")
    whole = not (chosen.quick or chosen.numbers) and len(rows) == len(numbers)
    if page is None and own and whole:
        page = DOCS  # a whole run goes to the docs by itself
    cases_page = _page(chosen.docs_cases)
    if cases_page is not None:
        every = lines_of_cases([(row["number"], grade_of(row), row["error"]) for row in rows])
        write_between(cases_page, every.rstrip(), name="cases")
    if page is not None:
        write_between(page, content, new=NEW)
        write_rows(page.with_name(ROWS), store.configuration, rows)
    print(f"{time.monotonic() - began:.0f} s; tables: {out / 'summary.md'}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases asked for and print how the tool did."""
    going_on = "the same command goes on"
    command("gap suite", __doc__, Options, grade_suite, arguments, interrupted=going_on)


if __name__ == "__main__":
    main()
