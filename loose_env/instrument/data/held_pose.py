"""Nominal pose and excited joints of a run, or a measured tool force, recorded or estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from loose_env.doctor import POSE_OFFSET, POSE_SPREAD
from loose_env.errors import InvalidData
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.settings.thresholds import EXCITED_SHARE
from loose_env.recording import Run
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class RunSetup:
    """Pose and excited joints of a run."""

    pose: Array
    """Position of each joint, as its sensors have it where there are any (n,) [rad or m]."""
    excited: NDArray[np.intp]
    """Joints that were excited, from 0."""
    notes: tuple[str, ...]
    """Values that had to be derived, in sentences."""

    def shown(self, arm: InstrumentedArm, noted: Mapping[str, float] | None) -> dict[str, float]:
        """Pose by joint: the recorded one where it agrees with the measured pose."""
        found = arm.by_joint(self.pose)
        for joint, q in (noted or {}).items():
            if joint in found and abs(found[joint] - q) <= POSE_OFFSET:
                found[joint] = float(q)
        return found


def run_setup(arm: InstrumentedArm, run: Run) -> RunSetup:
    """Determine the pose and the excited joints of a run."""
    measured = _positions(arm, run)
    noted = run.pose
    notes = []
    missing = [
        joint
        for joint, q in zip(arm.joints, measured, strict=True)
        if q is None and (noted is None or joint not in noted)
    ]
    if missing:
        has = "no 'pose'" if noted is None else "a 'pose' of some joints alone"
        raise InvalidData(
            f"{run.name}: the pose is not known: recording.json has {has} for this run, and no "
            f"position of {', '.join(missing)} was recorded; add "
            f'"pose": {{"{missing[0]}": 0.0, ...}}'
        )
    if noted is None:
        notes.append(f"{run.name}: no 'pose' is noted; taken from the joints' positions")
    base = arm.pose_of({} if noted is None else noted)
    pose = np.array(
        [b if q is None else float(np.nanmean(q)) for b, q in zip(base, measured, strict=True)]
    )
    for joint, q in zip(arm.joints, measured, strict=True):
        if q is not None and float(np.nanstd(q)) > POSE_SPREAD:
            raise InvalidData(
                f"{run.name}: joint {joint} moves by {float(np.nanstd(q)):.2g} rms; a diagnosis "
                "needs runs that hold a pose and shake one joint about it with small noise. For "
                "other motion use 'loose gap'"
            )
    if noted is not None:
        off = [
            f"{joint} by {q - b:.3g}"
            for joint, q, b in zip(arm.joints, pose, base, strict=True)
            if joint in noted and abs(q - b) > POSE_OFFSET
        ]
        if off:
            notes.append(
                f"{run.name}: the noted pose is not the measured one ({', '.join(off)}); the "
                "measured one is used"
            )
    known = [joint for joint in run.excited if joint in arm.joints]
    if run.excited and not known:
        raise InvalidData(
            f"{run.name}: excited are {list(run.excited)}, none of which lies between base and "
            f"tool; those are {list(arm.joints)}"
        )
    if not known and not tool_force_in(arm, run):
        known, source = _shaken(arm, run)
        notes.append(f"{run.name}: no 'excited' is noted; taken from the {source}: {known}")
    excited = np.array(sorted(arm.joints.index(joint) for joint in known), dtype=np.intp)
    return RunSetup(pose=pose, excited=excited, notes=tuple(notes))


def tool_force_in(arm: InstrumentedArm, run: Run) -> bool:
    """True if the force on the tool was measured: nothing else has to excite the arm."""
    return arm.tool_force is not None and arm.tool_force in run.sensors


def _positions(arm: InstrumentedArm, run: Run) -> list[Array | None]:
    found: list[Array | None] = [None] * arm.n
    for reading in arm.readings:
        if reading.kind == "position" and reading.sensor in run.sensors:
            found[reading.at] = run.sensors[reading.sensor]
    return found


def _shaken(arm: InstrumentedArm, run: Run) -> tuple[list[str], str]:
    """Joints whose actuators are excited with noise, and the columns that tell it."""
    power, source = np.zeros(arm.n), "commands"
    drives = arm.actuators
    for a, name in enumerate(drives.names):
        if name in run.controls:
            j = arm.actuators.driven_joint(name)
            power[j] += float(drives.force[j, a]) ** 2 * _wobble(run.controls[name])
    if not power.any():
        source = "torques"
        for j, joint in enumerate(arm.joints):
            if joint in run.torques:
                power[j] = _wobble(run.torques[joint])
    if not power.any():
        source = "positions"
        for j, q in enumerate(_positions(arm, run)):
            power[j] = 0.0 if q is None else _wobble(q)
    if not power.any():
        raise InvalidData(
            f'{run.name}: nothing says which joint was excited: note "excited" in '
            "recording.json, or record the commands"
        )
    return [arm.joints[j] for j in np.flatnonzero(power > EXCITED_SHARE * power.max())], source


def _wobble(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.var(signal.detrend(there))) if len(there) > 1 else 0.0
