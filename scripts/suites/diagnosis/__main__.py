"""Blind recordings for loose diagnose: an arm integrated without MuJoCo, truth kept apart."""

from __future__ import annotations

import contextlib
import io
import itertools
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from loose_env.cli.command import command
from loose_env.cli.main import main as loose
from loose_env.instrument import Diagnosis, read_diagnosis
from loose_env.recording import write_recording
from scripts.suites.diagnosis.cases import (
    SHOWS,
    BlindArm,
    Case,
    draw,
    random_motion,
    random_runs,
    shown,
)
from scripts.suites.gap.arms import model_xml
from scripts.suites.rows import Row, kept, run_cases


def recorded(case: Case, runs: int) -> dict[str, Any]:
    """Let the command line diagnose a recording of random runs, in a folder without truth."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, case.name)
        write_recording(folder, model_xml=model_xml(case.arm.figures), runs=random_runs(case, runs))
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = loose(["diagnose", str(folder), "--out", f"{place}/found", "--quiet"])
        if code != 0:
            raise RuntimeError(f"{case.name}: loose diagnose ended with {code}")
        found = read_diagnosis(Path(place, "found"))
    steps = [r.probabilities for r in found.records if r.condition == "suspect"]
    played = [random_motion(case, i, 3) for i in range(runs)]
    return marks(case, found) | {"steps": steps, "shown": shown(case, played)}


def in_session(case: Case, most: int) -> dict[str, Any]:
    """Let the tool choose its runs until it names the fault."""
    from loose_env.instrument import find_fault

    steps: list[dict[str, float]] = []

    def say(found: Diagnosis) -> None:
        steps.append(dict(found.posterior))

    machine = BlindArm(case)
    with tempfile.TemporaryDirectory() as place:
        model = Path(place, "model.xml")
        model.write_text(model_xml(case.arm.figures), encoding="utf-8")
        ended = find_fault(machine, model, most=most, say=say)
    return marks(case, ended.diagnosis) | {
        "steps": steps,
        "named": ended.named,
        "measurements": ended.measurements,
        "shown": shown(case, machine.played),
    }


def marks(case: Case, found: Diagnosis) -> dict[str, Any]:
    """Result and truth of a case."""
    row: dict[str, Any] = {
        "case": case.number,
        "seed": case.seed,
        "arm": case.arm.figures.name,
        "kind": case.kind,
        "true": case.hypothesis,
        "reference": case.reference,
        "said": found.fault.hypothesis,
        "probability": found.probability,
        "posterior": dict(found.posterior),
        "warnings": list(found.warnings),
    }
    if case.arm.effects:
        parameters = case.arm.effects[0].parameters
        row["gap"] = float(parameters["gap"])
        row["gap_said"] = found.fault.gap_m
        row["gap_interval"] = found.fault.gap_interval_m
        said = found.fault.direction
        if "direction" in parameters and said is not None:
            true = np.array(parameters["direction"])
            cosine = abs(float(true @ np.array(said))) / float(np.linalg.norm(true))
            row["angle"] = float(np.degrees(np.arccos(min(cosine, 1.0))))
            row["half_angle"] = found.fault.direction_half_angle_deg
    return row


Rows = Sequence[dict[str, Any]]
BINS = (0.0, 0.5, 0.7, 0.9, 0.98, 1.0)


def table(rows: Rows, title: str) -> str:
    """Table of one form of the suite."""
    lines = [title, f"  cases: {len(rows)}"]
    healthy = [r for r in rows if r["kind"] == "healthy"]
    lines.append(f"  healthy called healthy: {_share([r['said'] == 'healthy' for r in healthy])}")
    for kind in ("structural_looseness", "backlash"):
        own = [r for r in rows if r["kind"] == kind]
        seen = [r for r in own if r["shown"] > SHOWS]
        lines.append(f"  {kind}: kind and location: {_share(_right(own))}")
        lines.append(f"    detectable faults: {_share(_right(seen))}")
        lines.append(f"    kind: {_share([r['said'].startswith(kind) for r in own])}")
    in_session = bool(rows) and "named" in rows[0]
    for reference in () if in_session else (False, True):
        own = [r for r in rows if r["reference"] == reference]
        words = "with" if reference else "without"
        lines.append(f"  all, {words} healthy runs: {_share(_right(own))}")
    most = max((len(r["steps"]) for r in rows), default=0)
    faulty = [r for r in rows if r["kind"] != "healthy"]
    for count in range(1, most + 1):
        lines.append(
            f"  after {count} run(s): {_share(_right_after(rows, count))}; of faults "
            f"{_share(_right_after(faulty, count))}; calibration error "
            f"{_bins(_said_after(rows, count), _right_after(rows, count))[0]:.3f}"
        )
    lines += _numbers(rows) + _calibration(rows)
    if in_session:
        taken = [r["measurements"] for r in rows]
        lines.append(
            f"  runs taken: median {np.median(taken):g}, mean {np.mean(taken):.2f}; identified "
            f"{_share([r['named'] for r in rows])}; accuracy of those "
            f"{_share(_right([r for r in rows if r['named']]))}"
        )
    return "\n".join(lines)


def _numbers(rows: Rows) -> list[str]:
    right = [r for r in rows if r["said"] == r["true"]]
    angles = [r["angle"] for r in right if r.get("angle") is not None]
    lines = []
    if angles:
        inside = [r["angle"] <= r["half_angle"] for r in right if r.get("angle") is not None]
        lines.append(
            f"  direction: median {np.median(angles):.1f} degrees, nine of ten within "
            f"{np.percentile(angles, 90):.1f}; inside its 95 % cone {_share(inside)}"
        )
    faults = [r for r in right if r["kind"] != "healthy"]
    given = [r for r in faults if r.get("gap_said") is not None]
    if faults:
        lines.append(
            f"  clearance given: {_share([r.get('gap_said') is not None for r in faults])}"
        )
    if given:
        ratio = [abs(r["gap_said"] / r["gap"] - 1) for r in given]
        inside = [r["gap_interval"][0] <= r["gap"] <= r["gap_interval"][1] for r in given]
        lines.append(
            f"  clearance error: median {np.median(ratio):.0%}; inside its 95 % interval "
            f"{_share(inside)}"
        )
    return lines


def _calibration(rows: Rows) -> list[str]:
    if not rows:
        return []
    error, lines = _bins([r["probability"] for r in rows], _right(rows))
    return [f"  calibration error (ECE): {error:.3f}", *lines]


def _bins(probabilities: Sequence[float], outcomes: Sequence[bool]) -> tuple[float, list[str]]:
    """Expected calibration error, and a line for every bin of what was said."""
    said, right = np.array(probabilities), np.array(outcomes, dtype=float)
    error, lines = 0.0, []
    for low, high in itertools.pairwise(BINS):
        inside = (said > low) & (said <= high)
        if inside.any():
            gap = abs(float(said[inside].mean() - right[inside].mean()))
            error += gap * inside.mean()
            lines.append(
                f"    probability {low:.2f} to {high:.2f}: {inside.sum()} cases, mean "
                f"{said[inside].mean():.3f}, accuracy {right[inside].mean():.3f}"
            )
    return error, lines


def _after(row: dict[str, Any], count: int) -> dict[str, float]:
    """Probabilities by the first runs alone; by all where there are fewer."""
    found: dict[str, float] = row["steps"][min(count, len(row["steps"])) - 1]
    return found


def _said_after(rows: Rows, count: int) -> list[float]:
    return [max(_after(r, count).values()) for r in rows]


def _right_after(rows: Rows, count: int) -> list[bool]:
    return [_best(_after(r, count)) == r["true"] for r in rows]


def _best(probabilities: dict[str, float]) -> str:
    return max(probabilities, key=lambda name: probabilities[name])


def _right(rows: Rows) -> list[bool]:
    return [r["said"] == r["true"] for r in rows]


def _share(values: Sequence[bool]) -> str:
    if not values:
        return "no case"
    return f"{sum(values)} of {len(values)} ({sum(values) / len(values):.0%})"


SEED = 60_713
"""Of the printed tables; nothing was developed on it."""


@dataclass(frozen=True, kw_only=True)
class SuiteSettings:
    """Which cases, and how large."""

    out: Path
    """Folder of the rows of finished cases."""
    cases: int = 80
    """Number of cases."""
    first: int = 0
    """Number of the first case."""
    seed: int = SEED
    """Seed of the draw."""
    runs: int = 4
    """Runs of a recording, at most."""
    form: Literal["recorded", "session", "both"] = "both"
    """Recordings of random runs, sessions in which the tool chooses its runs, or both."""
    workers: int = 1
    """Processes side by side."""
    table: bool = False
    """Print the tables of the kept rows alone."""


def run(given: SuiteSettings) -> None:
    """Run the cases and print a table for each form."""
    for form in ("recorded", "session") if given.form == "both" else (given.form,):
        file = given.out / f"{form}-{given.seed}.jsonl"
        if not given.table:
            numbers = range(given.first, given.first + given.cases)
            work = partial(row_of, seed=given.seed, runs=given.runs, form=form)
            run_cases(numbers, work, file, workers=given.workers, say=line_of, key="case")
        print(table(kept(file), f"{form}, seed {given.seed}"))


def row_of(number: int, *, seed: int, runs: int, form: str) -> Row:
    """Row of a case in one form."""
    case = draw(number, seed)
    return recorded(case, runs) if form == "recorded" else in_session(case, 2 * runs)


def line_of(row: Row) -> str:
    """A case in a line."""
    wrong = "" if row["true"] == row["said"] else " WRONG"
    return (
        f"{row['case']} {row['arm']}: {row['true']} -> {row['said']} ({row['probability']:.3f})"
        f"{wrong}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command("diagnosis suite", __doc__, SuiteSettings, run, arguments)


if __name__ == "__main__":
    main()
