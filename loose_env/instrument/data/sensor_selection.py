"""Usable sensors and columns of a run, with notes on those left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.model.readings import Reading
from loose_env.instrument.settings.thresholds import LARGEST_READING
from loose_env.recording import Run


def readings_in(arm: InstrumentedArm, run: Run) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
    """Usable sensors of a run in `InstrumentedArm.readings` order, and notes on the rest.

    A sensor that never changes tells nothing; missing samples (NaN) of one that does are no reason
    to leave it out.
    """
    used, notes = [], []
    for reading in arm.readings:
        if reading.sensor not in run.sensors:
            continue
        if why := _dead(run, reading.sensor):
            notes.append(f"{run.name}: sensor {reading.sensor} is not used: {why}")
        else:
            used.append(reading)
    known = {reading.sensor for reading in arm.readings} | {arm.tool_force}
    others = [name for name in run.sensors if name not in known]
    if others:
        notes.append(
            f"recorded and not used: {', '.join(others)}; a diagnosis takes accelerometers and "
            "gyroscopes on the arm, and positions and velocities of its joints"
        )
    return tuple(used), tuple(notes)


def columns_in(arm: InstrumentedArm, run: Run) -> dict[str, NDArray[np.float64]]:
    """Usable columns (T,) of a run, by the names in its file."""
    found: dict[str, NDArray[np.float64]] = {}
    for reading in readings_in(arm, run)[0]:
        values = np.atleast_2d(run.sensors[reading.sensor].T)
        axes = [f".{axis}" for axis in "xyz"] if len(values) == 3 else [""]
        found |= {f"sensor.{reading.sensor}{a}": v for a, v in zip(axes, values, strict=True)}
    found |= {f"ctrl.{a}": run.controls[a] for a in arm.actuators.names if a in run.controls}
    found |= {f"torque.{j}": run.torques[j] for j in arm.joints if j in run.torques}
    return found


def _dead(run: Run, sensor: str) -> str:
    """Reason why a sensor carries no signal; "" if it does."""
    values = run.sensors[sensor]
    columns = [column[np.isfinite(column)] for column in np.atleast_2d(values.T)]
    largest = max(float(np.abs(column).max(initial=0.0)) for column in columns)
    if largest > LARGEST_READING:
        raise InvalidData(
            f"{run.name}: column 'sensor.{sensor}' reaches {largest:.3g}; no arm does: is it in SI "
            "units?"
        )
    if not any(column.size for column in columns):
        return "none of its samples is a number"
    if not any(column.size and np.ptp(column) > 0 for column in columns):
        return "it stands still"
    return ""
