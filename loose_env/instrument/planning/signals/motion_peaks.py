"""Peak speed, acceleration, jerk and torque rate of joints and commands, beside their limits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.model.motion_limits import MotionLimits, Quantity, unit_of
from loose_env.instrument.planning.signals.linear_answer import LinearAnswer
from loose_env.typing import Array

DERIVATIVES: tuple[Quantity, ...] = ("speed", "acceleration", "jerk")
"""Quantities of motion: the first, second and third derivative of a position."""

PeakOf = Literal["joint", "command"]
Peaks = dict[tuple[int, Quantity, PeakOf], float]
"""Joint from 0, quantity, and whose it is -> largest magnitude."""


@dataclass(frozen=True, kw_only=True)
class MotionPeak:
    """Largest value of a quantity in a run."""

    joint: str
    """The model's name."""
    quantity: Quantity
    """Speed, acceleration, jerk or torque rate."""
    of: PeakOf
    """Of the joint, as the model predicts it, or of the command."""
    value: float
    """Largest magnitude [`unit`]."""
    limit: float | None
    """Its limit [`unit`]; None for none."""
    source: str
    """Source of the limit; "" for none."""
    unit: str
    """Unit of both."""

    @property
    def within(self) -> bool:
        """True if the limit is kept."""
        return self.limit is None or self.value <= self.limit * (1 + 1e-9)


def joint_peaks(arm: InstrumentedArm, answer: LinearAnswer, j: int) -> Peaks:
    """Predicted peaks of all joints while joint j is shaken."""
    found: Peaks = {}
    for power, quantity in enumerate(DERIVATIVES, start=1):
        for i, value in enumerate(answer.peak(answer.moved, power)):
            found[i, quantity, "joint"] = float(value)
    rates = answer.peak(answer.drive, 1)
    for i, drive in enumerate(arm.drives):
        if i == j or (drive is not None and drive.servo):
            found[i, "torque rate", "joint"] = float(rates[i])
    return found


def command_peaks(j: int, played: Array, rate: float, *, of_torque: bool) -> Peaks:
    """Peaks of a command of joint j as a controller sees it, by differences of its samples."""
    if of_torque:
        return {(j, "torque rate", "command"): _largest(played, rate, 1)}
    return {
        (j, quantity, "command"): _largest(played, rate, power)
        for power, quantity in enumerate(DERIVATIVES, start=1)
    }


def _largest(values: Array, rate: float, power: int) -> float:
    if len(values) <= power:
        return 0.0
    return float(np.abs(np.diff(values, n=power)).max() * rate**power)


def highest(*several: Peaks) -> Peaks:
    """The largest of several peaks of the same quantity."""
    found: Peaks = {}
    for one in several:
        for key, value in one.items():
            found[key] = max(value, found.get(key, 0.0))
    return found


def with_limits(
    arm: InstrumentedArm, peaks: Peaks, limits: MotionLimits, scale: float = 1.0
) -> tuple[MotionPeak, ...]:
    """Peaks at a scale beside their limits, joints from the base, commands last."""
    found = []
    for (i, quantity, of), value in sorted(peaks.items(), key=_order):
        limit = limits.limit(quantity, i)
        found.append(
            MotionPeak(
                joint=arm.joints[i],
                quantity=quantity,
                of=of,
                value=scale * value,
                limit=limit if np.isfinite(limit) else None,
                source=limits.sources[quantity][i],
                unit=unit_of(quantity, bool(arm.nominal.sliding[i])),
            )
        )
    return tuple(found)


def _order(item: tuple[tuple[int, Quantity, PeakOf], float]) -> tuple[bool, int, int]:
    (joint, quantity, of), _ = item
    ranks: Iterable[Quantity] = (*DERIVATIVES, "torque rate")
    return of == "command", joint, list(ranks).index(quantity)
