"""The pose cases of Experiments Five and Six: VERA on the shaker, measured many times over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from loose_env.arms import Arm
from loose_env.excitation import Excitation
from loose_env.faults import Backlash, Fault, Healthy
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.sensors import Accelerometer, SensorSuite
from loose_env.statistics import (
    axial_difference,
    axial_mean,
    lowest_correlation_direction,
    maximum_correlation,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.rigs.shaken_vera import PROXIMAL, SHAKEN_BAND, shaken_vera
from loose_env.thesis.rigs.slide import finger_tight, loosened
from loose_env.typing import Array

RATE = 2000.0
"""Rate at which the tape is digitised [Hz]."""
RECORDS = 24
"""Records of every case; the thesis had one."""
DURATION = 1.2
"""Length of a record [s], as in tables 6.1 and 6.2."""
FORCE = 20.0
"""Rms force of the shaker [N]: the healthy tool then peaks at 2 to 3 g (table 6.1)."""

LOOSE_DIRECTION = np.radians(-15.0)
"""Direction of the looseness joint, from the long axis of link 2 [rad]."""
PLAY_DIRECTION = np.pi / 2
"""Direction in which play in joint 2 moves the tool, from the long axis of link 2 [rad]."""
_ALONG = (float(np.cos(LOOSE_DIRECTION)), float(np.sin(LOOSE_DIRECTION)), 0.0)

STATES: Mapping[str, tuple[Fault, str]] = {
    "high preload": (Healthy(), "engaged"),
    "low preload": (finger_tight(link=2, direction=_ALONG), "engaged"),
    "looseness": (loosened(link=2, direction=_ALONG), "engaged"),
    "pin half released": (Healthy(), "half_released"),
    "backlash": (
        Backlash(joint=2, gap=2e-3, stiffness=(2e4, 1e4), damping=(3.0, 2.0), friction=0.02),
        "engaged",
    ),
}
"""States of the rig: what is seated, and how the pin is; the same figures in all poses. A turn of
2 mrad at the pin is the same gap as the looseness joint's."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """A statistic over the records of a case."""

    mean: float
    """Mean over the records (axial for directions)."""
    low: float
    """Lower end of the interval that holds 95 % of single records."""
    high: float
    """Its upper end."""

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Spread of plain numbers."""
        low, high = np.quantile(values, [0.025, 0.975])
        return cls(mean=float(np.mean(values)), low=float(low), high=float(high))

    @classmethod
    def of_axes(cls, angles: Sequence[float]) -> Spread:
        """Spread of directions [rad]; the ends may leave the half turn to stay in order."""
        centre = axial_mean(np.array(angles))
        low, high = np.quantile(axial_difference(np.array(angles), centre), [0.025, 0.975])
        return cls(mean=float(centre), low=float(centre + low), high=float(centre + high))


@dataclass(frozen=True, kw_only=True, eq=False)
class CaseStatistics:
    """One pose in one state, over all its records."""

    theta2: float
    """Angle of joint 2 [rad]."""
    state: str
    """Key of `STATES`."""
    measurements: tuple[Measurement, ...]
    """The records."""

    @property
    def pairs(self) -> list[tuple[Array, Array]]:
        """Acceleration of link 1 (N,) and of the tool (2, N), a pair for every record."""
        return [(m.probes[PROXIMAL][1], m.tool) for m in self.measurements]

    @property
    def lowest(self) -> Spread:
        """Direction of lowest correlation from the tool's x axis [rad] (the thesis's φ)."""
        return Spread.of_axes([lowest_correlation_direction(x, a) for x, a in self.pairs])

    @property
    def maximum(self) -> Spread:
        """Maximum correlation over directions (the thesis's C)."""
        return Spread.of([maximum_correlation(x, a).value for x, a in self.pairs])


Cases = Mapping[str, Sequence[CaseStatistics]]
"""Cases of every state, in the order of the poses."""


def poses() -> tuple[float, ...]:
    """Angles of joint 2 in the five pose cases [rad]."""
    return tuple(float(np.radians(t)) for t in printed("tables")["theta2_deg"])


def printed_healthy() -> list[tuple[float, float, float]]:
    """Printed healthy cases: angle of joint 2, direction from the x axis [rad], magnitude."""
    table = printed("tables")
    return [
        (theta2, float(np.radians(case["lowest_high_preload_deg"] + 90)), c)
        for theta2, case, c in zip(
            poses(), table["looseness_cases"], table["table_6_4"]["c_n"], strict=True
        )
    ]


def from_y(angle: float) -> float:
    """Turn an angle from the tool's x axis [rad] into the thesis's, from its y axis [deg].

    Examples
    --------
    >>> round(from_y(np.radians(-15.0)))
    75
    """
    return float((np.degrees(angle) - 90.0) % 180.0)


@lru_cache(maxsize=4)
def measured_cases(
    seed: int, states: tuple[str, ...], *, records: int = RECORDS
) -> dict[str, list[CaseStatistics]]:
    """Measure every pose in every state.

    ``states``: keys of `STATES`. ``records``: records of every case; the first ones are the same
    for any number. Returns for every state, its cases in the order of `poses`.
    """
    return {state: _measure(state, seed, records) for state in states}


def _measure(state: str, seed: int, records: int) -> list[CaseStatistics]:
    fault, pin = STATES[state]
    arm: Arm = shaken_vera(pin=pin)  # type: ignore[arg-type]
    angles = poses()
    rig = SimulatedRig(
        arm,
        slots=len(angles) * records,
        sensors=SensorSuite(rate=RATE, accelerometer=Accelerometer(bandwidth=0.45 * RATE)),
    )
    shake = Excitation(torque_rms=(0.0, 0.0), duration=DURATION, band=SHAKEN_BAND, shaker_rms=FORCE)
    jobs = []
    for slot in range(rig.slots):
        rig.mount(slot, fault)
        pose, record = divmod(slot, records)
        rng = np.random.default_rng([seed, list(STATES).index(state), pose, record])
        jobs.append(Job(slot=slot, pose=np.array([0.0, angles[pose]]), excitation=shake, rng=rng))
    measured = rig.measure_many(jobs)
    return [
        CaseStatistics(
            theta2=theta2,
            state=state,
            measurements=tuple(
                m for m in measured[k * records : (k + 1) * records] if m.failure is None
            ),
        )
        for k, theta2 in enumerate(angles)
    ]
