"""Blind suite of diagnosis on machines unlike the package's models; finished cases are kept."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.cli.command import command
from loose_env.errors import InvalidSetting, LooseEnvError
from loose_env.evaluation import wilson
from loose_env.instrument import DiagnoseSettings, Diagnosis, diagnose
from loose_env.recording import Recording, Run, write_recording
from scripts.suites.machines.case import Case, CaseMade, CaseSettings, RunMade, draw, play
from scripts.suites.machines.machine import KINDS, Disturbances, Unstable
from scripts.suites.rows import kept, run_cases

Row = dict[str, Any]
AXES = "xyz"


def row_of(number: int, seed: int, settings: CaseSettings, only: str | None = None) -> Row:
    """Truth and result of a case."""
    alone = None
    if only is not None:
        alone = Disturbances.none() if only == "none" else Disturbances.only(only)
    return examined(draw(number, seed, settings, disturbances=alone)) | {"only": only}


def examined(case: Case) -> Row:
    """Play a case, write its recording, diagnose it; a reason under "unplayed" as `row_of`."""
    begun = time.process_time()
    try:
        made = play(case)
    except Unstable as error:
        return {
            "case": case.number,
            "seed": case.seed,
            "reference": case.reference,
            "truth": case.truth,
            "link": None if case.fault is None else case.fault.link + 1,
            "unplayed": str(error),
        }
    between = time.process_time()
    truth = truth_of(made) | {"simulating": between - begun}
    with tempfile.TemporaryDirectory() as place:
        recording = write(made, Path(place, case.name))
        between = time.process_time()
        try:
            found = diagnose(recording, plan=False)
        except LooseEnvError as error:
            return truth | {"error": str(error), "seconds": time.process_time() - between}
    return truth | result_of(found, made) | {"seconds": time.process_time() - between}


def write(made: CaseMade, folder: Path) -> Recording:
    """Write the recording of a case: what the diagnosis may see."""
    runs = [_run(one) for one in made.runs]
    return write_recording(folder, model_xml=made.case.model_xml, runs=runs)


def truth_of(made: CaseMade) -> Row:
    """What is true of a case."""
    case, fault = made.case, made.case.fault
    return {
        "case": case.number,
        "seed": case.seed,
        "joints": case.arm.joints,
        "servoed": case.arm.servoed,
        "rate": case.rate,
        "reference": case.reference,
        "disturbances": {k: dict(v) for k, v in case.disturbances.sizes.items()},
        "truth": case.truth,
        "link": None if fault is None else fault.link + 1,
        "gap": None if fault is None else fault.gap,
        "direction": None if fault is None else fault.direction,
        "opens": made.opens,
        "opened": made.opened,
        "change": made.change,
        "travel": made.travel,
        "share": made.share,
        "attempts": made.attempts,
    }


def result_of(found: Diagnosis, made: CaseMade) -> Row:
    """What the diagnosis said, and its errors."""
    sure = DiagnoseSettings().sure
    steps = [dict(r.probabilities) for r in found.records if r.probabilities]
    used = [k + 1 for k, step in enumerate(steps) if max(step.values()) > sure and k > 0]
    fault = made.case.fault
    angle = None
    if fault is not None and found.fault.direction is not None:
        cosine = abs(float(np.dot(fault.direction, found.fault.direction)))
        angle = float(np.degrees(np.arccos(min(cosine, 1.0))))
    named = found.fault.hypothesis
    settled = "faulty" if named != "healthy" else "healthy"
    verdict = getattr(found, "verdict", settled if found.settled else "open")
    because = getattr(found, "open_because", ())
    return {
        "named": named,
        "named_link": _link(named),
        "probability": found.probability,
        "posterior": dict(found.posterior),
        "settled": found.settled,
        "verdict": str(verdict),
        "open_because": [because] if isinstance(because, str) else list(because or ()),
        "misfit": getattr(found, "misfit", None),
        "warnings": list(found.warnings),
        "angle": angle,
        "half_angle": found.fault.direction_half_angle_deg,
        "gap_named": found.fault.gap_m,
        "gap_interval": found.fault.gap_interval_m,
        "steps": steps,
        "used": used[0] if used else None,
    }


def _link(hypothesis: str) -> int | None:
    """Number of the link or joint of a hypothesis."""
    digits = "".join(c for c in hypothesis.partition("@")[2] if c.isdigit())
    return int(digits) if digits else None


def _run(made: RunMade) -> Run:
    """Run in the package's form."""
    columns = made.columns
    sensors = {
        name.removeprefix("sensor."): values
        for name, values in columns.items()
        if name.startswith("sensor.joint")
    }
    sensors["tool_acc"] = np.stack([columns[f"sensor.tool_acc.{k}"] for k in AXES], axis=1)
    run = Run(
        name=made.name,
        time=columns["time"],
        controls={
            name.removeprefix("ctrl."): values
            for name, values in columns.items()
            if name.startswith("ctrl.")
        },
        sensors=sensors,
        excited=(made.excited,),
        pose=made.pose,
    )
    return replace(run, condition="healthy") if made.condition == "healthy" else run


def line_of(row: Row) -> str:
    """A case in a line."""
    if "unplayed" in row:
        return f"{row['case']}: not played: {row['unplayed']}"
    if "error" in row:
        return f"{row['case']}: {row['truth']} -> {row['error']}"
    opens = "" if row["link"] is None or row["opens"] else ", does not open"
    reference = " (reference)" if row["reference"] else ""
    return (
        f"{row['case']}{reference}: {row['truth']}{opens} -> {row['verdict']}, {row['named']} "
        f"{row['probability']:.3f}; {', '.join(row['disturbances']) or 'no disturbance'}"
    )


Rows = Sequence[dict[str, Any]]
BINS = (0.0, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
"""Ends of the bins of probability."""


def sure_fault(row: dict[str, Any]) -> bool:
    """Return True if a fault was surely named."""
    return bool(row.get("verdict") == "faulty")


def right(row: dict[str, Any]) -> bool:
    """Return True if the most probable hypothesis is the truth."""
    return bool(row.get("named") == row["truth"])


def right_link(row: dict[str, Any]) -> bool:
    """Return True if the most probable hypothesis lies at the true link or its joint."""
    return row["link"] is not None and row.get("named_link") == row["link"]


def tables(rows: Rows) -> str:
    """All tables in Markdown; machines that could not be played are counted apart."""
    played = [row for row in rows if "unplayed" not in row]
    apart = len(rows) - len(played)
    said = f" {apart} more machines could not be played: no servo loop held their pose."
    rows = played
    found = [
        f"{len(rows)} cases{_spread(rows)}.{said if apart else ''}",
        "",
        _head(("", "to reach", "measured")),
    ]
    found += [_line(line) for line in _summary(rows)]
    found += ["", "Probability of the most probable hypothesis against its accuracy:", ""]
    found += [_head(("probability", "cases", "mean", "accuracy"))]
    found += [_line(line) for line in calibration(rows)[1]]
    found += ["", "By disturbance present (a case has several) and by recorder:", ""]
    found += [_head(("cases with", "sure false alarms", "right link of faults that open",
                     "sure wrong link", "calibration error"))]  # fmt: skip
    found += [_line(line) for line in _strata(rows)]
    return "\n".join(found)


def calibration(rows: Rows) -> tuple[float, list[tuple[str, ...]]]:
    """Expected calibration error, and the lines of its bins."""
    rows = [row for row in rows if "probability" in row]
    told = np.array([row["probability"] for row in rows])
    hit = np.array([right(row) for row in rows], dtype=float)
    error = 0.0
    lines: list[tuple[str, ...]] = []
    for low, high in itertools.pairwise(BINS):
        inside = (told > low) & (told <= high)
        if inside.any():
            error += abs(float(told[inside].mean() - hit[inside].mean())) * float(inside.mean())
            lines.append((f"{low:g} to {high:g}", str(int(inside.sum())),
                          f"{told[inside].mean():.3f}", f"{hit[inside].mean():.3f}"))  # fmt: skip
    return error, lines


def _summary(rows: Rows) -> list[tuple[str, str, str]]:
    healthy = [row for row in rows if row["link"] is None]
    faulty = [row for row in rows if row["link"] is not None]
    opening = [row for row in faulty if row["opens"]]
    settled = [row for row in opening if sure_fault(row)]
    rest = [row for row in opening if not right_link(row)]
    lines = []
    for reference, most in ((False, "at most 2 %"), (True, "at most 0.5 %")):
        own = [row for row in healthy if row["reference"] == reference]
        words = "with" if reference else "without"
        lines.append((f"sure false alarms, {words} reference", most, _share(own, sure_fault)))
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
         _spread_of([row["angle"] for row in opening
                     if right(row) and row.get("angle") is not None])),
        ("free travel over the truth, median and 90th percentile of its ratio", "",
         _spread_of([_ratio(row) for row in opening if right(row) and row.get("gap_named")])),
        ("runs to a sure result, median and 90th percentile", "",
         _spread_of([row["used"] for row in rows if row.get("used")])),
        ("calibration error", "at most 0.03", f"{calibration(rows)[0]:.3f}"),
        ("seconds of a diagnosis, median and 90th percentile", "",
         _spread_of([row["seconds"] for row in rows])),
        ("refused recordings", "", _share(rows, lambda row: "error" in row)),
    ]  # fmt: skip
    return lines


def _strata(rows: Rows) -> list[tuple[str, ...]]:
    groups: list[tuple[str, Rows]] = []
    for name in KINDS:
        own = [row for row in rows if name in row["disturbances"]]
        if own:
            groups.append((f"`{name}`", own))
    groups += [
        ("position servos", [row for row in rows if row["servoed"]]),
        ("torque motors", [row for row in rows if not row["servoed"]]),
        ("recorder below 1 kHz", [row for row in rows if row["rate"] < 1000]),
        ("recorder of 1 kHz or more", [row for row in rows if row["rate"] >= 1000]),
    ]
    groups += [(f"{n} joints", [row for row in rows if row["joints"] == n]) for n in range(3, 8)]
    lines: list[tuple[str, ...]] = []
    for name, group in groups:
        healthy = [row for row in group if row["link"] is None]
        opening = [row for row in group if row["link"] is not None and row["opens"]]
        wrong = [sure_fault(row) and not right_link(row) for row in opening]
        lines.append((name, _share(healthy, sure_fault), _share(opening, right_link),
                      f"{sum(wrong)} of {len(wrong)}", f"{calibration(group)[0]:.3f}"))  # fmt: skip
    return lines


def _verdict(name: str) -> Callable[[dict[str, Any]], bool]:
    return lambda row: bool(row.get("verdict") == name)


def _share(rows: Rows, mark: Callable[[dict[str, Any]], bool]) -> str:
    if not rows:
        return "no case"
    count = sum(bool(mark(row)) for row in rows)
    low, high = wilson(count, len(rows))
    return f"{count} of {len(rows)} = {count / len(rows):.1%} ({low:.1%} to {high:.1%})"


def _ratio(row: dict[str, Any]) -> float:
    ratio = float(row["gap_named"] / row["gap"])
    return max(ratio, 1 / ratio)


def _spread_of(values: Sequence[float]) -> str:
    if not values:
        return "no case"
    return f"{np.median(values):.3g}, {np.percentile(values, 90):.3g} ({len(values)})"


def _spread(rows: Rows) -> str:
    seeds = sorted({row["seed"] for row in rows})
    return f", seed {', '.join(map(str, seeds))}" if seeds else ""


def _head(names: Iterable[str]) -> str:
    names = list(names)
    return f"{_line(names)}\n|{'---|' * len(names)}"


def _line(values: Iterable[str]) -> str:
    return "| " + " | ".join(values) + " |"


SEED = 81_207
"""Of the printed tables; nothing was developed on it. Development used the seed 1."""


@dataclass(frozen=True, kw_only=True)
class SuiteSettings:
    """Which cases, and how large."""

    out: Path
    """File of rows (JSON lines): of one seed and one --only."""
    cases: int = 100
    """Number of cases."""
    first: int = 0
    """Number of the first case."""
    seed: int = SEED
    """Seed of the draw."""
    only: str | None = None
    """Machines with this disturbance alone, or none."""
    runs: int = 6
    """Suspect runs of a recording."""
    poses: int = 3
    """Poses among them."""
    seconds: float = 1.2
    """Length of a run [s]."""
    workers: int = 1
    """Processes side by side."""
    table: bool = False
    """Print the tables of the kept rows alone."""


def run(given: SuiteSettings) -> None:
    """Run the cases and print the tables."""
    if given.only not in (None, "none", *KINDS):
        raise InvalidSetting(f"only: {given.only!r} is none of none, {', '.join(KINDS)}")
    rows = kept(given.out)
    other = {(row["seed"], row["only"]) for row in rows} - {(given.seed, given.only)}
    if given.table and not rows:
        raise InvalidSetting(f"{given.out} has no rows to make tables of; run some cases first")
    if not given.table:
        if other:
            raise InvalidSetting(
                f"{given.out} has rows of another seed or --only; give another file"
            )
        settings = CaseSettings(runs=given.runs, poses=given.poses, seconds=given.seconds)
        work = partial(row_of, seed=given.seed, settings=settings, only=given.only)
        numbers = range(given.first, given.first + given.cases)
        run_cases(numbers, work, given.out, workers=given.workers, say=line_of, key="case")
        rows = kept(given.out)
    rows.sort(key=lambda row: (row["seed"], row["case"]))
    print(tables(rows))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command(
        "machines", __doc__, SuiteSettings, run, arguments, interrupted="finished cases are kept"
    )


if __name__ == "__main__":
    main()
