"""The correlation loop: how well the tool follows the shaken joints, direction by direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.diagnosis import Prediction
from loose_env.rig import Measurement
from loose_env.statistics import (
    Covariances,
    acceleration_from_angle,
    axial_angle,
    bandpass,
    correlation_loop_from,
    covariances,
    lowest_coherence_direction_from,
)
from loose_env.typing import Array

__all__ = ["Loop", "LoopPair", "loop_of", "measured_loop", "predicted_loop", "record_of"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The correlation loop of one record, in the plane of the tool."""

    points: Array
    """r(phi) along every direction phi of the tool frame [1] (K, 2)."""
    lowest: Array
    """Direction of lowest correlation, tool frame, unit vector (2,)."""
    maximum: float
    """Highest correlation over directions [1]."""
    peak: Array
    """Covariance with the excitation: the side to which the loop lies (2,)."""

    def facing(self, other: Loop) -> Loop:
        """Turn the loop to the same side as another one."""
        if self.peak @ other.peak >= 0:
            return self
        return Loop(points=-self.points, lowest=self.lowest, maximum=self.maximum, peak=-self.peak)


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopPair:
    """What a record shows, and what it would show on the healthy arm."""

    measured: Loop
    healthy: Loop


def loop_of(cov: Covariances) -> Loop:
    """Trace the loop of a record with one or several shaken joints.

    Of several joints, the sum that correlates highest with the tool counts: the first
    canonical variate. It is uncorrelated with the tool along the direction of lowest
    coherence, so the loop has its notch there.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> loop = loop_of(covariances(x, a))
    >>> loop.lowest.tolist(), loop.maximum
    ([0.0, 1.0], 1.0)
    """
    lowest = lowest_coherence_direction_from(cov)
    # The canonical directions of the tool are perpendicular under its covariance.
    across = cov.aa @ lowest.direction
    weights = np.linalg.solve(cov.xx, cov.xa @ np.array([across[1], -across[0]]))
    # The sign of a sum is free: take the one in which most of it counts upwards.
    if np.sum(weights * np.sqrt(np.diag(cov.xx))) < 0:
        weights = -weights
    one = Covariances(
        xx=np.array([[weights @ cov.xx @ weights]]),
        xa=(weights @ cov.xa)[None],
        aa=cov.aa,
        count=cov.count,
    )
    # Close to the notch the correlation turns fast, so the angles crowd there.
    near = np.geomspace(1e-5, 0.1, 60)
    turn = np.unique(np.concatenate([np.linspace(0.0, np.pi, 361), near, np.pi - near]))
    angles = axial_angle(lowest.direction) + turn
    radius = correlation_loop_from(one, angles)
    return Loop(
        points=radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1),
        lowest=lowest.direction,
        maximum=float(np.sqrt(lowest.coherences.max())),
        peak=one.xa[0],
    )


def record_of(measurement: Measurement) -> tuple[Array, Array]:
    """Accelerations of the shaken joints (m, N) and of the tool (d, N), in the band."""
    on = np.flatnonzero(measurement.excited)
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[on], rate, band)
    return joint, bandpass(measurement.tool, rate, band)


def measured_loop(measurement: Measurement) -> Loop:
    """Trace the loop of a measurement in the plane."""
    return loop_of(covariances(*record_of(measurement)))


def predicted_loop(prediction: Prediction) -> Loop:
    """Trace the loop that the nominal, healthy arm would show."""
    return loop_of(
        Covariances(xx=prediction.joint, xa=prediction.joint_tool, aa=prediction.tool, count=0)
    )
