"""Grade the gap tool on blind recordings: the table of targets and the confusion matrix.

Each case is made by an arm that is integrated without MuJoCo, given to the tool as a recording and
nothing else, and graded against its sealed truth once the result is written. Rows of finished cases
are kept: the same command goes on where it was stopped.

    python -m scripts.suites.gap.run --quick                    # 20 cases, a quarter of an hour
    python -m scripts.suites.gap.run --numbers 0-9 1004 2001
    python -m scripts.suites.gap.run --tool stepwise_bic        # another method, the same cases
    python -m scripts.suites.gap.run --show                     # print the kept rows
    python -m scripts.suites.gap.run --methods                  # table of all methods
"""

from __future__ import annotations

import functools
import json
import math
import shutil
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import mujoco

import loose_env
from loose_env.cli.command import command
from loose_env.errors import InvalidSetting
from loose_env.gap import (
    GapSettings,
    GapSolution,
    compared,
    exported,
    find_gap,
    read_result,
    resting_runs,
    result_of,
    write_model,
)
from loose_env.recording import read_recording
from scripts.suites.gap.cases import (
    LAST,
    draw_case,
    full_list,
    is_written,
    mixed,
    name_of,
    numbers_of,
    quick_list,
    role_of,
    tolerance_of,
    write_case,
)
from scripts.suites.gap.grading import Grade, failed, grade, separable_by_data
from scripts.suites.gap.tables import METHODS, lines_of_cases, markdown, methods_table, text
from scripts.suites.rows import Row, check_code, code_hash, kept, run_cases

ROOT = Path(__file__).resolve().parents[3]
OUT = ROOT / "out" / "gap_suite"
TOOL = "loose_gap"
"""Name of the tool under test."""
TOOLS = (TOOL, "sysid", "stepwise_bic")
Tool = Callable[[Path, Path, float], None]
"""Reads the recording in the first folder and leaves ``result.json`` in the second, told how well
the nominal parameters are known."""
EXPORTED = "exported.json"
"""Residual of the written model in plain MuJoCo, beside that of the fit."""


# ----------------------------------------------------------------------------------- tools


def run_tool(recording: Path, folder: Path, tolerance: float) -> None:
    """Run the tool on one thread and write its result; the only place here that imports it."""
    settings = GapSettings(threads=1, tolerance=tolerance)
    with (folder / "log.txt").open("w", encoding="utf-8", buffering=1) as log:
        found = find_gap(
            read_recording(recording), settings, say=functools.partial(print, file=log)
        )
    residuals = exported_gap(found, folder)
    if residuals is not None:
        (folder / EXPORTED).write_text(json.dumps(residuals), encoding="utf-8")
    read_result(result_of(found).write(folder / "result.json"))


def exported_gap(found: GapSolution, folder: Path) -> tuple[float, float] | None:
    """Residual of the written model, stepped by MuJoCo alone, and of the fit [noise sd].

    None where MJCF cannot carry an effect, or no held-out run begins at rest and has commands.
    """
    corrected, held = found.corrected, found.problem.held_out_whole
    if not found.effects or not all(effect.in_model for effect in corrected.effects):
        return None
    runs, machine = resting_runs(held), found.problem.machine
    if not runs:
        return None
    step = exported(held, corrected, found.best.held_out_residual).step
    file, *_ = write_model(folder / "model.xml", machine, corrected, step=step)
    model = mujoco.MjModel.from_xml_path(str(file))
    tried = compared(held, found.best.held_out_residual, model, runs)
    return None if tried is None else (tried[1].left, tried[1].fitted)


def tool_named(name: str) -> Tool:
    """The tool under test, or another method by its name."""
    if name == "sysid":
        from scripts.suites.gap.rivals import run_sysid

        return run_sysid
    if name == "stepwise_bic":
        from scripts.suites.gap.rivals import run_stepwise_bic

        return run_stepwise_bic
    return run_tool


# ------------------------------------------------------------------------------- one case


@dataclass(frozen=True, kw_only=True)
class Folders:
    """Where things lie."""

    out: Path
    """Rows, and results in one folder a case."""
    blind: Path
    """``recordings``, which the tool may see, and ``truth``, which only grading may see."""
    keep: bool = False
    """Whether recordings stay after they were graded."""


def run_case(number: int, *, folders: Folders, tool: Tool, code: str = "") -> Row:
    """Make the recording of a case, run the tool on it and grade its result.

    The truth is opened only after the tool has left its whole result. Whatever goes wrong becomes
    the row, with the message.
    """
    name = name_of(number)
    recordings, truths = folders.blind / "recordings", folders.blind / "truth"
    folder = folders.out / "results" / name
    spent: dict[str, float] = {}
    error, stage = "", "making"
    began = time.perf_counter()
    try:
        if not is_written(number, name, recordings=recordings, truth=truths):
            write_case(draw_case(number), recordings=recordings, truth=truths)
        spent[stage], stage, began = time.perf_counter() - began, "tool", time.perf_counter()
        shutil.rmtree(folder, ignore_errors=True)  # nothing of an earlier run may be graded
        folder.mkdir(parents=True)
        tool(recordings / name, folder, tolerance_of(number))
        spent[stage], stage, began = time.perf_counter() - began, "grading", time.perf_counter()
        marks = grade(
            json.loads((folder / "result.json").read_text(encoding="utf-8")),
            json.loads((truths / f"{name}.json").read_text(encoding="utf-8")),
            separable=separable_by_data(number),
            exported=_exported(folder),
            seconds=spent["tool"],
        )
    except Exception as wrong:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
        error = " ".join(f"{stage}: {type(wrong).__name__}: {wrong}".split())
        truth = {"case": name, "role": role_of(number), "form": "", "effects": []}
        if (truths / f"{name}.json").is_file():
            truth = json.loads((truths / f"{name}.json").read_text(encoding="utf-8"))
        marks = failed(truth)
    spent[stage] = time.perf_counter() - began
    if not folders.keep and not error:
        shutil.rmtree(recordings / name, ignore_errors=True)
    return {
        "number": number,
        "case": marks.case,
        "role": marks.role,
        "error": error,
        "grade": asdict(marks),
        "times": {stage: round(seconds, 3) for stage, seconds in spent.items()},
        "code": code,
    }


def _exported(folder: Path) -> float:
    """Residual of the written model over that of the fit; NaN where it was not checked."""
    if not (folder / EXPORTED).exists():
        return math.nan
    written, fit = json.loads((folder / EXPORTED).read_text(encoding="utf-8"))
    return float(written) / max(float(fit), 1e-12)


def grade_of(row: Row) -> Grade:
    """Marks of a row, as they were before it was stored."""
    marks = dict(row["grade"])
    for name in ("truth", "said"):
        marks[name] = tuple((str(kind), str(where)) for kind, where in marks[name])
    for name in ("parameter_error", "covered", "covered_others"):
        marks[name] = tuple(marks[name])
    return Grade(**marks)


def line_of(row: Row) -> str:
    """One line about a case: whether it is right, what is true, what was said, times."""
    marks = grade_of(row)
    parts = [f"{marks.case} {row['number']:5d} {marks.role:<7} {marks.form:<7}"]
    if row["error"]:
        parts += ["FAILED", row["error"]]
    else:
        size = "" if math.isnan(marks.ratio) else f" ({marks.ratio:.1f} x just visible)"
        parts += [
            "right" if marks.right else "WRONG",
            f"true {_list(marks.truth)}{size}",
            f"said {_list(marks.said, marks.verdict)}",
            f"residual {marks.gap_before:.2f} to {marks.gap_after:.2f}",
        ]
    times = ", ".join(f"{stage} {spent:.0f} s" for stage, spent in row["times"].items())
    return "  ".join([*parts, f"[{times}]"])


def _list(effects: Sequence[tuple[str, str]], otherwise: str = "nothing") -> str:
    return " + ".join(f"{kind}@{where}" for kind, where in effects) or otherwise


# ------------------------------------------------------------------------------ the command


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Which cases, which tool, where."""

    quick: bool = False
    """20 cases in a quarter of an hour."""
    numbers: tuple[str, ...] = ()
    """Chosen cases, as in 7 or 1000-1022; the whole list by default."""
    tool: Literal["loose_gap", "sysid", "stepwise_bic"] = "loose_gap"
    """Tool that is graded: loose gap, or another method on the same cases."""
    out: Path | None = None
    """Folder of rows and results; out/gap_suite by default, of other methods with their name."""
    blind: Path | None = None
    """Folder of recordings and truth, made where they lack; by default in --out."""
    keep_recordings: bool = False
    """Keep recordings after their case is graded (about 3 MB each)."""
    show: bool = False
    """Run nothing, print the kept rows."""
    recording: Path | None = None
    """Print what the tool says of one recording instead."""
    methods: bool = False
    """Run nothing, print the table of all methods on the cases that all of them have."""
    afresh: bool = False
    """Remove kept rows first."""
    workers: int = 1
    """Processes side by side."""


def rows_file(tool: str, out: Path | None = None) -> Path:
    """File of the rows of a tool."""
    folder = out or (OUT if tool == TOOL else OUT.with_name(f"{OUT.name}_{tool}"))
    return folder.resolve() / "rows.jsonl"


def code_of(tool: str) -> str:
    """Hash of the code that the rows of a tool depend on."""
    own = [Path(loose_env.__file__).parent / part for part in ("gap", "recording", "statistics")]
    here = Path(__file__).parent
    if tool != TOOL:
        own = [here / "rivals.py"]
    suite = ("arms", "dynamics", "machine", "effects", "cases", "grading")
    return code_hash(*own, *(here / f"{name}.py" for name in suite))


def head_of(rows: Sequence[Row], asked: int) -> str:
    """How many cases there are, and what they took."""
    spent: dict[str, float] = {}
    for row in rows:
        for stage, seconds in row["times"].items():
            spent[stage] = spent.get(stage, 0.0) + seconds / 60.0
    parts = ", ".join(f"{stage} {minutes:.0f}" for stage, minutes in spent.items())
    whole = "" if len(rows) == asked else f" of {asked}"
    return f"{len(rows)} cases{whole}; {sum(spent.values()):.0f} min of work: {parts}"


def tables(rows: Sequence[Row], asked: int) -> str:
    """The tables as markdown, with a line for every case that is not right."""
    marks = [(r["number"], grade_of(r), r["error"]) for r in rows]
    parts = [head_of(rows, asked) + ".", "", markdown([g for _, g, _ in marks])]
    if wrong := [each for each in marks if not each[1].right]:
        parts += [
            "Cases that are not right, with the residual on held-out runs before and after "
            "[noise sd]:",
            "",
            lines_of_cases(wrong),
        ]
    return "\n".join(parts).rstrip() + "\n"


def said_of(recording: Path, tool: str, tolerance: float = 0.03) -> str:
    """What a tool says of one recording, a line for each effect."""
    with tempfile.TemporaryDirectory() as place:
        tool_named(tool)(recording, Path(place), tolerance)
        result = read_result(place)
    lines = [
        f"{METHODS[tool]}: {result.verdict}; residual on the held-out run "
        f"{result.gap.before:.2f} noise sd before, {result.gap.after:.2f} after"
    ]
    for effect in (*result.effects, *result.doubtful):
        values = []
        for key, value in effect.parameters.items():
            low, high = effect.interval_95.get(key, (math.nan, math.nan))
            values.append(f"{key} {value:.4g} ({low:.4g} to {high:.4g})")
        lines.append(f"  {effect.kind} at {effect.where}: {', '.join(values)}")
    return "\n".join(lines)


def run(settings: RunSettings) -> None:
    """Run the cases asked for and print how the tool did."""
    if settings.methods:
        found = {tool: kept(rows_file(tool)) for tool in TOOLS}
        if not any(found.values()):
            raise InvalidSetting("no tool has rows; run with --tool NAME first")
        graded = {
            tool: {r["number"]: grade_of(r) for r in rows if r["number"] <= LAST}
            for tool, rows in found.items()
        }
        print(methods_table(graded))
        return
    if settings.recording is not None:
        print(said_of(settings.recording, settings.tool))
        return
    numbers = numbers_of(settings.numbers) if settings.numbers else full_list()
    numbers = quick_list() if settings.quick else numbers
    file = rows_file(settings.tool, settings.out)
    if settings.afresh:
        file.unlink(missing_ok=True)
    code = code_of(settings.tool)
    check_code(kept(file), code, file)
    folders = Folders(
        out=file.parent,
        blind=(settings.blind or file.parent / "blind").resolve(),
        keep=settings.keep_recordings or settings.blind is not None,
    )
    if settings.show:
        rows = [row for row in kept(file) if row["number"] in set(numbers)]
    else:
        work = functools.partial(
            run_case, folders=folders, tool=tool_named(settings.tool), code=code
        )
        rows = run_cases(mixed(numbers), work, file, workers=settings.workers, say=line_of)
    rows.sort(key=lambda row: int(row["number"]))
    print(f"\n{head_of(rows, len(numbers))}\n\n{text([grade_of(row) for row in rows])}")
    summary = file.with_name("summary.md")
    summary.write_text(tables(rows, len(numbers)), encoding="utf-8")
    print(f"tables: {summary}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command(
        "gap suite", __doc__, RunSettings, run, arguments, interrupted="the same command goes on"
    )


if __name__ == "__main__":
    main()
