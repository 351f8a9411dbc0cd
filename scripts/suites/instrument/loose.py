"""`loose plan` and `loose diagnose` as a tool of the suite."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from loose_env.instrument import (
    DiagnoseSettings,
    Evidence,
    Numbers,
    Plan,
    PlanSettings,
    commands_of,
    judge,
    listen,
    plan,
)
from loose_env.recording import Recording, read_recording

LEFT_OUT: Mapping[str, Mapping[str, float]] = {
    "without rhythm": {"samples": 0.0},
    "without direction": {"vectors": 0.0},
    "without top band": {"top_db": -999.0},
    "without softness": {"softer": 0.0},
}
"""Variant -> numbers changed."""


class Loose:
    """The instrument as a user calls it, and variants with a part left out."""

    variants = (
        *LEFT_OUT,
        *(f"{field.name} x{k}" for field in dataclasses.fields(Numbers) for k in ("0.5", "2")),
    )
    changed: ClassVar[Mapping[str, Any]] = {}
    """Settings of the plan that are not the defaults."""

    def plan(self, folder: Path) -> dict[str, Any]:
        """Poses and commands of a session."""
        made, arm = _planned(folder, self.changed)
        runs = []
        for run in made.runs:
            _, played = commands_of(made, arm, run)
            pose = [run.pose[joint] for joint in arm.joints]
            name = Path(run.file).stem
            runs.append({"name": name, "pose": pose, "command": played, "level": run.level})
        return {"rate_hz": made.settings.limits.rate_hz, "runs": runs}

    def diagnose(self, folder: Path, variant: str = "") -> dict[str, Any]:
        """Answer from the recording, and from the reference where there is one."""
        changed = dict(LEFT_OUT.get(variant, {}))
        name, _, times = variant.rpartition(" x")
        if name:
            changed = {name: getattr(Numbers(), name) * float(times)}
        changed["sure"] = min(changed.get("sure", Numbers.sure), 0.99)
        found = judge(_heard(folder, **self.changed), Numbers(**changed))
        return {
            "verdict": found.verdict,
            "settled": found.settled,
            "places": [
                {
                    "kind": place.kind,
                    "at": place.at,
                    "probability": place.probability,
                    "direction": place.direction,
                }
                for place in found.places
            ],
            "tested": {
                place.name: "loose" if place.verdict in ("loose", "suspect") else place.verdict
                for place in found.places
            },
            "remarks": list(found.remarks),
            "remedy": found.remedy,
            "evidence": dict(found.evidence),
        }


class ThreePoses(Loose):
    """The instrument with half of its poses."""

    changed: ClassVar = {"poses": 3}


class NinePoses(Loose):
    """The instrument with half as many poses again."""

    changed: ClassVar = {"poses": 9}


class ThreeLevels(Loose):
    """The instrument at rising levels, until something knocks."""

    changed: ClassVar = {"levels": (0.3, 0.6, 1.0)}

    def enough(self, folder: Path) -> bool:
        """True if the levels played so far show a knock."""
        return bool(self.diagnose(folder)["verdict"] == "loose")


@functools.cache
def _heard(folder: Path, **changed: Any) -> Evidence:
    """Evidence of a session, by which all variants of its decision judge."""
    suspect = read_recording(folder / "recording")
    runs = list(suspect.runs)
    if (folder / "reference").is_dir():
        healthy = read_recording(folder / "reference").runs
        runs += [
            dataclasses.replace(run, condition="healthy", name=f"reference/{run.name}")
            for run in healthy
        ]
    whole = Recording(folder=suspect.folder, model_path=suspect.model_path, runs=tuple(runs))
    return listen(whole, DiagnoseSettings(), plan=_by_name(_planned(folder, changed)[0]))


def _planned(folder: Path, changed: Mapping[str, Any]) -> tuple[Plan, Any]:
    """Plan of a machine, by what its sheet says and what is changed of the defaults."""
    sheet = json.loads((folder / "session.json").read_text("utf-8"))
    own = sheet["controller"]
    hobby = own["rate_hz"] <= 100
    settings = PlanSettings(
        controller="hobby_servo" if hobby else "ur_rtde",
        commands=own["command"],
        rate_hz=min(float(own["rate_hz"]), 1000.0),
        bandwidth_hz=float(own["bandwidth_hz"]),
        max_speed_rad_s=tuple(own["max_speed"]),
        max_acceleration_rad_s2=tuple(own["max_acceleration"]),
        max_torque_nm=tuple(own["max_torque"]),
        low=tuple(own["low"]),
        high=tuple(own["high"]),
        corner_hz=sheet["accelerometer"].get("corner_hz"),
        tool=sheet["accelerometer"]["site"],
        **changed,
    )
    return plan(folder / "model.xml", settings)


def _by_name(made: Plan) -> Plan:
    """Plan whose runs are named as the suite's files."""
    runs = tuple(
        dataclasses.replace(run, file=f"{Path(run.file).stem}.parquet") for run in made.runs
    )
    return dataclasses.replace(made, runs=runs)
