"""A record as Fourier lines of its band, with the noise of every reading.

The excitation repeats after the length of the record, so the answer of a linear arm has lines at
multiples of the inverse of that length and nothing leaks between them. What a healthy record
shows of a line is then exact but for noise, and can be taken off a record of the loose arm line
by line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.rig import Measurement
from loose_env.sensors import SensorSuite
from loose_env.statistics import acceleration_from_angle
from loose_env.typing import Array, ComplexArray

__all__ = ["RecordLines", "less_healthy", "record_lines"]


_CONDITION = 1e-6
"""Smallest over largest command of a line below which healthy records do not tell joints apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordLines:
    """Lines of one record in which m joints were excited; c readings: d of the tool, m encoders."""

    pose: Array
    """Commanded pose [rad or m] (n,)."""
    excited: NDArray[np.bool_]
    """True for each excited joint (n,)."""
    frequency: Array
    """Frequencies of the lines [Hz] (K,)."""
    torque: ComplexArray
    """Lines of the commands, as a discrete Fourier transform has them (K, m)."""
    readings: ComplexArray
    """Lines of the readings: tool acceleration, then joint accelerations (K, c)."""
    noise: Array
    """Variance of what the sensors add to each (K, c)."""
    power: Array
    """Mean square of the whole motion, tool axes and joints apart, to measure model errors
    against (K, c)."""
    relative: bool = False
    """True if a healthy arm's response was subtracted from the readings."""


def record_lines(arm: Arm, measurement: Measurement, sensors: SensorSuite) -> RecordLines:
    """Take the lines of a record in the band of its excitation.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    measurement : Measurement
        A record in which at least one joint was excited and no shaker was on.
    sensors : SensorSuite
        Sensors that read it, for their noise.

    Raises
    ------
    InvalidData
        If the measurement failed, does not fit the arm, nothing was excited, a shaker was on, or
        its channels have different lengths, values that are not finite, or a tool that stands
        still.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.excitation import Excitation
    >>> from loose_env.rig import SimulatedRig
    >>> shake = Excitation(torque_rms=(5.0, 0.0), duration=0.2, band=(30.0, 150.0))
    >>> record = SimulatedRig(planar(2)).measure(np.array([0.1, 0.4]), shake)
    >>> record_lines(planar(2), record, SensorSuite()).frequency[:3].tolist()
    [30.0, 35.0, 40.0]
    """
    if measurement.failure is not None:
        raise InvalidData(f"the measurement failed: {measurement.failure}")
    if len(measurement.pose) != arm.n or len(measurement.tool) != len(arm.axes):
        raise InvalidData(
            f"arm {arm.name!r} has {arm.n} joints and a tool with {len(arm.axes)} axes; the record "
            f"has {len(measurement.pose)} and {len(measurement.tool)}"
        )
    on = np.flatnonzero(measurement.excited)
    if not len(on):
        raise InvalidData("no joint was excited in this record: excite at least one")
    if measurement.excitation.shaker_rms > 0:
        raise InvalidData("the shaker was on; take records with excited joints alone")
    count, rate = measurement.tool.shape[1], measurement.rate
    channels = {
        "tool": measurement.tool,
        "command": measurement.command[on],
        "encoder": measurement.encoder[on, 1:-1],
    }
    lengths = {name: channel.shape[-1] for name, channel in channels.items()}
    if len(set(lengths.values())) > 1:
        raise InvalidData(
            f"the channels of the record have different lengths (encoder less two): {lengths}; it "
            "may be cut off"
        )
    broken = [name for name, channel in channels.items() if not np.isfinite(channel).all()]
    if broken:
        raise InvalidData(f"{', '.join(broken)} of the record holds NaN or infinite values")
    if not np.ptp(measurement.tool, axis=1).any():
        raise InvalidData("the tool's readings are constant: is the accelerometer connected?")
    low, high = measurement.excitation.band
    frequency: Array = np.fft.rfftfreq(count, 1 / rate).astype(float)
    kept = (frequency >= low - 1e-9) & (frequency <= high + 1e-9)
    frequency = frequency[kept]
    tool, joint, torque = (
        np.fft.rfft(signal)[:, kept].T
        for signal in (
            measurement.tool,
            acceleration_from_angle(measurement.encoder[on], rate, (low, high)),
            measurement.command[on],
        )
    )
    accelerometer, encoder = sensors.accelerometer, sensors.encoder
    of_tool = accelerometer.noise_density**2 * rate / 2 + accelerometer.resolution**2 / 12
    of_joint = np.where(
        arm.sliding[on],
        encoder.linear_noise**2 + encoder.linear_resolution**2 / 12,
        encoder.noise**2 + encoder.resolution**2 / 12,
    )
    noise = np.concatenate(
        [
            np.full(tool.shape, count * of_tool),
            count * of_joint * (2 * np.pi * frequency[:, None]) ** 4,
        ],
        axis=1,
    )
    readings = np.concatenate([tool, joint], axis=1)
    return RecordLines(
        pose=measurement.pose,
        excited=measurement.excited,
        frequency=frequency,
        torque=torque,
        readings=readings,
        noise=noise,
        power=_power_of(readings, tool.shape[1]),
    )


def less_healthy(record: RecordLines, healthy: Sequence[RecordLines]) -> RecordLines:
    """Subtract the healthy arm's response to the same commands from a record.

    Parameters
    ----------
    record : RecordLines
        Record of the arm under test.
    healthy : sequence of RecordLines
        Records of the healthy arm. Those in the same pose with the same joints excited are used: as
        many as joints at least, or their answers cannot be told apart.

    Returns
    -------
    RecordLines
        Residual, with the noise of all records in it.

    Raises
    ------
    InvalidData
        If there are too few such records, or their lines lie elsewhere.
    """
    alike = [
        h
        for h in healthy
        if np.array_equal(h.excited, record.excited) and np.abs(h.pose - record.pose).max() <= 1e-6
    ]
    joints = (np.flatnonzero(record.excited) + 1).tolist()
    if len(alike) < len(joints):
        raise InvalidData(
            f"a record in pose {record.pose.round(4).tolist()} excites joints {joints}: "
            f"{len(joints)} or more healthy records like it are needed, {len(alike)} given"
        )
    if any(
        h.frequency.shape != record.frequency.shape
        or np.abs(h.frequency - record.frequency).max() > 1e-9
        for h in alike
    ):
        raise InvalidData(
            "healthy records need the length and the band of the records they are compared with: "
            "their Fourier lines lie elsewhere"
        )
    torque = np.stack([h.torque for h in alike], axis=2)  # (K, m, R)
    readings = np.stack([h.readings for h in alike], axis=2)
    values = np.linalg.svd(torque, compute_uv=False)
    if (values[:, -1] < _CONDITION * values.max()).any():
        raise InvalidData(
            f"the commands of the healthy records with joints {joints} are too much alike to tell "
            "what each joint does; draw them anew for every record"
        )
    # Combination of healthy records that makes this record's command, line by line.
    share = np.einsum("krm,km->kr", np.linalg.pinv(torque), record.torque)
    left = record.readings - np.einsum("kcr,kr->kc", readings, share)
    noise = record.noise * (1 + np.sum(np.abs(share) ** 2, axis=1))[:, None]
    axes = record.readings.shape[1] - len(joints)
    return replace(record, readings=left, noise=noise, power=_power_of(left, axes), relative=True)


def _power_of(readings: ComplexArray, axes: int) -> Array:
    """Mean square of tool axes together and of each joint (K, c)."""
    power = np.abs(readings) ** 2
    power[:, :axes] = power[:, :axes].mean(axis=1, keepdims=True)
    return np.asarray(power)
