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

from loose_env.errors import InvalidData, MissingExtra
from loose_env.statistics import as_floats, wrap_axial
from loose_env.thesis.methods.motion.gaussian_ridge import (
    hemisphere,
    planar_ridge,
    planar_trial,
    rotation,
    sd_from_exponent,
    spatial_ridge,
    spatial_trial,
    variance_trial,
)
from loose_env.thesis.methods.motion.histogram import Histogram
from loose_env.typing import Array

Model = Callable[[ArrayLike, ArrayLike], Array]


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """Settings of the fit of a ridge."""

    bins: Literal["filled", "all"] = "filled"
    """Bins that are fitted. The ridge of the model has no ends, the motion has: with empty bins
    beyond its ends the fit turns towards the diagonal of the motion's outline."""
    weights: Literal["sampling", "unit"] = "sampling"
    """Unit of the distances. Sampling: positions in the standard deviation within a bin,
    counts in the root of their mean. Unit: positions in the spread, counts in the highest."""
    iterations: int = 200
    """Iterations at most [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """A fitted ridge."""

    parameters: Array
    """In the plane (3,): a0, a1, a2 of `planar_ridge`. In space (6,): b of `spatial_ridge`."""
    direction: Array
    """Unit vector along the ridge, that of the looseness, shape (2,) or (3,)."""
    sd: Array
    """Standard deviations of the Gaussian motion across it, shape (1,) or (2,), largest first,
    unit of the data; infinite where the fit found no ridge."""
    residual: float
    """Mean of the squared orthogonal distances, in the unit of the weights [1]."""
    converged: bool
    """True if the search converged to a minimum."""
    starts: int = 1
    """Trial directions from which it was started."""


def match_planar(
    found: Histogram, trial: ArrayLike, settings: MatchSettings | None = None
) -> Match:
    """Fit `planar_ridge` to a planar histogram from trial parameters.

    ``trial`` (3,): trial a0, a1, a2; see `planar_trial`. Returns the minimum that was reached; a2
    is wrapped to [0, pi).

    Examples
    --------
    >>> grid = Histogram(counts=np.ones((9, 9)), low=np.full(2, -4.5), width=1.0)
    >>> ridge = planar_ridge(grid.points(), [100.0, -0.2, 1.0]).reshape(9, 9)
    >>> match = match_planar(replace(grid, counts=ridge), [90.0, -0.22, 1.1])
    >>> match.parameters.round(3).tolist()
    [100.0, -0.2, 1.0]
    """
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

    ``trial`` (6,): trial parameters; see `spatial_trial`.

    Examples
    --------
    >>> grid = Histogram(counts=np.ones((7, 7, 7)), low=np.full(3, -3.5), width=1.0)
    >>> truth = [100.0, 0.6, 0.1, 0.9, 0.4, 0.3]
    >>> column = replace(grid, counts=spatial_ridge(grid.points(), truth).reshape(7, 7, 7))
    >>> match = match_spatial(column, spatial_trial(column, [1.0, 0.2, 0.4]))
    >>> match.direction.round(3).tolist() == rotation(0.4, 0.3)[2].round(3).tolist()
    True
    """
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

    ``starts``: trial directions, 1 or more. Returns the match of the lowest residual; those that
    converged come first.

    Examples
    --------
    >>> grid = Histogram(counts=np.ones((9, 9)), low=np.full(2, -4.5), width=1.0)
    >>> ridge = planar_ridge(grid.points(), [100.0, -0.2, 1.0]).reshape(9, 9)
    >>> search_planar(replace(grid, counts=ridge), starts=4).parameters.round(3).tolist()
    [100.0, -0.2, 1.0]
    """
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
    trials = [spatial_trial(found, u) for u in hemisphere(starts).T]
    return _lowest([match_spatial(found, trial, settings) for trial in trials])


def _fit(
    model: Model, found: Histogram, trial: ArrayLike, scale: Array, settings: MatchSettings | None
) -> tuple[Array, float, bool]:
    """Fit a model in units of the data's own spread and height; ``scale`` takes parameters back."""
    try:
        from odrpack import odr_fit
    except ImportError as error:
        raise MissingExtra(
            "distribution matching needs odrpack: install it with pip install 'loose-env[report]'"
        ) from error
    how = MatchSettings() if settings is None else settings
    begin = as_floats(trial, "trial")
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
