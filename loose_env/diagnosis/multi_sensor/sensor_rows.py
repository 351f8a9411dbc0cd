"""Measured axes of several accelerometers, and records of them in second-order statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, link_site
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.rig import Measurement
from loose_env.sensors import LinkAccelerometers
from loose_env.statistics import (
    acceleration_from_angle,
    bandpass,
    covariances,
    effective_samples,
    transmission_by_instrument_from,
)
from loose_env.typing import Array

__all__ = ["SensorRows", "StackedRecord", "rows_of", "splitting_order", "stack"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorRows:
    """The measured axes of an arm's accelerometers, one a row."""

    link: NDArray[np.intp]
    """Link that carries the row's sensor; 0 for the tool's (D,)."""
    direction: Array
    """Measured direction: tool frame, or frame of the body that carries the sensor (D, 3)."""

    def __len__(self) -> int:
        return len(self.link)

    def projection(self, part: SensorRows) -> Array:
        """Matrix that makes the readings of ``part`` out of these (D of part, D).

        Raises
        ------
        InvalidSetting
            If a direction of ``part`` is not measured here.
        """
        same = part.link[:, None] == self.link
        found: Array = np.where(same, part.direction @ self.direction.T, 0.0)
        if not np.allclose(found @ self.direction, part.direction, atol=1e-6):
            raise InvalidSetting(
                "the rows asked for hold directions that the given sensors do not measure; these "
                f"are on links {sorted(set(self.link.tolist()))} (0: tool)"
            )
        return found


def rows_of(arm: Arm, links: LinkAccelerometers | None, *, tool: bool = True) -> SensorRows:
    """Measured axes of an arm: the tool's, then those of its links, as `Measurement` has them.

    Parameters
    ----------
    arm : Arm
        The arm.
    links : LinkAccelerometers or None
        Accelerometers on its links.
    tool : bool
        True if the tool's accelerometer is used.

    Raises
    ------
    InvalidSetting
        If no sensor is left.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> rows_of(planar(3), LinkAccelerometers(tangential=True)).link.tolist()
    [0, 0, 1, 2, 3]
    """
    axes = np.eye(3)[list(arm.axes)]
    number, direction = [], []
    if tool:
        number += [0] * len(axes)
        direction += list(axes)
    if links is not None:
        for link in links.on(arm):
            along = [link_site(arm, link, links.place).tangent] if links.tangential else list(axes)
            number += [link] * len(along)
            direction += along
    if not number:
        raise InvalidSetting("no accelerometer is left: use the tool's, or one on a link")
    return SensorRows(link=np.array(number, dtype=np.intp), direction=np.array(direction))


def splitting_order(n: int) -> tuple[int, ...]:
    """Order in which links should get a sensor: each halves the largest group not yet split.

    A sensor at the distal end of link k sees the seats of links 1 to k and no other, so sensors
    part the links into groups as cuts part a line; the tool's is the cut after link n.

    Examples
    --------
    >>> splitting_order(6)
    (3, 1, 4, 2, 5, 6)
    """
    cuts: list[int] = [0, n]
    order: list[int] = []
    while len(order) < n - 1:
        sizes = np.diff(cuts)
        largest = int(np.argmax(sizes))
        at = cuts[largest] + int(sizes[largest]) // 2
        order.append(at)
        cuts = sorted([*cuts, at])
    return (*order, n)


@dataclass(frozen=True, kw_only=True, eq=False)
class StackedRecord:
    """One record of all rows: what of each follows the m commands, and what does not.

    "In step" is the covariance with a command over that command's rms: the part of a signal that
    follows the command, at its rms.
    """

    pose: Array
    """Commanded pose [rad or m] (n,)."""
    torque: Array
    """Rms random torque commanded [N·m or N] (n,)."""
    joint: Array
    """In-step accelerations of the excited joints [rad/s² or m/s²] (m, m)."""
    transmission: Array
    """Row acceleration per joint acceleration, command as instrument [m or 1] (D, m)."""
    rest: Array
    """Covariance of the part of the rows that follows no joint [m²/s⁴] (D, D)."""
    samples: Array
    """Independent samples that the record is worth for each row [1] (D,)."""

    @property
    def scatter(self) -> Array:
        """Sampling covariance of each column of transmission @ joint [m²/s⁴] (D, D)."""
        return np.asarray(self.rest / np.sqrt(np.outer(self.samples, self.samples)))

    @property
    def excited(self) -> NDArray[np.bool_]:
        """True for each excited joint (n,)."""
        return np.asarray(self.torque > 0)

    def projected(self, matrix: Array) -> StackedRecord:
        """Return the record as other rows would have it; see `SensorRows.projection`."""
        return StackedRecord(
            pose=self.pose,
            torque=self.torque,
            joint=self.joint,
            transmission=matrix @ self.transmission,
            rest=matrix @ self.rest @ matrix.T,
            # A row that is made of several is worth the fewest of theirs.
            samples=np.array([self.samples[np.abs(row) > 1e-9].min() for row in matrix]),
        )


def stack(measurement: Measurement, rows: SensorRows) -> StackedRecord:
    """Work out the statistics of a record.

    Parameters
    ----------
    measurement : Measurement
        The record; at least one joint was excited.
    rows : SensorRows
        The measured axes; the tool's first.

    Raises
    ------
    InvalidData
        If the measurement failed, nothing moves or it has other channels than the rows.
    """
    if measurement.failure is not None:
        raise InvalidData(f"the record is worthless: {measurement.failure}")
    on = np.flatnonzero(measurement.excited)
    if len(on) == 0:
        raise InvalidData("no joint was excited; at least one is needed")
    signals = _signals(measurement, rows)
    rate, band = measurement.rate, measurement.excitation.band
    a = bandpass(signals, rate, band)
    x = acceleration_from_angle(measurement.encoder[on], rate, band)
    u = bandpass(measurement.command[on], rate, band)
    with_x, with_a = covariances(u, x), covariances(u, a)
    b = transmission_by_instrument_from(with_x, with_a)
    rms = np.sqrt(np.diag(with_x.xx))
    rest = a - a.mean(1, keepdims=True) - b @ (x - x.mean(1, keepdims=True))
    count = np.array(
        [min(effective_samples(v, r) for v in u) if np.ptp(r) > 0 else len(r) for r in rest]
    )
    return StackedRecord(
        pose=measurement.pose,
        torque=np.array(measurement.excitation.torque_rms),
        joint=(with_x.xa / rms[:, None]).T,
        transmission=b,
        rest=rest @ rest.T / rest.shape[1],
        samples=np.minimum(count, rest.shape[1]),
    )


def _signals(measurement: Measurement, rows: SensorRows) -> Array:
    parts: Sequence[Array] = [measurement.tool]
    if measurement.links is not None:
        parts = [measurement.tool, measurement.links.reshape(-1, measurement.tool.shape[1])]
    signals = np.concatenate(parts)
    if not (rows.link == 0).any():  # the tool's accelerometer is there but not used
        signals = signals[len(measurement.tool) :]
    if len(signals) != len(rows):
        raise InvalidData(
            f"the record has {len(signals)} axes of accelerometers, the rows describe {len(rows)}"
        )
    return signals
