"""Loose link and direction from accelerometers at the tool and on links (8.3.3).

A seat of link k that slides along u moves every sensor beyond it by the same vector and none
before it. Against the healthy arm, what follows the commands changes by one pattern over all
sensors and excitations; its place of onset names the link in a single pose. For each link the
stacked change is compared with that pattern, weighted with what scatter and the sensors' own
errors allow. How far the seat opens under each excitation is unknown and integrated out in
closed form; the direction is found by maximising what remains. Motion of the seat that follows no
command shows at the same sensors along the same direction, and counts beside it.

What sensors and model get wrong is the same in every record. It is carried as errors that all
excitations share, so that neither the direction nor the odds grow surer than the sensors allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from loose_env.arms import Mismatch
from loose_env.diagnosis.multi_sensor.direction_search import UNKNOWN, climb, half_grid
from loose_env.diagnosis.multi_sensor.incoherent_motion import LooseMotion, loose_records
from loose_env.diagnosis.multi_sensor.sensed_arm import SensedArm, SensedPose
from loose_env.diagnosis.multi_sensor.sensor_errors import (
    against_nominal,
    against_reference,
    healthy_rest,
    pattern_error,
    sensor_error,
    zero_error,
)
from loose_env.diagnosis.multi_sensor.sensor_rows import SensorRows, StackedRecord
from loose_env.diagnosis.records.prediction import SensorFloor
from loose_env.errors import InvalidData
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

__all__ = ["OpeningPrior", "SensorVerdict", "weigh_links"]


@dataclass(frozen=True, kw_only=True)
class OpeningPrior:
    """Expected opening of a loose seat: 0 shut, 1 floating freely."""

    shared: float = 0.4
    """Standard deviation of the opening that all excitations share [1]."""
    own: float = 0.3
    """Standard deviation of what each excitation opens beside it [1]."""
    aside: float = 0.1
    """Standard deviation of seat motion that no nominal force explains, over floating [1]."""
    sizes: tuple[float, ...] = (1.0, 0.3, 0.1, 0.0)
    """Factors on all of these, equally likely [1]: friction and weight may hold a seat nearly shut.
    Without small ones, a link whose seat is driven hard would be cleared because little moves."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorVerdict:
    """Evidence of the sensors in one pose."""

    evidence: Array
    """Log-likelihood of each link being loose, against the healthy arm (n,)."""
    direction: Array
    """Best sliding direction of each link, unit vector in its seat's frame (n, 3)."""
    spread: Array
    """Root mean square angle between each of these directions and the true one [rad] (n,)."""
    world: Array
    """The same directions in the world's frame of the nominal arm (n, 3)."""

    @property
    def link(self) -> int:
        """Link most likely to be the loose one, from 1."""
        return int(np.argmax(self.evidence)) + 1

    @property
    def odds(self) -> float:
        """Log of how much likelier a loose link is than a healthy arm, links equally likely."""
        return float(logsumexp(self.evidence) - np.log(len(self.evidence)))

    def probabilities(self, healthy: float = 0.5) -> Array:
        """Probability of the healthy arm, then of each link (1 + n,).

        Parameters
        ----------
        healthy : float
            Probability of the healthy arm before the records; the links share the rest.
        """
        n = len(self.evidence)
        prior = np.log(np.array([healthy, *([(1 - healthy) / n] * n)]))
        log = prior + np.concatenate([[0.0], self.evidence])
        return np.asarray(np.exp(log - logsumexp(log)))


def weigh_links(
    sensed: SensedArm,
    rows: SensorRows,
    records: Sequence[StackedRecord],
    reference: Sequence[StackedRecord] | None = None,
    *,
    mismatch: Mismatch | None = None,
    opening: OpeningPrior | None = None,
    sensors: SensorSuite | None = None,
) -> SensorVerdict:
    """Weigh the links of an arm by the records of one pose.

    Parameters
    ----------
    sensed : SensedArm
        The nominal arm with its sensors.
    rows : SensorRows
        The axes that were measured; all their sensors must be among those of ``sensed``.
    records : sequence of StackedRecord
        Records of the arm in question, in one pose.
    reference : sequence of StackedRecord, optional
        Records of the same arm when it was healthy, in the same pose and with the same joints
        excited, in the same order and at the same level. The nominal arm takes their place where
        there are none.
    mismatch : Mismatch, optional
        Errors of the sensors and, without a reference, of the nominal arm.
    opening : OpeningPrior, optional
        Opening of a loose seat.
    sensors : SensorSuite, optional
        Figures of the accelerometers; their noise counts where the nominal arm is the reference.

    Raises
    ------
    InvalidData
        If records and reference do not match.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.diagnosis.multi_sensor.sensor_rows import rows_of
    >>> arm = planar(2)
    >>> sensed, rows = SensedArm(arm, links=()), rows_of(arm, None)
    >>> at = sensed.at([0.0, 1.0], [True, False])
    >>> b = at.transmission[0, :2]
    >>> def record(change):
    ...     return StackedRecord(
    ...         pose=np.array([0.0, 1.0]),
    ...         torque=np.array([1.0, 0.0]),
    ...         joint=np.eye(1),
    ...         transmission=b + change,
    ...         rest=1e-4 * np.eye(2),
    ...         samples=np.full(2, 100.0),
    ...     )
    >>> verdict = weigh_links(sensed, rows, [record([[0.0], [-0.1]])], [record(0.0)])
    >>> verdict.direction[1].round(2).tolist()
    [0.0, 1.0, 0.0]
    """
    _require_matching(records, reference)
    mismatch, opening = mismatch or Mismatch(), opening or OpeningPrior()
    sites = _sites(sensed, rows)
    quiet = SensorFloor.of(sensors or SensorSuite(), sensed.arm.band)
    change, scatter, modes, basis, loose, floating = [], [], [], [], [], []
    for k, record in enumerate(records):
        at = sensed.at(record.pose, record.excited)
        if reference is None:
            healthy = np.einsum("dc,dcm->dm", rows.direction, at.transmission[sites])
            own = record.scatter
            spread, error = against_nominal(rows, sites, at, record, mismatch)
            joint = quiet.joints(sensed.arm)[record.excited]
            still = healthy_rest(rows, sites, at, record, quiet.tool, joint)
        else:
            healthy = reference[k].transmission
            mix = np.linalg.solve(reference[k].joint, record.joint)
            own = record.scatter + reference[k].scatter * np.max(np.sum(mix**2, axis=0))
            spread, error = np.zeros(len(rows)), []
            still = reference[k].rest
        moved = (record.transmission - healthy) @ record.joint
        wide = own + np.diag(spread + 1e-6 * np.trace(own))
        pattern, power = _basis(rows, sites, at, record, opening)
        column = np.einsum("dc,dcna->dna", rows.direction, at.column[sites])
        off = pattern_error(rows, at, record.rest, still, mismatch)
        loose.append((record.rest, still, column, *off))
        floating.append(power)
        for e in range(moved.shape[1]):
            change.append(moved[:, e])
            scatter.append(wide)
            basis.append(pattern[:, :, :, e])
        modes.append(np.array(error).reshape(-1, *moved.shape))
    changes = np.array(change)
    bends, missed = against_reference(rows, changes.T, mismatch)
    shared = np.concatenate([np.concatenate(modes, axis=-1), bends]).transpose(0, 2, 1)
    shared = shared[np.any(shared != 0, axis=(1, 2))]  # sensors that do not move make no errors
    wide = np.array(scatter) + missed[:, None, None] * np.eye(len(rows))
    whole = _Weighed(changes, wide, shared, np.array(basis))
    samples = np.array([record.samples.min() for record in records])
    rest, still, column, bent, bending = (np.array(part) for part in zip(*loose, strict=True))
    reduced = loose_records(rest, still, column, bent, bending, samples)
    motion = LooseMotion(*reduced, np.array(floating))
    at = sensed.at(records[0].pose, records[0].excited)
    evidence, direction, variance = _search(_Likelihood(whole, at.mass, opening, motion), at)
    # Change and loose motion count as independent, but share the sensors' errors: the variance may
    # be too small by up to a half, and cannot be below what the sensors leave.
    least = sensor_error(rows, sites, at, direction, mismatch)
    variance = np.clip(least, variance, 2 * variance)
    variance += zero_error(rows, sites, at, direction, mismatch)
    return SensorVerdict(
        evidence=evidence,
        direction=direction,
        spread=np.minimum(np.sqrt(variance), UNKNOWN[at.mass.shape[1]]),
        world=np.einsum("ncd,nd->nc", at.orientation, direction),
    )


def _basis(
    rows: SensorRows,
    sites: NDArray[np.intp],
    at: SensedPose,
    record: StackedRecord,
    opening: OpeningPrior,
) -> tuple[Array, Array]:
    """Change per A x A products of the direction, then per its A components (n, D, q, m).

    Beside it the power of each link's seat acceleration if it floats freely (n,) [m²/s⁴].
    """
    torque = record.torque[record.excited]
    driven = np.einsum("dc,dcnabm->ndabm", rows.direction, at.driven[sites]) * torque
    column = np.einsum("dc,dcna->nda", rows.direction, at.column[sites])
    axes = column.shape[2]
    mean_mass = np.trace(at.mass, axis1=1, axis2=2) / axes
    floating = np.sqrt(at.force) * torque / mean_mass[:, None]  # (n, m)
    aside = opening.aside * column[..., None] * floating[:, None, None]
    n, d = column.shape[:2]
    basis = np.concatenate([driven.reshape(n, d, axes**2, -1), aside], axis=2)
    return basis, np.sum(floating**2, axis=1)


class _Weighed:
    """Whitened products of the change and of each link's basis."""

    def __init__(self, change: Array, scatter: Array, modes: Array, basis: Array) -> None:
        # change (M, D), scatter (M, D, D), modes (r, M, D), basis (M, n, D, q)
        root = np.linalg.cholesky(scatter)
        columns, n, d, q = basis.shape
        flat = basis.transpose(0, 2, 1, 3).reshape(columns, d, n * q)
        joined = np.concatenate([flat, modes.transpose(1, 2, 0), change[..., None]], axis=2)
        white = np.linalg.solve(root, joined)
        phi, z, y = white[..., : n * q], white[..., n * q : -1], white[..., -1:]
        phi = phi.reshape(columns, d, n, q).transpose(2, 0, 1, 3)  # (n, M, D, q)
        self.gram = np.zeros((n, columns, q, columns, q))
        at = np.arange(columns)
        own = phi.transpose(0, 1, 3, 2) @ phi
        self.gram[:, at, :, at, :] = own.transpose(1, 0, 2, 3)
        self.lever = (phi.transpose(0, 1, 3, 2) @ y)[..., 0]
        # Woodbury: errors common to several columns are few.
        zt = z.transpose(0, 2, 1)
        inner = np.eye(z.shape[2]) + (zt @ z).sum(axis=0)
        seen = (zt @ phi).transpose(0, 2, 1, 3).reshape(n, z.shape[2], columns * q)
        # All links in one call: the matrix is factorised once.
        right = seen.transpose(1, 0, 2).reshape(len(inner), n * columns * q)
        beside = np.linalg.solve(inner, right)
        solved = beside.reshape(len(inner), n, columns * q).transpose(1, 0, 2)
        self.gram -= (seen.transpose(0, 2, 1) @ solved).reshape(self.gram.shape)
        seen_change = (zt @ y).sum(axis=0)[:, 0]
        self.lever -= (seen_change @ solved).reshape(self.lever.shape)
        # More than any pattern can explain.
        shared = seen_change @ np.linalg.solve(inner, seen_change)
        self.energy = float(np.maximum(np.sum(y**2) - shared, 0.0))


class _Likelihood:
    """Log-likelihood of each link's sliding direction against the healthy arm."""

    def __init__(
        self,
        whole: _Weighed,
        mass: Array,
        opening: OpeningPrior,
        motion: LooseMotion | None = None,
    ) -> None:
        self.mass, self.motion = mass, motion
        n, columns, q = whole.lever.shape
        self.columns = columns
        prior = np.zeros((columns, 2, columns, 2))
        prior[:, 0, :, 0] = opening.shared**2 + opening.own**2 * np.eye(columns)
        prior[:, 1, :, 1] = np.eye(columns)
        self.sizes, self.most = opening.sizes, 1.001 * whole.energy + 1
        self.root = np.linalg.cholesky(prior.reshape(2 * columns, 2 * columns))
        # Columns beside each other: (n, M M, q, q) and (n, M, q).
        self.gram = whole.gram.transpose(0, 1, 3, 2, 4).reshape(n, columns**2, q, q)
        self.lever = whole.lever

    def __call__(self, u: Array) -> Array:
        """Log-likelihood of directions u (n, U, A), openings integrated out (n, U)."""
        n, count, axes = u.shape
        m, size = self.columns, 2 * self.columns
        mass = np.sum((u @ self.mass) * u, axis=2)
        product = (u[..., :, None] * u[..., None, :]).reshape(n, count, axes**2)
        weight = np.zeros((n, count, axes**2 + axes, 2))
        weight[:, :, : axes**2, 0] = product / mass[..., None]
        weight[:, :, axes**2 :, 1] = u
        weight = weight[:, :, None]  # (n, U, 1, q, 2)
        gram = weight.transpose(0, 1, 2, 4, 3) @ (self.gram[:, None] @ weight)
        gram = gram.reshape(n, count, m, m, 2, 2).transpose(0, 1, 2, 4, 3, 5)
        lever = (self.lever[:, None] @ weight[:, :, 0]).reshape(n, count, size)
        inner = self.root.T @ gram.reshape(n, count, size, size) @ self.root
        lever = lever @ self.root
        found = []
        for factor in self.sizes:
            # One factorisation gives the determinant, and the quadratic form in its last corner.
            joined = np.empty((n, count, size + 1, size + 1))
            joined[..., :size, :size] = np.eye(size) + factor**2 * inner
            joined[..., size, :size] = joined[..., :size, size] = factor * lever
            joined[..., size, size] = self.most
            diagonal = np.diagonal(np.linalg.cholesky(joined), axis1=2, axis2=3)
            height = np.log(diagonal[..., :size]).sum(axis=2)
            found.append(0.5 * (self.most - diagonal[..., size] ** 2) - height)
        total = logsumexp(found, axis=0) - np.log(len(found))
        return np.asarray(total if self.motion is None else total + self.motion(u))


def _search(likelihood: _Likelihood, at: SensedPose) -> tuple[Array, Array, Array]:
    """Evidence of each link (n,), its best direction (n, 3) and that one's variance [rad²] (n,).

    Directions near the best one are taken as a Gaussian if it is narrower than the grid; all
    others are summed over the grid.
    """
    n, axes = at.mass.shape[:2]
    grid = half_grid(axes)
    over = likelihood(np.broadcast_to(grid, (n, *grid.shape)))
    spacing = np.pi / len(grid) if axes == 2 else np.sqrt(2 * np.pi / len(grid))
    best, peak, variance = climb(likelihood, grid[np.argmax(over, axis=1)], spacing)
    if axes == 2:
        volume = np.sqrt(2 * np.pi * variance[:, 0]) / np.pi
    else:
        volume = np.sqrt(np.prod(variance, axis=1))
    narrow = np.sqrt(variance.max(axis=1)) < spacing
    angle = np.arccos(np.minimum(np.abs(best @ grid.T), 1.0))  # (n, U)
    summed = ~narrow[:, None] | (angle > 2 * spacing)
    log = np.where(summed, over - np.log(len(grid)), -np.inf)
    inside = np.where(narrow, peak + np.log(np.minimum(volume, 1.0)), -np.inf)
    evidence = np.logaddexp(logsumexp(log, axis=1), inside)
    share = np.exp(log - evidence[:, None])
    wide = np.sum(share * (angle**2 + spacing**2 / 12), axis=1)
    total = wide + np.exp(inside - evidence) * variance.sum(axis=1)
    direction = np.zeros((n, 3))
    direction[:, :axes] = best
    for row in direction:  # an axis has two ends; the last component that is not zero is positive
        row *= np.sign(row[np.flatnonzero(np.abs(row) > 1e-9)[-1]])
    return evidence, direction, total


def _sites(sensed: SensedArm, rows: SensorRows) -> NDArray[np.intp]:
    known = {0: 0, **{link: k for k, link in enumerate(sensed.links, start=1)}}
    missing = sorted(set(rows.link.tolist()) - set(known))
    if missing:
        raise InvalidData(
            f"the rows hold sensors on links {missing}, the arm was given some on "
            f"{list(sensed.links)}"
        )
    return np.array([known[int(link)] for link in rows.link], dtype=np.intp)


def _require_matching(
    records: Sequence[StackedRecord], reference: Sequence[StackedRecord] | None
) -> None:
    if not records:
        raise InvalidData("at least one record is needed")
    if any(not np.array_equal(r.pose, records[0].pose) for r in records):
        raise InvalidData("all records must be of one pose; weigh poses one by one and add up")
    if reference is None:
        return
    if len(reference) != len(records):
        raise InvalidData(f"{len(records)} records need as many references, got {len(reference)}")
    for k, (record, other) in enumerate(zip(records, reference, strict=True)):
        if not np.array_equal(record.pose, other.pose) or (record.excited != other.excited).any():
            raise InvalidData(f"record {k} and its reference differ in pose or excited joints")
