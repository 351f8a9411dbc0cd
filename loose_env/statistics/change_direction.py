"""The direction of a change of transmission, with its confidence region, in the plane and in space.

A seat that slides along z changes the transmission by an outer product, z v.T, whatever joints are
excited: v says how far each drives the seat. What is measured is that product plus errors whose
covariance is known. For any axis u the best v follows in closed form, and

    q(u) = min over v of (D - u v.T) C^-1 (D - u v.T)

is the squared misfit of the change D under the errors' covariance C. Its lowest point is the
estimate, and its lowest value tests whether one direction explains the change. An axis belongs to
the confidence region if its misfit is not much above the lowest. How much is allowed depends on
how much of the change the axis explains: where that is little, errors alone make directions, and
more must be allowed (a conditional likelihood ratio, whose region may be the whole sphere).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, chdtri, fdtrc, fdtri

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics._checks import FloatArray, as_direction
from loose_env.statistics.angles import axial_vector
from loose_env.statistics.sphere import axes_grid, tangents
from loose_env.statistics.transmission_estimate import TransmissionEstimate

_GRID = {2: 90, 3: 400}
"""Axes at which the misfit is looked at first."""
_STARTS = 3
_STEPS, _SHRINK = 24, 0.5
_AZIMUTHS, _RADII = 24, 90
_DRAWS = 4000
_STRENGTHS = np.concatenate(([0.0], np.geomspace(0.3, 3000.0, 30)))


class Misfit:
    """Squared misfit of a change along any axis, errors weighed by their covariance.

    Parameters
    ----------
    change : TransmissionEstimate
        Change of transmission, shape (d, m), with its covariance.

    Raises
    ------
    InvalidData
        If d is neither 2 nor 3, a value is not finite, or the covariance is not positive.
    """

    def __init__(self, change: TransmissionEstimate) -> None:
        d, m = change.b.shape
        if d not in (2, 3):
            raise InvalidData(f"the change has {d} rows; a direction needs two or three")
        size = d * m
        covariance = change.covariance.reshape(size, size)
        if not (np.isfinite(change.b).all() and np.isfinite(covariance).all()):
            raise InvalidData("the change or its covariance holds NaN or infinite values")
        spread = np.diag(covariance)
        if not (spread >= 0).all() or not spread.any():
            raise InvalidData("the covariance of the change must be positive")
        # In units of each entry's scatter; one without any gets next to none.
        scale = np.sqrt(np.maximum(spread, 1e-12 * spread.max()))
        precision = np.linalg.inv(covariance / np.outer(scale, scale) + 1e-10 * np.eye(size))
        self.precision = (precision / np.outer(scale, scale)).reshape(d, m, d, m)
        self._weighted = np.einsum("imjn,jn->im", self.precision, change.b)
        self.total = float(np.sum(self._weighted * change.b))
        """Misfit of no change at all."""

    def at(self, axes: FloatArray) -> FloatArray:
        """Misfit at unit vectors of shape (K, d); shape (K,)."""
        drive, gram = self._normal_equations(axes)
        fitted = np.linalg.solve(gram, drive[..., None])[..., 0]
        return np.asarray(self.total - np.sum(drive * fitted, axis=1))

    def drives(self, axis: FloatArray) -> FloatArray:
        """Best v for one axis, shape (m,)."""
        drive, gram = self._normal_equations(axis[None])
        return np.asarray(np.linalg.solve(gram[0], drive[0]))

    def without(self, axes: FloatArray) -> FloatArray:
        """Misfit if nothing of the change lay along these axes and anything across, shape (K,).

        Small where a change of fewer directions than d explains all: it has no part along u.
        """
        d, m = self._weighted.shape
        covariance = np.linalg.inv(self.precision.reshape(d * m, d * m)).reshape(d, m, d, m)
        change = np.einsum("imjn,jn->im", covariance, self._weighted)
        along = axes @ change
        among = np.einsum("ki,imjn,kj->kmn", axes, covariance, axes)
        return np.asarray(np.sum(along * np.linalg.solve(among, along[..., None])[..., 0], axis=1))

    def _normal_equations(self, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        return axes @ self._weighted, np.einsum("ki,imjn,kj->kmn", axes, self.precision, axes)


class Region:
    """Axes whose misfit is not too far above the lowest.

    Parameters
    ----------
    misfit : Misfit
        Misfit of the change.
    lowest : float
        Its lowest value.
    shape : tuple of int
        (d, m) of the change.
    level : float
        Confidence level.
    degrees : float
        Degrees of freedom of the errors' covariance.

    References
    ----------
    Moreira, A conditional likelihood ratio test for structural models, Econometrica 71 (2003).
    """

    def __init__(
        self, misfit: Misfit, lowest: float, shape: tuple[int, int], level: float, degrees: float
    ) -> None:
        self.misfit, self.lowest = misfit, lowest
        self.allowed = _allowed(*shape, level)
        across = shape[0] - 1
        self.widening = 1.0
        if math.isfinite(degrees):
            exact = across * float(fdtri(across, max(degrees, 1.0), level))
            self.widening = exact / float(chdtri(across, 1.0 - level))

    def excess(self, axes: FloatArray) -> FloatArray:
        """Rise of the misfit over what is allowed, at unit vectors (K, d); up to 1 is inside."""
        misfit = self.misfit.at(axes)
        allowed = np.interp(self.misfit.total - misfit, _STRENGTHS, self.allowed)
        return np.asarray(np.maximum(misfit - self.lowest, 0.0) / (self.widening * allowed))


@lru_cache(maxsize=64)
def _allowed(d: int, m: int, level: float) -> FloatArray:
    """Rise of the misfit at the true axis that errors alone exceed with chance 1 - level.

    By how much of the change the true axis explains (`_STRENGTHS`). For errors that are alike in
    all entries this is exact: with y the part along the axis, of size squared t, and Z what the
    errors put across it, the rise is the largest eigenvalue of (y, Z) (y, Z).T less t.
    """
    z = np.random.default_rng(0).standard_normal((_DRAWS, d - 1, m))
    allowed = []
    for strength in _STRENGTHS:
        whole = np.concatenate((np.zeros((_DRAWS, 1, m)), z), axis=1)
        whole[:, 0, 0] = math.sqrt(strength)
        largest = np.linalg.eigvalsh(whole @ whole.transpose(0, 2, 1))[:, -1]
        allowed.append(float(np.quantile(largest - strength, level)))
    limit = float(chdtri(d - 1, 1.0 - level))  # where it goes for a strong change
    return np.asarray(np.maximum(allowed, limit), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class ChangeDirection:
    """Direction of a change of transmission and the region of axes it cannot be told from."""

    direction: FloatArray
    """Unit vector in the tool frame, shape (d,); its last non-zero component is positive."""
    drive: FloatArray
    """Change along it per acceleration of each excited joint, m, shape (m,)."""
    half_angle: float
    """Largest angle from the direction to an axis inside the region, rad; pi/2: none is out."""
    sd: float
    """Root mean square standard deviation of the direction over the ways across it, rad."""
    precision: FloatArray
    """Precision across the direction near it, 1/rad^2, shape (d, d); the region is wider than it
    says where little of the change stands out."""
    level: float
    """Confidence level of the region."""
    evidence: float
    """How far the change is from none, chi-square units: what the direction explains of it."""
    region: "Region"
    """The region itself."""

    def contains(self, axis: ArrayLike) -> bool:
        """Whether an axis of the tool frame, shape (d,), lies inside the region."""
        unit = as_direction(axis, len(self.direction), "axis")
        return bool(self.region.excess(unit[None])[0] <= 1.0)


def change_direction(change: TransmissionEstimate, level: float = 0.95) -> ChangeDirection:
    """Find the one direction that explains a change of transmission, and its confidence region.

    Where all errors are alike this is the leading left singular vector of the change.

    Parameters
    ----------
    change : TransmissionEstimate
        Change of transmission, shape (d, m) with d = 2 or 3, with the covariance of all its
        errors: sampling and what sensors and model get wrong.
    level : float
        Confidence level, above 0 and below 1.

    Returns
    -------
    ChangeDirection
        Direction, region, and how strongly the change speaks.

    Raises
    ------
    InvalidData
        If the change or its covariance cannot be used.
    InvalidSetting
        If the level is out of range.

    References
    ----------
    Cragg and Donald, J. Econometrics 76 (1997), minimum distance of a matrix to one of lower
    rank; regions by profile likelihood.

    Examples
    --------
    >>> small = 1e-4 * np.eye(6).reshape(3, 2, 3, 2)
    >>> loose = TransmissionEstimate(np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 0.4]]), small)
    >>> found = change_direction(loose)
    >>> np.abs(found.direction).round(2).tolist(), found.drive.round(2).tolist()
    ([0.0, 0.0, 1.0], [0.3, 0.4])
    >>> found.contains([0.0, 0.0, 1.0]), found.contains([0.0, 0.2, 1.0])
    (True, False)
    """
    if not 0.0 < level < 1.0:
        raise InvalidSetting(f"level is {level}; it must lie above 0 and below 1")
    d, m = change.b.shape
    misfit = Misfit(change)
    direction, lowest = _lowest(misfit.at, d)
    region = Region(misfit, lowest, (d, m), level, change.degrees)
    half_angle, border = _extent(region, direction)
    sd = border / math.sqrt(region.widening * float(chdtri(d - 1, 1.0 - level)))
    return ChangeDirection(
        direction=direction,
        drive=misfit.drives(direction),
        half_angle=half_angle,
        sd=sd,
        precision=_curvature(misfit, direction, 0.3 * sd) / (2 * region.widening),
        level=level,
        evidence=misfit.total - lowest,
        region=region,
    )


@dataclass(frozen=True, slots=True)
class ChangeRank:
    """How many directions a change of transmission has."""

    rank: int
    """0: no change; 1: one direction; 2 or more: several."""
    p_values: tuple[float, ...]
    """Chance of so large a misfit if the rank were 0, 1, ..., for each rank that is tested."""
    misfits: tuple[float, ...]
    """Squared misfit of the best change of rank 0, 1, ..."""
    significance: float
    """A rank is refused below this chance."""


def change_rank(change: TransmissionEstimate, significance: float = 0.01) -> ChangeRank:
    """Count the directions of a change of transmission.

    Ranks are tried from zero up; the first that the change's errors can explain is the answer. The
    misfit of the best matrix of rank r is chi-square with (d - r)(m - r) degrees of freedom, or F
    where the errors' covariance is itself an estimate.

    Parameters
    ----------
    change : TransmissionEstimate
        As in `change_direction`.
    significance : float
        Chance below which a rank is refused, above 0 and below 1.

    Returns
    -------
    ChangeRank
        The rank, and every test on the way to min(d, m).

    Raises
    ------
    InvalidData, InvalidSetting
        As `change_direction`.

    Examples
    --------
    >>> small = 1e-4 * np.eye(9).reshape(3, 3, 3, 3)
    >>> turned = np.outer([0.0, 0.6, 0.8], [0.3, -0.2, 0.5])
    >>> [change_rank(TransmissionEstimate(b, small)).rank for b in (0 * turned, turned, np.eye(3))]
    [0, 1, 3]
    """
    if not 0.0 < significance < 1.0:
        raise InvalidSetting(f"significance is {significance}; it must lie above 0 and below 1")
    misfit = Misfit(change)
    d, m = change.b.shape
    most = min(d, m)
    misfits = [misfit.total]
    if most > 1:
        misfits.append(max(_lowest(misfit.at, d)[1], 0.0))
    if most > 2:
        misfits.append(max(_lowest(misfit.without, d)[1], 0.0))
    p_values = tuple(_chance(q, (d - r) * (m - r), change.degrees) for r, q in enumerate(misfits))
    rank = next((r for r, p in enumerate(p_values) if p >= significance), most)
    return ChangeRank(rank, p_values, tuple(misfits), significance)


def _chance(misfit: float, constraints: int, degrees: float) -> float:
    """Chance of a larger misfit; F instead of chi-square where the scatter is estimated."""
    if not math.isfinite(degrees):
        return float(chdtrc(constraints, misfit))
    return float(fdtrc(constraints, max(degrees, 1.0), misfit / constraints))


def _lowest(at: Callable[[FloatArray], FloatArray], dimension: int) -> tuple[FloatArray, float]:
    """Lowest point of a smooth function of axes: the best of a grid, then ever finer about them."""
    grid = axes_grid(_GRID[dimension], dimension)
    best = grid[np.argsort(at(grid))[:_STARTS]]
    step = 1.5 * math.sqrt(2 * math.pi / len(grid)) if dimension == 3 else math.pi / len(grid)
    offsets = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    around = np.stack(np.meshgrid(*[offsets] * (dimension - 1), indexing="ij"), axis=-1)
    around = around.reshape(-1, dimension - 1)
    for _ in range(_STEPS):
        across = np.stack([tangents(u) for u in best])
        near = best[:, None] + step * (around @ across)
        near /= np.linalg.norm(near, axis=2, keepdims=True)
        values = at(near.reshape(-1, dimension)).reshape(near.shape[:2])
        best = near[np.arange(len(best)), np.argmin(values, axis=1)]
        step *= _SHRINK
    values = at(best)
    return axial_vector(best[int(np.argmin(values))]), float(np.min(values))


def _extent(region: Region, direction: FloatArray) -> tuple[float, float]:
    """Largest angle of the region about its direction, and the rms angle of its inner border."""
    across = tangents(direction)
    if len(across) == 1:
        ways = np.concatenate((across, -across))
    else:
        turn = 2 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
        ways = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
    # Fine where the region is small: from a hundredth of a degree to a right angle.
    radii = np.geomspace(1e-4, math.pi / 2, _RADII)
    axes = np.cos(radii)[:, None, None] * direction + np.sin(radii)[:, None, None] * ways
    excess = region.excess(axes.reshape(-1, len(direction))).reshape(axes.shape[:2])
    inside = excess <= 1.0
    last = np.where(inside.any(axis=0), _RADII - 1 - np.argmax(inside[::-1], axis=0), -1)
    first = np.where(inside.all(axis=0), _RADII - 1, np.argmax(~inside, axis=0) - 1)
    outer = [_crossing(radii, excess[:, w], int(k)) for w, k in enumerate(last)]
    inner = [_crossing(radii, excess[:, w], int(k)) for w, k in enumerate(first)]
    return max(outer), math.sqrt(float(np.mean(np.square(inner))))


def _curvature(misfit: Misfit, direction: FloatArray, step: float) -> FloatArray:
    """Second derivatives of the misfit across a direction, by differences over a step (rad)."""
    across = tangents(direction)
    size = len(across)
    ways = np.concatenate([np.eye(size), np.ones((1, size))]) @ across
    axes = np.concatenate(([direction], direction + step * ways, direction - step * ways))
    values = misfit.at(axes / np.linalg.norm(axes, axis=1, keepdims=True))
    second = (values[1 : size + 2] + values[size + 2 :] - 2 * values[0]) / step**2
    hessian = np.diag(second[:size])
    if size == 2:
        hessian[0, 1] = hessian[1, 0] = (second[2] - second[0] - second[1]) / 2
    values, vectors = np.linalg.eigh(hessian)
    inside = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(across.T @ inside @ across)


def _crossing(radii: FloatArray, excess: FloatArray, k: int) -> float:
    """Angle at which the region is left after the k-th radius, -1 being the middle."""
    if k == len(radii) - 1:
        return float(radii[-1])
    low, start = (0.0, 0.0) if k < 0 else (math.sqrt(excess[k]), float(radii[k]))
    # The root of the misfit grows about linearly with the angle.
    share = (1.0 - low) / max(math.sqrt(excess[k + 1]) - low, 1e-300)
    return start + min(max(share, 0.0), 1.0) * (float(radii[k + 1]) - start)
