"""Measurements and the jobs that ask for them; a rig that replays recorded runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import Excitation
from loose_env.recording import Recording, Run
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """Readings of one record in one pose.

    All channels are sampled together at ``rate``. Encoder channels have one sample more at
    either end, so that accelerations can be formed by differences.
    """

    pose: Array
    """Commanded pose [rad] (n,)."""
    excitation: Excitation
    """What was played."""
    rate: float
    """Sampling rate [Hz]."""
    command: Array
    """Random part of the commanded torque [N·m] (n, N)."""
    encoder: Array
    """Encoder readings, motor side [rad] (n, N + 2)."""
    tool: Array
    """Tool accelerometer, tool frame, proper acceleration [m/s²] (d, N)."""
    links: Array | None = None
    """Link accelerometers, link frames [m/s²] (L, d, N); None where there are none.

    One for each of the L links that carry one, base first; d is 1 where they are tangential."""
    probes: Mapping[str, Array] = field(default_factory=dict)
    """Further accelerometers by their site, along its own axes [m/s²] (3, N) each."""
    shaker_force: Array | None = None
    """Commanded force of the shaker [N] (N,); None where there is no shaker."""
    failure: str | None = None
    """Why the record is worthless; None for a good one."""

    @property
    def excited(self) -> NDArray[np.bool_]:
        """Whether each joint was excited (n,)."""
        return np.array(self.excitation.excited)


class Rig(Protocol):
    """Protocol of a rig: a simulated arm, a recording or a real arm."""

    def measure(self, pose: Array, excitation: Excitation) -> Measurement:
        """Move the arm to a pose, apply the excitation, and return the readings."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """One measurement to take."""

    slot: int
    """Which arm of the rig."""
    pose: Array
    """Commanded pose [rad] (n,)."""
    excitation: Excitation
    """What to play."""
    rng: np.random.Generator
    """Source of the excitation, the sensor noise and the seat's place in its gap."""


def check_jobs(arm: Arm, jobs: Sequence[Job]) -> None:
    """Reject jobs that do not match an arm."""
    slots = [job.slot for job in jobs]
    if len(set(slots)) != len(slots):
        raise InvalidSetting(f"each slot can be measured once at a time, got slots {slots}")
    n = arm.n
    for job in jobs:
        if job.pose.shape != (n,) or len(job.excitation.torque_rms) != n:
            raise InvalidSetting(
                f"arm {arm.name!r} needs {n} joint positions and {n} torques, got "
                f"{job.pose.shape} and {len(job.excitation.torque_rms)}"
            )
        if job.excitation.shaker_rms > 0 and arm.shaker is None:
            raise InvalidSetting(
                f"arm {arm.name!r} has no shaker; set shaker_rms to 0 or take an arm "
                "that stands at one"
            )


def whole_factor(rate: float, timestep: float) -> int:
    """Simulation steps per reading."""
    factor = round(1 / (rate * timestep))
    if factor < 1 or abs(factor * rate * timestep - 1) > 1e-6:
        raise InvalidSetting(
            f"the sampling rate {rate:g} Hz must be a whole fraction of the "
            f"simulation's {1 / timestep:g} Hz"
        )
    return factor


_JOINT = 3.0
"""Distance between poses that counts like another joint than the one asked for [rad or m]."""


class RecordedRig:
    """Answers every measurement with the nearest recorded run, each run once.

    Parameters
    ----------
    recording : Recording
        Runs with ``pose`` and ``excited``. Healthy references are not given out.
    joints : sequence of str
        Joints in the order of the poses that will be asked for, base first.

    Raises
    ------
    InvalidData
        If no run has a pose and excited joints.
    """

    def __init__(self, recording: Recording, joints: Sequence[str]) -> None:
        self.joints = tuple(joints)
        self._left = [
            run
            for run in recording.runs
            if run.condition == "suspect" and run.pose is not None and run.excited
        ]
        if not self._left:
            raise InvalidData(
                "the recording has no run of the arm under test with 'pose' and 'excited'; note "
                "both in recording.json"
            )

    @property
    def left(self) -> int:
        """Runs not yet replayed."""
        return len(self._left)

    def measure(self, pose: Array, excitation: Excitation) -> Run:
        """Replay the run nearest in pose with the same excited joint, if there is one.

        Raises
        ------
        InvalidData
            If all runs were given out.
        """
        if not self._left:
            raise InvalidData("all runs of the recording were given out; record more")
        asked = {j for j, on in zip(self.joints, excitation.excited, strict=True) if on}

        def unlike(run: Run) -> float:
            assert run.pose is not None
            there = np.array([run.pose.get(j, q) for j, q in zip(self.joints, pose, strict=True)])
            away = float(np.linalg.norm(there - pose))
            return away + (0.0 if asked & set(run.excited) else _JOINT)

        nearest = min(self._left, key=unlike)
        self._left.remove(nearest)
        return nearest
