"""Link finding by turns of direction: tests, next poses, shape of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from loose_env.arms import LinearArm, LinearPose
from loose_env.diagnosis.prediction import RecordStatistics, SensorFloor, predict
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation
from loose_env.io import Checked, Count, NonNegative, NonNegativeCount
from loose_env.statistics import ComparativeIndex, axial_difference, comparative_index
from loose_env.typing import Array

Order = Literal["outward", "inward", "bisection"]
Finding = Literal["still", "turned", "unclear"]


@dataclass(frozen=True, kw_only=True)
class LinkFindingSettings(Checked):
    """Thresholds and excitation of the method; the thesis prints no thresholds."""

    order: Order = "outward"
    """Order of the joints: from the base out, from the tool in, or halving."""
    joint: Count = 1
    """Joint that is excited, from 1."""
    level: Count = 3
    """Excitation level, from 1."""
    still: NonNegative = 0.35
    """Threshold e_min on abs(z*): below it the direction stayed (step 6)."""
    turned: NonNegative = 0.35
    """Threshold e_max on abs(abs(z*) - 1): below it the direction turned (step 7)."""
    retries: NonNegativeCount = 1
    """Further moves of one joint when neither threshold decides (step 8)."""
    index: Literal["d", "e"] = "d"
    """Comparative index that is asked about healthy: D (6.18) or E (6.17)."""
    healthy_index: NonNegative = 0.01
    """Comparative index up to which the arm looks healthy."""
    healthy_poses: Count = 2
    """Poses that must look healthy before the verdict healthy."""
    backlash_angle: NonNegative = 20.0
    """Rms angle to a joint's own line up to which play in that joint explains it [deg]."""
    backlash_kurtosis: float = 0.5
    """Excess kurtosis along that line above which the motion is not normal."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """Direction of looseness in one record, in the plane."""

    pose: Array
    """Pose [rad] (n,)."""
    direction: float
    """Direction of lowest correlation in the tool frame [rad], axial."""
    correlation: float
    """Maximum correlation [1]."""
    kurtosis: float
    """Excess kurtosis along the direction [1]."""
    nominal_direction: float
    """Direction of lowest correlation of the nominal healthy arm [rad], axial."""
    nominal_correlation: float
    """Maximum correlation of the nominal healthy arm [1]."""

    @property
    def index(self) -> ComparativeIndex:
        """Comparative index against the nominal healthy arm (6.15 to 6.18)."""
        return comparative_index(
            self.nominal_correlation, self.nominal_direction, self.correlation, self.direction
        )


def judge_turn(
    before: Sighting, after: Sighting, joint: int, settings: LinkFindingSettings
) -> Finding:
    """Say whether the direction turned when one joint moved (steps 5 to 8 of 4.2.2).

    The axis of the rotation between the directions is z* = (p x p*) / sin(-move) (4.31), in the
    plane a number times the normal: 0 if the direction stayed, 1 if it turned by the whole move. As
    the sign of a direction is unknown, so is that of z*.

    Parameters
    ----------
    before, after : Sighting
        Records in two poses that differ in ``joint`` alone.
    joint : int
        The joint that moved, from 1.
    settings : LinkFindingSettings
        Holds the two thresholds.
    """
    move = np.sin(after.pose[joint - 1] - before.pose[joint - 1])
    if abs(move) < 1e-6:
        return "unclear"
    size = abs(np.sin(after.direction - before.direction) / move)
    if size < settings.still:
        return "still"
    return "turned" if abs(size - 1) < settings.turned else "unclear"


def next_joint(order: Order, low: int, high: int) -> int:
    """Joint to move next while the loose link lies in low..high.

    A move of joint j that turns the direction says that the link is below j; one that leaves
    it says j or above.

    Examples
    --------
    >>> next_joint("outward", 1, 6), next_joint("inward", 1, 6), next_joint("bisection", 1, 6)
    (2, 6, 4)
    """
    if order == "outward":
        return low + 1
    if order == "inward":
        return high
    return (low + high + 1) // 2


def looks_healthy(sightings: Sequence[Sighting], settings: LinkFindingSettings) -> bool:
    """True if the comparative index is below its threshold in every record."""
    values = [s.index.mag_d if settings.index == "d" else s.index.mag_e for s in sightings]
    return max(values) <= settings.healthy_index


def backlash_joint(
    linear: LinearArm, sightings: Sequence[Sighting], settings: LinkFindingSettings
) -> int | None:
    """Joint whose line all directions keep to, with motion that is not normal; None without."""
    if max(s.kurtosis for s in sightings) < settings.backlash_kurtosis:
        return None
    rms = []
    for j in range(linear.arm.n):
        off = []
        for s in sightings:
            line = linear.at(s.pose).kinematic[:, j]
            off.append(axial_difference(s.direction, float(np.arctan2(line[1], line[0]))))
        rms.append(float(np.sqrt(np.mean(np.square(off)))))
    best = int(np.argmin(rms))
    return best + 1 if np.degrees(rms[best]) <= settings.backlash_angle else None


@dataclass(frozen=True, kw_only=True)
class MotionShape:
    """Shape of the tool's motion in a record with one joint driven."""

    across: float
    """Second largest variance over the one of the nominal arm [1]; about 1 on one line."""
    kurtosis: float
    """Largest excess kurtosis along the tool axes [1]; about 0 if normal."""

    def is_play(self, *, across: float = 5.0, kurtosis: float = 0.3) -> bool:
        """Tell whether the motion is one-dimensional and not normal.

        Examples
        --------
        >>> MotionShape(across=1.1, kurtosis=1.5).is_play()
        True
        >>> MotionShape(across=90.0, kurtosis=1.5).is_play()  # a slide beyond the joint
        False
        """
        return self.across <= across and self.kurtosis >= kurtosis


def shape_of_motion(
    record: RecordStatistics, nominal: LinearPose, floor: SensorFloor
) -> MotionShape:
    """Shape of the tool's motion with one joint driven.

    Parameters
    ----------
    record : RecordStatistics
        Record with exactly one joint excited.
    nominal : LinearPose
        The nominal arm in the record's pose.
    floor : SensorFloor
        Noise of the sensors in the arm's band.

    Raises
    ------
    InvalidData
        If not exactly one joint was excited.
    """
    driven = np.flatnonzero(record.excited)
    if len(driven) != 1:
        raise InvalidData(
            "the shape of the motion tells play in one driven joint; joints "
            f"{(driven + 1).tolist()} were excited: excite one alone"
        )
    shake = Excitation(
        torque_rms=tuple(float(t) for t in record.torque),
        duration=record.duration,
        band=nominal.linear.arm.band,
    )
    expected = np.linalg.eigvalsh(predict(nominal, shake, floor).tool)[-2]
    found = np.linalg.eigvalsh(record.tool_covariance)[-2]
    return MotionShape(across=float(found / expected), kurtosis=float(record.kurtosis.max()))
