r"""Run and grade `loose gap`, or any other tool, on blind recordings of several worlds.

Each case is a machine that is integrated without MuJoCo, given to the tool as a recording and
nothing else, and graded against its sealed truth once the result is written. Rows of finished cases
are kept: the same command goes on where it was stopped.

    python -m scripts.suites.gap.run --numbers 0-59                     # development
    python -m scripts.suites.gap.run --numbers 10000-10359 --phrase "words chosen today"
    python -m scripts.suites.gap.run --tool module:function             # recording folder -> result
    python -m scripts.suites.gap.run --methods                          # table of all tools
    python -m scripts.suites.gap.run --ablate --most-seconds 20         # one thing changed each

Others enter with files: recordings are made from a phrase that is kept back, each answer is what
``result.json`` holds, and truths are checked against the commitments that were given out.

    python -m scripts.suites.gap.run --make SUITE --numbers 10000-10059 --phrase SECRET
    python -m scripts.suites.gap.run --blind SUITE --numbers 10000-10059 --phrase SECRET \
        --answers ANSWERS --out out/gap_suite/THEIRS
"""

from __future__ import annotations

import functools
import importlib
import json
import math
import resource
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import loose_env
from loose_env.cli.command import command
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import Positive, write_text
from scripts.suites.blind import commit, numbers_of, sealed_truth
from scripts.suites.gap import ablation
from scripts.suites.gap.cases import made
from scripts.suites.gap.effects import CATALOGUE, KINDS
from scripts.suites.gap.grading import failed, grade, methods_table, table, words_of
from scripts.suites.gap.worlds import TOLERANCES
from scripts.suites.rows import BlindSettings, Row, asked_apart, blind_rows, code_hash, kept, named

ROOT = Path(__file__).resolve().parents[3]
OUT = ROOT / "out" / "gap_suite"
Tool = Callable[[Path], Mapping[str, Any]]
"""Reads the recording in a folder; returns what ``result.json`` of `loose gap` holds."""
VERDICTS = ("no_gap", "named", "unexplained")
LONGEST = 1800.0
"""Time after which a tool counts as failed [s]."""


def loose_gap(recording: Path, variant: str = "") -> Mapping[str, Any]:
    """The tool under test, as a user calls it, or a variant of it."""
    say = functools.partial(print, file=sys.stderr, flush=True)
    settings = ablation.changed(variant) if variant else {}
    found = loose_env.explain_gap(recording, ignore_doctor=True, say=say, threads=1, **settings)
    return json.loads(found.result.to_json())  # type: ignore[no-any-return]


def answered(answers: Path, name: str) -> Mapping[str, Any]:
    """An answer given as a file, checked."""
    path = answers / f"{name}.json"
    try:
        answer = json.loads(path.read_text(encoding="utf-8"))
        if answer["verdict"] not in VERDICTS:
            raise ValueError(f"{answer['verdict']!r}; a verdict is one of {VERDICTS}")
        for effect in answer.get("effects", ()):
            if effect["kind"] not in KINDS or not isinstance(effect["where"], str):
                raise ValueError(f"{effect['kind']!r} at {effect['where']!r}; no such kind")
            spans = [(low, high) for low, high in (effect.get("interval_95") or {}).values()]
            for x in (*(effect.get("parameters") or {}).values(), *(x for s in spans for x in s)):
                if not math.isfinite(float(x)):
                    raise ValueError(f"{effect['kind']!r} has the number {x}; it has to be finite")
    except OSError as error:
        raise InvalidData(f"{path}: no answer; every case needs one") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidData(f"{path}: {type(error).__name__} {error}; see protocol.json") from error
    return answer  # type: ignore[no-any-return]


def tool_of(name: str) -> Tool:
    """A tool as ``module:function``, ``loose_gap``, or a variant of it, ``loose_gap@VARIANT``."""
    own, at, variant = name.partition("@")
    if own == "loose_gap":
        if at:
            ablation.changes_of(variant)
        return functools.partial(loose_gap, variant=variant)
    return named(name, "loose_gap")  # type: ignore[no-any-return]


def ask(tool: str, recording: Path, folder: Path) -> None:
    """Run a tool on a recording in this process; write its result and what it took."""
    asked, begun = tool_of(tool), time.process_time()
    result = dict(asked(recording))
    cost = {
        "cpu": round(time.process_time() - begun, 2),
        "memory": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }
    write_text(folder / "cost.json", json.dumps(cost))
    write_text(folder / "result.json", json.dumps(result))


def run_case(
    number: int, *, tool: str, answers: Path | None, phrase: str, out: Path, blind: Path, code: str
) -> Row:
    """Make a case, let the tool answer it in a process of its own, and grade the answer.

    The truth is opened only after the tool has left its whole result. Whatever goes wrong in the
    tool becomes the row, with the message.
    """
    begun, name = time.perf_counter(), made(number, phrase, blind)
    row: Row = {"number": number, "phrase": phrase, "code": code, "error": ""}
    if answers is not None:
        return row | grade(answered(answers, name), sealed_truth(blind, phrase, name))
    folder = out / "results" / name
    shutil.rmtree(folder, ignore_errors=True)  # nothing of an earlier run may be graded
    folder.mkdir(parents=True)
    words = ["--tool", tool, "--recording", str(blind / "recordings" / name), "--out", str(folder)]
    _, ended = asked_apart("scripts.suites.gap.run", words, folder / "log.txt", LONGEST)
    truth = sealed_truth(blind, phrase, name)
    if (folder / "result.json").is_file():
        result, cost = (
            json.loads((folder / file).read_text(encoding="utf-8"))
            for file in ("result.json", "cost.json")
        )
        row |= grade(result, truth) | cost
    else:
        row |= failed(truth) | {"error": ended}
    return {**row, "seconds": round(time.perf_counter() - begun, 1)}


def make(numbers: Sequence[int], phrase: str, folder: Path) -> None:
    """Write recordings, truth, what entrants are told, and commitments to the truth."""
    names = sorted(made(number, phrase, folder) for number in numbers)
    protocol = {
        "format": "gap-benchmark/2", "verdicts": VERDICTS,
        "tolerances": TOLERANCES, "kinds": {name: dict(KINDS[name].units) for name in CATALOGUE},
    }  # fmt: skip
    commit(folder, phrase, names, protocol)


@dataclass(frozen=True, kw_only=True)
class RunSettings(BlindSettings):
    """Which cases, which tool, where."""

    tool: str = "loose_gap"
    """Tool that is graded: loose_gap or module:function."""
    methods: bool = False
    """Run nothing, print the table of all tools on the cases that all of them have."""
    recording: Path | None = None
    """Write what the tool says of one recording into --out instead: result.json and cost.json."""
    ablate: tuple[str, ...] | None = None
    """Run the cases again with one thing changed at a time; with words, only the variants that
    begin so, such as without or core.decision."""
    most_seconds: Positive = LONGEST
    """Of --ablate, cases whose CPU time as shipped was no more [s]."""


def code_of(tool: str) -> str:
    """Hash of the code that the rows of a tool depend on."""
    here = Path(__file__).parent
    suite = [here / f"{name}.py" for name in ("arms", "dynamics", "worlds", "effects", "cases")]
    if tool.partition("@")[0] == "loose_gap":
        own = [Path(loose_env.__file__).parent / part for part in ("gap", "recording")]
    else:
        own = [Path(importlib.import_module(tool.partition(":")[0]).__file__ or "")]
    return code_hash(*own, *suite, here.parent / "blind.py")


def run(given: RunSettings) -> None:
    """Run the cases asked for and print how the tool did."""
    numbers = numbers_of(given.numbers)
    if given.methods:
        tools = {file.parent.name: kept(file) for file in sorted(OUT.glob("*/rows.jsonl"))}
        if not tools:
            raise InvalidSetting(f"no tool has rows in {OUT}; run with --tool NAME first")
        print(methods_table(tools))
        return
    if given.make is not None:
        make(numbers, given.phrase, given.make)
        return
    tool_of(given.tool)
    variants = ablation.chosen(given.ablate or ())
    if given.recording is not None:
        ask(given.tool, given.recording, given.out or OUT)
        return
    out = (given.out or OUT / given.tool.replace(":", ".")).resolve()
    rows = rows_of(given, given.tool, numbers, out)
    if not rows:
        raise InvalidSetting(f"{out} has no rows of these cases; run them first")
    if given.ablate is not None:
        cheap = [row for row in rows if row.get("cpu", math.inf) <= given.most_seconds]
        if not cheap or given.tool != "loose_gap":
            raise InvalidSetting(
                f"{len(cheap)} of {len(rows)} cases of {given.tool} took {given.most_seconds:g} s "
                "or less; ablate loose_gap, with more --most-seconds"
            )
        own = [row["number"] for row in cheap]
        found = {
            name: rows_of(given, f"loose_gap@{name}", own, out / "ablation" / name)
            for name in variants
        }
        printed = ablation.summary(cheap, found, of=len(rows), most_seconds=given.most_seconds)
        file = out / "ablation.md"
    else:
        who = f"tool {given.tool}" if given.answers is None else f"answers in {given.answers}"
        printed = f"{len(rows)} cases of {len(numbers)}, {who}.\n\n{table(rows)}\n"
        file = out / "summary.md"
    print(f"\n{printed}")
    write_text(file, printed)


def rows_of(given: RunSettings, tool: str, numbers: Sequence[int], out: Path) -> list[Row]:
    """Rows of a tool, kept in a folder; those that it lacks are run, or left out by --show."""
    blind, phrase, code = (given.blind or OUT / "blind").resolve(), given.phrase, code_of(tool)
    common: dict[str, Any] = {"phrase": phrase, "out": out, "blind": blind, "code": code}
    work = functools.partial(run_case, tool=tool, answers=given.answers, **common)
    return blind_rows(given, out / "rows.jsonl", code, numbers, work, line_of)


def line_of(row: Row) -> str:
    """One line about a case."""
    said = f"FAILED {row['error']}" if row["error"] else f"[{row.get('cpu', 0):.0f} s CPU]"
    return f"{row['number']:5d} {words_of(row)}  {said}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command(
        "gap suite", __doc__, RunSettings, run, arguments, interrupted="the same command goes on"
    )


if __name__ == "__main__":
    main()
