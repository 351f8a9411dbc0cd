"""Play in the driven joint, told by the shape of the motion that this joint alone makes (3.4).

With one joint driven a healthy arm moves its tool along one line, and normally if the command is
normal. A loose seat beyond adds motion across that line. If the motion keeps to the line and is no
longer normal, there is play in the driven joint itself.

A real record is never quite one-dimensional: sensors are noisy and links bend. The variance across
the line is therefore held against the one that the nominal arm predicts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.arms import LinearPose
from loose_env.diagnosis.records.prediction import SensorFloor, predict
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation

__all__ = ["MotionShape", "shape_of_motion"]


@dataclass(frozen=True, kw_only=True)
class MotionShape:
    """Shape of the tool's motion in a record with one joint driven."""

    across: float
    """Second largest variance over the one of the nominal arm [1]; about 1 on one line."""
    kurtosis: float
    """Largest excess kurtosis along the tool axes [1]; about 0 if normal."""

    def is_play(self, *, across: float = 5.0, kurtosis: float = 0.3) -> bool:
        """Tell whether the motion is one-dimensional and not normal.

        Parameters
        ----------
        across : float
            Ratio of variances up to which the motion counts as one-dimensional [1].
        kurtosis : float
            Excess kurtosis from which it counts as not normal [1].

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
