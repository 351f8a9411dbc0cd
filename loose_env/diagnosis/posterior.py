"""Posterior over faults from all records by the nominal arm; record likelihood, opening table.

Nuisances are carried on a grid: the direction of the slide, the friction of the guide, and the
stiffness of the bending modes of the arm, if it has any. The opening of the seat differs from
record to record; it is summed out with the probabilities that its drive, friction and load give.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from loose_env.arms import Arm, LinearArm, Mismatch
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
    predict_seats,
    seat_drives,
    sensor_errors,
)
from loose_env.errors import InvalidSetting
from loose_env.excitation import SeatReference
from loose_env.faults import DEFAULT_KINDS, hypotheses, places_of_kind
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
    """Log-likelihood of one record."""

    log: Array
    """Over locations, openings and loose motion (P, S, Q)."""
    force: Array
    """Rms force that each shut seat transmits in the record (P,)."""
    load: Array
    """Force that gravity puts on each seat at rest (P,)."""


def fit_record(
    linear: LinearArm,
    record: RecordStatistics,
    directions: Array,
    floor: SensorFloor,
    mismatch: Mismatch,
) -> Fit:
    """Likelihood of a record, for sliding directions (A, axes).

    Three things are compared with what each seat would do. The part of the tool's motion that
    does not follow the joint as measured, a - B x, must not follow the command either. The
    apparent inertia must be the predicted one. The covariance of a - B x must be what the
    arm's modes, the sensors and the loose seat leave (a Wishart density). With several joints
    excited at once only the first is asked.
    """
    pose = linear.at(record.pose)
    on = np.flatnonzero(record.excited)
    d, m = len(record.tool_covariance), len(on)
    noise = channel_noise(floor, linear.arm, on)
    seats = predict_seats(pose, record.torque, directions, noise)
    samples = independent_samples(linear.arm, record.duration)

    b, residual = unexplained(record, seats, least=0.0 if m > 1 else -np.inf)
    # Error floor of float32 readings and the linear model.
    rounding = (1e-3 * floor.tool**2 + LINEAR_ERROR**2 * np.trace(record.tool_covariance)) * np.eye(
        d
    )
    residual += rounding
    away = np.concatenate([-b, np.eye(d)], axis=1)

    s = OPENINGS[None, :, None, None]
    step = seats.in_step + s * seats.in_step_open[:, None]  # (P, S, p, m)
    log = _in_step(linear, record, on, b, away, residual, samples, seats.in_step, step, mismatch)
    if m > 1:
        log = np.repeat(log[..., None], len(LOOSE), 2)
        return Fit(log=log, force=seats.force, load=seats.load)

    x = step[..., 0, 0]
    inertia = float(record.inertia[on[0]])
    expected = float(record.torque[on[0]]) / np.where(np.abs(x) < 1e-9, 1e-9, x)
    error = np.sqrt(INERTIA_ERROR**2 + 1 / samples)
    log = log - 0.5 * np.log1p(((expected / inertia - 1) / error) ** 2 / 4) * 5

    s = OPENINGS[None, :]
    rest = [seats.rest, seats.rest_mixed[:, None], seats.rest_open[:, None]]
    alone = [part[..., 0, 0] for part in rest]
    power = x**2 + alone[0] + s * alone[1] + s**2 * alone[2] - noise[0]
    # Scaled to the joint motion that was measured: the command's own power drops out.
    scale = np.maximum(record.joint_rms[on[0]] ** 2 - noise[0], 0.1 * noise[0])
    scale = scale / np.maximum(power, 1e-3 * float(seats.in_step[0, 0]) ** 2)
    scale, s = np.clip(scale, 0.2, 5.0)[..., None, None], s[..., None, None]
    # Sensor noise is no motion: it does not scale.
    sensed = away @ np.diag(noise) @ away.T
    shut, mixed_in, opened = (away @ part @ away.T for part in rest)
    across = (shut - sensed + s * mixed_in + s**2 * opened) * scale + sensed + rounding
    loose = away @ seats.loose @ away.T
    loose = loose + _SPREAD * np.trace(loose, axis1=1, axis2=2)[:, None, None] * np.eye(d)
    degrees = 2 / (2 / samples + POWER_ERROR**2)
    log = log[..., None] + wishart_fit(
        residual, across + 1e-12 * np.eye(d), loose[:, None], LOOSE, degrees
    )
    return Fit(log=log, force=seats.force, load=seats.load)


def unexplained(
    record: RecordStatistics, seats: SeatPrediction, *, least: float
) -> tuple[Array, Array]:
    """Transmission by instrument (d, m), and covariance of what it leaves of the tool's motion.

    With several joints their covariance is only predicted, and more may be taken off than was
    there: no eigenvalue falls below ``least``.
    """
    on = np.flatnonzero(record.excited)
    m, b = len(on), record.transmission_by_instrument[:, on]
    joint = joint_covariance(record.joint_rms[on], seats.in_step[:m], seats.rest[:m, :m])
    mixed = joint @ record.transmission[:, on].T
    residual = record.tool_covariance - b @ mixed - mixed.T @ b.T + b @ joint @ b.T
    if np.isfinite(least):
        size, along = np.linalg.eigh(residual)
        residual = along @ np.diag(np.maximum(size, least)) @ along.T
    return b, residual


def joint_covariance(rms: Array, in_step: Array, rest: Array) -> Array:
    """Covariance of the excited joints (m, m): as strong as measured, correlated as predicted."""
    predicted = in_step @ in_step.T + rest
    scale = rms / np.sqrt(np.diag(predicted))
    return np.asarray(predicted * np.outer(scale, scale))


def _in_step(
    linear: LinearArm,
    record: RecordStatistics,
    on: NDArray[np.intp],
    b: Array,
    away: Array,
    residual: Array,
    samples: float,
    healthy: Array,
    step: Array,
    mismatch: Mismatch,
) -> Array:
    """Log-density of "a - B x does not follow the command" (P, S)."""
    d, m = b.shape
    # Unit of the residual: joint motion as predicted, so that the density is one of B.
    x = np.sqrt(np.diag(healthy[:m] @ healthy[:m].T))
    errors = transmission_errors(linear, record.pose, on, b, mismatch)
    uncertain = np.array([(e * x).ravel() for e in errors])
    covariance = uncertain.T @ uncertain + np.kron(residual, np.eye(m)) / samples
    nominal = healthy[m:] @ np.linalg.inv(healthy[:m])
    covariance += _OPEN_ERROR**2 * float((((b - nominal) * x) ** 2).sum()) * np.eye(d * m)
    missing = (away @ step).reshape(*step.shape[:2], d * m)
    white = missing @ whitener(covariance).T
    # Heavier tails than normal: mismatch is cut off, not Gaussian, and shared by all records.
    fit = -0.5 * (5 + d * m) * np.log1p((white**2).sum(-1) / 5)
    motion = step[..., 0, 0] if m == 1 else np.linalg.det(step[..., :m, :])
    motion = np.abs(motion) / np.prod(x)
    return np.asarray(fit + d * np.log(np.maximum(motion, 1e-9)))


def transmission_errors(
    linear: LinearArm,
    pose: Array,
    on: NDArray[np.intp],
    b: Array,
    mismatch: Mismatch,
) -> Array:
    """Changes of the transmission, one for each independent error of the model [m] (K, d, m)."""
    zeros = joint_zero_errors(linear, pose, mismatch)[:, :, on]
    # Lengths in the rough: each tool axis by as much as the longest lever would change.
    longer = np.zeros((len(b), *b.shape))
    longer[np.arange(len(b)), np.arange(len(b))] = mismatch.length * np.abs(b).max()
    return np.concatenate([sensor_errors(b, mismatch), zeros, longer])


_TINY = 1e-300


def wishart_fit(found: Array, fixed: Array, added: Array, amounts: Array, degrees: float) -> Array:
    """Log-density of a covariance (d, d), less its highest value: 0 where expectation meets it.

    ``-degrees / 2 (tr(E⁻¹ F) - d - ln det(E⁻¹ F))``, the log-density of Wishart's distribution of
    ``degrees * F`` with scale E up to a constant, for E = ``fixed + amount * added`` at all amounts
    (..., Q). Determinant and trace are ratios of polynomials in the amount, so the cofactors are
    worked out once for all amounts.
    """
    d = len(found)
    of_fixed, of_added = _cofactors(fixed), _cofactors(added)
    if d == 2:  # det(A + q B) = det A + q tr(adj A B) + q² det B
        determinant = [_det(fixed, of_fixed), _dot(of_fixed, added), _det(added, of_added)]
        numerator = [_dot(of_fixed, found), _dot(of_added, found)]
    else:
        determinant = [_det(fixed, of_fixed), _dot(of_fixed, added)]
        determinant += [_dot(fixed, of_added), _det(added, of_added)]
        between = _cofactors(fixed + added) - of_fixed - of_added
        numerator = [_dot(of_fixed, found), _dot(between, found), _dot(of_added, found)]
    expected = np.maximum(_polynomial(determinant, amounts), _TINY)
    trace = _polynomial(numerator, amounts) / expected
    measured = np.log(max(np.linalg.det(found), _TINY))
    return np.asarray(-0.5 * degrees * (trace - d - measured + np.log(expected)))


def _polynomial(coefficients: list[Array], at: Array) -> Array:
    """Values of polynomials, lowest coefficient first, at all points (..., Q)."""
    stacked = np.stack(np.broadcast_arrays(*coefficients), axis=-1)
    return np.asarray(stacked @ at ** np.arange(len(coefficients))[:, None])


def _dot(a: Array, b: Array) -> Array:
    """Trace of the product of symmetric matrices (...)."""
    return np.asarray(np.einsum("...ij,...ij->...", a, b))


def _det(matrix: Array, cofactors: Array) -> Array:
    """Determinant, along the first row (...)."""
    return np.asarray(np.einsum("...i,...i->...", matrix[..., 0, :], cofactors[..., 0, :]))


def _cofactors(m: Array) -> Array:
    """Cofactors of symmetric 2 x 2 or 3 x 3 matrices (..., d, d)."""
    if m.shape[-1] == 2:
        return np.asarray(np.trace(m, axis1=-2, axis2=-1)[..., None, None] * np.eye(2) - m)
    return np.cross(np.roll(m, -1, axis=-2), np.roll(m, -2, axis=-2))


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
        beyond = [k for k, share in self.kinds.items() if k not in DEFAULT_KINDS and share > 0]
        if beyond:
            raise InvalidSetting(
                f"the posterior has no model of {beyond}, only of {list(DEFAULT_KINDS)}: keep to "
                "these kinds, or use an agent that works without it"
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
        slides = self.loose.shape[1] - self.links
        by_place = logsumexp(self.loose, axis=(0, 2))
        by_link = logsumexp(by_place[:slides].reshape(self.links, -1), axis=1)
        log = np.concatenate([[logsumexp(self.healthy)], by_link, by_place[slides:]])
        return np.asarray(np.exp(log - logsumexp(log)))

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
        self.linear, self.hypotheses = linear, hypotheses(arm, DEFAULT_KINDS, everywhere=True)
        self.table = shipped_table()
        self.floor = SensorFloor.of(sensors, arm.band)
        count = self.settings.directions if axes == 2 else self.settings.space_directions
        self.directions = axes_grid(count, axes)
        self.variants, self._weights = variants(linear, self.settings.mismatch.stiffness)
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
        fits = [
            fit_record(arm, record, self.directions, self.floor, self.settings.mismatch)
            for arm in self.variants
        ]
        temper = self.settings.temper
        healthy = np.array([fit.log[0, SHUT, 0] for fit in fits])
        loose = np.stack([self._summed(fit) for fit in fits])
        return Belief(
            healthy=belief.healthy + temper * healthy,
            loose=belief.loose + temper * loose,
            links=belief.links,
            directions=belief.directions,
        )

    def _summed(self, fit: Fit) -> Array:
        """Sum a record's likelihood over openings and loose motion (P, F)."""
        slides = self.linear.arm.n * len(self.directions)
        top = fit.log.max()
        likelihood = np.exp(fit.log - top).reshape(len(fit.log), -1)
        nodes = self.table.nodes(fit.force[:, None], self._friction, fit.load[:, None])
        mixed = np.zeros(self._friction.shape)
        for table, locations in (
            (self.table.slide, slice(0, slides)),
            (self.table.hinge, slice(slides, None)),
        ):
            by_node = likelihood[locations] @ table.reshape(-1, likelihood.shape[1]).T
            for node, weight in nodes:
                mixed[locations] += weight[locations] * np.take_along_axis(
                    by_node, node[locations], 1
                )
        return np.asarray(np.log(np.maximum(mixed, 1e-300)) + top)


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
    offsets = np.linspace(-1.8, 1.8, 6)
    arms = []
    for offset in offsets:
        spec = linear.arm.spec.copy()
        for joint in spec.joints:
            if joint.name not in linear.arm.joints:
                joint.stiffness = joint.stiffness * np.exp(stiffness * offset)
        arms.append(LinearArm(dataclasses.replace(linear.arm, spec=spec), points=120, remember=16))
    log = -0.5 * offsets**2
    return arms, np.asarray(log - logsumexp(log))
