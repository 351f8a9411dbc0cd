"""Writing a case: the recording in one folder, the truth sealed in another."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.recording import Run, write_recording
from scripts.suites.gap.cases.cases import Case
from scripts.suites.gap.cases.motions import Motion
from scripts.suites.gap.cases.sensing import Signals, add_noise, rounded
from scripts.suites.gap.effects.sensor import ACCELEROMETER
from scripts.suites.gap.effects.types import FORWARD, FREE, INVERSE, MIXED, RANDOM
from scripts.suites.gap.simulator.build import FACTORS
from scripts.suites.gap.simulator.model_xml import model_xml
from scripts.suites.gap.simulator.simulate import SAMPLE

FORMAT = "gap-truth/1"
"""Format of a file of truth."""


def runs_of(case: Case) -> list[Run]:
    """Readings of a case with noise."""
    runs = []
    readings = case.arm.assemble()[1]
    for i, motion in enumerate(case.motions):
        rng = np.random.default_rng(np.random.SeedSequence([case.seed, 2, case.number, i]))
        signals = rounded(add_noise(case.arm.run(motion), case.noise, rng), readings)
        runs.append(_run(case, motion, signals, f"run-{i + 1:02d}"))
    return runs


def _run(case: Case, motion: Motion, signals: Signals, name: str) -> Run:
    joints, form = range(case.arm.figures.joints), case.form
    if form == MIXED:
        form = INVERSE if motion.straight else FORWARD
    sensors: dict[str, Any] = {}
    for j in joints:
        sensors[f"joint{j + 1}_pos"] = signals.position[:, j]
        sensors[f"joint{j + 1}_vel"] = signals.velocity[:, j]
    if form != INVERSE:
        sensors[ACCELEROMETER] = signals.acceleration
    controls, torques = {}, {}
    if form == INVERSE:
        torques = {f"joint{j + 1}": signals.torque[:, j] for j in joints}
    elif form != FREE:
        controls = {f"motor{j + 1}": motion.commands[:, j] for j in joints}
    extra: dict[str, Any] = {}
    if form == RANDOM:
        assert motion.excited is not None and motion.pose is not None
        extra["excited"] = (f"joint{motion.excited + 1}",)
        extra["pose"] = {f"joint{j + 1}": float(motion.pose[j]) for j in joints}
    return Run(
        name=name,
        time=np.arange(len(signals.position)) * SAMPLE,  # type: ignore[arg-type]
        controls=controls,
        sensors=sensors,
        torques=torques,
        **extra,
    )


def truth_of(case: Case) -> dict[str, Any]:
    """What is true of a case, as it is sealed."""
    return {
        "format": FORMAT,
        "case": case.name,
        "number": case.number,
        "role": case.role,
        "form": case.form,
        "arm": case.arm.figures.name,
        "families": [motion.family for motion in case.motions],
        "effects": [
            {
                "kind": effect.kind,
                "where": effect.place.name,
                "index": effect.place.index,
                "parameters": dict(effect.parameters),
                "size": size,
            }
            for effect, size in zip(case.arm.effects, case.sizes, strict=True)
        ],
        "factors": {name: getattr(case.arm.factors, name).tolist() for name in FACTORS},
        "noise": {
            "position": case.noise.reading.tolist(),
            "velocity": case.noise.velocity.tolist(),
            "acceleration": case.noise.acceleration,
            "torque": case.noise.torque.tolist(),
        },
    }


def write_runs(folder: Path, case: Case, runs: list[Run]) -> Path:
    """Write runs of a case with its nominal model as a recording; return its folder."""
    write_recording(
        folder,
        model_xml=model_xml(case.arm.figures, drives=case.form != FREE),
        runs=runs,
        overwrite=True,
    )
    return folder


def write_case(case: Case, *, recordings: Path, truth: Path) -> Path:
    """Write a case's recording and its truth, the truth last.

    Parameters
    ----------
    case : Case
        The case.
    recordings : Path
        Folder of recordings; the case is a folder in it.
    truth : Path
        Folder of truths, which must lie elsewhere.

    Returns
    -------
    Path
        The recording.
    """
    if recordings.resolve() in (truth.resolve(), *truth.resolve().parents):
        raise ValueError(f"truth {truth} lies inside the recordings {recordings}; keep it apart")
    folder = write_runs(recordings / case.name, case, runs_of(case))
    truth.mkdir(parents=True, exist_ok=True)
    path = truth / f"{case.name}.json"
    beside = path.with_suffix(f".{os.getpid()}.part")
    beside.write_text(json.dumps(truth_of(case), indent=1) + "\n", encoding="utf-8")
    beside.rename(path)
    return folder


def is_written(number: int, name: str, *, recordings: Path, truth: Path) -> bool:
    """Whether a case is there already, whole."""
    path = truth / f"{name}.json"
    return path.is_file() and (recordings / name / "recording.json").is_file()
