"""Statistics of one record at the tool and at accelerometers on links."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, link_site
from loose_env.diagnosis.prediction import healthy_transmission
from loose_env.errors import InvalidData
from loose_env.rig import Measurement
from loose_env.sensors import LinkAccelerometers
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

_STILL = 1e-12
"""Share of the largest variance, and of a row's mean, taken as rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordStatistics:
    """Second- and higher-order statistics of one record.

    Arrays over joints have n entries; those of joints that were not excited are zero. Of B
    records together, as `statistics_of_all` gives them, every number is an array (B,) and every
    array has an axis more in front.
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

    def __getitem__(self, k: int) -> RecordStatistics:
        """Statistics of one record of several."""
        own: dict[str, Any] = {}
        for each in fields(self):
            value = getattr(self, each.name)[k]
            own[each.name] = float(value) if np.ndim(value) == 0 else value
        return RecordStatistics(**own)


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
    return statistics_of_all([measurement])[0]


def statistics_of_all(measurements: Sequence[Measurement]) -> RecordStatistics:
    """Work out the statistics of B measurements of one arm, alike in length and band.

    Equally many joints, one at least, were excited in each; not necessarily the same ones. The
    statistics of a record do not depend on those beside it.

    Raises
    ------
    InvalidData
        If one of the measurements failed, or nothing moves in it.
    """
    first = measurements[0]
    n, count = len(first.pose), len(measurements)
    torque = np.array([m.excitation.torque_rms for m in measurements])
    on = torque > 0
    joints = np.nonzero(on)[1].reshape(count, -1)
    rate, band = first.rate, first.excitation.band
    raw = np.array([m.tool for m in measurements])
    tool = bandpass(raw, rate, band)
    turned = np.array([m.encoder[own] for m, own in zip(measurements, joints, strict=True)])
    played = np.array([m.command[own] for m, own in zip(measurements, joints, strict=True)])
    cov = record_covariances(
        bandpass(played, rate, band), acceleration_from_angle(turned, rate, band), tool
    )
    lowest = lowest_coherence_direction_from(cov.x_a)

    def spread(values: Array) -> Array:
        """Values of the excited joints among those of all (B, ..., n)."""
        wide = np.zeros((*values.shape[:-1], n))
        at = joints.reshape(count, *[1] * (values.ndim - 2), -1)
        np.put_along_axis(wide, np.broadcast_to(at, values.shape), values, axis=-1)
        return wide

    instrument = transmission_by_instrument_from(cov.command_x, cov.command_a)
    third, fourth = _shape(raw, lowest.direction)
    several: dict[str, Any] = {
        "pose": np.array([m.pose for m in measurements]),
        "torque": torque,
        "duration": np.array([m.excitation.duration for m in measurements]),
        "transmission": spread(transmission_from(cov.x_a)),
        "transmission_by_instrument": spread(instrument),
        "joint_rms": spread(np.sqrt(_diagonals(cov.x_a.xx))),
        "inertia": spread(_diagonals(apparent_inertia_from(cov.command_x))),
        "tool_covariance": cov.x_a.aa,
        "lowest_direction": lowest.direction,
        "lowest_coherence": lowest.coherence,
        "maximum_correlation": np.sqrt(lowest.coherences[:, -1]),
        "skewness": third[:, :-1],
        "kurtosis": fourth[:, :-1],
        "lowest_skewness": third[:, -1],
        "lowest_kurtosis": fourth[:, -1],
    }
    return RecordStatistics(**several)


def _diagonals(matrices: Array) -> Array:
    """Diagonals (B, k) of matrices (B, k, k)."""
    return np.asarray(np.diagonal(matrices, axis1=-2, axis2=-1))


def _shape(tool: Array, direction: Array) -> tuple[Array, Array]:
    """Skewness and excess kurtosis along the tool axes, then along a direction (B, d + 1).

    Along an axis that stands still ideal sensors show rounding only; zero means no impacts there.
    """
    along = np.einsum("bd,bdn->bn", direction, tool)
    rows = np.concatenate([tool, along[:, None]], axis=1)
    power = rows.var(axis=-1)
    most = power.max(axis=-1, keepdims=True)
    moving = (power > _STILL * most) & (np.sqrt(power) > _STILL * np.abs(rows.mean(axis=-1)))
    third, fourth = np.zeros(power.shape), np.zeros(power.shape)
    if moving.any():
        third[moving], fourth[moving] = shape_of(rows[moving])
    return third, fourth


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkReadings:
    """Statistics of the accelerometers on L links with a axes each, base first.

    Of several records, arrays have an axis more in front.
    """

    transmission_by_instrument: Array
    """Acceleration per joint acceleration, the command as instrument, frame of the link
    [m, 1 where the joint slides] (L, a, n); zero for joints that were not excited."""
    rms: Array
    """Rms acceleration in the band [m/s²] (L, a)."""


def link_axes(arm: Arm, choice: LinkAccelerometers) -> tuple[str, ...]:
    """Names of the axes that each accelerometer measures.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> link_axes(planar(2), LinkAccelerometers())
    ('x', 'y')
    """
    return ("tangent",) if choice.tangential else tuple("xyz"[axis] for axis in arm.axes)


def link_readings_of_all(measurements: Sequence[Measurement]) -> LinkReadings:
    """Statistics of the accelerometers on links in B measurements.

    Alike as for `statistics_of_all`.

    Raises
    ------
    InvalidData
        If one has none, failed, or nothing moves.
    """
    count, n = len(measurements), len(measurements[0].pose)
    signals = []
    for measurement in measurements:
        if measurement.links is None:
            raise InvalidData(
                "the record has no accelerometers on links; set link_accelerometers to False, or "
                "take a rig that carries them"
            )
        signals.append(measurement.links)
    links, axes = signals[0].shape[:2]
    joints = [np.flatnonzero(measurement.excited) for measurement in measurements]
    rate, band = measurements[0].rate, measurements[0].excitation.band
    motion = bandpass(np.reshape(signals, (count, links * axes, -1)), rate, band)
    turned = np.array([m.encoder[own] for m, own in zip(measurements, joints, strict=True)])
    played = np.array([m.command[own] for m, own in zip(measurements, joints, strict=True)])
    cov = record_covariances(
        bandpass(played, rate, band), acceleration_from_angle(turned, rate, band), motion
    )
    found = transmission_by_instrument_from(cov.command_x, cov.command_a)
    wide = np.zeros((count, links * axes, n))
    for own, row, on in zip(wide, found, joints, strict=True):
        own[:, on] = row
    return LinkReadings(
        transmission_by_instrument=wide.reshape(count, links, axes, n),
        rms=motion.std(axis=-1).reshape(count, links, axes),
    )


def sensed_arms(arm: Arm, choice: LinkAccelerometers) -> list[Arm]:
    """Arms whose tool is the accelerometer on a link, one for each link that carries one."""
    arms = []
    for link in choice.on(arm):
        at, spec = link_site(arm, link, choice.place), arm.spec.copy()
        name = f"accelerometer{link}"
        site = spec.body(at.body).add_site(name=name, pos=list(at.position))
        if choice.tangential:
            site.quat = at.tangential_quat
        axes = (0,) if choice.tangential else arm.axes
        arms.append(dataclasses.replace(arm, spec=spec, tool=name, axes=axes))
    return arms


class NominalLinks:
    """Transmission of the nominal, healthy arm to the accelerometers on its links.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    choice : LinkAccelerometers
        Which links carry one, where, and along which axes.

    Examples
    --------
    At the proximal end link 1 sits on its own joint, which moves it nowhere.

    >>> from loose_env.arms import planar
    >>> links = NominalLinks(planar(2), LinkAccelerometers(place="proximal"))
    >>> links.transmission([0.0, 0.5], [True, False]).round(2)[:, :, 0].tolist()
    [[0.0, 0.0], [0.14, 0.26]]
    """

    def __init__(self, arm: Arm, choice: LinkAccelerometers) -> None:
        self._linear = [LinearArm(one, remember=32) for one in sensed_arms(arm, choice)]

    def transmission(
        self, pose: Sequence[float] | Array, excited: Sequence[bool] | NDArray[np.bool_]
    ) -> Array:
        """Acceleration per joint acceleration at a pose [rad] (n,), command as instrument.

        Returns
        -------
        ndarray (L, a, n)
            As `LinkReadings.transmission_by_instrument`, for flat torque.
        """
        mask, q = np.asarray(excited, dtype=bool), np.asarray(pose, dtype=float)
        rows = []
        for linear in self._linear:
            wide = np.zeros((len(linear.arm.axes), len(q)))
            wide[:, mask] = healthy_transmission(linear.at(q).response(mask), mask)
            rows.append(wide)
        return np.array(rows)
