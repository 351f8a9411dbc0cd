"""One case from its number to its marks: recorded, given to the tool, graded.

The truth is opened only after the tool has left its whole result. Whatever goes wrong in a case
becomes its row, with the message.
"""

from __future__ import annotations

import json
import math
import shutil
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from scripts.suites.gap.cases.cases import name_of, role_of
from scripts.suites.gap.cases.draw import draw_case, tolerance_of
from scripts.suites.gap.cases.recordings import is_written, write_case
from scripts.suites.gap.grading.grade import Grade, failed, grade
from scripts.suites.gap.grading.separability import separable_by_data
from scripts.suites.gap.grading.tool import EXPORTED, RESULT, Tool, run_tool

__all__ = ["Folders", "Row", "grade_of", "line_of", "lost", "run_case", "shard_for"]

Row = dict[str, Any]
"""Number, name and role of a case, its marks, what went wrong ("" if nothing) and times [s]."""


@dataclass(frozen=True, kw_only=True)
class Folders:
    """Where things lie; on several machines every one of them must see these folders."""

    out: Path
    """Results, one folder a case."""
    blind: Path
    """``recordings`` and ``truth``."""
    keep: bool = False
    """Whether recordings stay after they were graded."""

    @property
    def recordings(self) -> Path:
        """What the tool may see."""
        return self.blind / "recordings"

    @property
    def truth(self) -> Path:
        """What only grading may see."""
        return self.blind / "truth"

    def results(self, case: str) -> Path:
        """Folder of the results of a case."""
        return self.out / "results" / case


@dataclass(kw_only=True)
class _Times:
    """Time spent by stage [s]."""

    spent: dict[str, float] = field(default_factory=dict)
    stage: str = "making"
    """The stage under way, or the last one."""

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        self.stage, began = stage, time.perf_counter()
        try:
            yield
        finally:
            self.spent[stage] = round(time.perf_counter() - began, 3)


def shard_for(number: int) -> range:
    """The span of episodes that is one case."""
    return range(number, number + 1)


def run_case(shard: range, *, folders: Folders, tool: Tool = run_tool) -> list[Row]:
    """Make the recording of a case, run the tool on it and grade its result.

    Parameters
    ----------
    shard : range
        The case, as `shard_for` makes it.
    folders : Folders
        Where things lie.
    tool : callable
        The tool.

    Returns
    -------
    list of Row
        One row. It depends on the case and the code alone, but for its times.
    """
    number = shard.start
    name = name_of(number)
    folder = folders.results(name)
    times = _Times()
    try:
        with times.of("making"):
            if not is_written(number, name, recordings=folders.recordings, truth=folders.truth):
                write_case(draw_case(number), recordings=folders.recordings, truth=folders.truth)
        with times.of("tool"):
            # nothing of an earlier run may be graded for this one's
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            tool(folders.recordings / name, folder, tolerance_of(number))
        with times.of("grading"):
            marks = grade(
                json.loads((folder / RESULT).read_text(encoding="utf-8")),
                read_truth(folders, name),
                separable=separable_by_data(number),
                exported=_exported(folder),
                seconds=times.spent["tool"],
            )
    except Exception as error:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
        message = " ".join(f"{times.stage}: {type(error).__name__}: {error}".split())
        return [_row(number, _failed(number, folders), message, times.spent)]
    if not folders.keep:
        shutil.rmtree(folders.recordings / name, ignore_errors=True)
    return [_row(number, marks, "", times.spent)]


def _exported(folder: Path) -> float:
    """Gap that the written model leaves over that of the fit; NaN where it was not checked."""
    file = folder / EXPORTED
    if not file.exists():
        return math.nan
    gaps = json.loads(file.read_text(encoding="utf-8"))
    return float(gaps["exported"]) / max(float(gaps["fit"]), 1e-12)


def read_truth(folders: Folders, name: str) -> dict[str, Any]:
    """What is true of a case."""
    truth: dict[str, Any] = json.loads((folders.truth / f"{name}.json").read_text(encoding="utf-8"))
    return truth


def lost(number: int, message: str, folders: Folders) -> Row:
    """The row of a case whose worker died each time it was tried."""
    return _row(number, _failed(number, folders), f"worker: {message}", {})


def _failed(number: int, folders: Folders) -> Grade:
    """Marks of a case without a result; what is true of it is told where it was drawn at all."""
    try:
        truth = read_truth(folders, name_of(number))
    except (OSError, ValueError):
        truth = {"case": name_of(number), "role": role_of(number), "form": "", "effects": []}
    return failed(truth)


def _row(number: int, marks: Grade, error: str, spent: Mapping[str, float]) -> Row:
    return {
        "number": number,
        "case": marks.case,
        "role": marks.role,
        "error": error,
        "grade": asdict(marks),
        "times": dict(spent),
    }


def grade_of(row: Mapping[str, Any]) -> Grade:
    """Marks of a row, as they were before it was stored."""
    marks = dict(row["grade"])
    for name in ("truth", "said"):
        marks[name] = tuple((str(kind), str(where)) for kind, where in marks[name])
    for name in ("parameter_error", "covered", "covered_others"):
        marks[name] = tuple(marks[name])
    return Grade(**marks)


def line_of(row: Mapping[str, Any]) -> str:
    """One line about a case: whether it is right, what is true, what was said, times.

    Examples
    --------
    >>> marks = failed({"case": "case-0007", "role": "none", "form": "forward", "effects": []})
    >>> print(line_of(_row(3, marks, "tool: InvalidData: no runs", {"making": 2, "tool": 1})))
    case-0007     3 none    forward  FAILED  tool: InvalidData: no runs  [making 2 s, tool 1 s]
    """
    marks = grade_of(row)
    parts = [f"{marks.case} {row['number']:5d} {marks.role:<7} {marks.form:<7}"]
    if row["error"]:
        parts += ["FAILED", row["error"]]
    else:
        parts += ["right" if marks.right else "WRONG"]
        size = "" if math.isnan(marks.ratio) else f" ({marks.ratio:.1f} x just visible)"
        parts += [f"true {_list(marks.truth)}{size}", f"said {_list(marks.said, marks.verdict)}"]
        parts += [f"gap {marks.gap_before:.2f} to {marks.gap_after:.2f}"]
    times = ", ".join(f"{stage} {spent:.0f} s" for stage, spent in row["times"].items())
    return "  ".join([*parts, f"[{times}]"])


def _list(effects: tuple[tuple[str, str], ...], otherwise: str = "nothing") -> str:
    return " + ".join(f"{kind}@{where}" for kind, where in effects) or otherwise
