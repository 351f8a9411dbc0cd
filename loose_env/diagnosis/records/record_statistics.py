"""The statistics of one record: all that a diagnosis sees of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.rig import Measurement
from loose_env.statistics import (
    acceleration_from_angle,
    apparent_inertia_from,
    bandpass,
    lowest_coherence_direction_from,
    record_covariances,
    shape_of,
    transmission_by_instrument_from,
    transmission_from,
)
from loose_env.typing import Array

__all__ = ["RecordStatistics", "statistics_of"]

_STILL = 1e-12
"""Share of the largest variance, and of a row's mean, taken as rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordStatistics:
    """Second- and higher-order statistics of one record.

    Arrays over joints have n entries; those of joints that were not excited are zero.
    """

    pose: Array
    """Commanded pose [rad] (n,)."""
    torque: Array
    """Rms random torque commanded [N·m] (n,)."""
    duration: float
    """Length of the record [s]."""
    transmission: Array
    """Tool acceleration per measured joint acceleration, in the band [m] (d, n)."""
    transmission_by_instrument: Array
    """The same with the command as instrument [m] (d, n)."""
    joint_rms: Array
    """Rms joint acceleration in the band [rad/s²] (n,)."""
    inertia: Array
    """Apparent inertia: torque per joint acceleration [kg·m²] (n,)."""
    tool_covariance: Array
    """Covariance of the tool acceleration in the band [m²/s⁴] (d, d)."""
    lowest_direction: Array
    """Direction of lowest coherence with the excitation, tool frame, unit vector (d,)."""
    lowest_coherence: float
    """Squared correlation along that direction [1]; zero by construction for one joint."""
    maximum_correlation: float
    """Highest correlation over directions [1]."""
    skewness: Array
    """Skewness along the tool axes, whole bandwidth; 0 along one that stands still [1] (d,)."""
    kurtosis: Array
    """Excess kurtosis along the tool axes, whole bandwidth; 0 as above [1] (d,)."""
    lowest_skewness: float
    """Skewness along the direction of lowest coherence [1]."""
    lowest_kurtosis: float
    """Excess kurtosis along the direction of lowest coherence [1]."""

    @property
    def excited(self) -> NDArray[np.bool_]:
        """True for each excited joint (n,)."""
        return np.asarray(self.torque > 0)


def statistics_of(measurement: Measurement) -> RecordStatistics:
    """Work out the statistics of a measurement in which at least one joint was excited.

    Raises
    ------
    InvalidData
        If the measurement failed, or nothing moves.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.excitation import Excitation
    >>> from loose_env.faults import Healthy
    >>> from loose_env.rig import SimulatedRig
    >>> arm = planar(2)
    >>> rig = SimulatedRig(arm)
    >>> rig.mount(0, Healthy())
    >>> shake = Excitation(torque_rms=(0.0, 1.0), duration=0.4, band=arm.band)
    >>> measured = rig.measure(np.zeros(2), shake, rng=np.random.default_rng(0))
    >>> statistics_of(measured).transmission.shape
    (2, 2)
    """
    n = len(measurement.pose)
    on = np.flatnonzero(measurement.excited)
    rate, band = measurement.rate, measurement.excitation.band
    tool = bandpass(measurement.tool, rate, band)
    joint = acceleration_from_angle(measurement.encoder[on], rate, band)
    command = bandpass(measurement.command[on], rate, band)
    cov = record_covariances(command, joint, tool)
    lowest = lowest_coherence_direction_from(cov.x_a)
    torque = np.array(measurement.excitation.torque_rms)

    def spread(values: Array) -> Array:
        wide = np.zeros((*values.shape[:-1], n))
        wide[..., on] = values
        return wide

    instrument = transmission_by_instrument_from(cov.command_x, cov.command_a)
    axes = len(measurement.tool)
    third, fourth = _shape(measurement.tool, lowest.direction)
    return RecordStatistics(
        pose=measurement.pose,
        torque=torque,
        duration=measurement.excitation.duration,
        transmission=spread(transmission_from(cov.x_a)),
        transmission_by_instrument=spread(instrument),
        joint_rms=spread(np.sqrt(np.diag(cov.x_a.xx))),
        inertia=spread(np.diag(apparent_inertia_from(cov.command_x))),
        tool_covariance=cov.x_a.aa,
        lowest_direction=lowest.direction,
        lowest_coherence=float(lowest.coherence),
        maximum_correlation=float(np.sqrt(lowest.coherences.max())),
        skewness=third[:axes],
        kurtosis=fourth[:axes],
        lowest_skewness=float(third[axes]),
        lowest_kurtosis=float(fourth[axes]),
    )


def _shape(tool: Array, direction: Array) -> tuple[Array, Array]:
    """Skewness and excess kurtosis along the tool axes, then along a direction (d + 1,).

    Where excitation and arm leave an axis still, as the plane of a SCARA whose quill is shaken,
    ideal sensors show rounding only. It has no shape; zero means no impacts there.
    """
    rows = np.array([*tool, direction @ tool])
    power = rows.var(axis=1)
    moving = (power > _STILL * power.max()) & (np.sqrt(power) > _STILL * np.abs(rows.mean(axis=1)))
    third, fourth = np.zeros(len(rows)), np.zeros(len(rows))
    if moving.any():
        third[moving], fourth[moving] = shape_of(rows[moving])
    return third, fourth
