"""Public benchmark "naming missing physics".

Usage: python -m scripts.suites.gap.public make FOLDER [--cases 12 | --numbers 300-302 1901]
           [--seed-phrase SECRET] [--name NAME]
       python -m scripts.suites.gap.public answer RECORDING OUT [--tolerance 0.03]
       python -m scripts.suites.gap.public score FOLDER RESULTS [--name NAME] [--open]
       python -m scripts.suites.gap.public board [SCORES ...] [--docs]

make writes a suite: FOLDER/sealed is kept back, the rest is given to entrants. answer runs
loose gap on a recording. score checks the commitments and grades answers. board prints the
leaderboard. docs/gap_benchmark.md describes the formats. Exit codes: 0 done, 2 something given
cannot be used.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from loose_env.cli.command import errors_in_one_line
from loose_env.gap import GapSettings, find_gap, result_of
from loose_env.io import write_text
from loose_env.recording import read_recording
from scripts.suites.gap.cases.numbers import numbers_of
from scripts.suites.gap.public.answers import answer_of, answer_schema, write_answer
from scripts.suites.gap.public.board import leaderboard, read_score, stored_scores, write_board
from scripts.suites.gap.public.making import MakeSettings, make
from scripts.suites.gap.public.scoring import score, table, write_score

__all__ = ["main"]

TOLERANCE = 0.03
"""Largest relative error of nominal parameters in all cases but whole machines."""


def parser_of() -> argparse.ArgumentParser:
    """The commands and their options."""
    parser = argparse.ArgumentParser(
        prog="python -m scripts.suites.gap.public",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    made = commands.add_parser("make", help="write a suite, or what is missing of it")
    made.add_argument("folder", type=Path, metavar="FOLDER")
    which = made.add_mutually_exclusive_group()
    which.add_argument("--cases", type=int, default=MakeSettings.cases, help="number of cases")
    which.add_argument("--numbers", nargs="+", metavar="CASE", help="chosen cases, as in 1901")
    made.add_argument(
        "--seed-phrase", default="", metavar="SECRET",
        help="all is drawn from it; default: one is drawn and kept in FOLDER/sealed",
    )  # fmt: skip
    made.add_argument("--name", default="", help="name of the suite; default: that of FOLDER")
    answered = commands.add_parser("answer", help="run loose gap on a recording")
    answered.add_argument("recording", type=Path, metavar="RECORDING")
    answered.add_argument("out", type=Path, metavar="OUT", help="file, or folder for CASE.json")
    answered.add_argument(
        "--tolerance", type=float, default=TOLERANCE, help="as protocol.json says"
    )
    scored = commands.add_parser("score", help="grade answers; writes RESULTS/score.json")
    scored.add_argument("folder", type=Path, metavar="FOLDER")
    scored.add_argument("results", type=Path, metavar="RESULTS", help="folder of CASE.json")
    scored.add_argument("--name", default="", help="name of the entry; default: that of RESULTS")
    scored.add_argument(
        "--open", action="store_true", help="also write marks by case, which tell the truths"
    )
    board = commands.add_parser("board", help="leaderboard of stored scores")
    board.add_argument("scores", type=Path, nargs="*", metavar="SCORES", help="default: the docs'")
    board.add_argument("--docs", action="store_true", help="write it to docs/gap_benchmark.md")
    return parser


def run(given: argparse.Namespace) -> None:
    """Run one command."""
    if given.command == "make":
        settings = MakeSettings(
            cases=given.cases,
            numbers=tuple(numbers_of(given.numbers or ())),
            seed_phrase=given.seed_phrase,
            name=given.name,
        )
        suite = make(given.folder, settings, say=lambda line: print(line, file=sys.stderr))
        schema = json.dumps(answer_schema(suite.kinds), indent=1) + "\n"
        write_text(given.folder / "answer.schema.json", schema)
        print(f"{given.folder}: {len(suite.cases)} cases, suite {suite.identity}")
        print(f"keep back: {given.folder / 'sealed'}")
    elif given.command == "answer":
        began = time.process_time()
        settings_of_tool = GapSettings(threads=1, tolerance=given.tolerance)
        result = result_of(find_gap(read_recording(given.recording), settings_of_tool))
        answer = answer_of(result, cpu_seconds=round(time.process_time() - began, 1))
        to_folder = given.out.suffix != ".json"
        file = given.out / f"{given.recording.resolve().name}.json" if to_folder else given.out
        print(f"{write_answer(file, answer)}: {answer.verdict}")
    elif given.command == "score":
        found = score(given.folder, given.results, name=given.name, opened=given.open)
        print(table(found))
        print(write_score(given.results / "score.json", found), file=sys.stderr)
    else:
        scores = [read_score(path) for path in given.scores or stored_scores()]
        print(leaderboard(scores))
        if given.docs:
            write_board(scores)


def main(arguments: Sequence[str] | None = None) -> None:
    """Take the command line."""
    given = parser_of().parse_args(arguments)
    try:
        with errors_in_one_line(f"gap {given.command}", interrupted="the same command goes on"):
            run(given)
    except SystemExit as ended:
        if not isinstance(ended.code, str):
            raise
        print(ended.code, file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
