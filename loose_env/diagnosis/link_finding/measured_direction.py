"""Direction of looseness from the change of transmission, with its covariance.

The change dB of the tool's motion per joint motion, against the nominal arm in the same pose, is
z v' for a slide seen along z: its leading left singular vector is the direction. Two errors bend
it. The model's: the accelerometer's leakage, mounting and gains act as a matrix M on the nominal
transmission B, and the arm's geometry is a little off; across z this leaves an angle of about
|M B v| / s, with s the singular value. The record's: what the joints do not explain, over the
square root of the number of independent samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Mismatch
from loose_env.diagnosis.likelihood.axial_likelihood import precision_of
from loose_env.diagnosis.link_finding.spatial import DirectionSighting
from loose_env.diagnosis.records.prediction import Prediction, SensorFloor
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics import axial_vector
from loose_env.typing import Array

__all__ = ["ChangeModel", "ChangeSighting", "sight_change"]


@dataclass(frozen=True, kw_only=True)
class ChangeModel:
    """Errors of the transmission of a healthy arm."""

    sensor: float = 0.025
    """Entries of the accelerometer's error matrix: leakage, gain, mounting [1]."""
    geometry: float = 0.015
    """Error of each joint's transmission by lengths and joint zeros, relative [1]."""
    floor: float = np.radians(2.0)
    """Standard deviation that no direction can beat: the mounting bends all alike [rad]."""

    def __post_init__(self) -> None:
        for name in ("sensor", "geometry", "floor"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise InvalidSetting(f"{name} must be zero or more, got {value!r}")
        if self.sensor + self.geometry + self.floor == 0:
            raise InvalidSetting("a change model without any error is not one; set floor")

    @classmethod
    def of(cls, mismatch: Mismatch, *, joints: int) -> ChangeModel:
        """Derive it from how far the nominal model of an arm with so many joints is off."""
        mounting = np.radians(mismatch.misalignment)
        sensor = float(np.hypot(mismatch.cross_axis, mounting))
        zeros = np.radians(mismatch.joint_zero) * np.sqrt(joints)
        tilt = np.hypot(mismatch.gain, mismatch.length)
        return cls(
            sensor=sensor,
            geometry=float(np.hypot(zeros, tilt)),
            floor=max(sensor, float(np.radians(0.5))),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ChangeSighting(DirectionSighting):
    """A direction of looseness from the change of transmission."""

    ratio: float
    """Size of the change over that of the nominal transmission, |dB| / |B| [1]."""
    expected_ratio: float
    """Rms of that ratio where nothing is loose [1]."""
    values: Array
    """Singular values of the change, falling, joints weighted by their motion [m/s²]."""
    noise: float
    """Singular value that errors alone leave, rms [m/s²]."""

    @property
    def rank(self) -> int:
        """Number of directions in the change that stand out: 0 none, 1 one slide, more several."""
        return int(np.sum(self.values > 3 * self.noise))

    @property
    def excess(self) -> float:
        """Change over what errors leave [1]: about 1 where nothing is loose."""
        return self.ratio / self.expected_ratio


def sight_change(
    record: RecordStatistics,
    nominal: Prediction,
    *,
    band: tuple[float, float],
    floor: SensorFloor,
    model: ChangeModel,
    springs: Array | None = None,
) -> ChangeSighting:
    """Read the direction of looseness off the change of transmission in one record.

    Joints are weighted by their nominal accelerations, so that those that turn and those that
    slide can be excited together.

    Parameters
    ----------
    record : RecordStatistics
        The record.
    nominal : Prediction
        Prediction of the healthy nominal arm for it.
    band : (float, float)
        Band of the excitation [Hz].
    floor : SensorFloor
        Noise of the sensors in the band.
    model : ChangeModel
        Errors of model and sensors.
    springs : ndarray (K, d, m), optional
        Changes of the transmission by errors of springs, from
        `loose_env.diagnosis.records.model_uncertainty.stiffness_errors`; they matter for an arm
        that bends in its band.

    Raises
    ------
    InvalidData
        If no joint was excited, the two do not fit, or a value is not finite.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import LinearArm
    >>> from loose_env.diagnosis.records.prediction import predict
    >>> from loose_env.diagnosis.records.record_statistics import statistics_of
    >>> from loose_env.excitation import Excitation
    >>> from loose_env.rig import SimulatedRig
    >>> arm = planar(2)
    >>> rig, pose = SimulatedRig(arm), np.array([0.1, 0.9])
    >>> shake = Excitation(torque_rms=(5.0, 2.0), duration=0.4, band=arm.band)
    >>> quiet = SensorFloor(joint=0.01, tool=0.001)
    >>> seen = sight_change(
    ...     statistics_of(rig.measure(pose, shake)),
    ...     predict(rig.nominal.at(pose), shake, quiet),
    ...     band=arm.band,
    ...     floor=quiet,
    ...     model=ChangeModel(),
    ... )
    >>> seen.rank  # nothing is loose
    0
    """
    on = np.flatnonzero(record.excited)
    reference = nominal.transmission_by_instrument
    d, m = reference.shape
    if not len(on) or len(on) != m or len(record.tool_covariance) != d:
        raise InvalidData(
            f"the record excites {len(on)} joints and has {len(record.tool_covariance)} tool axes, "
            f"the prediction {m} and {d}"
        )
    rms = np.sqrt(np.diag(nominal.joint))
    weighted = reference * rms
    change = record.transmission_by_instrument[:, on] * rms - weighted
    if not (np.isfinite(change).all() and weighted.any()):
        raise InvalidData("transmissions must be finite, and the nominal arm must move its tool")
    left, values, right = np.linalg.svd(change, full_matrices=False)
    direction, v = axial_vector(left[:, 0]), right[0]

    samples = 2 * (band[1] - band[0]) * record.duration
    # Encoder noise n enters as B n; it does not know the command, so it only adds scatter.
    scatter = _residual(record, nominal, on, floor) + floor.joint**2 * (reference @ reference.T)
    scatter = scatter / samples
    # Joints that move alike, or follow the command badly, are harder to tell apart: a row of B
    # scatters with (Sxu Suu^-1 Sux)^-1.
    followed = nominal.command_joint.T @ np.linalg.solve(nominal.command, nominal.command_joint)
    mixed = np.linalg.inv(followed) * np.outer(rms, rms)

    columns = np.sum(weighted**2, axis=0)
    bent = model.sensor**2 * float(np.sum((weighted @ v) ** 2))
    bent += model.geometry**2 * float(columns @ v**2)
    errors = float(np.trace(mixed) * np.trace(scatter))
    errors += (d * model.sensor**2 + model.geometry**2) * float(columns.sum())
    bending = np.zeros((0, d, m)) if springs is None else springs * rms
    errors += float(np.sum(bending**2))
    lean = bending @ v  # (K, d)
    noise = float(np.sqrt(errors / min(d, m)))
    # Errors alone have a largest singular value too: only what exceeds it points anywhere.
    top = float(values[0]) ** 2 - noise**2
    precision = np.zeros((d, d))
    if top > 0:
        covariance = float(v @ mixed @ v) * scatter + bent * np.eye(d) + lean.T @ lean
        covariance = covariance / top
        precision = precision_of(direction, covariance + model.floor**2 * np.eye(d))
    return ChangeSighting(
        pose=record.pose,
        direction=direction,
        precision=precision,
        ratio=float(np.sqrt(np.sum(values**2) / columns.sum())),
        expected_ratio=float(np.sqrt(errors / columns.sum())),
        values=values,
        noise=noise,
    )


def _residual(
    record: RecordStatistics, nominal: Prediction, on: NDArray[np.intp], floor: SensorFloor
) -> Array:
    """Covariance of the tool acceleration that the joints leave unexplained (d, d).

    Its shape is what remains beside the measured transmission of the measured joint motion, with
    the nominal correlations between joints. Its size is at most what the record's lowest
    coherence leaves.
    """
    rms = np.sqrt(np.diag(nominal.joint))
    correlation = nominal.joint / np.outer(rms, rms)
    moved = record.transmission_by_instrument[:, on] * record.joint_rms[on]
    values, vectors = np.linalg.eigh(record.tool_covariance - moved @ correlation @ moved.T)
    left = (vectors * np.maximum(values, max(floor.tool**2, 1e-30))) @ vectors.T
    most = max(1 - record.lowest_coherence, 0.0) * float(np.trace(record.tool_covariance))
    return np.asarray(min(1.0, most / float(np.trace(left))) * left)
