"""Direction of a transmission change and its confidence region, in 2-D and 3-D.

A seat that slides along z changes the transmission by an outer product, z v.T, whatever joints are
excited: v says how far each drives the seat. What is measured is that product plus errors whose
covariance is known. For any axis u the best v follows in closed form, and

    q(u) = min over v of (D - u v.T) C^-1 (D - u v.T)

is the squared misfit of the change D under the errors' covariance C. Its lowest point is the
estimate, and its lowest value tests whether one direction explains the change. An axis belongs to
the confidence region if its misfit is not much above the lowest. How much is allowed depends on
how well the change would tell the angle of that axis: where that is little, errors alone make
directions, and more must be allowed (a conditional likelihood ratio, whose region may be the whole
sphere).
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri, fdtri

from loose_env.errors import InvalidSetting
from loose_env.statistics._checks import as_direction
from loose_env.statistics.directions.angle_information import angle_information
from loose_env.statistics.directions.sphere import tangents
from loose_env.statistics.tool_transmission.axis_misfit import Misfit, lowest_axis
from loose_env.statistics.tool_transmission.estimate import TransmissionEstimate
from loose_env.typing import Array

_AZIMUTHS, _RADII = 24, 90
_DRAWS = 10000
_STRENGTHS = np.concatenate(([0.0], np.geomspace(0.3, 3000.0, 30)))


class Region:
    """Confidence region: axes whose misfit is within a threshold of the minimum.

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

    def excess(self, axes: Array) -> Array:
        """Misfit over the threshold, at unit vectors (K, d); at most 1 inside."""
        misfit, drives = self.misfit.at(axes), self.misfit.drives(axes)
        strength = angle_information(self.misfit.precision, axes, drives)
        allowed = np.interp(strength, _STRENGTHS, self.allowed)
        return np.asarray(np.maximum(misfit - self.lowest, 0.0) / (self.widening * allowed))


@lru_cache(maxsize=64)
def _allowed(d: int, m: int, level: float) -> Array:
    """Misfit threshold at the given confidence level.

    By how well the change tells the angle of the true axis (`_STRENGTHS`, `angle_information`).
    For errors that are alike in all entries this is exact: with y the part along the axis, of size
    squared t, and Z what the errors put across it, t is that information and the rise is the
    largest eigenvalue of (y, Z) (y, Z).T less t.
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
    """Direction of a transmission change and its confidence region."""

    direction: Array
    """Unit vector in the tool frame, shape (d,); its last non-zero component is positive."""
    drive: Array
    """Change along it per acceleration of each excited joint, m, shape (m,)."""
    half_angle: float
    """Largest angle from the direction to an axis inside the region, rad; pi/2: none is out."""
    sd: float
    """Root mean square standard deviation of the direction over the ways across it, rad."""
    precision: Array
    """Precision across the direction near it, 1/rad^2, shape (d, d); the region is wider than it
    says where little of the change stands out."""
    level: float
    """Confidence level of the region."""
    evidence: float
    """How far the change is from none, chi-square units: what the direction explains of it."""
    region: "Region"
    """The region itself."""

    def contains(self, axis: ArrayLike) -> bool:
        """Return whether an axis of the tool frame, shape (d,), lies in the region."""
        unit = as_direction(axis, len(self.direction), "axis")
        return bool(self.region.excess(unit[None])[0] <= 1.0)


def change_direction(change: TransmissionEstimate, level: float = 0.95) -> ChangeDirection:
    """Estimate the direction of a transmission change, with its confidence region.

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
    Moreira, Econometrica 71 (2003), the conditional likelihood ratio behind the region.

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
    direction, lowest = lowest_axis(misfit.at, misfit.likely())
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


def _extent(region: Region, direction: Array) -> tuple[float, float]:
    """Largest angle of the region about its direction, and rms angle of its border."""
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


def _curvature(misfit: Misfit, direction: Array, step: float) -> Array:
    """Hessian of the misfit across a direction, by finite differences (step in rad)."""
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


def _crossing(radii: Array, excess: Array, k: int) -> float:
    """Angle at which the region ends after the k-th radius; -1 is the centre."""
    if k == len(radii) - 1:
        return float(radii[-1])
    low, start = (0.0, 0.0) if k < 0 else (math.sqrt(excess[k]), float(radii[k]))
    # The root of the misfit grows about linearly with the angle.
    share = (1.0 - low) / max(math.sqrt(excess[k + 1]) - low, 1e-300)
    return start + min(max(share, 0.0), 1.0) * (float(radii[k + 1]) - start)
