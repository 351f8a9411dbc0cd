"""Scatter of measured changes of motion about the direction that each place predicts, pooled.

The source judges two poses at a time (4.2.2). Here every record counts: carried back into link k,
the directions of all poses agree if link k slides and scatter if it does not; under play in joint j
all lie along that joint's own line. The change C of the tool's motion against the nominal arm
(3.34), d axes by m shaken joints, is held against the rank-one changes u v' along a direction u,
whatever share v the joints have in it. What the best v leaves, in units of what errors of model and
sampling allow, is the scatter of the record about u.

An arm that bends within its band does not pass the motion of a seat on along the seat's line, so u
is taken from the nominal arm's change with the seat floating; on a stiff arm it is the slide's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.learned.features import SeatFeatures, TransmissionChange
from loose_env.diagnosis.link_finding.direction_images import fault_locations
from loose_env.diagnosis.records.record_statistics import RecordStatistics
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

__all__ = ["PlaceDirections", "PooledScatter", "RecordScatter", "scatter_of"]

_AXES = {2: 60, 3: 300}
"""Sliding directions tried for each link by dimension: 3 and 8 degrees apart."""
SECOND_ORDER = 0.02
"""Error of each element over the rms nominal motion [1]: products of two model errors, which the
covariance to first order lacks. Without it single records of healthy arms stand out 60-fold."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordScatter:
    """One record: how its change of motion lies to the direction of every place."""

    directions: Array
    """Direction that each place predicts, tool frame, axial (P, d)."""
    direction: Array
    """Direction of the measured change, tool frame, axial (d,)."""
    gain: Array
    """Part of it that lies along each place's direction, chi-square [1] (P,)."""
    joints: int
    """Joints shaken, m."""

    @property
    def excess(self) -> float:
        """Most change along one place, over what errors make of it in the mean [1]."""
        return float(self.gain.max()) / self.joints


class PlaceDirections:
    """Holds records against the directions of all places of an arm.

    Places are the sliding directions of link 1, those of link 2, ..., then the joints' plays:
    P = n A + n.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    sensors : SensorSuite
        Figures of the sensors.
    mismatch : Mismatch
        Errors of the nominal model.
    """

    def __init__(self, linear: LinearArm, sensors: SensorSuite, mismatch: Mismatch) -> None:
        d = len(linear.arm.axes)
        self.features = SeatFeatures(linear, sensors, mismatch, directions=_AXES[d])
        self.names = fault_locations(linear.arm)
        """Hypotheses: a slide of each link, then play in each joint (2 n,)."""
        self.axes = self.features.directions
        """Sliding directions in a link's frame, unit vectors (A, d)."""

    def of(self, record: RecordStatistics) -> RecordScatter:
        """Hold one record against all places; at least one joint must be excited."""
        return scatter_of([self.features.with_change(record)[2]], int(record.excited.sum()))


def scatter_of(
    changes: Sequence[TransmissionChange], joints: int, *, second_order: float = SECOND_ORDER
) -> RecordScatter:
    """Scatter of a change about the direction of every place.

    Parameters
    ----------
    changes : sequence of TransmissionChange
        Measured change, its errors, and the change by each floating seat, at the tool and then at
        each further sensor. A place moves all sensors by one vector: its direction has the axes of
        all of them.
    joints : int
        Joints excited, m.
    second_order : float
        Error of each element beyond the first order, over the rms nominal motion [1].
    """
    opened = np.concatenate([c.open.reshape(len(c.open), -1, joints) for c in changes], axis=1)
    d = opened.shape[1]
    line = _leading(opened)
    measured = np.concatenate([change.measured for change in changes])
    nominal = np.concatenate([change.nominal for change in changes])
    # Sensors err on their own, springs for all of them at once.
    springs = [change.springs for change in changes if change.springs is not None]
    shared = np.concatenate(springs, axis=1) if springs else np.zeros((1, len(measured)))
    covariance = shared.T @ shared
    begin = 0
    for change in changes:
        own = slice(begin, begin := begin + len(change.measured))
        covariance[own, own] = change.covariance
    covariance += second_order**2 * np.mean(nominal**2) * np.eye(len(measured))
    inverse = np.linalg.inv(covariance).reshape(d, joints, d, joints)
    # Least squares over v for each u: the normal equations of c = (u x 1) v.
    weighted = np.einsum("pi,iajb->pajb", line, inverse, optimize=True)
    normal = np.einsum("pajb,pj->pab", weighted, line, optimize=True)
    toward = line @ np.einsum("iajb,jb->ia", inverse, measured.reshape(d, joints))
    # A place that moves no sensor explains nothing.
    normal = normal + np.where(np.any(line, axis=1), 0.0, 1.0)[:, None, None] * np.eye(joints)
    gain = np.einsum("pa,pa->p", toward, np.linalg.solve(normal, toward[..., None])[..., 0])
    axes = len(changes[0].measured) // joints
    at_tool = measured.reshape(d, joints)[:axes]
    return RecordScatter(
        directions=_leading(opened[:, :axes]),
        direction=np.linalg.eigh(at_tool @ at_tool.T)[1][:, -1],
        gain=gain,
        joints=joints,
    )


def _leading(matrices: Array) -> Array:
    """Leading left singular vectors (P, D) of matrices (P, D, m); zero where a matrix is."""
    right = np.linalg.eigh(np.swapaxes(matrices, -1, -2) @ matrices)[1][..., -1]
    left = np.einsum("pdm,pm->pd", matrices, right)
    size = np.linalg.norm(left, axis=1, keepdims=True)
    return np.asarray(left / np.where(size > 0, size, 1.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class PooledScatter:
    """All records so far: how the changes scatter about each place's direction.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.sensors import SensorSuite
    >>> places = PlaceDirections(LinearArm(planar(2)), SensorSuite(), Mismatch())
    >>> lines = np.tile([[1.0, 0.0]], (len(places.features.hypothesis), 1))
    >>> gain = np.where(places.features.hypothesis == 1, 9.0, 1.0)  # link 2 explains it
    >>> seen = RecordScatter(directions=lines, direction=lines[0], gain=gain, joints=2)
    >>> pool = PooledScatter.none(places, outlier=20.0).after(seen)
    >>> pool.names[int(np.argmin(pool.by_hypothesis))], pool.excess
    ('structural_looseness@link2', 3.5)
    """

    names: tuple[str, ...]
    """Hypotheses: a slide of each link, then play in each joint (2 n,)."""
    axes: Array
    """Sliding directions in a link's frame (A, d)."""
    outlier: float
    """Scatter at which a record begins to count as an outlier [1]."""
    scatter: Array
    """Scatter about each place's direction, outliers bounded [1] (P,)."""
    gain: Array
    """Change along it over what errors make of it, summed over the records [1] (P,)."""
    records: int = 0
    """Number of records."""

    @classmethod
    def none(cls, places: PlaceDirections, *, outlier: float) -> PooledScatter:
        """Begin without any record."""
        zero = np.zeros(places.features.locations)
        return cls(names=places.names, axes=places.axes, outlier=outlier, scatter=zero, gain=zero)

    def after(self, record: RecordScatter) -> PooledScatter:
        """Add a record."""
        off = np.maximum(record.gain.max() - record.gain, 0.0)
        off = self.outlier * np.log1p(off / self.outlier)
        return replace(
            self,
            scatter=self.scatter + off,
            gain=self.gain + record.gain / record.joints,
            records=self.records + 1,
        )

    @property
    def excess(self) -> float:
        """Most change along one place, beyond one per record that errors make [1]."""
        return float(self.gain.max()) - self.records

    @property
    def by_hypothesis(self) -> Array:
        """Scatter of every hypothesis [1] (2 n,).

        A slide's is averaged over its directions, so that play, whose line is known beforehand,
        is weighed fairly against a slide, whose direction is fitted.
        """
        slides, plays = self._split(self.scatter)
        least = slides.min(axis=1)
        mean = np.mean(np.exp(-0.5 * (slides - least[:, None])), axis=1)
        return np.concatenate([least - 2 * np.log(mean), plays])

    @property
    def directions(self) -> Array:
        """Direction that fits each link best, in the link's frame (n, d)."""
        return np.asarray(self.axes[self._split(self.scatter)[0].argmin(axis=1)])

    def _split(self, values: Array) -> tuple[Array, Array]:
        """Values of the slides (n, A) and of the plays (n,)."""
        n = len(self.names) // 2
        return values[: n * len(self.axes)].reshape(n, -1), values[n * len(self.axes) :]
