"""Marginal distribution matching: fit a Gaussian ridge to a histogram by orthogonal distances.

The direction along the ridge is that of the looseness. Bins are points with two kinds of error:
a sample lies anywhere in its bin, and counts scatter (thesis 4.1.1).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData, InvalidSetting, MissingExtra
from loose_env.statistics._checks import FloatArray, as_floats
from loose_env.statistics.angles import wrap_axial
from loose_env.statistics.gaussian_ridge import (
    exponent_from_sd,
    planar_ridge,
    rotation,
    sd_from_exponent,
    spatial_ridge,
)
from loose_env.statistics.histogram import Histogram

__all__ = [
    "Match",
    "MatchSettings",
    "hemisphere",
    "match_planar",
    "match_spatial",
    "planar_trial",
    "search_planar",
    "search_spatial",
    "spatial_trial",
    "variance_trial",
]

Model = Callable[[ArrayLike, ArrayLike], FloatArray]


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """How a ridge is fitted.

    Raises
    ------
    InvalidSetting
        If a choice is unknown or there is no iteration.
    """

    bins: Literal["filled", "all"] = "filled"
    """Bins that are fitted. The ridge of the model has no ends, the motion has: with empty bins
    beyond its ends the fit turns towards the diagonal of the motion's outline."""
    weights: Literal["sampling", "unit"] = "sampling"
    """What a distance is measured in. Sampling: positions in the standard deviation within a bin,
    counts in the root of their mean. Unit: positions in the spread, counts in the highest."""
    iterations: int = 200
    """Iterations at most [1]."""

    def __post_init__(self) -> None:
        if self.bins not in ("filled", "all"):
            raise InvalidSetting(f"bins is {self.bins!r}; it is 'filled' or 'all'")
        if self.weights not in ("sampling", "unit"):
            raise InvalidSetting(f"weights is {self.weights!r}; it is 'sampling' or 'unit'")
        if self.iterations < 1:
            raise InvalidSetting(f"iterations is {self.iterations}; it must be 1 or more")


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """A fitted ridge."""

    parameters: FloatArray
    """In the plane (3,): a0, a1, a2 of `planar_ridge`. In space (6,): b of `spatial_ridge`."""
    direction: FloatArray
    """Unit vector along the ridge, that of the looseness, shape (2,) or (3,)."""
    sd: FloatArray
    """Standard deviations of the Gaussian motion across it, shape (1,) or (2,), largest first,
    unit of the data; infinite where the fit found no ridge."""
    residual: float
    """Mean of the squared orthogonal distances, in the unit of the weights [1]."""
    converged: bool
    """Whether the search stopped at a minimum of its own accord."""
    starts: int = 1
    """Trial directions from which it was started."""


def variance_trial(found: Histogram) -> float:
    """Trial variance: half the mean squared distance from the origin (4.7).

    It is the mean over the counts: the sum as printed needs the division by their sum.

    Parameters
    ----------
    found : Histogram
        Counts in d directions; the motion has a mean of zero.

    Returns
    -------
    float
        Variance of one direction if all were alike (divided by d), squared unit of the data.

    Raises
    ------
    InvalidData
        If the histogram is empty.

    Examples
    --------
    >>> corners = Histogram(counts=np.ones((2, 2)), low=np.array([-2.0, -2.0]), width=2.0)
    >>> variance_trial(corners)
    1.0
    """
    counts = found.counts.ravel()
    total = float(counts.sum())
    if not (math.isfinite(total) and total > 0.0 and (counts >= 0.0).all()):
        raise InvalidData("counts must be finite, not negative, and not all zero")
    squared = np.sum(found.points() ** 2, axis=0)
    return float(np.sum(squared * counts)) / total / found.counts.ndim


def planar_trial(found: Histogram, angle: float) -> FloatArray:
    """Trial parameters with a given direction: a0 the highest count, a1 from (4.7) and (4.9).

    Parameters
    ----------
    found : Histogram
        Counts in the plane.
    angle : float
        Trial direction a2 of the Gaussian component, rad.

    Returns
    -------
    array, shape (3,)
        a0, a1, a2.

    Raises
    ------
    InvalidData
        If the histogram is not planar, or empty.

    Examples
    --------
    >>> corners = Histogram(counts=np.ones((2, 2)), low=np.array([-2.0, -2.0]), width=2.0)
    >>> planar_trial(corners, 0.5).tolist()
    [1.0, -0.5, 0.5]
    """
    _require_dimension(found, 2)
    a1 = exponent_from_sd(math.sqrt(variance_trial(found)))
    return np.array([float(found.counts.max()), a1, angle])


def spatial_trial(found: Histogram, direction: ArrayLike) -> FloatArray:
    """Trial parameters of `spatial_ridge`: round, with the trial variance of (4.7).

    Parameters
    ----------
    found : Histogram
        Counts in space.
    direction : array, shape (3,)
        Trial direction of the looseness, of any length above zero.

    Returns
    -------
    array, shape (6,)
        Parameters b.

    Raises
    ------
    InvalidData
        If the histogram is not spatial, or empty, or the direction has no length.

    Examples
    --------
    >>> corners = Histogram(counts=np.ones((2, 2, 2)), low=np.full(3, -2.0), width=2.0)
    >>> spatial_trial(corners, [1.0, 0.0, 0.0]).tolist()
    [1.0, 1.0, 0.0, 1.0, 0.0, 0.0]
    """
    _require_dimension(found, 3)
    x, y, z = as_floats(direction, "direction")
    flat = math.hypot(x, y)
    if not (math.isfinite(flat + z) and flat + abs(z) > 0.0):
        raise InvalidData(f"direction is {direction!r}; it needs a length above zero")
    root = 1.0 / math.sqrt(variance_trial(found))
    return np.array([found.counts.max(), root, 0.0, root, math.atan2(y, x), math.atan2(z, flat)])


def match_planar(
    found: Histogram, trial: ArrayLike, settings: MatchSettings | None = None
) -> Match:
    """Fit `planar_ridge` to a planar histogram from trial parameters.

    Parameters
    ----------
    found : Histogram
        Counts in the plane.
    trial : array, shape (3,)
        Trial a0, a1, a2; see `planar_trial`.
    settings : MatchSettings, optional
        How it is fitted.

    Returns
    -------
    Match
        The minimum that was reached; a2 is wrapped to [0, pi).

    Raises
    ------
    InvalidData
        If the histogram is not planar, has fewer than four bins to fit, or the trial is unfit.
    MissingExtra
        If odrpack is not installed.

    Examples
    --------
    >>> grid = Histogram(counts=np.ones((9, 9)), low=np.full(2, -4.5), width=1.0)
    >>> ridge = planar_ridge(grid.points(), [100.0, -0.2, 1.0]).reshape(9, 9)
    >>> match = match_planar(replace(grid, counts=ridge), [90.0, -0.22, 1.1])
    >>> match.parameters.round(3).tolist()
    [100.0, -0.2, 1.0]
    """
    _require_dimension(found, 2)
    size, top = math.sqrt(variance_trial(found)), float(found.counts.max())
    scale = np.array([top, size**-2, 1.0])
    fitted, residual, converged = _fit(planar_ridge, found, trial, scale, settings)
    fitted[2] = wrap_axial(float(fitted[2]))
    return Match(
        parameters=fitted,
        direction=np.array([-math.sin(fitted[2]), math.cos(fitted[2])]),
        sd=np.array([sd_from_exponent(float(fitted[1]))]),
        residual=residual,
        converged=converged,
    )


def match_spatial(
    found: Histogram, trial: ArrayLike, settings: MatchSettings | None = None
) -> Match:
    """Fit `spatial_ridge` to a histogram in space from trial parameters.

    Parameters
    ----------
    found : Histogram
        Counts in space.
    trial : array, shape (6,)
        Trial parameters; see `spatial_trial`.
    settings : MatchSettings, optional
        How it is fitted.

    Returns
    -------
    Match
        The minimum that was reached.

    Raises
    ------
    InvalidData
        If the histogram is not spatial, has too few bins to fit, or the trial is unfit.
    MissingExtra
        If odrpack is not installed.

    Examples
    --------
    >>> grid = Histogram(counts=np.ones((7, 7, 7)), low=np.full(3, -3.5), width=1.0)
    >>> truth = [100.0, 0.6, 0.1, 0.9, 0.4, 0.3]
    >>> column = replace(grid, counts=spatial_ridge(grid.points(), truth).reshape(7, 7, 7))
    >>> match = match_spatial(column, spatial_trial(column, [1.0, 0.2, 0.4]))
    >>> match.direction.round(3).tolist() == rotation(0.4, 0.3)[2].round(3).tolist()
    True
    """
    _require_dimension(found, 3)
    size, top = math.sqrt(variance_trial(found)), float(found.counts.max())
    scale = np.array([top, 1 / size, 1 / size, 1 / size, 1.0, 1.0])
    fitted, residual, converged = _fit(spatial_ridge, found, trial, scale, settings)
    root = np.array([[fitted[1], 0.0], [fitted[2], fitted[3]]])
    precision = np.linalg.eigvalsh(root @ root.T)
    safe = np.where(precision > 0.0, precision, 1.0)
    return Match(
        parameters=fitted,
        direction=rotation(float(fitted[4]), float(fitted[5]))[2],
        sd=np.where(precision > 0.0, safe**-0.5, math.inf),
        residual=residual,
        converged=converged,
    )


def search_planar(
    found: Histogram, starts: int = 12, settings: MatchSettings | None = None
) -> Match:
    """Fit from trial directions spread evenly over [0, pi) and keep the lowest residual (5.3.1).

    Parameters
    ----------
    found : Histogram
        Counts in the plane.
    starts : int
        Trial directions, 1 or more.
    settings : MatchSettings, optional
        How it is fitted.

    Returns
    -------
    Match
        The match of the lowest residual; those that converged come first.

    Raises
    ------
    InvalidData
        As `match_planar`.
    InvalidSetting
        If there is no start.
    MissingExtra
        If odrpack is not installed.

    Examples
    --------
    >>> grid = Histogram(counts=np.ones((9, 9)), low=np.full(2, -4.5), width=1.0)
    >>> ridge = planar_ridge(grid.points(), [100.0, -0.2, 1.0]).reshape(9, 9)
    >>> search_planar(replace(grid, counts=ridge), starts=4).parameters.round(3).tolist()
    [100.0, -0.2, 1.0]
    """
    _require_starts(starts)
    angles = np.arange(starts) * math.pi / starts
    return _lowest([match_planar(found, planar_trial(found, a), settings) for a in angles])


def search_spatial(
    found: Histogram, starts: int = 12, settings: MatchSettings | None = None
) -> Match:
    """Fit from trial directions spread evenly over the hemisphere and keep the lowest residual.

    Parameters, returns and errors are those of `search_planar`, for a histogram in space.

    Examples
    --------
    >>> grid = Histogram(counts=np.ones((7, 7, 7)), low=np.full(3, -3.5), width=1.0)
    >>> truth = [100.0, 0.6, 0.1, 0.9, 0.4, 0.3]
    >>> column = replace(grid, counts=spatial_ridge(grid.points(), truth).reshape(7, 7, 7))
    >>> match = search_spatial(column, starts=4)
    >>> abs(round(float(match.direction @ rotation(0.4, 0.3)[2]), 3)), match.starts
    (1.0, 4)
    """
    _require_starts(starts)
    trials = [spatial_trial(found, u) for u in hemisphere(starts).T]
    return _lowest([match_spatial(found, trial, settings) for trial in trials])


def hemisphere(count: int) -> FloatArray:
    """Unit vectors spread evenly over the upper hemisphere (3, count), on a golden spiral.

    Examples
    --------
    >>> hemisphere(2).round(3).T.tolist()
    [[0.661, 0.0, 0.75], [-0.714, 0.654, 0.25]]
    """
    k = np.arange(count)
    z = 1.0 - (k + 0.5) / count
    turn = k * math.pi * (3.0 - math.sqrt(5.0))
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z])


def _fit(
    model: Model,
    found: Histogram,
    trial: ArrayLike,
    scale: FloatArray,
    settings: MatchSettings | None,
) -> tuple[FloatArray, float, bool]:
    """Fit a model in units of the data's own spread and height; ``scale`` takes parameters back."""
    try:
        from odrpack import odr_fit
    except ImportError as error:
        raise MissingExtra(
            "distribution matching needs odrpack: install it with pip install 'loose-env[report]'"
        ) from error
    how = MatchSettings() if settings is None else settings
    begin = as_floats(trial, "trial")
    if begin.shape != scale.shape or not np.isfinite(begin).all():
        raise InvalidData(f"trial is {trial!r}; it must be {len(scale)} finite parameters")
    counts = found.counts.ravel()
    kept = counts > 0.0 if how.bins == "filled" else np.ones(len(counts), dtype=bool)
    if kept.sum() <= len(scale):
        raise InvalidData(
            f"{kept.sum()} bins are too few to fit {len(scale)} parameters; take more samples or "
            "more bins"
        )
    top, size = float(scale[0]), math.sqrt(variance_trial(found))
    points, heights = found.points()[:, kept] / size, counts[kept] / top
    by_place, by_height = 1.0, 1.0
    if how.weights == "sampling":
        by_place = 12.0 * (size / found.width) ** 2
        by_height = top**2 / float(counts[kept].mean())
    fit = odr_fit(
        model,
        points,
        heights,
        begin / scale,
        weight_x=by_place,
        weight_y=by_height,
        diff_scheme="forward",
        maxit=how.iterations,
    )
    return fit.beta * scale, float(fit.sum_square) / int(kept.sum()), bool(fit.success)


def _lowest(matches: list[Match]) -> Match:
    best = min(matches, key=lambda match: (not match.converged, match.residual))
    return replace(best, starts=len(matches))


def _require_dimension(found: Histogram, dimension: int) -> None:
    if found.counts.ndim != dimension:
        raise InvalidData(f"the histogram has {found.counts.ndim} directions, not {dimension}")


def _require_starts(starts: int) -> None:
    if isinstance(starts, bool) or not isinstance(starts, (int, np.integer)) or starts < 1:
        raise InvalidSetting(f"starts is {starts!r}; it must be a whole number of 1 or more")
