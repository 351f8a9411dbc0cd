"""Measure-and-diagnose loop with a robot or simulation (find_fault), until a fault is identified.

Any object with ``measure(pose, excitation)`` is a rig. It takes the arm to the pose, plays the
excitation, and returns what was recorded: a `loose_env.recording.Run` with the columns of the
recording format, or a `loose_env.rig.Measurement`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import Excitation
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.result import Diagnosis, NextMeasurement
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.recording import Run
from loose_env.rig import Measurement
from loose_env.typing import Array


class RecordingRig(Protocol):
    """Source of recordings: a robot with its recorder, a simulation, a recording."""

    def measure(self, pose: Array, excitation: Excitation) -> Run | Measurement:
        """Take the arm to a pose, play the excitation, and return what was recorded."""
        ...


class Session:
    """Diagnosis of one arm, updated by each measurement."""

    def __init__(
        self,
        model: str | Path,
        settings: DiagnoseSettings | None = None,
        motion: MotionSettings | None = None,
    ) -> None:
        self.settings = DiagnoseSettings() if settings is None else settings
        self._bench = Workbench(Path(model), self.settings, motion)
        self._last: Diagnosis | None = None
        self._count = 0

    @property
    def arm(self) -> InstrumentedArm:
        """The arm of the model."""
        return self._bench.arm

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints in the order of poses and excitations, base first."""
        return self._bench.arm.joints

    def next(self) -> NextMeasurement | None:
        """Next measurement; None where the fault is identified, or no pose will do."""
        if self._last is None:
            self._last = self._bench.diagnosis()
        return self._last.next

    def add(self, measurement: Run | Measurement) -> Diagnosis:
        """Add a measurement and update the diagnosis.

        A run whose name another one has is listed with the number of the measurement behind it.
        """
        self._count += 1
        run = measurement
        if isinstance(measurement, Measurement):
            run = run_of(self._bench.arm, measurement, f"run-{self._count:02d}")
        assert isinstance(run, Run)
        run = replace(run, name=self._named(run.name))
        self._bench.add(run)
        self._last = self._bench.diagnosis()
        return self._last

    def _named(self, name: str) -> str:
        """The name of a run, with the number of its measurement where another has it already."""
        taken = {run.name for run in self._bench.runs}
        made, number = name, self._count
        while made in taken:
            made = f"{name}-{number:02d}"
            number += 1
        return made

    def excitation(self, wanted: NextMeasurement, joint: str) -> Excitation:
        """The excitation of one joint of a measurement that `next` asked for."""
        torque = dict(zip(wanted.joints, wanted.torques, strict=True))[joint]
        return Excitation(
            torque_rms=tuple(torque if name == joint else 0.0 for name in self.joints),
            duration=wanted.seconds,
            band=wanted.band_hz,
        )

    def pose(self, wanted: NextMeasurement) -> Array:
        """The pose of a measurement, base first (n,) [rad or m]."""
        return np.array([wanted.pose[name] for name in self.joints])


@dataclass(frozen=True, kw_only=True)
class Found:
    """Outcome of a session."""

    diagnosis: Diagnosis
    measurements: int
    """Runs that were taken."""
    named: bool
    """True if the fault was identified; False where no more runs were allowed or
    no pose would do."""


def find_fault(
    rig: RecordingRig,
    model: str | Path,
    settings: DiagnoseSettings | None = None,
    *,
    motion: MotionSettings | None = None,
    most: int = 12,
    say: Callable[[Diagnosis], None] = lambda _: None,
) -> Found:
    """Measure and diagnose in turn until the fault is identified.

    Parameters
    ----------
    rig : RecordingRig
        Rig that measures.
    model : str or Path
        MJCF file of the nominal model.
    settings : DiagnoseSettings, optional
        Prior knowledge.
    motion : MotionSettings, optional
        Limits of the controller that measurements keep to; none by default.
    most : int
        Most runs that are taken.
    say : callable
        Told every diagnosis on the way.

    Returns
    -------
    Found

    Raises
    ------
    InvalidSetting
        If ``most`` is below one.
    InvalidData
        If a measurement cannot be used.
    """
    if most < 1:
        raise InvalidSetting(f"most is a number of runs, one or more, got {most!r}")
    session = Session(model, settings, motion)
    wanted = session.next()
    found, count = None, 0
    while wanted is not None and count < most:
        for joint in wanted.joints:
            run = rig.measure(session.pose(wanted), session.excitation(wanted, joint))
            found, count = session.add(run), count + 1
            say(found)
            if found.next is None or count >= most:
                break
        assert found is not None
        wanted = found.next
    if found is None:
        raise InvalidData("nothing could be measured: no pose of this arm tells anything")
    return Found(diagnosis=found, measurements=count, named=found.settled)


def run_of(arm: InstrumentedArm, measurement: Measurement, name: str) -> Run:
    """A measurement of a rig as a run of a recording."""
    if measurement.failure is not None:
        raise InvalidData(f"{name}: the measurement failed: {measurement.failure}")
    if len(measurement.pose) != arm.n or len(measurement.tool) != 3:
        raise InvalidData(
            f"{name}: the model has {arm.n} joints and an accelerometer of three axes; the "
            f"measurement has {len(measurement.pose)} and {len(measurement.tool)}"
        )
    tool = next(r.sensor for r in arm.readings if r.kind == "acceleration" and r.at == 0)
    sensors: dict[str, Array] = {tool: measurement.tool.T}
    for reading in arm.readings:
        if reading.kind == "position":
            sensors[reading.sensor] = measurement.encoder[reading.at, 1:-1]
    samples = measurement.tool.shape[1]
    on = np.flatnonzero(measurement.excited)
    return Run(
        name=name,
        time=np.arange(samples) / measurement.rate,
        sensors=sensors,
        torques={arm.joints[j]: measurement.command[j] for j in on},
        excited=tuple(arm.joints[j] for j in on),
        pose=arm.by_joint(measurement.pose),
    )
