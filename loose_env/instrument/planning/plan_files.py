"""Files of a plan: ``plan.json``, signal, and empty recording.

``DIR/recording`` is a recording in the making: its model has every actuator and sensor that runs
can name, its ``recording.json`` lists the runs measured so far and the ones planned now. Put the
measured run there under the name given, and the folder reads as a recording.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.planning.plan import Plan
from loose_env.instrument.planning.signals.signal import Signal
from loose_env.io import plain, write_text, written_beside
from loose_env.recording import DESCRIPTION, RunEntry, read_description, write_csv, write_parquet
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
    "signal_stems",
    "write_plan",
]


FORMAT = "loose-plan/1"
"""Format of ``plan.json``."""
PLAN = "plan.json"
PAGE = "plan.html"
RECORDING = "recording"
_MODEL = "model.xml"
_ENDINGS = (".csv", ".parquet")
_SIGNAL = re.compile(r"signal(-[1-9]\d*)?\.(csv|parquet)")


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
            mine = [RECORDING, PAGE, "signal.csv", "signal.parquet"]
            there = [name for name in mine if (self.folder / name).exists()]
            if there:
                raise InvalidSetting(
                    f"--out {folder} holds {', '.join(there)}, which would be overwritten, and no "
                    f"{PLAN}; give a new or empty folder, or that of an earlier plan"
                )
        self.signals = _signals_of(earlier or {})
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

    def next_names(self, count: int) -> tuple[str, ...]:
        """Files for the runs to come, each with the number after the last one measured."""
        taken = {Path(entry.file).stem for entry in self.measured}
        names: list[str] = []
        number = 1
        while len(names) < count:
            stem = f"run-{number:02d}"
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
    runs = files.next_names(len(plan.signals))
    stems = signal_stems(plan.signals)
    _refuse_others(files, stems)
    written: list[Path] = []
    (files.folder / PLAN).unlink(missing_ok=True)
    (files.folder / PAGE).unlink(missing_ok=True)  # an earlier pose beside a new signal
    for old in files.signals:
        if Path(old).stem not in stems:
            (files.folder / old).unlink(missing_ok=True)
    # First: a run cut short is known by it as one of ours.
    write_text(files.recording / _MODEL, plan.arm.recording_model.xml)
    entries = [_entry(entry) for entry in files.measured]
    entries += [
        {"file": run, "excited": [signal.joint], "pose": dict(plan.next.pose)}
        for run, signal in zip(runs, plan.signals, strict=True)
    ]
    description = {"format": RECORDING_FORMAT, "model": _MODEL, "runs": entries}
    written.append(
        write_text(files.recording / DESCRIPTION, json.dumps(description, indent=1) + "\n")
    )
    for signal, stem in zip(plan.signals, stems, strict=True):
        columns = signal_columns(signal)
        for ending, write in ((".csv", write_csv), (".parquet", write_parquet)):
            path = files.folder / f"{stem}{ending}"
            written.append(written_beside(path, partial(_table, write, columns)))
    text = json.dumps(plan_json(plan, runs, known), indent=1, ensure_ascii=False, allow_nan=False)
    return [write_text(files.folder / PLAN, text + "\n"), *written]


def signal_stems(signals: Sequence[Signal]) -> tuple[str, ...]:
    """Names of the signals' files without their endings."""
    return tuple("signal" if k == 1 else f"signal-{k}" for k in range(1, len(signals) + 1))


def signal_columns(signal: Signal) -> dict[str, Array]:
    """Columns of a signal: time, and the command of every actuator."""
    return {"time": signal.time, **{f"ctrl.{a}": u for a, u in signal.commands.items()}}


def run_columns(plan: Plan) -> tuple[str, ...]:
    """Columns that a measured run should have."""
    made = plan.arm.recording_model
    return (
        "time",
        *(f"ctrl.{name}" for name in plan.signals[0].commands),
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
    signals = []
    for signal, run, stem in zip(plan.signals, runs, signal_stems(plan.signals), strict=True):
        j = arm.joints.index(signal.joint)
        drive = arm.drives[j]
        assert drive is not None
        signals.append(
            {
                "joint": signal.joint,
                "actuator": drive.actuator,
                "command": "position" if drive.servo else "torque",
                "csv": f"{stem}.csv",
                "parquet": f"{stem}.parquet",
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
        "expected": {name: asdict(one) for name, one in plan.expected.items()},
        "recording": RECORDING,
        "columns": list(run_columns(plan)),
        "warnings": list(plan.warnings),
        "settings": dict(plan.settings),
    }
    values: dict[str, Any] = plain(whole)
    return values


def _table(write: Any, columns: Mapping[str, Array], path: Path) -> None:
    write(path, columns)


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


def _refuse_others(files: PlanFiles, stems: Sequence[str]) -> None:
    """Refuse to overwrite files that no plan wrote."""
    names = [f"{stem}{ending}" for stem in stems[1:] for ending in _ENDINGS]
    there = [n for n in names if n not in files.signals and (files.folder / n).exists()]
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


def _signals_of(whole: Mapping[str, Any]) -> frozenset[str]:
    """Checked names of a plan's signals: the file may have been edited."""
    signals = whole.get("signals")
    listed = [one for one in signals if isinstance(one, dict)] if isinstance(signals, list) else []
    names = (str(one.get(key)) for one in listed for key in ("csv", "parquet"))
    return frozenset(name for name in names if _SIGNAL.fullmatch(name))
