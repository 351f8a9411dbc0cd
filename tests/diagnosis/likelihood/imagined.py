"""Records worked out without a simulation: what the linear model says a seat would show."""

from __future__ import annotations

import numpy as np

from loose_env.arms import LinearArm
from loose_env.diagnosis.likelihood.seat_response import predict_seats
from loose_env.diagnosis.records.prediction import SensorFloor
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.excitation import at_levels
from loose_env.sensors import SensorSuite


def imagined_record(
    linear: LinearArm,
    pose: list[float],
    *,
    joint: int,
    link: int = 1,
    direction: list[float] | None = None,
    opening: float = 0.0,
) -> RecordStatistics:
    """Make the record of a link that opens by a share, one joint at the top level."""
    arm = linear.arm
    at, levels = linear.at(pose), np.zeros(arm.n)
    levels[joint - 1] = arm.levels[-1]
    excitation, _ = at_levels(at, levels, duration=1.2)
    torque = np.array(excitation.torque_rms)
    axes = linear.slide_dofs.shape[1]
    u = np.eye(axes)[0] if direction is None else np.array(direction) / np.linalg.norm(direction)
    floor = SensorFloor.of(SensorSuite(), arm.band)
    noise = np.concatenate([floor.joints(arm)[[joint - 1]], np.full(len(arm.axes), floor.tool)])
    seats = predict_seats(at, torque, u[None, :], noise**2)
    k = link - 1
    step = seats.in_step + opening * seats.in_step_open[k]
    rest = seats.rest + opening * seats.rest_mixed[k] + opening**2 * seats.rest_open[k]
    covariance = step @ step.T + rest

    def wide(column: np.ndarray) -> np.ndarray:
        found = np.zeros((*column.shape, arm.n))
        found[..., joint - 1] = column
        return found

    d = len(arm.axes)
    return RecordStatistics(
        pose=np.array(pose),
        torque=torque,
        duration=1.2,
        transmission=wide(covariance[1:, 0] / covariance[0, 0]),
        transmission_by_instrument=wide(step[1:, 0] / step[0, 0]),
        joint_rms=wide(np.sqrt(covariance[0, 0])),
        inertia=wide(torque[joint - 1] / step[0, 0]),
        tool_covariance=covariance[1:, 1:],
        lowest_direction=np.eye(d)[0],
        lowest_coherence=0.0,
        maximum_correlation=1.0,
        skewness=np.zeros(d),
        kurtosis=np.zeros(d),
        lowest_skewness=0.0,
        lowest_kurtosis=0.0,
    )
