"""Run and grade `loose gap` or a rival on blind recordings; tables of targets and methods.

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

import loose_env
from loose_env.cli.command import command
from loose_env.errors import InvalidSetting
from loose_env.evaluation import wilson
from loose_env.gap import (
    GapSettings,
    Tolerances,
    read_result,
    solve_gap,
)
from loose_env.io import write_text
from loose_env.recording import read_recording
from scripts.suites.gap.cases import (
    LAST,
    ROLES,
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
from scripts.suites.gap.grading import FAILED, Grade, failed, grade, separable_by_data
from scripts.suites.rows import Row, check_code, code_hash, kept, run_cases

ROOT = Path(__file__).resolve().parents[3]
OUT = ROOT / "out" / "gap_suite"
TOOL = "loose_gap"
"""Name of the tool under test."""
TOOLS = (TOOL, "sysid", "stepwise_bic")
Tool = Callable[[Path, Path, float], None]
"""Reads the recording in the first folder and leaves ``result.json`` in the second, told how well
the nominal parameters are known."""


# ----------------------------------------------------------------------------------- tools


def run_tool(recording: Path, folder: Path, tolerance: float) -> None:
    """Run the tool on one thread and write its result; the only place here that imports it."""
    settings = GapSettings(threads=1, tolerances=stated(tolerance))
    with (folder / "log.txt").open("w", encoding="utf-8", buffering=1) as log:
        found = solve_gap(
            read_recording(recording), settings, say=functools.partial(print, file=log)
        )
    read_result(found.result.write(folder / "result.json"))


def stated(tolerance: float) -> Tolerances:
    """What the suite says of its models: uniform errors of parameters, and exact sensors."""
    share = tolerance / np.sqrt(3)
    return Tolerances(
        mass=share, inertia=share, armature=share, torque=share, velocity_gain=share,
        damping=share, centre=0.002, centre_m=5e-4, zero=2e-4, offset=0.002, shift_samples=0.1,
        sensor=1e-3, sensor_bias=1e-3, sensor_samples=0.05,
    )  # fmt: skip


def tool_named(name: str) -> Tool:
    """The tool under test, or another method by its name."""
    if name == "sysid":
        from scripts.suites.gap.sysid import run_sysid

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
        if not is_written(name, recordings=recordings, truth=truths):
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
            f"true {_effects(marks.truth, 'nothing')}{size}",
            f"said {_effects(marks.said, marks.verdict)}",
            f"residual {marks.gap_before:.2f} to {marks.gap_after:.2f}",
        ]
    times = ", ".join(f"{stage} {spent:.0f} s" for stage, spent in row["times"].items())
    return "  ".join([*parts, f"[{times}]"])


# ---------------------------------------------------------------------------------- tables

ON_READING = frozenset({"sensor_gain", "sensor_bias", "torque_ripple"})
"""Kinds that a model file cannot carry; the result has code for them."""
CLOSE = 0.1
"""Relative error up to which a parameter counts as close."""


def share(hits: int, count: int) -> str:
    """A share in per cent with Wilson's 95 % interval."""
    if count == 0:
        return "no cases"
    low, high = wilson(hits, count)
    return f"{hits}/{count} = {100 * hits / count:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def summary(grades: Sequence[Grade]) -> list[tuple[str, str, str]]:
    """Rows of the table of targets: what, target, measured."""
    by = {role: [g for g in grades if g.role == role] for role in ROLES}
    outside, several = by["outside"], by["single"] + by["pair"] + by["triple"]
    missing = by["single"] + by["pair"] + by["triple"] + by["machine"]
    whole = [g for g in several if g.found == len(g.truth) > 0]
    machines = by["machine"]
    after = [
        g.gap_after
        for g in missing
        if np.isfinite(g.gap_after) and not any(kind in ON_READING for kind, _ in g.truth)
    ]
    before = [g.gap_before for g in missing if np.isfinite(g.gap_before)]
    errors = [error for g in missing for error in g.parameter_error]
    covered = [held for g in missing for held in g.covered]
    others = [held for g in missing for held in g.covered_others]
    found = sum(g.found for g in by["pair"])
    seconds = [g.seconds for g in grades if np.isfinite(g.seconds)]
    rows = [
        ("single effects, kind and location correct", "at least 97 %", _right(by["single"])),
        ("pairs, both correct", "at least 88 %", _right(by["pair"])),
        ("effects of pairs found", "at least 95 %", share(found, 2 * len(by["pair"]))),
        ("triples, all three correct", "at least 70 %", _right(by["triple"])),
        ("effects of triples found", "at least 90 %", _found(by["triple"])),
        ("effects of whole machines found", "at least 85 %", _found(machines)),
        ("effects identified in whole machines that are there", "at least 95 %",
         share(sum(g.found for g in machines), sum(len(g.said) for g in machines))),
        ("a further, false effect beside the true ones", "at most 3 %",
         share(sum(len(g.said) > len(g.truth) for g in whole), len(whole))),
        ("false alarms with nothing missing", "at most 2 %",
         share(sum(not g.right for g in by["none"]), len(by["none"]))),
        ("outside the catalogue, called unexplained", "at least 90 %", _right(outside)),
        ("held-out RMS residual before, median [noise sd]", "", _median(before)),
        ("held-out RMS residual after, representable effects, median [noise sd]", "at most 1.25",
         _median(after)),
        ("error of parameters, median", "at most 10 %",
         f"{100 * np.median(errors):.1f} %" if errors else "none"),
        ("parameters within 10 % of the truth", "",
         share(sum(error <= CLOSE for error in errors), len(errors))),
        ("95 % intervals that cover the true value", "92 to 97 %",
         share(sum(covered), len(covered))),
        ("the same of further parameters", "92 to 97 %", share(sum(others), len(others))),
        ("time of one run on one core, median and largest [s]", "",
         f"{np.median(seconds):.0f}, {max(seconds):.0f}" if seconds else "none"),
        ("cases that failed, wrong in all of the above", "0",
         share(sum(g.verdict == FAILED for g in grades), len(grades))),
    ]  # fmt: skip
    return rows


def _right(grades: Sequence[Grade]) -> str:
    return share(sum(g.right for g in grades), len(grades))


def _found(grades: Sequence[Grade]) -> str:
    return share(sum(g.found for g in grades), sum(len(g.truth) for g in grades))


def _median(values: Sequence[float]) -> str:
    return f"{np.median(values):.2f}" if values else "none"


def markdown(grades: Sequence[Grade]) -> str:
    """The table of targets and the marks by size."""
    parts = ["| | to reach | measured |", "| --- | --- | --- |"]
    parts += [f"| {' | '.join(row)} |" for row in summary(grades)]
    parts += ["", "| size over just visible | single effects correct |", "| --- | --- |"]
    singles = [g for g in grades if g.role == "single"]
    for low, high in ((0.0, 2.0), (2.0, 5.0), (5.0, 12.0), (12.0, np.inf)):
        label = f"{low:.0f} to {high:.0f}" if np.isfinite(high) else f"over {low:.0f}"
        parts.append(f"| {label} | {_right([g for g in singles if low <= g.ratio < high])} |")
    return "\n".join(parts) + "\n"


def lines_of_cases(cases: Sequence[tuple[int, Grade, str]]) -> str:
    """Truth and result of cases, as markdown."""
    lines = ["| case | runs | true | over just visible | result | residual |"]
    lines += ["| ---: | --- | --- | ---: | --- | --- |"]
    for number, g, error in cases:
        size = f"{g.ratio:.1f}" if np.isfinite(g.ratio) else ""
        # a bar in a message would end its cell
        said = f"failed: {error}".replace("|", "\\|") if error else _effects(g.said, g.verdict)
        gap = "" if error else f"{g.gap_before:.2f} to {g.gap_after:.2f}"
        lines.append(
            f"| {number} | {g.form} | {_effects(g.truth, 'nothing')} | {size} | {said} | {gap} |"
        )
    return "\n".join(lines) + "\n"


def _effects(effects: Sequence[tuple[str, str]], otherwise: str) -> str:
    return ", ".join(f"{kind} at {where}" for kind, where in effects) or otherwise


METHODS = {
    "loose_gap": "`loose gap`",
    "sysid": "`mujoco.sysid`, all parameters free",
    "stepwise_bic": "stepwise selection, BIC",
}
"""Names in the table of methods."""


def methods_table(graded: Mapping[str, Mapping[int, Grade]]) -> str:
    """The table of targets with a column a tool, on the cases that all tools with rows have."""
    graded = {name: own for name, own in graded.items() if own}
    numbers = sorted(set.intersection(*(set(own) for own in graded.values())))
    columns = [summary([own[number] for number in numbers]) for own in graded.values()]
    lines = [f"{len(numbers)} cases that all methods have run: {_ranges(numbers)}.", ""]
    lines += [f"| | {' | '.join(METHODS[name] for name in graded)} |"]
    lines += ["| --- |" + " --- |" * len(graded)]
    for row in zip(*columns, strict=True):
        lines.append(f"| {row[0][0]} | {' | '.join(got for _, _, got in row)} |")
    return "\n".join(lines)


def _ranges(numbers: Sequence[int]) -> str:
    """Numbers as ranges: 1-3 7."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return " ".join(f"{p[0]}-{p[-1]}" if len(p) > 1 else f"{p[0]}" for p in parts)


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
        own = [here / "rivals.py", here / "sysid.py"]
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
    print(f"\n{tables(rows, len(numbers))}")
    write_text(file.with_name("summary.md"), tables(rows, len(numbers)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command(
        "gap suite", __doc__, RunSettings, run, arguments, interrupted="the same command goes on"
    )


if __name__ == "__main__":
    main()
