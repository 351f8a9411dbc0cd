"""Files of a plan: ``plan.json``, signal, and empty recording; columns that a run should have.

``DIR/recording`` is a recording in the making: its model has every actuator and sensor that runs
can name, its ``recording.json`` lists the runs measured so far and the ones planned now. Put the
measured run there under the name given, and the folder reads as a recording.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.instrument.planning.files.plan_folder import (
    FORMAT,
    PLAN,
    RECORDING,
    PlanFiles,
    limits_json,
    write_description,
)
from loose_env.instrument.planning.files.ros_trajectory import joint_columns
from loose_env.instrument.planning.files.signal_files import (
    ENDINGS,
    FIRST,
    TRANSIT,
    signal_columns,
    signal_stems,
    write_table,
)
from loose_env.instrument.planning.plan import Plan
from loose_env.io import plain, write_text
from loose_env.typing import Array


def write_plan(files: PlanFiles, plan: Plan, *, known: str = "") -> list[Path]:
    """Write a plan; ``plan.json`` is removed first and written last.

    Parameters
    ----------
    files : PlanFiles
        Paths of the files.
    plan : Plan
        The plan.
    known : str
        Source of the prior knowledge, for the file.

    Returns
    -------
    list of Path
        Files written, the plan first.

    Raises
    ------
    InvalidSetting
        If a signal would take the place of a file that no plan wrote.
    """
    planned = files.runs_of(plan)
    tables, formats = _tables(files, plan), _formats(plan)
    for _, columns in tables.values():  # a JointTrajectory may be impossible: before anything goes
        if "ros2" in formats:
            joint_columns(plan.arm, {k: v for k, v in columns.items() if k != "time"})
    names, kept = files.make_room(tables)
    written = [write_description(files, plan.arm.recording_model.xml, planned)]
    for stem, (own, columns) in tables.items():
        written += write_table(files.folder, stem, columns, plan.arm, own, plan.pose)
    runs = [one.entry["file"] for one in planned if one.kind == "run"]
    whole = plan_json(plan, runs, known)
    whole["runs"] = [one.listed for one in planned]
    whole["files"] = sorted(names | kept)
    text = json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False)
    return [write_text(files.folder / PLAN, text + "\n"), *written]


def _formats(plan: Plan) -> tuple[str, ...]:
    """Formats of the signal's files."""
    return tuple(dict.fromkeys(plan.settings.get("signal_format") or ("csv", "parquet")))


def _tables(files: PlanFiles, plan: Plan) -> dict[str, tuple[tuple[str, ...], Mapping[str, Array]]]:
    """Stem of each file -> its formats and columns."""
    formats = _formats(plan)
    tables: dict[str, tuple[tuple[str, ...], Mapping[str, Array]]] = {
        stem: (formats, signal_columns(signal))
        for signal, stem in zip(plan.signals, signal_stems(plan.signals), strict=True)
    }
    if files.first is None and plan.settings.get("repeat"):
        tables[FIRST] = (formats, signal_columns(plan.signals[0]))
    if plan.transit.duration_s > 0:
        columns = {"time": plan.transit.time, **plan.transit.columns(plan.arm)}
        tables[TRANSIT] = (formats, columns)
    return tables


def command_columns(plan: Plan) -> tuple[str, ...]:
    """Columns of the commands in a measured run.

    The model says what a command does only where it is one of its own actuators: beside others,
    the torque that the drives gave is recorded.
    """
    if plan.signals[0].kind == "model":
        return tuple(f"ctrl.{name}" for name in plan.signals[0].commands)
    return tuple(f"torque.{name}" for name in plan.arm.joints)


def run_columns(plan: Plan) -> tuple[str, ...]:
    """Columns that a measured run should have."""
    made = plan.arm.recording_model
    return (
        "time",
        *command_columns(plan),
        *(f"sensor.{made.accelerometer}.{axis}" for axis in "xyz"),
        *(f"sensor.{name}" for name in made.positions),
    )


def plan_json(plan: Plan, runs: Sequence[str], known: str = "") -> dict[str, Any]:
    """Content of ``plan.json``, as JSON has it."""
    arm, chosen = plan.arm, plan.next
    units = {
        name: ("N", "m") if slides else ("N·m", "rad")
        for name, slides in zip(arm.joints, arm.nominal.sliding, strict=True)
    }
    formats = _formats(plan)
    signals = []
    for signal, run, stem in zip(plan.signals, runs, signal_stems(plan.signals), strict=True):
        j = arm.joints.index(signal.joint)
        drive = arm.drives[j]
        assert drive is not None
        signals.append(
            {
                "joint": signal.joint,
                "actuator": drive.actuator,
                "command": signal.kind
                if signal.kind != "model"
                else "position"
                if drive.servo
                else "torque",
                "csv": f"{stem}.csv" if "csv" in formats else None,
                "parquet": f"{stem}.parquet" if "parquet" in formats else None,
                "files": [f"{stem}{ENDINGS[name]}" for name in formats],
                "command_rate_hz": signal.rate_hz,
                "scale": signal.scale,
                "peaks": [asdict(peak) for peak in signal.peaks],
                "steady_s": list(signal.steady_s),
                "start_commands": dict(signal.start),
                "sags": arm.by_joint(signal.sags),
                "torque_rms": signal.drive_rms,
                "command_torque_rms": signal.torque_rms,
                "torque_peaks": arm.by_joint(signal.torque_peaks),
                "torque_limits": arm.by_joint(np.array(arm.nominal.torque_limits)),
                "torque_unit": units[signal.joint][0],
                "joint_acceleration_rms": signal.joint_rms,
                "tool_acceleration_rms": signal.tool_rms,
                "largest_travel": float(signal.travel[j]),
                "travel_unit": units[signal.joint][1],
                "limited_by": signal.limited_by,
                "run": f"{RECORDING}/{run}",
            }
        )
    whole = {
        "format": FORMAT,
        "model": arm.path.name,
        "known": known,
        "pose": dict(chosen.pose),
        "joints": list(chosen.joints),
        "band_hz": list(chosen.band_hz),
        "levels": list(chosen.levels),
        "torques": list(chosen.torques),
        "seconds": chosen.seconds,
        "rate_hz": chosen.rate_hz,
        "seed": plan.settings.get("seed", 0),
        "reason": chosen.reason,
        "gain_bits": chosen.gain,
        "held_by": arm.held_by,
        "tool": arm.recording_model.site,
        "signals": signals,
        "limits": limits_json(arm, plan.limits),
        "transit": {
            "from": arm.by_joint(plan.transit.positions[0]),
            "from_origin": plan.start_origin,
            "duration_s": plan.transit.duration_s,
            "peaks": [asdict(peak) for peak in plan.transit.peaks],
        },
        "expected": {name: asdict(one) for name, one in plan.expected.items()},
        "recording": RECORDING,
        "columns": list(run_columns(plan)),
        "warnings": list(plan.warnings),
        "settings": dict(plan.settings),
    }
    values: dict[str, Any] = plain(whole)
    return values
