"""Accelerometers on links: their transmission in a record, and the nominal arm's."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, link_site
from loose_env.errors import InvalidData
from loose_env.rig import Measurement
from loose_env.sensors import LinkAccelerometers
from loose_env.statistics import (
    acceleration_from_angle,
    bandpass,
    record_covariances,
    transmission_by_instrument_from,
)
from loose_env.typing import Array

__all__ = [
    "LinkReadings",
    "NominalLinks",
    "link_axes",
    "link_readings_of",
    "link_readings_of_all",
    "sensed_arms",
]


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


def link_readings_of(measurement: Measurement) -> LinkReadings:
    """Work out the statistics of the accelerometers on links.

    Raises
    ------
    InvalidData
        If the measurement has none, failed, or nothing moves.
    """
    several = link_readings_of_all([measurement])
    return LinkReadings(
        transmission_by_instrument=several.transmission_by_instrument[0], rms=several.rms[0]
    )


def link_readings_of_all(measurements: Sequence[Measurement]) -> LinkReadings:
    """Work out the same of B measurements, alike as for `statistics_of_all`.

    Raises
    ------
    InvalidData
        As `link_readings_of`, for one of them.
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
    """Arms whose tool is the accelerometer on a link, one for each that carries one.

    What the package works out for the tool it works out for the accelerometers by them.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> [one.tool for one in sensed_arms(planar(2), LinkAccelerometers())]
    ['accelerometer1', 'accelerometer2']
    """
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
        on = np.flatnonzero(mask)
        rows = []
        for linear in self._linear:
            answer = linear.at(q).response(mask)
            joint = answer.joint[:, on].real.mean(axis=0)
            wide = np.zeros((answer.tool.shape[1], len(q)))
            wide[:, on] = np.linalg.solve(joint.T, answer.tool.real.mean(axis=0).T).T
            rows.append(wide)
        return np.array(rows)
