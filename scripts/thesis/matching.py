"""Gaussian ridge fitted to a histogram of motion (marginal distribution matching), studied.

The motion is taken as Gaussian in all directions but one, and uniform along that one, which is the
direction of the looseness. Bins are points with two kinds of error, so distances are orthogonal: a
sample lies anywhere in its bin, and counts scatter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import MissingExtra
from loose_env.statistics import axial_difference, wrap_axial
from loose_env.typing import Array
from scripts.thesis.planar_motion import Histogram, histogram

Model = Callable[[ArrayLike, ArrayLike], Array]
_STEEPEST = 50.0  # Exponents are cut here, so that a wild step of a search does not overflow.


def along(points: ArrayLike, angle: float) -> Array:
    """Component of points (2, N) along a direction of the plane (4.4)."""
    x, y = np.asarray(points, dtype=float)
    return np.asarray(np.cos(angle) * x + np.sin(angle) * y)


def planar_ridge(points: ArrayLike, a: ArrayLike) -> Array:
    """Height of the ridge: z = a0 exp(a1 (cos a2 x + sin a2 y)^2) (4.3, 4.5, 4.6).

    ``a``: height, exponent (negative) and direction [rad] of the Gaussian component.
    """
    a0, a1, a2 = np.asarray(a, dtype=float)
    return np.asarray(a0 * np.exp(np.minimum(a1 * along(points, a2) ** 2, _STEEPEST)))


def exponent_from_sd(sd: float) -> float:
    """Exponent a1 of a standard deviation: -1 / (2 sd^2) (4.8)."""
    return -0.5 / sd**2


def rotation(azimuth: float, elevation: float) -> Array:
    """Rotation into the plane across a direction (4.2): row three is the direction [rad]."""
    cr, sr = np.cos(azimuth), np.sin(azimuth)
    ce, se = np.cos(elevation), np.sin(elevation)
    return np.array([[-sr, cr, 0.0], [-se * cr, -se * sr, ce], [ce * cr, ce * sr, se]])


def to_plane(points: ArrayLike, azimuth: float, elevation: float) -> Array:
    """Points (3, N) in the frame whose z axis is the direction of azimuth and elevation (4.1)."""
    return np.asarray(rotation(azimuth, elevation) @ np.asarray(points, dtype=float))


def spatial_ridge(points: ArrayLike, b: ArrayLike) -> Array:
    """Height of the column of ellipses: b0 exp(-|L' p|^2 / 2), p the points in the plane (4.1).

    ``b`` (6,): height, the three entries of L = [[b1, 0], [b2, b3]], a root of the inverse
    covariance in the plane, azimuth and elevation of the direction across it [rad].
    """
    height, root, skew, other, azimuth, elevation = np.asarray(b, dtype=float)
    x, y, _ = to_plane(points, azimuth, elevation)
    squared = (root * x + skew * y) ** 2 + (other * y) ** 2
    return np.asarray(height * np.exp(-0.5 * squared))


def variance_trial(found: Histogram) -> float:
    """Trial variance: half the mean squared distance from the origin (4.7), in d directions 1 / d.

    It is the mean over the counts: the sum as printed needs the division by their sum.
    """
    counts, squared = found.counts.ravel(), np.sum(found.points() ** 2, axis=0)
    return float(np.sum(squared * counts)) / float(counts.sum()) / found.counts.ndim


def planar_trial(found: Histogram, angle: float) -> Array:
    """Trial parameters with a given direction: a0 the highest count, a1 from (4.7) and (4.9)."""
    a1 = exponent_from_sd(math.sqrt(variance_trial(found)))
    return np.array([float(found.counts.max()), a1, angle])


def spatial_trial(found: Histogram, direction: ArrayLike) -> Array:
    """Trial parameters of `spatial_ridge` (6,): round, with the trial variance of (4.7)."""
    x, y, z = np.asarray(direction, dtype=float)
    root = 1.0 / math.sqrt(variance_trial(found))
    azimuth, elevation = math.atan2(y, x), math.atan2(z, math.hypot(x, y))
    return np.array([found.counts.max(), root, 0.0, root, azimuth, elevation])


def hemisphere(count: int) -> Array:
    """Unit vectors spread evenly over the upper hemisphere (3, count), on a golden spiral."""
    k = np.arange(count)
    z = 1.0 - (k + 0.5) / count
    turn, flat = k * math.pi * (3.0 - math.sqrt(5.0)), np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z])


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """Settings of the fit of a ridge."""

    bins: Literal["filled", "all"] = "filled"
    """Bins that are fitted. The ridge of the model has no ends, the motion has: with empty bins
    beyond its ends the fit turns towards the diagonal of the motion's outline."""
    iterations: int = 200
    """Iterations at most [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """A fitted ridge."""

    parameters: Array
    """In the plane (3,): a0, a1, a2 of `planar_ridge`. In space (6,): b of `spatial_ridge`."""
    direction: Array
    """Unit vector along the ridge, that of the looseness, shape (2,) or (3,)."""
    residual: float
    """Mean of the squared orthogonal distances [1]."""
    converged: bool
    """True if the search converged to a minimum."""


def match(found: Histogram, trial: ArrayLike, settings: MatchSettings | None = None) -> Match:
    """Fit the ridge of the histogram's dimension from trial parameters; a2 is put in [0, pi)."""
    size, top = math.sqrt(variance_trial(found)), float(found.counts.max())
    planar = found.counts.ndim == 2
    scale = [top, size**-2, 1.0] if planar else [top, 1 / size, 1 / size, 1 / size, 1.0, 1.0]
    model = planar_ridge if planar else spatial_ridge
    fitted, residual, converged = _fit(model, found, trial, np.array(scale), settings)
    if planar:
        fitted[2] = wrap_axial(float(fitted[2]))
        direction = np.array([-math.sin(fitted[2]), math.cos(fitted[2])])
    else:
        direction = rotation(float(fitted[4]), float(fitted[5]))[2]
    return Match(parameters=fitted, direction=direction, residual=residual, converged=converged)


def search(found: Histogram, starts: int, settings: MatchSettings | None = None) -> Match:
    """Fit from trial directions spread over all axes and keep the lowest residual (5.3.1).

    Matches that converged come first.
    """
    if found.counts.ndim == 2:
        trials = [planar_trial(found, a) for a in np.arange(starts) * math.pi / starts]
    else:
        trials = [spatial_trial(found, u) for u in hemisphere(starts).T]
    matches: Sequence[Match] = [match(found, trial, settings) for trial in trials]
    return min(matches, key=lambda m: (not m.converged, m.residual))


def _fit(
    model: Model, found: Histogram, trial: ArrayLike, scale: Array, settings: MatchSettings | None
) -> tuple[Array, float, bool]:
    """Fit a model in units of the data's own spread and height; ``scale`` takes parameters back.

    Positions weigh by the standard deviation within a bin, counts by the root of their mean.
    """
    try:
        from odrpack import odr_fit
    except ImportError as error:
        raise MissingExtra(
            "distribution matching needs odrpack: install it with pip install 'loose-env[report]'"
        ) from error
    how = MatchSettings() if settings is None else settings
    counts = found.counts.ravel()
    kept = counts > 0.0 if how.bins == "filled" else np.ones(len(counts), dtype=bool)
    top, size = float(scale[0]), math.sqrt(variance_trial(found))
    fit = odr_fit(
        model,
        found.points()[:, kept] / size,
        counts[kept] / top,
        np.asarray(trial, dtype=float) / scale,
        weight_x=12.0 * (size / found.width) ** 2,
        weight_y=top**2 / float(counts[kept].mean()),
        diff_scheme="forward",
        maxit=how.iterations,
    )
    return fit.beta * scale, float(fit.sum_square) / int(kept.sum()), bool(fit.success)


# Data sets whose direction is known, and the errors of matching on them.

HALF_WIDTH = 3.0
"""Half the range of the uniform component, in deviations of the Gaussian one."""
ANGLE = math.radians(34.0)
"""Direction of the Gaussian component in the plane [rad], midway between two starts."""
AXIS = (math.radians(30.0), math.radians(35.0))
"""Azimuth and elevation of the looseness in space [rad]."""
SPATIAL_SD = (1.0, 0.6)
"""Deviations of the Gaussian components in space."""
GOOD = math.radians(5.0)
"""Error of the direction that counts as success [rad]."""
STARTS = 8
"""Trial directions of a search."""
OFFSETS = np.radians(np.arange(0.0, 91.0, 10.0))
"""Distances of the trial direction from the truth [rad]."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """Data sets of one kind."""

    name: str
    trials: int
    """Samples in a data set."""
    bins: int
    """Bins in each direction."""
    sets: int
    """Data sets."""
    settings: MatchSettings | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """Results of matching in the plane on the data sets of a case."""

    case: Case
    near: Array
    """Errors from a trial direction within 10 % of the truth: a0 [1], a1 [1], a2 [rad] (S, 3)."""
    success: Array
    """Share of directions within 5 degrees, by distance of the trial direction (K,)."""
    searched: float
    """Share of directions within 5 degrees with several starts [1]."""
    converged: float
    """Share of single starts that stopped of their own accord [1]."""


def ridge_samples(count: int, rng: np.random.Generator) -> Array:
    """Samples that are Gaussian along `ANGLE` and uniform across it (2, count)."""
    gauss = rng.standard_normal(count)
    flat = rng.uniform(-HALF_WIDTH, HALF_WIDTH, count)
    c, s = math.cos(ANGLE), math.sin(ANGLE)
    return np.stack([c * gauss - s * flat, s * gauss + c * flat])


def exact_surface(bins: int = 20) -> tuple[Histogram, Array]:
    """A histogram whose counts are exactly the model's, and the model's parameters."""
    truth, span = np.array([10.0, -0.5, ANGLE]), 1.2 * HALF_WIDTH
    grid = Histogram(counts=np.ones((bins, bins)), low=np.full(2, -span), width=2.0 * span / bins)
    heights = planar_ridge(grid.points(), truth).reshape(bins, bins)
    return replace(grid, counts=heights), truth


def near_errors(found: Histogram, truth: Array, part: float) -> Array:
    """Relative errors of a0, a1 and a2 from all corners of a box of trial values (8, 3)."""
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return np.stack(
        [match(found, truth * (1.0 + part * s)).parameters / truth - 1.0 for s in signs]
    )


def far_success(found: Histogram, truth: Array) -> tuple[float, Array]:
    """Share of fits that reach the true parameters within 0.1 %, from far trial values.

    Over heights and exponents wrong by ten either way, and directions up to 80 degrees off; and the
    share of both sides on which the direction is found from (4.7) to (4.9), at each of `OFFSETS`.
    """
    reached = []
    for height in (0.1, 1.0, 10.0):
        for exponent in (0.1, 1.0, 10.0):
            for offset in OFFSETS[:-1:2]:
                m = match(found, truth * [height, exponent, 1.0] + [0.0, 0.0, offset])
                size = np.abs(m.parameters[:2] / truth[:2] - 1.0).max()
                reached.append(size < 1e-3 and abs(_error(m)) < 1e-3 * ANGLE)
    by_offset = [
        np.mean(
            [
                abs(_error(match(found, planar_trial(found, ANGLE + sign * offset)))) < GOOD
                for sign in (-1.0, 1.0)
            ]
        )
        for offset in OFFSETS
    ]
    return float(np.mean(reached)), np.array(by_offset, dtype=float)


def planar_study(case: Case, seed: Sequence[int], part: float) -> Found:
    """Match each data set from near (within ``part``), from each distance, from several starts."""
    near, right, searched, converged = [], np.zeros(len(OFFSETS)), [], []
    for k in range(case.sets):
        data = histogram(ridge_samples(case.trials, np.random.default_rng([*seed, k])), case.bins)
        sign = 1.0 if k % 2 else -1.0
        height = case.trials * data.width**2 / (2.0 * HALF_WIDTH * math.sqrt(2.0 * math.pi))
        truth = np.array([height, -0.5, ANGLE])
        close = match(data, truth * (1.0 + sign * part), case.settings)
        near.append([*(close.parameters / truth - 1.0)[:2], _error(close)])
        for j, offset in enumerate(OFFSETS):
            m = match(data, planar_trial(data, ANGLE + sign * offset), case.settings)
            right[j] += abs(_error(m)) < GOOD
            converged.append(m.converged)
        searched.append(abs(_error(search(data, STARTS, case.settings))) < GOOD)
    return Found(
        case=case,
        near=np.array(near),
        success=right / case.sets,
        searched=float(np.mean(searched)),
        converged=float(np.mean(converged)),
    )


def spatial_study(case: Case, seed: Sequence[int]) -> tuple[Array, Array]:
    """Error of the direction from trials 0, 30, 60, 90 degrees off (S, 4), and searched (S,) [rad].

    All by data set.
    """
    frame = rotation(*AXIS)
    offsets = np.radians([0.0, 30.0, 60.0, 90.0])
    errors, searched = np.empty((case.sets, len(offsets))), []
    for k in range(case.sets):
        rng = np.random.default_rng([*seed, k])
        gauss = rng.standard_normal((2, case.trials)) * np.array(SPATIAL_SD)[:, None]
        flat = rng.uniform(-HALF_WIDTH, HALF_WIDTH, case.trials)
        data = histogram(frame.T @ np.vstack([gauss, flat]), case.bins)
        turn = rng.uniform(0.0, 2.0 * math.pi)
        across = frame[0] * math.cos(turn) + frame[1] * math.sin(turn)
        for j, offset in enumerate(offsets):
            begin = math.cos(offset) * frame[2] + math.sin(offset) * across
            errors[k, j] = _angle(match(data, spatial_trial(data, begin), case.settings), frame[2])
        searched.append(_angle(search(data, STARTS, case.settings), frame[2]))
    return errors, np.array(searched)


def _error(m: Match) -> float:
    """Error of a2 [rad]."""
    return axial_difference(float(m.parameters[2]), ANGLE)


def _angle(m: Match, truth: Array) -> float:
    """Angle between the axis found and the true one [rad]."""
    return math.acos(min(1.0, abs(float(m.direction @ truth))))
