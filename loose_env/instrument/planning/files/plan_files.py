"""Files of a plan: ``plan.json``, signal, and empty recording.

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

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.model.motion_limits import QUANTITIES
from loose_env.instrument.planning.files.planned_runs import PlannedRun, planned_runs
from loose_env.instrument.planning.files.ros_trajectory import joint_columns
from loose_env.instrument.planning.files.signal_files import (
    ENDINGS,
    FIRST,
    TRANSIT,
    own_files,
    signal_columns,
    signal_stems,
    write_table,
)
from loose_env.instrument.planning.plan import Plan
from loose_env.io import plain, write_text
from loose_env.recording import DESCRIPTION, RunEntry, read_description
from loose_env.recording import FORMAT as RECORDING_FORMAT
from loose_env.typing import Array

__all__ = [
    "FORMAT",
    "PAGE",
    "PLAN",
    "RECORDING",
    "PlanFiles",
    "plan_json",
    "read_plan",
    "run_columns",
    "write_plan",
]


FORMAT = "loose-plan/1"
"""Format of ``plan.json``."""
PLAN = "plan.json"
PAGE = "plan.html"
RECORDING = "recording"
_MODEL = "model.xml"


class PlanFiles:
    """A folder for plans: new, or one that an earlier plan was written to.

    Parameters
    ----------
    folder : Path
        The folder.
    model_xml : str
        Model for the recording in it.

    Raises
    ------
    InvalidSetting
        If it is a file, or holds files that this would overwrite and no plan wrote.
    InvalidData
        If its recording is of another model, or cannot be read.
    """

    def __init__(self, folder: Path, model_xml: str) -> None:
        self.folder = folder.resolve()
        if self.folder.exists() and not self.folder.is_dir():
            raise InvalidSetting(f"--out {folder} is a file; give a folder")
        self.recording = self.folder / RECORDING
        plan, model = self.folder / PLAN, self.recording / _MODEL
        earlier = read_plan(plan)
        if plan.exists() and earlier is None:
            raise InvalidSetting(
                f"--out {folder} holds a {PLAN} that is none of ours; give another"
            )
        if not plan.exists() and not _same(model, model_xml):
            mine = [RECORDING, PAGE, *sorted(_usual_files())]
            there = [name for name in mine if (self.folder / name).exists()]
            if there:
                raise InvalidSetting(
                    f"--out {folder} holds {', '.join(there)}, which would be overwritten, and no "
                    f"{PLAN}; give a new or empty folder, or that of an earlier plan"
                )
        self.signals = own_files(earlier or {})
        """Files of signals that an earlier plan lists as its own."""
        self.measured: tuple[RunEntry, ...] = ()
        if (self.recording / DESCRIPTION).exists():
            if not _same(model, model_xml):
                raise InvalidData(
                    f"{self.recording}: the recording there was planned with another model, tool "
                    "or payload; give another --out, or the model and the options of before"
                )
            entries = read_description(self.recording / DESCRIPTION).runs
            self.measured = tuple(e for e in entries if (self.recording / e.file).is_file())

    @property
    def first(self) -> RunEntry | None:
        """First run of the session; None before it is measured."""
        return next((e for e in self.measured if e.condition == "suspect" and e.pose), None)

    @property
    def keeps_first(self) -> bool:
        """True if the signal of the session's first run is there."""
        return self.first is not None and any(
            name.startswith(FIRST) and (self.folder / name).exists() for name in self.signals
        )

    def runs_of(self, plan: Plan) -> tuple[PlannedRun, ...]:
        """Runs that a plan asks for, in order."""
        return planned_runs(plan, self.first, self.next_names, first_signal=self.keeps_first)

    def next_names(self, count: int, kind: str = "run") -> tuple[str, ...]:
        """Files for the runs to come, each with the number after the last one measured.

        Parameters
        ----------
        count : int
            Number of files.
        kind : {"run", "repeat", "reference"}
            Kind of the runs, with which the names begin.
        """
        taken = {Path(entry.file).stem for entry in self.measured}
        names: list[str] = []
        number = 1
        while len(names) < count:
            stem = f"{kind}-{number:02d}"
            if stem not in taken:
                names.append(f"{stem}.csv")
            number += 1
        return tuple(names)


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
    names = {stem + ENDINGS[f] for stem, (fs, _) in tables.items() for f in fs}
    kept = {name for name in files.signals if name.startswith(FIRST) and files.first is not None}
    _refuse_others(files, names)
    written: list[Path] = []
    (files.folder / PLAN).unlink(missing_ok=True)
    (files.folder / PAGE).unlink(missing_ok=True)  # an earlier pose beside a new signal
    for old in files.signals - names - kept:
        (files.folder / old).unlink(missing_ok=True)
    # First: a run cut short is known by it as one of ours.
    write_text(files.recording / _MODEL, plan.arm.recording_model.xml)
    entries = [_entry(entry) for entry in files.measured]
    entries += [one.entry for one in planned]
    description = {"format": RECORDING_FORMAT, "model": _MODEL, "runs": entries}
    written.append(
        write_text(files.recording / DESCRIPTION, json.dumps(description, indent=1) + "\n")
    )
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
        "limits": {
            quantity: {
                name: {
                    "limit": value if np.isfinite(value) else None,
                    "source": source or None,
                }
                for name, value, source in zip(
                    arm.joints,
                    plan.limits.values[quantity],
                    plan.limits.sources[quantity],
                    strict=True,
                )
            }
            for quantity in QUANTITIES
        },
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


def _entry(entry: RunEntry) -> dict[str, Any]:
    said: dict[str, Any] = {"file": entry.file}
    if entry.excited:
        said["excited"] = list(entry.excited)
    if entry.pose is not None:
        said["pose"] = dict(entry.pose)
    if entry.condition != "suspect":
        said["condition"] = entry.condition
    return said


def _same(model: Path, text: str) -> bool:
    """True if a model was written by a plan for the same model."""
    try:
        return model.read_text("utf-8") == text
    except (OSError, UnicodeDecodeError):
        return False


def _usual_files() -> frozenset[str]:
    """Files that every plan may write."""
    return frozenset(s + e for s in ("signal", TRANSIT, FIRST) for e in ENDINGS.values())


def _refuse_others(files: PlanFiles, names: set[str]) -> None:
    """Refuse to overwrite files that no plan wrote."""
    # Those of a plan that was cut short are known by its recording.
    ours = files.signals if (files.folder / PLAN).exists() else files.signals | _usual_files()
    there = [n for n in sorted(names - ours) if (files.folder / n).exists()]
    if there:
        raise InvalidSetting(
            f"--out {files.folder} holds {', '.join(there)}, which would be overwritten, and no "
            "plan lists it; move it away, or give another folder"
        )


def read_plan(path: Path) -> dict[str, Any] | None:
    """Content of a plan; None where there is none, or it is none of the format."""
    try:
        whole = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return whole if isinstance(whole, dict) and whole.get("format") == FORMAT else None
