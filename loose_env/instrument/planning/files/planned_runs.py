"""Runs that a plan asks for: of the new pose, repeats of the first run, healthy references."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from loose_env.instrument.planning.files.signal_files import FIRST, signal_stems
from loose_env.instrument.planning.plan import Plan
from loose_env.recording import RunEntry

RunKind = Literal["run", "repeat", "reference"]

_REASONS: Mapping[RunKind, str] = {
    "run": "",
    "repeat": "the same as the session's first run: what differs is drift and scatter",
    "reference": "the same on the healthy machine: faults are then found by the difference of two "
    "measurements, without the errors of the model",
}


@dataclass(frozen=True, kw_only=True)
class PlannedRun:
    """Run to be measured."""

    kind: RunKind
    """A run of the new pose, a repeat of the first run, or a reference."""
    file: str
    """Its file in the recording."""
    signal: str
    """Stem of the signal that it plays, or the direction of the force on the tool."""
    joint: str
    """Joint that is shaken; "" where the tool is struck or shaken."""
    pose: Mapping[str, float]
    """Positions of the joints [rad or m]."""

    @property
    def entry(self) -> dict[str, Any]:
        """Its entry in ``recording.json``; repeats and references may be missing there."""
        said: dict[str, Any] = {"file": self.file}
        if self.joint:
            said["excited"] = [self.joint]
        said["pose"] = dict(self.pose)
        if self.kind == "reference":
            said["condition"] = "healthy"
        if self.kind != "run":
            said["planned"] = True
        return said

    @property
    def listed(self) -> dict[str, Any]:
        """Its entry in ``plan.json``."""
        return {
            "kind": self.kind,
            "run": self.file,
            "signal": self.signal,
            "joint": self.joint,
            "pose": dict(self.pose),
            "condition": "healthy" if self.kind == "reference" else "suspect",
            "reason": _REASONS[self.kind],
        }


def planned_runs(
    plan: Plan,
    first: RunEntry | None,
    names: Callable[[int, str], tuple[str, ...]],
    *,
    first_signal: bool = True,
) -> tuple[PlannedRun, ...]:
    """Runs of a plan in the order in which they are measured."""
    stems = signal_stems(plan.signals)
    pose = dict(plan.next.pose)
    found: list[PlannedRun] = []
    kinds: list[RunKind] = ["run"]
    if plan.settings.get("reference"):
        kinds.append("reference")
    for kind in kinds:
        files = names(len(plan.signals), kind)
        for file, stem, signal in zip(files, stems, plan.signals, strict=True):
            found.append(
                PlannedRun(kind=kind, file=file, signal=stem, joint=signal.joint, pose=pose)
            )
    count = int(plan.settings.get("repeat", 0))
    if first is not None and not (first_signal and first.excited):
        count = 0
    for file in names(count, "repeat"):
        found.append(
            PlannedRun(
                kind="repeat",
                file=file,
                signal=FIRST,
                joint=plan.signals[0].joint if first is None else first.excited[0],
                pose=pose if first is None else dict(first.pose or {}),
            )
        )
    order = {"run": 0, "repeat": 1, "reference": 2}
    return tuple(sorted(found, key=lambda one: order[one.kind]))
