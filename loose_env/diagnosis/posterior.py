"""Posterior over faults from all records by the nominal arm; record likelihood, opening table.

Nuisances are carried on a grid: the direction of the slide, the friction of the guide, and the
stiffness of the bending modes of the arm, if it has any. The opening of the seat differs from
record to record; it is summed out with the probabilities that its drive, friction and load give.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import files

import numpy as np
from scipy.special import logsumexp

from loose_env.arms import Arm, LinearArm, LinearPoses, Mismatch
from loose_env.diagnosis.prediction import (
    INERTIA_ERROR,
    LINEAR_ERROR,
    POWER_ERROR,
    RecordStatistics,
    SeatPrediction,
    SensorFloor,
    channel_noise,
    independent_samples,
    joint_zero_errors,
    joints_on,
    predict_seats,
    seat_drives,
    sensor_errors,
)
from loose_env.errors import InvalidSetting
from loose_env.excitation import SeatReference
from loose_env.faults import KINDS, hypotheses, places_of_kind
from loose_env.inference import whitener
from loose_env.sensors import SensorSuite
from loose_env.statistics import axes_grid
from loose_env.typing import Array, IndexArray

OPENINGS = np.linspace(-0.4, 1.2, 21)
"""Openings s that are tried [1]: 0 shut, 1 floating freely."""
LOOSE = np.concatenate([[0.0], np.geomspace(1e-3, 3.0, 8)])
"""Loose motion out of step that is tried, over that of a freely floating seat [1]."""
SHUT = int(np.argmin(np.abs(OPENINGS)))
"""Index of the shut seat among the openings."""

_OPEN_ERROR = 0.05
"""Relative error of the predicted change of transmission."""
_SPREAD = 0.03
"""Share of loose motion that shows across its direction."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Log-likelihood of B records."""

    log: Array
    """Over openings, loose motion and locations (B, S, Q, P), or whatever it is (B, S, 1, P)."""
    force: Array
    """Rms force that each shut seat transmits in the record (B, P)."""
    load: Array
    """Force that gravity puts on each seat at rest (B, P)."""


def fit_records(
    poses: LinearPoses,
    records: RecordStatistics,
    directions: Array,
    floor: SensorFloor,
    mismatch: Mismatch,
) -> Fit:
    """Likelihood of B records with equally many joints excited, for sliding directions (A, axes).

    Three things are compared with what each seat would do. The part of the tool's motion that
    does not follow the joint as measured, a - B x, must not follow the command either. The
    apparent inertia must be the predicted one. The covariance of a - B x must be what the
    arm's modes, the sensors and the loose seat leave (a Wishart density). With several joints
    excited at once only the first is asked.
    """
    arm, on = poses.linear.arm, joints_on(records.torque)
    d, m = records.tool_covariance.shape[-1], on.shape[1]
    noise = channel_noise(floor, arm, on)
    one = m == 1
    seats = predict_seats(poses, records.torque, directions, noise, free=one, opening=one)
    samples = independent_samples(arm, records.duration)

    b, residual = unexplained(records, seats, least=0.0 if m > 1 else -np.inf)
    # Error floor of float32 readings and the linear model.
    total = np.trace(records.tool_covariance, axis1=1, axis2=2)
    floors = (1e-3 * floor.tool**2 + LINEAR_ERROR**2 * total)[:, None, None] * np.eye(d)
    residual += floors
    away = away_from(b)
    log, x = _in_step(poses, on, b, away, residual, samples, seats, mismatch)
    if m > 1:
        return Fit(log=log[:, :, None], force=seats.force, load=seats.load)

    def each(values: Array) -> Array:
        """One number a record, before openings and locations."""
        return np.asarray(values)[:, None, None]

    inertia = np.take_along_axis(records.inertia, on, axis=1)[:, 0]
    torque = np.take_along_axis(records.torque, on, axis=1)[:, 0]
    expected = each(torque / inertia) / np.where(np.abs(x) < 1e-9, 1e-9, x)
    error = np.sqrt(INERTIA_ERROR**2 + 1 / samples)
    log -= 2.5 * np.log(1 + ((expected - 1) / each(error)) ** 2 / 4)

    s = OPENINGS[:, None]
    mixed, opened = (part[:, None, :, 0, 0] for part in (seats.rest_mixed, seats.rest_open))
    power = x**2 + each(seats.rest[:, 0, 0] - noise[:, 0]) + s * mixed + s**2 * opened
    # Scaled to the joint motion that was measured: the command's own power drops out.
    own = np.take_along_axis(records.joint_rms, on, axis=1)[:, 0] ** 2
    scale = np.maximum(own - noise[:, 0], 0.1 * noise[:, 0])
    scale = each(scale) / np.maximum(power, each(1e-3 * seats.in_step[:, 0, 0] ** 2))
    scale = np.clip(scale, 0.2, 5.0)
    # Sensor noise is no motion: it does not scale.
    sensed = away @ (noise[..., None] * away.mT)
    fixed_part = _elements(sensed + floors + 1e-12 * np.eye(d))[..., None, None]
    healthy = _elements(away @ seats.rest @ away.mT - sensed)[..., None, None]
    away = away[:, None]
    changed = (away @ part @ away.mT for part in (seats.rest_mixed, seats.rest_open))
    linear, square = (_elements(part)[:, :, None] for part in changed)
    loose = away @ seats.loose @ away.mT
    loose += _SPREAD * np.trace(loose, axis1=2, axis2=3)[..., None, None] * np.eye(d)
    fixed = (healthy + s * linear + s**2 * square) * scale + fixed_part
    degrees = 2 / (2 / samples + POWER_ERROR**2)
    measured = np.log(np.maximum(np.linalg.det(residual), _TINY))
    found = wishart_fit(
        _elements(residual)[..., None, None], fixed, _elements(loose)[:, :, None], LOOSE,
        each(degrees)[..., None], each(measured)[..., None],
    )  # fmt: skip
    found += log[:, :, None]
    return Fit(log=found, force=seats.force, load=seats.load)


def away_from(b: Array) -> Array:
    """Matrix that takes from the tool's motion what follows the joints (..., d, m + d)."""
    eye = np.broadcast_to(np.eye(b.shape[-2]), (*b.shape[:-1], b.shape[-2]))
    return np.concatenate([-b, eye], axis=-1)


def unexplained(
    records: RecordStatistics, seats: SeatPrediction, *, least: float
) -> tuple[Array, Array]:
    """Transmission by instrument (B, d, m), and covariance of what it leaves of the tool's motion.

    With several joints their covariance is only predicted, and more may be taken off than was
    there: no eigenvalue falls below ``least``.
    """
    on = joints_on(records.torque)
    m, b = on.shape[1], at_joints(records.transmission_by_instrument, on)
    rms = np.take_along_axis(records.joint_rms, on, axis=1)
    joint = joint_covariance(rms, seats.in_step[:, :m], seats.rest[:, :m, :m])
    mixed = joint @ at_joints(records.transmission, on).mT
    residual = records.tool_covariance - b @ mixed - mixed.mT @ b.mT + b @ joint @ b.mT
    if np.isfinite(least):
        size, along = np.linalg.eigh(residual)
        residual = along @ (np.maximum(size, least)[..., None] * along.mT)
    return b, residual


def at_joints(values: Array, on: IndexArray) -> Array:
    """Columns (B, d, m) of some joints (B, m) among those of all (B, d, n)."""
    return np.take_along_axis(values, on[:, None], axis=2)


def joint_covariance(rms: Array, in_step: Array, rest: Array) -> Array:
    """Covariances of the excited joints (B, m, m): strong as measured, correlated as predicted."""
    predicted = in_step @ in_step.mT + rest
    scale = rms / np.sqrt(np.diagonal(predicted, axis1=1, axis2=2))
    return np.asarray(predicted * (scale[:, :, None] * scale[:, None]))


def _in_step(
    poses: LinearPoses,
    on: IndexArray,
    b: Array,
    away: Array,
    residual: Array,
    samples: Array,
    seats: SeatPrediction,
    mismatch: Mismatch,
) -> tuple[Array, Array]:
    """Log-density of "a - B x does not follow the command" (B, S, P).

    And the motion of the joint by its command there, for one joint.
    """
    d, m = b.shape[1:]
    healthy, opened = seats.in_step, seats.in_step_open
    # Unit of the residual: joint motion as predicted, so that the density is one of B.
    x = np.sqrt((healthy[:, :m] ** 2).sum(-1))
    errors = transmission_errors(poses, on, b, mismatch)
    uncertain = (errors * x[:, None, None]).reshape(*errors.shape[:2], d * m)
    sampling = np.einsum("bij,kl->bikjl", residual / samples[:, None, None], np.eye(m))
    covariance = uncertain.mT @ uncertain + sampling.reshape(-1, d * m, d * m)
    nominal = healthy[:, m:] @ np.linalg.inv(healthy[:, :m])
    off = (((b - nominal) * x[:, None]) ** 2).sum((1, 2))
    covariance += _OPEN_ERROR**2 * off[:, None, None] * np.eye(d * m)
    # The residual is linear in the opening, and so is its white form.
    white = whitener(covariance)
    shut = ((away @ healthy).reshape(len(b), 1, -1) @ white.mT).mT
    change = ((away[:, None] @ opened).reshape(len(b), -1, d * m) @ white.mT).mT
    s = OPENINGS[:, None]
    square, mixed = (change**2).sum(1)[:, None], (shut * change).sum(1)[:, None]
    far = np.maximum((shut**2).sum(1)[:, None] + s * (2 * mixed + s * square), 0.0)
    # Heavier tails than normal: mismatch is cut off, not Gaussian, and shared by all records.
    fit = -0.5 * (5 + d * m) * np.log(1 + far / 5)
    if m == 1:
        motion = healthy[:, :1, :1] + s * opened[:, None, :, 0, 0]
    else:
        # A polynomial of the opening, of degree m: worked out at as many nodes as it takes.
        nodes = np.linspace(OPENINGS[0], OPENINGS[-1], m + 1)
        of_joints = opened[:, :, None, :m] * nodes[:, None, None]
        between = np.linalg.solve(np.vander(nodes).T, np.vander(OPENINGS, m + 1).T)
        motion = (np.linalg.det(healthy[:, None, None, :m] + of_joints) @ between).mT
    size = np.abs(motion) / np.prod(x, axis=1)[:, None, None]
    return fit + d * np.log(np.maximum(size, 1e-9)), motion


def transmission_errors(poses: LinearPoses, on: IndexArray, b: Array, mismatch: Mismatch) -> Array:
    """Changes of transmissions (B, d, m) by each error of the model [m] (B, K, d, m)."""
    zeros = joint_zero_errors(poses.linear, poses.pose, mismatch)
    # Lengths in the rough: each tool axis by as much as the longest lever would change.
    d = b.shape[1]
    longest = mismatch.length * np.abs(b).max(axis=(1, 2))
    longer = longest[:, None, None, None] * np.eye(d)[..., None] * np.ones(b.shape[2])
    own = np.take_along_axis(zeros, on[:, None, None], axis=3)
    return np.concatenate([sensor_errors(b, mismatch), own, longer], axis=1)


_TINY = 1e-300


def wishart_fit(
    found: Array, fixed: Array, added: Array, amounts: Array, degrees: Array, measured: Array
) -> Array:
    """Log-density of covariances, less its highest value: 0 where expectation meets it.

    ``-degrees / 2 (tr(E⁻¹ F) - d - ln det(E⁻¹ F))``, the log-density of Wishart's distribution of
    ``degrees * F`` with scale E up to a constant, for E = ``fixed + amount * added`` at all amounts
    (B, S, Q, P). Determinant and trace are ratios of polynomials in the amount, of which the
    coefficients are worked out once for all amounts. Matrices are their `_elements` (., B, S, P),
    ``measured`` is ln det F.
    """
    d = 2 if len(found) == 3 else 3
    of_fixed, of_added = _cofactors(fixed), _cofactors(added)
    if d == 2:  # det(A + q B) = det A + q tr(adj A B) + q² det B
        determinant = [_dot(fixed, of_fixed) / 2, _dot(of_fixed, added), _dot(added, of_added) / 2]
        numerator = [_dot(of_fixed, found), _dot(of_added, found)]
    else:
        both = _cofactors(added + found) - of_added - _cofactors(found)
        determinant = [_dot(fixed, of_fixed) / 3, _dot(of_fixed, added)]
        determinant += [_dot(fixed, of_added), _dot(added, of_added) / 3]
        numerator = [_dot(of_fixed, found), _dot(fixed, both), _dot(of_added, found)]
    expected = _polynomial(determinant, amounts)
    np.maximum(expected, _TINY, out=expected)
    log = _polynomial(numerator, amounts)
    log /= expected
    log += np.log(expected, out=expected)
    log -= d + measured
    log *= -0.5 * degrees
    return log


def _polynomial(coefficients: list[Array], at: Array) -> Array:
    """Values of polynomials (B, S, P), lowest coefficient first, at all points (B, S, Q, P)."""
    stacked = np.empty((*coefficients[0].shape[:2], len(coefficients), coefficients[0].shape[2]))
    for k, own in enumerate(coefficients):
        stacked[:, :, k] = own
    return np.asarray(np.vander(at, len(coefficients), increasing=True) @ stacked)


def _elements(m: Array) -> Array:
    """Elements of symmetric matrices (..., d, d): the diagonal, then those above it (., ...)."""
    rows, columns = np.triu_indices(m.shape[-1], 1)
    both = np.arange(m.shape[-1])
    return np.moveaxis(m[..., [*both, *rows], [*both, *columns]], -1, 0)


def _dot(a: Array, b: Array) -> Array:
    """Trace of the product of symmetric matrices, given as `_elements`."""
    if len(a) == 3:
        return np.asarray(a[0] * b[0] + a[1] * b[1] + 2 * a[2] * b[2])
    on = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return np.asarray(on + 2 * (a[3] * b[3] + a[4] * b[4] + a[5] * b[5]))


def _cofactors(m: Array) -> Array:
    """Cofactors of symmetric 2 x 2 or 3 x 3 matrices, all as `_elements`."""
    if len(m) == 3:
        return np.stack([m[1], m[0], -m[2]])
    a, d, f, b, c, e = m
    on = [d * f - e * e, a * f - c * c, a * d - b * b]
    return np.stack([*on, c * e - b * f, b * e - c * d, b * c - a * e])


RATIOS = np.geomspace(0.05, 100.0, 20)
"""Driving force over friction at the nodes of the table [1]."""
PRESSES = np.array([0.0, 0.15, 0.3, 0.5, 1.0])
"""Gravity over the sum of gravity and driving force at the nodes of the table [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpeningTable:
    """Probabilities of openings and loose motion."""

    slide: Array
    """For slides (presses, ratios, openings, loose motion)."""
    hinge: Array
    """For play in joints (presses, ratios, openings, loose motion)."""

    @staticmethod
    def nodes(force: Array, friction: Array, load: Array) -> list[tuple[IndexArray, Array]]:
        """Four nodes about seats that are driven, held and loaded by forces (...) [N, or N·m].

        Each with its index, the tables' first two axes taken as one, and its weight, linear in the
        press and in the logarithm of the ratio.
        """
        ratio = np.maximum(force / friction, RATIOS[0])
        lower, upper = _between(np.log(ratio), np.log(RATIOS))
        few, many = _between(load / np.maximum(load + force, 1e-300), PRESSES)
        return [
            ((few + i) * len(RATIOS) + lower + j, a * b)
            for i, a in enumerate((1 - many, many))
            for j, b in enumerate((1 - upper, upper))
        ]


def _between(values: Array, nodes: Array) -> tuple[IndexArray, Array]:
    """Lower node of each value, and the share of the next one."""
    position = np.interp(values, nodes, np.arange(len(nodes)))
    lower = np.minimum(position.astype(np.intp), len(nodes) - 2)
    return lower, position - lower


@lru_cache(maxsize=1)
def shipped_table() -> OpeningTable:
    """Return the table that ships with the package."""
    text = files("loose_env.diagnosis").joinpath("opening.json").read_text(encoding="utf-8")
    stored = json.loads(text)
    return OpeningTable(slide=np.array(stored["slide"]), hinge=np.array(stored["hinge"]))


@dataclass(frozen=True, kw_only=True)
class PosteriorSettings:
    """Prior over faults and grid of the posterior."""

    friction: tuple[float, float] = (0.02, 1.0)
    """Range of guide friction over the seat drive of the top level, log-uniform [1]."""
    friction_over: SeatReference = "median"
    """Pose whose seat drive friction is compared to."""
    frictions: int = 8
    """Nodes of friction."""
    directions: int = 18
    """Sliding directions tried over half a turn, for an arm that moves in a plane."""
    space_directions: int = 200
    """Sliding directions tried over the half sphere, for an arm in space."""
    mismatch: Mismatch = field(default_factory=Mismatch)
    """Standard deviations of the nominal model's errors."""
    kinds: Mapping[str, float] = field(
        default_factory=lambda: {"healthy": 1 / 3, "structural_looseness": 1 / 3, "backlash": 1 / 3}
    )
    """Prior probability of each kind of fault."""
    temper: float = 0.8
    """Exponent on each record's likelihood: records of one arm share their mismatch."""

    def __post_init__(self) -> None:
        if not 0 < self.friction[0] <= self.friction[1] < np.inf:
            raise InvalidSetting(f"friction must be 0 < low <= high, got {self.friction}")
        if self.frictions < 1 or self.directions < 2 or self.space_directions < 3:
            raise InvalidSetting(
                "at least one friction, two directions in the plane and three in space are "
                f"needed, got {self.frictions}, {self.directions} and {self.space_directions}"
            )
        beyond = [k for k, share in self.kinds.items() if k not in KINDS and share > 0]
        if beyond:
            raise InvalidSetting(
                f"the posterior has no model of {beyond}: keep to the kinds {list(KINDS)}"
            )
        if not 0 < self.temper <= 1:
            raise InvalidSetting(f"temper must be above 0 and at most 1, got {self.temper}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """Log-weights of all hypotheses and their parameters."""

    healthy: Array
    """Of the healthy arm, by variant of the arm (V,)."""
    loose: Array
    """Of each location and friction, by variant (V, P, F)."""
    links: int
    """Number of links."""
    directions: Array
    """Sliding directions of a link in its frame, unit vectors (A, axes)."""

    @property
    def probabilities(self) -> Array:
        """Probability of each of the posterior's hypotheses, in their order."""
        slides, top = self.loose.shape[1] - self.links, max(self.loose.max(), self.healthy.max())
        by_place = np.exp(self.loose - top).sum((0, 2))
        by_link = by_place[:slides].reshape(self.links, -1).sum(1)
        weight = np.concatenate([[np.exp(self.healthy - top).sum()], by_link, by_place[slides:]])
        return np.asarray(weight / weight.sum())

    def by_direction(self, link: int) -> Array:
        """Probability of each sliding direction, if that link is loose (A,)."""
        slides = self.loose.shape[1] - self.links
        log = logsumexp(self.loose, axis=(0, 2))[:slides].reshape(self.links, -1)[link - 1]
        return np.asarray(np.exp(log - logsumexp(log)))

    def axis(self, link: int) -> Array:
        """Mean sliding direction of a link in its frame, a unit vector without sign (3,).

        Directions count by their probability if that link is loose; the mean is the leading
        eigenvector of the sum of their outer products.
        """
        u = self.directions
        mean = np.linalg.eigh(np.einsum("a,ai,aj->ij", self.by_direction(link), u, u))[1][:, -1]
        return np.concatenate([mean, np.zeros(3 - len(mean))])


class FaultPosterior:
    """Bayes' rule over faults, with the nominal arm as the only model.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm, in a plane or in space.
    sensors : SensorSuite
        Figures of the sensors.
    settings : PosteriorSettings, optional
        Ranges and priors.

    Raises
    ------
    InvalidSetting
        If the tool is read along one axis only.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> posterior = FaultPosterior(LinearArm(planar(2)), SensorSuite())
    >>> posterior.start().probabilities.round(3).tolist()
    [0.333, 0.167, 0.167, 0.167, 0.167]
    """

    def __init__(
        self,
        linear: LinearArm,
        sensors: SensorSuite,
        settings: PosteriorSettings | None = None,
    ) -> None:
        self.settings = PosteriorSettings() if settings is None else settings
        arm = linear.arm
        axes = linear.slide_dofs.shape[1]
        if axes not in (2, 3):
            raise InvalidSetting(
                f"arm {arm.name!r} reads {axes} axis at its tool; the posterior needs 2, for "
                "an arm that moves in a plane, or 3"
            )
        self.linear, self.hypotheses = linear, hypotheses(arm, everywhere=True)
        self.table = shipped_table()
        self.floor = SensorFloor.of(sensors, arm.band)
        count = self.settings.directions if axes == 2 else self.settings.space_directions
        self.directions = axes_grid(count, axes)
        self.variants, self._weights = variants(linear.thinned(), self.settings.mismatch.stiffness)
        self.frictions = friction_nodes(self.settings.friction, self.settings.frictions)
        """Nodes of friction over the seat drive of the top level [1] (F,)."""
        driven = seat_drives(linear, self.directions, self.settings.friction_over)
        self._friction = driven[:, None] * self.frictions  # (P, F)

    def start(self) -> Belief:
        """Return the prior."""
        nodes = self.settings.frictions
        prior = log_prior(self.linear.arm, self.settings.kinds)
        share = location_prior(prior, len(self.directions))
        return Belief(
            healthy=prior[0] + self._weights,
            loose=np.repeat((share - np.log(nodes))[:, None], nodes, 1)
            + self._weights[:, None, None],
            links=self.linear.arm.n,
            directions=self.directions,
        )

    def update(self, belief: Belief, record: RecordStatistics) -> Belief:
        """Take in one record; the order of records does not matter."""
        return self.update_all([belief], record.several)[0]

    def update_all(self, beliefs: Sequence[Belief], records: RecordStatistics) -> list[Belief]:
        """Take one record each into B beliefs; they do not depend on each other."""
        settings, found = self.settings, list(beliefs)
        few = max(1, _CELLS // (self._friction.shape[0] * len(OPENINGS) * len(LOOSE)))
        for rows in alike(records, few):
            own = records[rows]
            poses = self.variants[0].at_all(own.pose)
            fits = [  # springs change no inertia: every variant stands as the first does
                fit_records(
                    replace(poses, linear=arm), own, self.directions, self.floor, settings.mismatch
                )
                for arm in self.variants
            ]
            healthy = np.stack([fit.log[:, SHUT, 0, 0] for fit in fits], axis=1)
            loose = np.stack([self._summed(fit) for fit in fits], axis=1)
            for k, row in enumerate(rows):
                found[row] = replace(
                    found[row],
                    healthy=found[row].healthy + settings.temper * healthy[k],
                    loose=found[row].loose + settings.temper * loose[k],
                )
        return found

    def _summed(self, fit: Fit) -> Array:
        """Sum the records' likelihoods over openings and loose motion (B, P, F)."""
        slides = self.linear.arm.n * len(self.directions)
        cells = fit.log.reshape(len(fit.log), -1, fit.log.shape[-1])
        top = cells.max(axis=(1, 2), keepdims=True)
        likelihood = np.exp(cells - top)
        by_node = np.empty((len(cells), len(RATIOS) * len(PRESSES), cells.shape[-1]))
        for table, places in (
            (self.table.slide, slice(0, slides)),
            (self.table.hinge, slice(slides, None)),
        ):
            shares = table if fit.log.shape[2] > 1 else table.sum(axis=3)
            shares = shares.reshape(by_node.shape[1], -1)
            by_node[..., places] = shares @ likelihood[..., places]
        nodes = self.table.nodes(fit.force[:, None], self._friction.T, fit.load[:, None])
        rows, columns = np.arange(len(cells))[:, None, None], np.arange(cells.shape[-1])
        mixed = sum(weight * by_node[rows, node, columns] for node, weight in nodes)
        return np.asarray(np.log(np.maximum(mixed, 1e-300)) + top).mT


_CELLS = 800_000
"""Likelihoods worked out at once: what the processor's cache holds."""


def alike(records: RecordStatistics, few: int) -> Iterator[IndexArray]:
    """Rows of records in which equally many joints are on, a few at a time."""
    excited = np.count_nonzero(records.torque, axis=1)
    for count in np.unique(excited):
        rows = np.flatnonzero(excited == count)
        yield from (rows[k : k + few] for k in range(0, len(rows), few))


def log_prior(arm: Arm, kinds: Mapping[str, float]) -> Array:
    """Log-probability of the hypotheses: healthy, slides, plays that are felt (1 + 2 n,)."""
    n = arm.n
    felt = np.isin(np.arange(1, n + 1), places_of_kind(arm, "backlash"))
    slides = np.full(n, kinds.get("structural_looseness", 0.0) / n)
    plays = felt * kinds.get("backlash", 0.0) / max(felt.sum(), 1)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.concatenate([[kinds.get("healthy", 0.0)], slides, plays])))


def location_prior(prior: Array, directions: int) -> Array:
    """Log-probability of every location: a link's is shared by its sliding directions (P,)."""
    n = (len(prior) - 1) // 2
    return np.concatenate(
        [np.repeat(prior[1 : n + 1] - np.log(directions), directions), prior[n + 1 :]]
    )


def friction_nodes(friction: tuple[float, float], count: int) -> Array:
    """Middles of equal parts of a range of friction, log-uniform (count,)."""
    low, high = np.log(friction)
    return np.asarray(np.exp(low + (high - low) * (np.arange(count) + 0.5) / count))


def variants(linear: LinearArm, stiffness: float) -> tuple[list[LinearArm], Array]:
    """Arms whose bending modes are softer and stiffer than nominal, with their log-weights.

    An arm without bending modes has one variant: itself.
    """
    if not len(linear.flexible_dofs) or stiffness == 0:
        return [linear], np.zeros(1)
    offsets, base = np.linspace(-1.8, 1.8, 6), LinearArm(linear.arm, points=120, remember=16)
    bending, arms = base.model.dof_jntid[base.flexible_dofs], []
    for offset in offsets:
        model = copy(base.model)
        model.jnt_stiffness[bending] *= np.exp(stiffness * offset)
        arms.append(base.variant(base.arm, model))
    log = -0.5 * offsets**2
    return arms, np.asarray(log - logsumexp(log))
