"""Blind recordings and their diagnosis by the command line."""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.cli.main import main
from loose_env.instrument import Diagnosis, read_diagnosis
from loose_env.recording import write_recording
from scripts.suites.diagnosis.cases import Case
from scripts.suites.diagnosis.measuring import (
    BlindArm,
    random_motion,
    random_runs,
    shown,
)
from scripts.suites.gap.simulator.model_xml import model_xml


def recorded(case: Case, runs: int) -> dict[str, Any]:
    """Let the command line diagnose a recording of random runs, in a folder without truth."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, case.name)
        write_recording(folder, model_xml=model_xml(case.arm.figures), runs=random_runs(case, runs))
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = main(["diagnose", str(folder), "--out", f"{place}/found", "--quiet"])
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
