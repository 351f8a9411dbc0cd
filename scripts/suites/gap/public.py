"""Public benchmark "naming missing physics": suites with sealed truths, and answers in JSON.

    python -m scripts.suites.gap.public make FOLDER [--cases 12]      # FOLDER/sealed is kept back
    python -m scripts.suites.gap.public answer RECORDING OUT          # run loose gap on a recording
    python -m scripts.suites.gap.public score FOLDER RESULTS --name NAME
    python -m scripts.suites.gap.public board [SCORES ...] [--docs]

docs/accuracy.md describes the formats.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from loose_env.cli.command import commands
from loose_env.gap import GapSettings, find_gap, result_of
from loose_env.io import write_text
from loose_env.recording import read_recording
from scripts.suites.gap.cases import (
    numbers_of,
)
from scripts.suites.gap.public_scores import (
    leaderboard,
    read_score,
    score,
    stored_scores,
    table,
    write_board,
    write_score,
)
from scripts.suites.gap.public_suite import (
    MakeSettings,
    answer_of,
    answer_schema,
    make,
    write_answer,
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Made:
    """Write a suite, or what is missing of it."""

    folder: Positional[Path]
    """Folder of the suite."""
    cases: int = MakeSettings.cases
    """Number of cases."""
    numbers: tuple[str, ...] = ()
    """Chosen cases, as in 1901 or 300-302, in place of drawn ones."""
    seed_phrase: str = ""
    """All is drawn from it; by default one is drawn and kept in FOLDER/sealed."""
    name: str = ""
    """Name of the suite; by default that of FOLDER."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Asked:
    """Run loose gap on a recording."""

    recording: Positional[Path]
    """Folder of the recording."""
    out: Positional[Path]
    """File, or folder for CASE.json."""
    tolerance: float = 0.03
    """Largest relative error of the nominal parameters, as protocol.json says."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scored:
    """Grade answers; writes RESULTS/score.json."""

    folder: Positional[Path]
    """Folder of the suite."""
    results: Positional[Path]
    """Folder of CASE.json."""
    name: str = ""
    """Name of the entry; by default that of RESULTS."""
    open: bool = False
    """Also write marks by case, which tell the truths."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Board:
    """Leaderboard of stored scores."""

    scores: Positional[tuple[Path, ...]] = ()
    """Files of scores; by default those beside the page."""
    docs: bool = False
    """Write it to docs/accuracy.md."""


def _make(given: Made) -> None:
    settings = MakeSettings(
        cases=given.cases,
        numbers=tuple(numbers_of(given.numbers)),
        seed_phrase=given.seed_phrase,
        name=given.name,
    )
    suite = make(given.folder, settings, say=lambda line: print(line, file=sys.stderr))
    schema = json.dumps(answer_schema(suite.kinds), indent=1) + "\n"
    write_text(given.folder / "answer.schema.json", schema)
    print(f"{given.folder}: {len(suite.cases)} cases, suite {suite.identity}")
    print(f"keep back: {given.folder / 'sealed'}")


def _answer(given: Asked) -> None:
    began = time.process_time()
    settings = GapSettings(threads=1, tolerance=given.tolerance)
    result = result_of(find_gap(read_recording(given.recording), settings))
    answer = answer_of(result, cpu_seconds=round(time.process_time() - began, 1))
    file = given.out
    if file.suffix != ".json":
        file = file / f"{given.recording.resolve().name}.json"
    print(f"{write_answer(file, answer)}: {answer.verdict}")


def _score(given: Scored) -> None:
    found = score(given.folder, given.results, name=given.name, opened=given.open)
    print(table(found))
    print(write_score(given.results / "score.json", found), file=sys.stderr)


def _board(given: Board) -> None:
    scores = [read_score(path) for path in given.scores or stored_scores()]
    print(leaderboard(scores))
    if given.docs:
        write_board(scores)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    actions: dict[str, tuple[type[Any], Callable[[Any], object]]] = {
        "make": (Made, _make),
        "answer": (Asked, _answer),
        "score": (Scored, _score),
        "board": (Board, _board),
    }
    commands("gap benchmark", __doc__, actions, arguments, interrupted="the same command goes on")


if __name__ == "__main__":
    main()
