"""Move from one pose to another within joint limits, by a fifth-order polynomial in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.model.motion_limits import MotionLimits, Quantity
from loose_env.instrument.planning.signals.motion_peaks import MotionPeak, with_limits
from loose_env.instrument.settings.thresholds import TRANSIT_RISE_S, TRANSIT_SHARE
from loose_env.typing import Array

_PEAKS: Mapping[Quantity, float] = {
    "speed": 15 / 8,
    "acceleration": 10 / np.sqrt(3),
    "jerk": 60.0,
}
"""Largest derivatives of the path x(t) = 10 t³ - 15 t⁴ + 6 t⁵ over the unit time [1]."""
_LEAST_MOVE = 1e-6
"""Move of a joint below which it stands [rad or m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Transit:
    """Move between two poses: every joint by the same polynomial of fifth order."""

    time: Array
    """From its start [s] (T,)."""
    positions: Array
    """Of n joints, base first [rad or m] (T, n)."""
    duration_s: float
    """Length of the move [s]; 0 where the arm is there already."""
    peaks: tuple[MotionPeak, ...]
    """Peaks of each joint that moves, beside their limits."""

    def columns(self, arm: InstrumentedArm) -> dict[str, Array]:
        """Columns of its file, without time: ``position.JOINT`` (T,)."""
        return {f"position.{name}": self.positions[:, i] for i, name in enumerate(arm.joints)}


def transit(
    arm: InstrumentedArm,
    start: Array,
    end: Array,
    limits: MotionLimits,
    rate: float,
    *,
    share: float = TRANSIT_SHARE,
) -> Transit:
    """Plan a straight move of the joints within a share of their limits.

    Where a joint has no acceleration limit, its speed takes `TRANSIT_RISE_S` to rise.
    """
    move = np.abs(end - start)
    move[move < _LEAST_MOVE] = 0.0
    speed = share * limits.values["speed"]
    acceleration = share * limits.values["acceleration"]
    acceleration = np.where(np.isfinite(acceleration), acceleration, speed / TRANSIT_RISE_S)
    most: dict[Quantity, Array] = {
        "speed": speed,
        "acceleration": acceleration,
        "jerk": share * limits.values["jerk"],
    }
    duration = 0.0
    for power, (quantity, peak) in enumerate(_PEAKS.items(), start=1):
        needed = (peak * move / most[quantity]) ** (1 / power)
        duration = max(duration, float(needed.max()))
    steps = int(np.ceil(duration * rate))
    t = np.arange(steps + 1) / max(steps, 1)
    path = t**3 * (10 - 15 * t + 6 * t**2)
    length = steps / rate
    peaks = {
        (int(i), quantity, "joint"): float(peak * move[i] / length**power)
        for power, (quantity, peak) in enumerate(_PEAKS.items(), start=1)
        for i in np.flatnonzero(move)
    }
    return Transit(
        time=np.arange(steps + 1) / rate,
        positions=start + path[:, None] * (end - start),
        duration_s=length,
        peaks=with_limits(arm, peaks, limits),  # type: ignore[arg-type]
    )
