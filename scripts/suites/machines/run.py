"""Diagnosis of a blind case by its recording; truth and result in a row."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import LooseEnvError
from loose_env.instrument import DiagnoseSettings, Diagnosis, diagnose
from loose_env.recording import Recording, Run, write_recording
from scripts.suites.machines.case import Case, CaseMade, RunMade, draw, play
from scripts.suites.machines.disturbances import Disturbances
from scripts.suites.machines.machine import Unstable
from scripts.suites.machines.plans import CaseSettings

Row = dict[str, Any]
AXES = "xyz"


def row_of(number: int, seed: int, settings: CaseSettings, only: str | None = None) -> Row:
    """Truth and result of a case.

    Parameters
    ----------
    number, seed : int
        Of the case and of the suite.
    settings : CaseSettings
        Size of the recording.
    only : str, optional
        The one disturbance of the machine, "none" for its model; else they are drawn.

    Returns
    -------
    dict
        With a reason under "unplayed" for a machine whose servo loops hold no pose.
    """
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
