"""Run the suite and print its tables; finished cases are kept in the file of rows."""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from scripts.study import write_between
from scripts.suites.machines.disturbances import KINDS, ranges_table
from scripts.suites.machines.grade import tables
from scripts.suites.machines.plans import CaseSettings
from scripts.suites.machines.run import Row, line_of, row_of
from scripts.suites.row_files import add, kept

SEED = 81_207
"""Of the printed tables; nothing was developed on it. Development used the seed 1."""
DOCS = Path(__file__).resolve().parents[3] / "docs" / "diagnosis_suite.md"


def main(words: Sequence[str] | None = None) -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(prog="machines", description=__doc__)
    parser.add_argument("--cases", type=int, default=100, help="number of cases")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=SEED, help="of the draw")
    parser.add_argument("--out", type=Path, required=True, help="file of rows (JSON lines)")
    parser.add_argument(
        "--only", choices=("none", *KINDS), help="machines with this disturbance alone, or none"
    )
    parser.add_argument("--runs", type=int, default=6, help="suspect runs of a recording")
    parser.add_argument("--poses", type=int, default=3, help="poses among them")
    parser.add_argument("--seconds", type=float, default=1.2, help="length of a run [s]")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--table", action="store_true", help="print the tables of the rows alone")
    parser.add_argument("--docs", action="store_true", help="write the tables into the page")
    given = parser.parse_args(words)
    if given.table and not kept(given.out):
        parser.error(f"{given.out} has no rows to make tables of; run some cases into it first")
    rows = sorted(kept(given.out), key=_order)
    if not given.table:
        settings = CaseSettings(runs=given.runs, poses=given.poses, seconds=given.seconds)
        done = {(row["seed"], row["case"], row["only"]) for row in rows}
        asked = [
            number
            for number in range(given.first, given.first + given.cases)
            if (given.seed, number, given.only) not in done
        ]
        given.out.parent.mkdir(parents=True, exist_ok=True)
        jobs = [(number, given.seed, settings, given.only) for number in asked]
        for count, row in enumerate(done_by(jobs, given.workers), start=1):
            add(given.out, row)
            print(f"{count}/{len(jobs)} {line_of(row)}", flush=True)
        rows = sorted(kept(given.out), key=_order)
    print(tables(rows))
    if given.docs:
        write_between(DOCS, tables(rows))
        write_between(DOCS, ranges_table(), name="disturbances")


def done_by(
    jobs: Sequence[tuple[int, int, CaseSettings, str | None]], workers: int
) -> Iterator[Row]:
    """Rows of the jobs as they are done, by one process or several."""
    if workers <= 1:
        yield from (row_of(*job) for job in jobs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        for future in as_completed([pool.submit(row_of, *job) for job in jobs]):
            yield future.result()


def _order(row: Row) -> tuple[int, int]:
    return row["seed"], row["case"]


if __name__ == "__main__":
    main()
