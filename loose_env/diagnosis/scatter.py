"""Scatter of measured motion changes about each fault location's direction, over records.

Errors of sensors, joint zeros and springs are those of the arm, the same in every record: they are
fitted beside the place over all records, within their standard deviations. Counted anew in every
record, they would add up in healthy arms as a fault does, and hide half of what poses tell.

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
from scipy import stats

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.directions import fault_locations
from loose_env.diagnosis.features import (
    SeatFeatures,
    TransmissionChange,
    sampling_covariance,
)
from loose_env.diagnosis.prediction import (
    LinkReadings,
    RecordStatistics,
    independent_samples,
    sensed_arms,
)
from loose_env.errors import InvalidSetting
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

_AXES = {2: 60, 3: 300}
"""Sliding directions tried for each link by dimension: 3 and 8 degrees apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordScatter:
    """One record: its change of motion, the errors of that, and the direction of every place."""

    lines: Array
    """Direction that each place predicts, axes of all sensors (P, D); zero where it moves none."""
    directions: Array
    """The same at the tool, tool frame, axial (P, d)."""
    direction: Array
    """Direction of the measured change, tool frame, axial (d,)."""
    measured: Array
    """Measured change of motion [m/s²] (D m,)."""
    precision: Array
    """Inverse covariance of its errors that no other record shares (D m, D m)."""
    shared: Array
    """Errors that the records of an arm share, one standard deviation each (K, D m)."""
    joints: int
    """Joints shaken, m."""

    @property
    def gain(self) -> Array:
        """Part of the change that lies along each place's direction, chi-square [1] (P,)."""
        misfit = _Left().after(self, self.measured[None]).misfit()[:, 0]
        return np.asarray(misfit[-1] - misfit[:-1])


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
        change = self._at_tool(record)
        sampling = self.sampling(record, [self.features])
        return scatter_of([change], int(record.excited.sum()), sampling=sampling)

    def _at_tool(self, record: RecordStatistics) -> TransmissionChange:
        on = np.flatnonzero(record.excited)
        return self.features.change_at(record, record.transmission_by_instrument[:, on])

    def sampling(self, record: RecordStatistics, sensors: Sequence[SeatFeatures]) -> Array:
        """Covariance of what the finite length of a record makes of the changes at some sensors.

        Predicted, not measured: the measured motion out of step is a difference of two large
        numbers where the arm bends, by chance often below zero, and where a seat is loose it is the
        seat's, along the seat's own direction, and no error of that place. [m²/s⁴] (D m, D m), axes
        of all sensors.
        """
        on = np.flatnonzero(record.excited)
        answers = [one.linear.at(record.pose).response(record.excited) for one in sensors]
        tool = np.concatenate([answer.tool for answer in answers], axis=1)  # (K, D, m)
        joint = answers[0].joint[:, on]
        b = np.linalg.solve(joint.real.mean(axis=0).T, tool.real.mean(axis=0).T).T
        floor = self.features.floor
        noise = floor.tool**2 * np.eye(len(b))
        noise += (b * floor.joints(self.features.linear.arm)[on] ** 2) @ b.T
        rest = (tool - b @ joint) * record.torque[on]
        samples = independent_samples(self.features.linear.arm, record.duration)
        return sampling_covariance(rest, noise, samples)


def scatter_of(
    changes: Sequence[TransmissionChange],
    joints: int,
    *,
    sampling: Array,
) -> RecordScatter:
    """Hold the change at the tool, and at further sensors, against the direction of every place.

    A place moves all sensors by one vector: its direction has the axes of all of them. ``sampling``
    is the covariance of the sampling errors of all axes [m²/s⁴] (D m, D m).
    """
    measured = np.concatenate([change.measured for change in changes])
    nominal = np.concatenate([change.nominal for change in changes])
    opened = np.concatenate([c.open.reshape(len(c.open), -1, joints) for c in changes], axis=1)
    own = sampling.copy()
    shared = np.concatenate([_rows(change.arm_errors, change) for change in changes], axis=1)
    first = np.sum(shared**2) / len(measured)
    begin = 0
    for change in changes:
        part = slice(begin, begin := begin + len(change.measured))
        sensor = _rows(change.sensor_errors, change)
        first += np.sum(sensor**2) / len(measured)
        if len(changes) == 1:
            shared = np.concatenate([shared, sensor])
        else:
            own[part, part] += sensor.T @ sensor
    # With sensors on links too, the errors of each are left among those of the record: as shared
    # ones they would be a hundred.
    # Products of two errors, twice the square of all to first order; no more than twice these.
    own += (2 * first) ** 2 / max(np.mean(nominal**2), first, 1e-300) * np.eye(len(measured))
    axes = len(changes[0].measured) // joints
    at_tool = measured.reshape(-1, joints)[:axes]
    lines = _leading(opened)
    return RecordScatter(
        lines=lines,
        directions=lines if len(changes) == 1 else _leading(opened[:, :axes]),
        direction=np.linalg.eigh(at_tool @ at_tool.T)[1][:, -1],
        measured=measured,
        precision=np.asarray(np.linalg.inv(own), dtype=float),
        shared=shared,
        joints=joints,
    )


def _rows(errors: Array | None, change: TransmissionChange) -> Array:
    return np.zeros((0, len(change.measured))) if errors is None else errors


def _leading(matrices: Array) -> Array:
    """Leading left singular vectors (P, D) of matrices (P, D, m); zero where a matrix is."""
    if matrices.shape[1] <= matrices.shape[2]:
        left = np.linalg.eigh(matrices @ matrices.mT)[1][..., -1]
        return np.asarray(left * np.any(matrices, axis=(1, 2))[:, None])
    right = np.linalg.eigh(matrices.mT @ matrices)[1][..., -1]
    left = np.einsum("pdm,pm->pd", matrices, right)
    size = np.linalg.norm(left, axis=1, keepdims=True)
    return np.asarray(left / np.where(size > 0, size, 1.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Left:
    """Misfit of every place, and of none, as a quadratic form in the shared errors.

    Of B sets of changes: those measured, or draws of what errors alone make of the same records.
    """

    constant: Array | float = 0.0
    """At shared errors of zero (P + 1, B)."""
    slope: Array | float = 0.0
    """Half of minus its slope there (P + 1, B, K)."""
    curvature: Array | float = 0.0
    """Half of its second derivative (P + 1, K, K)."""

    def after(self, record: RecordScatter, changes: Array) -> _Left:
        """Add a record with changes (B, D m), the joints' shares in each motion eliminated."""
        m, line, w = record.joints, record.lines, record.precision
        d, count = len(w) // m, len(changes)
        known = np.concatenate([changes, record.shared])
        whole = known @ w @ known.T
        weighted = np.einsum("pi,iajb->pajb", line, w.reshape(d, m, d, m), optimize=True)
        normal = np.einsum("pajb,pj->pab", weighted, line, optimize=True)
        # A place that moves no sensor explains nothing.
        normal = normal + np.where(np.any(line, axis=1), 0.0, 1.0)[:, None, None] * np.eye(m)
        toward = (weighted.reshape(-1, d * m) @ known.T).reshape(len(line), m, len(known))
        solved = np.linalg.solve(normal, toward)

        def added(first: slice, second: slice) -> Array:
            """Part of the quadratic form, for every place and for none."""
            taken = toward[..., first].mT @ solved[..., second]
            part = whole[first, second]
            return np.concatenate([part - taken, part[None]])

        sets, errors = slice(0, count), slice(count, None)
        own = np.diagonal(whole)[:count]
        taken = np.einsum("pmb,pmb->pb", toward[..., sets], solved[..., sets])
        return _Left(
            constant=self.constant + np.concatenate([own - taken, own[None]]),
            slope=self.slope + added(sets, errors),
            curvature=self.curvature + added(errors, errors),
        )

    def misfit(self) -> Array:
        """Smallest misfit over the shared errors, their own size counted (P + 1, B)."""
        slope, curvature = np.asarray(self.slope), np.asarray(self.curvature)
        best = np.linalg.solve(np.eye(slope.shape[-1]) + curvature, slope.mT)
        return np.asarray(self.constant - np.einsum("pbk,pkb->pb", slope, best))


@dataclass(frozen=True, kw_only=True, eq=False)
class PooledScatter:
    """All records so far: how the changes scatter about each place's direction.

    Errors of the arm and of its sensors are the same in every record: what they may be is fitted
    beside the place, and counted once.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.sensors import SensorSuite
    >>> places = PlaceDirections(LinearArm(planar(2)), SensorSuite(), Mismatch())
    >>> slide = places.features.hypothesis == 1  # link 2 explains it
    >>> lines = np.where(slide[:, None], [1.0, 0.0], [0.0, 1.0])
    >>> seen = RecordScatter(
    ...     lines=lines,
    ...     directions=lines,
    ...     direction=lines[0],
    ...     measured=np.array([3.0, 3.0, 0, 0]),
    ...     precision=np.eye(4),
    ...     shared=np.zeros((0, 4)),
    ...     joints=2,
    ... )
    >>> pool = PooledScatter.none(places, outlier=20.0).after(seen)
    >>> pool.names[int(np.argmin(pool.by_hypothesis))], round(pool.gain, 6)
    ('structural_looseness@link2', 18.0)
    >>> pool.stands_out(0.01, np.random.default_rng(0))
    True
    """

    names: tuple[str, ...]
    """Hypotheses: a slide of each link, then play in each joint (2 n,)."""
    axes: Array
    """Sliding directions in a link's frame (A, d)."""
    outlier: float
    """Scatter at which a record begins to count as an outlier [1]."""
    scatter: Array
    """Scatter about each place's direction, outliers bounded [1] (P,)."""
    misfit: Array
    """Misfit of each place, then of no place: chi-square with the best shared errors (P + 1,)."""
    left: _Left
    """What the records leave to the shared errors."""
    records: tuple[RecordScatter, ...] = ()
    """The records."""

    @classmethod
    def none(cls, places: PlaceDirections, *, outlier: float) -> PooledScatter:
        """Begin without any record."""
        count = places.features.locations
        return cls(
            names=places.names,
            axes=places.axes,
            outlier=outlier,
            scatter=np.zeros(count),
            misfit=np.zeros(count + 1),
            left=_Left(),
        )

    def after(self, record: RecordScatter) -> PooledScatter:
        """Add a record."""
        left = self.left.after(record, record.measured[None])
        misfit = left.misfit()[:, 0]
        # What the record adds, given those before it.
        off = (misfit - self.misfit)[:-1]
        off = self.outlier * np.log1p((off - off.min()) / self.outlier)
        return replace(
            self,
            scatter=self.scatter + off,
            misfit=misfit,
            left=left,
            records=(*self.records, record),
        )

    @property
    def gain(self) -> float:
        """Most change that one place explains, chi-square [1]; zero before any record."""
        return float(self.misfit[-1] - self.misfit[:-1].min())

    def stands_out(self, significance: float, rng: np.random.Generator) -> bool:
        """Tell whether errors alone make so much change along one place with less probability.

        Nothing is drawn where one place alone decides, its gain chi-square with a degree of freedom
        for each joint shaken: errors along several places make more than along one, and at most as
        much as the sum of their probabilities says.
        """
        if not self.records:
            return False
        by_one = float(stats.chi2.sf(self.gain, sum(record.joints for record in self.records)))
        if by_one >= significance or by_one * len(self.scatter) < significance:
            return by_one < significance
        return self.chance(rng) < significance

    def chance(self, rng: np.random.Generator, *, draws: int = 64) -> float:
        """Probability that errors alone make so much change along one place [1].

        It depends on all that the records are: number, lengths, joints shaken, poses and shared
        errors. So errors are drawn for these very records, by the covariances that the changes are
        held against, and the largest gain of each draw is noted. A gamma distribution with the mean
        and the variance of these gains gives the tail that so few draws do not reach.
        """
        if not self.records:
            return 1.0
        left = _Left()
        shared = rng.standard_normal((draws, len(self.records[0].shared)))
        for record in self.records:
            own = rng.standard_normal((len(record.measured), draws))
            own = np.linalg.solve(np.linalg.cholesky(record.precision).T, own).T
            left = left.after(record, own + shared @ record.shared)
        misfit = left.misfit()
        gains = misfit[-1] - misfit[:-1].min(axis=0)
        mean, variance = gains.mean(), gains.var()
        return float(stats.gamma.sf(self.gain, mean**2 / variance, scale=variance / mean))

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


class SensedPlaces(PlaceDirections):
    """Holds records of tool and link accelerometers against the places of an arm.

    Places are those of `PlaceDirections`.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    sensors : SensorSuite
        Parameters of the sensors, accelerometers on links among them.
    mismatch : Mismatch
        Errors of the nominal model.

    Raises
    ------
    InvalidSetting
        If there are no accelerometers on links, or they measure one axis only.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> suite = SensorSuite(link_accelerometers=True)
    >>> SensedPlaces(LinearArm(planar(2)), suite, Mismatch()).names[0]
    'structural_looseness@link1'
    """

    def __init__(self, linear: LinearArm, sensors: SensorSuite, mismatch: Mismatch) -> None:
        super().__init__(linear, sensors, mismatch)
        choice = sensors.on_links
        if choice is None:
            raise InvalidSetting(
                "the local method needs accelerometers on links and the sensors have none; set "
                "link_accelerometers=True in SensorSuite"
            )
        if choice.tangential:
            raise InvalidSetting(
                "the local method needs all axes of the accelerometers on links, and tangential "
                "ones measure one; set tangential=False"
            )
        arms = sensed_arms(linear.arm, choice)
        self._links = [self.features.sensed_at(arm) for arm in arms]

    def with_links(self, record: RecordStatistics, links: LinkReadings) -> RecordScatter:
        """Hold one record of all sensors against all places."""
        on = np.flatnonzero(record.excited)
        changes = [self._at_tool(record)]
        read = zip(self._links, links.transmission_by_instrument, strict=True)
        changes += [one.change_at(record, b[:, on]) for one, b in read]
        sampling = self.sampling(record, [self.features, *self._links])
        return scatter_of(changes, len(on), sampling=sampling)
