"""Diagnosis with a corrected model: an arm with a spring in a drive that its model lacks.

The drive of one joint has a spring that the nominal model does not know. The healthy arm is
recorded, `loose gap` identifies the missing effect and writes the corrected model, and
`arm_from_file` reads it. Then faults are hidden in the true arm and diagnosed with the nominal
model, with the corrected one and with the true one, on the same hidden arms. The mode of the spring
goes from above the band of the excitation to below it.

The agent needs no training: it excites every joint in turn in the first pose, compares the spectra
of the records with the whole dynamic model (`direction_by_dynamics`), calls the arm healthy where
no seat moves, and says "unsure" where the lack of fit is too large.

Usage: python scripts/studies/corrected_arm.py [--quick] [--out FOLDER]
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from loose_agents.execution.study import Row, Study, StudyRun

from loose_env.arms import Arm, LinearArm, arm_from_file
from loose_env.cli.main import main as loose
from loose_env.diagnosis import direction_by_dynamics
from loose_env.envs import DiagnosisEnv, DiagnosisSettings
from loose_env.errors import InvalidData
from loose_env.faults import UNSURE
from loose_env.gap import GapResult, read_result
from scripts.study_parts.corrected_tables import MODELS, draw, show
from scripts.study_parts.three_axis_arm import NOMINAL, Settings, record, spring_of, true_xml

ROOT = Path(__file__).resolve().parents[2]
Case = tuple[float | None, str]
"""Mode of the spring [Hz], and the model of the diagnosis, or "gap" for its correction."""


def close_gap(settings: Settings, recording: Path, folder: Path) -> GapResult:
    """Run `loose gap`; finished parts of an earlier run are taken up."""
    words = ["gap", str(recording), "--out", str(folder), "--threads", "1"]
    if settings.kinds:
        words += ["--kinds", *settings.kinds]
    if loose(words) != 0:
        raise InvalidData("loose gap failed; its message stands above")
    return read_result(folder)


def gap_row(settings: Settings, mode: float, result: GapResult) -> Row:
    """Result of `loose gap` for one mode."""
    return {
        "what": "gap",
        "mode_hz": mode,
        "stiffness": spring_of(settings, mode)[0],
        "verdict": result.verdict,
        "effects": [
            {
                "kind": effect.kind,
                "where": effect.where,
                "parameters": dict(effect.parameters),
                "interval_95": {k: list(v) for k, v in effect.interval_95.items()},
                "ambiguous_with": [f"{p.kind}@{p.where}" for p in effect.ambiguous_with],
            }
            for effect in result.effects
        ],
        "before": result.gap.before,
        "after": result.gap.after,
    }


def arm_of(path: Path, levels: tuple[float, ...] | None = None) -> Arm:
    """Read an arm, with levels in place of those that its own model would suggest."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm = arm_from_file(path)
    return arm if levels is None else dataclasses.replace(arm, levels=levels)


def diagnose(env: DiagnosisEnv, linear: LinearArm, settings: Settings, seed: int) -> Row:
    """Play one episode: shake every joint in turn, compare with the model, name the fault."""
    env.reset(seed=seed)
    records, earned, lack = [], 0.0, None
    info: dict[str, Any] = {}
    for j in range(env.arm.n):
        levels = np.where(np.arange(env.arm.n) == j, settings.level, 0)
        shake = env.actions.encode(levels=levels, duration=0)
        _, reward, _, truncated, info = env.step(shake)
        earned += reward
        if truncated:
            return _outcome(info, earned, lack)
        if info["measurement"] is not None:  # None where gravity leaves the drive no torque
            records.append(info["measurement"])
    verdict = UNSURE
    if records:
        found = direction_by_dynamics(linear, records)
        lack = found.lack_of_fit
        if lack <= settings.lack_of_fit:
            verdict = found.location if found.evidence > 0 else "healthy"
    name = env.actions.encode(verdict=1 + env.verdicts.index(verdict))
    _, reward, _, _, info = env.step(name)
    return _outcome(info, earned + reward, lack)


def _outcome(info: dict[str, Any], earned: float, lack: float | None) -> Row:
    return {
        "truth": info["fault"],
        "verdict": info["verdict"],
        "success": bool(info["is_success"]),
        "reward": earned,
        "lack_of_fit": lack,
    }


def diagnosis_row(settings: Settings, mode: float | None, model: str, arm: Arm, true: Arm) -> Row:
    """Diagnose all hidden arms of a mode with one model; a list for each column."""
    rules = DiagnosisSettings(engine="reduced", raw=True, durations=(settings.duration,))
    env, linear = DiagnosisEnv(arm, rules, true_arm=true, threads=1), LinearArm(arm)
    played = [
        diagnose(env, linear, settings, settings.seed + 1 + k) for k in range(settings.episodes)
    ]
    columns = {name: [one[name] for one in played] for name in played[0]}
    return {"what": "diagnosis", "mode_hz": mode, "model": model} | columns


def work_folder(run: StudyRun) -> Path:
    """Folder of the models and recordings of a run."""
    return (run.out or ROOT / "out") / "corrected_arm" / ("quick" if run.quick else "full")


def cases(settings: Settings, run: StudyRun) -> list[Case]:
    """The arm without a spring, then for each mode the correction and all diagnoses."""
    return [(None, "nominal"), *((m, of) for m in settings.modes for of in ("gap", *MODELS))]


def work(case: Case, *, settings: Settings, run: StudyRun, say: Callable[[str], None]) -> list[Row]:
    """Correct the model for one mode, or diagnose with one model."""
    mode, model = case
    folder = work_folder(run)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "nominal.xml"
    path.write_text(NOMINAL, encoding="utf-8")
    nominal = arm_of(path)
    if mode is None:
        return [diagnosis_row(settings, mode, model, nominal, nominal)]
    corrected = folder / f"gap-{mode:g}" / "model.xml"
    if model == "gap" or not corrected.is_file():
        record(settings, mode, folder / f"recording-{mode:g}")
        result = close_gap(settings, folder / f"recording-{mode:g}", corrected.parent)
        if model == "gap":
            return [gap_row(settings, mode, result)]
    path = folder / f"true-{mode:g}.xml"
    path.write_text(true_xml(settings, mode), encoding="utf-8")
    true = arm_of(path, nominal.levels)
    arms = {"nominal": nominal, "true": true}
    arm = arms.get(model) or arm_of(corrected, nominal.levels)
    return [diagnosis_row(settings, mode, model, arm, true)]


STUDY = Study(
    script=__file__,
    about=__doc__,
    settings=Settings,
    run=StudyRun,
    quick={
        "modes": (60.0,),
        "kinds": ("joint_compliance", "backlash", "rotor_inertia"),
        "episodes": 12,
    },
    cases=cases,
    work=work,
    case_of=lambda row: (row["mode_hz"], row.get("model", "gap")),
    show=show,
    draw=draw,
)
main = STUDY.main

if __name__ == "__main__":
    main()
