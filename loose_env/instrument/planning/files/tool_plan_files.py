"""Runs and files of a plan whose tool is struck or shaken: ``plan.json`` and recording."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from loose_env.instrument.planning.files.plan_folder import (
    FORMAT,
    PLAN,
    RECORDING,
    PlanFiles,
    limits_json,
    write_description,
)
from loose_env.instrument.planning.files.planned_runs import PlannedRun, RunKind
from loose_env.instrument.planning.files.signal_files import TRANSIT, write_table
from loose_env.instrument.planning.signals.tool_plan import ToolPlan
from loose_env.io import plain, write_text


def tool_runs(files: PlanFiles, plan: ToolPlan) -> tuple[PlannedRun, ...]:
    """Runs of a plan: the directions, repeats of the first, references."""
    counts: dict[RunKind, int] = {"run": len(plan.runs)}
    counts["repeat"] = 0 if files.first else int(plan.settings["repeat"])
    counts["reference"] = len(plan.runs) if plan.settings["reference"] else 0
    return tuple(
        PlannedRun(
            kind=kind,
            file=file,
            signal=plan.runs[0 if kind == "repeat" else k].name,
            joint="",
            pose=plan.next_pose,
        )
        for kind, count in counts.items()
        for k, file in enumerate(files.next_names(count, kind))
    )


def write_tool_plan(files: PlanFiles, plan: ToolPlan, *, known: str = "") -> list[Path]:
    """Write a plan; ``plan.json`` is removed first and written last.

    Parameters
    ----------
    files : PlanFiles
        Paths of the files.
    plan : ToolPlan
        The plan.
    known : str
        Source of the prior knowledge, for the file.

    Returns
    -------
    list of Path
        Files written, the plan first.
    """
    planned = tool_runs(files, plan)
    formats = [f for f in plan.settings["signal_format"] if f != "ros2"] or ["csv"]
    tables = {}
    if plan.signal is not None:
        tables["signal"] = (formats, dict(plan.signal))
    if plan.transit.duration_s > 0:
        columns = {"time": plan.transit.time, **plan.transit.columns(plan.arm)}
        tables[TRANSIT] = (list(plan.settings["signal_format"]), columns)
    files.make_room(tables)
    written = [write_description(files, plan.arm.recording_model.xml, planned)]
    for stem, (own, columns) in tables.items():
        written += write_table(files.folder, stem, columns, plan.arm, own, plan.pose)
    whole = _json(plan, planned, known)
    whole["files"] = sorted(path.name for path in written if path.parent == files.folder)
    text = json.dumps(plain(whole), indent=1, ensure_ascii=False, allow_nan=False)
    return [write_text(files.folder / PLAN, text + "\n"), *written]


def _json(plan: ToolPlan, planned: tuple[PlannedRun, ...], known: str) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "model": plan.arm.path.name,
        "known": known,
        "excitation": plan.kind,
        "pose": plan.next_pose,
        "directions": [asdict(run) for run in plan.runs],
        "force_rms_n": plan.force_n,
        "band_hz": list(plan.band_hz),
        "seconds": plan.seconds,
        "rate_hz": plan.rate_hz,
        "tool": plan.arm.recording_model.site,
        "force_sensor": plan.arm.tool_force,
        "signals": [],
        "runs": [one.listed for one in planned],
        "limits": limits_json(plan.arm, plan.limits),
        "transit": {
            "from": plan.arm.by_joint(plan.transit.positions[0]),
            "from_origin": plan.start_origin,
            "duration_s": plan.transit.duration_s,
            "peaks": [asdict(peak) for peak in plan.transit.peaks],
        },
        "recording": RECORDING,
        "columns": list(plan.columns),
        "warnings": list(plan.warnings),
        "settings": dict(plan.settings),
    }
