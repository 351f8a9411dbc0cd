"""Blind suite of `loose diagnose`: simulated arms diagnosed without their truth, and graded."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from loose_env.cli.command import command, one_of
from loose_env.errors import InvalidSetting, LooseEnvError
from loose_env.evaluation import expected_calibration_error, wilson
from loose_env.instrument import DiagnoseSettings, Diagnosis, diagnose, find_fault
from loose_env.recording import write_recording
from scripts.suites.diagnosis.cases import BlindArm, Case, draw, random_runs, shown
from scripts.suites.diagnosis.machines import (
    DISTURBANCES,
    RichCase,
    Unstable,
    alone,
    draw_rich,
)
from scripts.suites.rows import Row, kept, run_cases

OPENS = 0.05
"""Change of the tool's motion by a fault over the motion, from which the fault opens."""


def recorded(case: Case | RichCase, runs: int) -> Row:
    """Diagnose a recording in a folder without truth; a reason under "unplayed" or "error"."""
    truth = truth_of(case)
    try:
        made, change = case.played() if isinstance(case, RichCase) else random_runs(case, runs)
    except Unstable as error:
        return truth | {"unplayed": str(error)}
    truth |= {"opens": max(change, default=0.0) > OPENS, "change": change}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, f"case-{case.number:04d}")
        recording = write_recording(folder, model_xml=case.model_xml, runs=made)
        begun = time.process_time()
        try:
            found = diagnose(recording, plan=False)
        except LooseEnvError as error:
            return truth | {"error": str(error), "seconds": time.process_time() - begun}
    steps = [dict(r.probabilities) for r in found.records if r.condition == "suspect"]
    return truth | result_of(case, found, steps) | {"seconds": time.process_time() - begun}


def in_session(case: Case, most: int) -> Row:
    """Let the tool choose its runs until it names the fault."""
    steps: list[dict[str, float]] = []
    machine, begun = BlindArm(case), time.process_time()
    with tempfile.TemporaryDirectory() as place:
        model = Path(place, "model.xml")
        model.write_text(case.model_xml, encoding="utf-8")
        ended = find_fault(
            machine, model, most=most, say=lambda found: steps.append(dict(found.posterior))
        )
    spent, change = time.process_time() - begun, shown(case, machine.played)
    return truth_of(case) | result_of(case, ended.diagnosis, steps) | {
        "opens": max(change, default=0.0) > OPENS, "change": change, "seconds": spent,
        "measurements": ended.measurements,
    }  # fmt: skip


def truth_of(case: Case | RichCase) -> Row:
    """What is true of a case."""
    fault = case.fault
    return {
        "case": case.number,
        "seed": case.seed,
        "reference": case.reference,
        "truth": "healthy" if fault is None else f"{fault.kind}@{fault.place.name}",
        "link": None if fault is None else fault.place.index + 1,
        "gap": None if fault is None else fault.parameters["gap"],
        **case.facts,
    }


def result_of(case: Case | RichCase, found: Diagnosis, steps: Sequence[dict[str, float]]) -> Row:
    """What the diagnosis said, after each suspect run too, and its errors."""
    sure, named, said = DiagnoseSettings().sure, found.fault.hypothesis, found.fault.direction
    used = [k for k, step in enumerate(steps, start=1) if step and max(step.values()) > sure]
    angle, digits = None, "".join(c for c in named.partition("@")[2] if c.isdigit())
    if case.fault is not None and "direction" in case.fault.parameters and said is not None:
        true = np.array(case.fault.parameters["direction"])
        cosine = abs(float(true @ np.array(said))) / float(np.linalg.norm(true))
        angle = float(np.degrees(np.arccos(min(cosine, 1.0))))
    return {
        "named": named,
        "named_link": int(digits) if digits else None,
        "probability": found.probability,
        "posterior": dict(found.posterior),
        "settled": found.settled,
        "verdict": str(found.verdict),
        "misfit": found.misfit,
        "warnings": list(found.warnings),
        "angle": angle,
        "half_angle": found.fault.direction_half_angle_deg,
        "gap_named": found.fault.gap_m,
        "gap_interval": found.fault.gap_interval_m,
        "steps": list(steps),
        "used": used[0] if used else None,
    }


def line_of(row: Row) -> str:
    """A case in a line."""
    if reason := row.get("unplayed", row.get("error")):
        return f"{row['case']}: {row['truth']} -> {reason}"
    opens = "" if row["link"] is None or row["opens"] else ", does not open"
    reference = " (reference)" if row["reference"] else ""
    return (
        f"{row['case']}{reference}: {row['truth']}{opens} -> {row['verdict']}, {row['named']} "
        f"{row['probability']:.3f}; {', '.join(row['disturbances']) or 'no disturbance'}"
    )


# ---------------------------------------------------------------------------------- tables

Rows = Sequence[Row]
BINS = (0.0, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
"""Ends of the bins of probability."""


def right(row: Row) -> bool:
    """Return True if the most probable hypothesis is the truth."""
    return bool(row.get("named") == row["truth"])


def right_link(row: Row) -> bool:
    """Return True if the most probable hypothesis lies at the true link or its joint."""
    return row["link"] is not None and row.get("named_link") == row["link"]


def _verdict(name: str) -> Callable[[Row], bool]:
    return lambda row: bool(row.get("verdict") == name)


sure_fault = _verdict("faulty")


def tables(rows: Rows) -> str:
    """All tables in Markdown; machines that could not be played are counted apart."""
    played = [row for row in rows if "unplayed" not in row]
    seeds = ", ".join(map(str, sorted({row["seed"] for row in played})))
    apart = len(rows) - len(played)
    said = f" {apart} more machines could not be played: no servo loop held their pose."
    rows, told = played, [row for row in played if "probability" in row]
    found = [f"{len(rows)} cases{f', seed {seeds}' if seeds else ''}.{said if apart else ''}", ""]
    found += _table(("", "to reach", "measured"), _summary(rows))
    found += ["", "Probability of the most probable hypothesis against its accuracy:", ""]
    bins = []
    for low, high in itertools.pairwise(BINS):
        own = [row for row in told if low < row["probability"] <= high]
        if own:
            mean = np.mean([row["probability"] for row in own])
            share = np.mean([right(row) for row in own])
            bins.append((f"{low:g} to {high:g}", str(len(own)), f"{mean:.3f}", f"{share:.3f}"))
    found += _table(("probability", "cases", "mean", "accuracy"), bins)
    found += ["", "After so many runs:", ""]
    most = max((len(row["steps"]) for row in told), default=0)
    groups = (told, [row for row in told if row["opens"]])
    after = [
        (str(count), *(_share(own, partial(_right_after, count=count)) for own in groups))
        for count in range(1, most + 1)
    ]
    found += _table(("runs", "right hypothesis", "of faults that open"), after)
    found += ["", "By disturbance present (a case has several) and by recorder:", ""]
    head = ("cases with", "sure false alarms", "right link of faults that open",
            "sure wrong link", "calibration error")  # fmt: skip
    return "\n".join([*found, *_table(head, _strata(rows))])


def _right_after(row: Row, count: int) -> bool:
    """Whether the first runs alone make the truth most probable; all where there are fewer."""
    found = row["steps"][min(count, len(row["steps"])) - 1]
    return bool(max(found, key=found.get) == row["truth"])


def _calibration(rows: Rows) -> float:
    told = [row for row in rows if "probability" in row]
    if not told:
        return float("nan")
    return expected_calibration_error(
        [row["probability"] for row in told], [right(row) for row in told]
    )


def _summary(rows: Rows) -> list[tuple[str, str, str]]:
    healthy = [row for row in rows if row["link"] is None]
    faulty = [row for row in rows if row["link"] is not None]
    opening = [row for row in faulty if row["opens"]]
    settled = [row for row in opening if sure_fault(row)]
    rest = [row for row in opening if not right_link(row)]
    own = [row for row in opening if right(row)]
    angles, gaps = ([r for r in own if r.get(name)] for name in ("angle", "gap_named"))
    lines = [
        (f"sure false alarms, {words} reference", most,
         _share([row for row in healthy if row["reference"] == (words == "with")], sure_fault))
        for words, most in (("without", "at most 2 %"), ("with", "at most 0.5 %"))
    ]  # fmt: skip
    for verdict in ("healthy", "open", "model_mismatch"):
        lines.append((f"healthy arms: {verdict}", "", _share(healthy, _verdict(verdict))))
    lines += [
        ("faults that open", "", _share(faulty, lambda row: row["opens"])),
        ("surely healthy of faults that open", "", _share(opening, _verdict("healthy"))),
        ("surely healthy of the others", "",
         _share([row for row in faulty if not row["opens"]], _verdict("healthy"))),
        ("right link of faults that open", "at least 85 %", _share(opening, right_link)),
        ("right hypothesis of faults that open", "", _share(opening, right)),
        ("settled of faults that open", "", _share(opening, sure_fault)),
        ("right link of those", "", _share(settled, right_link)),
        ("no sure wrong name where the link is not right", "at least 90 %",
         _share(rest, lambda row: not sure_fault(row))),
        ("the model is not this arm's, of the same", "",
         _share(rest, _verdict("model_mismatch"))),
        ("direction error, median and 90th percentile [degrees]", "",
         _spread([row["angle"] for row in angles])),
        ("true direction inside its 95 % cone", "",
         _share(angles, lambda row: row["angle"] <= row["half_angle"])),
        ("free travel over the truth, median and 90th percentile of its ratio", "",
         _spread([np.exp(abs(np.log(row["gap_named"] / row["gap"]))) for row in gaps])),
        ("true free travel inside its 95 % interval", "",
         _share([row for row in gaps if row.get("gap_interval")],
                lambda row: row["gap_interval"][0] <= row["gap"] <= row["gap_interval"][1])),
        ("runs to a sure result, median and 90th percentile", "",
         _spread([row["used"] for row in rows if row.get("used")])),
        ("calibration error", "at most 0.03", f"{_calibration(rows):.3f}"),
        ("seconds of a diagnosis, median and 90th percentile", "",
         _spread([row["seconds"] for row in rows])),
        ("refused recordings", "", _share(rows, lambda row: "error" in row)),
    ]  # fmt: skip
    taken = [row["measurements"] for row in rows if "measurements" in row]
    if taken:
        lines.append(("runs taken, median and 90th percentile", "", _spread(taken)))
    return lines


def _strata(rows: Rows) -> list[tuple[str, ...]]:
    groups: list[tuple[str, Callable[[Row], bool]]] = [
        (f"`{name}`", lambda row, name=name: name in row["disturbances"])  # type: ignore[misc]
        for name in DISTURBANCES
    ]
    groups += [
        ("position servos", lambda row: row["servoed"]),
        ("torque motors", lambda row: not row["servoed"]),
        ("recorder below 1 kHz", lambda row: row["rate"] < 1000),
        ("recorder of 1 kHz or more", lambda row: row["rate"] >= 1000),
    ]
    groups += [(f"{n} joints", lambda row, n=n: row["joints"] == n) for n in range(3, 8)]  # type: ignore[misc]
    lines: list[tuple[str, ...]] = []
    for name, inside in groups:
        group = [row for row in rows if inside(row)]
        healthy = [row for row in group if row["link"] is None]
        opening = [row for row in group if row["link"] is not None and row["opens"]]
        wrong = sum(sure_fault(row) and not right_link(row) for row in opening)
        if group:
            lines.append((name, _share(healthy, sure_fault), _share(opening, right_link),
                          f"{wrong} of {len(opening)}", f"{_calibration(group):.3f}"))  # fmt: skip
    return lines


def _share(rows: Rows, mark: Callable[[Row], bool]) -> str:
    if not rows:
        return "no case"
    count = sum(bool(mark(row)) for row in rows)
    low, high = wilson(count, len(rows))
    return f"{count} of {len(rows)} = {count / len(rows):.1%} ({low:.1%} to {high:.1%})"


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "no case"
    return f"{np.median(values):.3g}, {np.percentile(values, 90):.3g} ({len(values)})"


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    rows = [head, ["---"] * len(head), *lines]
    return ["| " + " | ".join(cells) + " |" for cells in rows]


# ------------------------------------------------------------------------------ the command

SEED = 60_713
"""Of the printed tables; nothing was developed on it."""


@dataclass(frozen=True, kw_only=True)
class SuiteSettings:
    """Which cases, and how large."""

    out: Path
    """Folder of the rows of finished cases, or a file (.jsonl) of those of one form."""
    cases: int = 80
    """Number of cases."""
    first: int = 0
    """Number of the first case."""
    seed: int = SEED
    """Seed of the draw."""
    runs: int = 4
    """Runs of a recording; twice as many in a session at most."""
    form: Literal["recorded", "session", "both", "machines"] = "both"
    """Recordings of random runs, sessions in which the tool chooses its runs, or both; machines:
    recordings of machines richer than the model."""
    only: Annotated[str, one_of(("any", "none", *DISTURBANCES))] = "any"
    """Of machines, this disturbance alone, or none."""
    seconds: float = 1.2
    """Length of the runs of machines [s]."""
    workers: int = 1
    """Processes side by side."""
    table: bool = False
    """Print the tables of the kept rows alone."""


def run(given: SuiteSettings) -> None:
    """Run the cases and print the tables of each form."""
    for form in ("recorded", "session") if given.form == "both" else (given.form,):
        file = given.out / f"{form}-{given.seed}.jsonl"
        if given.out.suffix == ".jsonl":
            file = given.out
        rows = kept(file)
        if given.table and not rows:
            raise InvalidSetting(f"{file} has no rows to make tables of; run some cases first")
        if not given.table:
            if {(row["seed"], row["only"]) for row in rows} - {(given.seed, given.only)}:
                raise InvalidSetting(
                    f"{file} has rows of another seed or --only; give another file"
                )
            numbers = range(given.first, given.first + given.cases)
            work = partial(row_of, given=given, form=form)
            run_cases(numbers, work, file, workers=given.workers, say=line_of, key="case")
            rows = kept(file)
        print(f"{form}: {tables(sorted(rows, key=lambda row: (row['seed'], row['case'])))}")


def row_of(number: int, *, given: SuiteSettings, form: str) -> Row:
    """Row of a case in one form."""
    if form == "machines":
        sizes = None if given.only == "any" else {} if given.only == "none" else alone(given.only)
        rich = draw_rich(number, given.seed, runs=given.runs, seconds=given.seconds, sizes=sizes)
        return recorded(rich, given.runs) | {"only": given.only}
    case = draw(number, given.seed)
    row = recorded(case, given.runs) if form == "recorded" else in_session(case, 2 * given.runs)
    return row | {"only": given.only}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command(
        "diagnosis suite", __doc__, SuiteSettings, run, arguments,
        interrupted="finished cases are kept",
    )  # fmt: skip


if __name__ == "__main__":
    main()
