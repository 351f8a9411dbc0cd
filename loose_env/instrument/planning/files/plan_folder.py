"""Folder of a plan: names, measured runs, recording to be filled; a plan read back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.model.motion_limits import QUANTITIES, MotionLimits
from loose_env.instrument.planning.files.planned_runs import PlannedRun, planned_runs
from loose_env.instrument.planning.files.signal_files import ENDINGS, FIRST, TRANSIT, own_files
from loose_env.instrument.planning.plan import Plan
from loose_env.io import write_text
from loose_env.recording import DESCRIPTION, RunEntry, read_description
from loose_env.recording import FORMAT as RECORDING_FORMAT
from loose_env.typing import Array

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
                    f"{self.recording}: the recording there was planned with another model, tool, "
                    "payload or excitation; give another --out, or the model and options of before"
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

    def make_room(
        self, tables: Mapping[str, tuple[Sequence[str], Mapping[str, Array]]]
    ) -> tuple[set[str], set[str]]:
        """Remove what an earlier plan wrote and this one does not, its ``plan.json`` first.

        Parameters
        ----------
        tables : mapping
            Stem of each file -> its formats and columns.

        Returns
        -------
        set of str
            Files to be written.
        set of str
            Files of the session's first run, which stay.

        Raises
        ------
        InvalidSetting
            If one of them would take the place of a file that no plan wrote.
        """
        names = {stem + ENDINGS[f] for stem, (formats, _) in tables.items() for f in formats}
        kept = {name for name in self.signals if name.startswith(FIRST) and self.first is not None}
        # Those of a plan that was cut short are known by its recording.
        ours = self.signals if (self.folder / PLAN).exists() else self.signals | _usual_files()
        there = [n for n in sorted(names - ours) if (self.folder / n).exists()]
        if there:
            raise InvalidSetting(
                f"--out {self.folder} holds {', '.join(there)}, which would be overwritten, and no "
                "plan lists it; move it away, or give another folder"
            )
        (self.folder / PLAN).unlink(missing_ok=True)
        (self.folder / PAGE).unlink(missing_ok=True)  # an earlier pose beside a new signal
        for old in self.signals - names - kept:
            (self.folder / old).unlink(missing_ok=True)
        return names, kept


def write_description(files: PlanFiles, model_xml: str, planned: Sequence[PlannedRun]) -> Path:
    """Write the recording's model and its list of runs, measured and planned."""
    # The model first: a run cut short is known by it as one of ours.
    write_text(files.recording / _MODEL, model_xml)
    entries = [_entry(entry) for entry in files.measured]
    entries += [one.entry for one in planned]
    description = {"format": RECORDING_FORMAT, "model": _MODEL, "runs": entries}
    return write_text(files.recording / DESCRIPTION, json.dumps(description, indent=1) + "\n")


def limits_json(arm: InstrumentedArm, limits: MotionLimits) -> dict[str, Any]:
    """Limits by quantity and joint, each with its source; None for none."""
    return {
        quantity: {
            name: {"limit": value if np.isfinite(value) else None, "source": source or None}
            for name, value, source in zip(
                arm.joints, limits.values[quantity], limits.sources[quantity], strict=True
            )
        }
        for quantity in QUANTITIES
    }


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


def read_plan(path: Path) -> dict[str, Any] | None:
    """Content of a plan; None where there is none, or a JSON file of another format."""
    try:
        whole = json.loads(path.read_text("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InvalidData(f"{path}: the plan cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise InvalidData(
            f"{path}: the plan is damaged, no JSON: {' '.join(str(error).split())}; its limits are "
            "not known: bring it back, or delete it and make the plan anew"
        ) from None
    return whole if isinstance(whole, dict) and whole.get("format") == FORMAT else None
