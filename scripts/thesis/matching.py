"""Gaussian ridge fitted to a histogram of motion in the plane (marginal distribution matching).

The motion is taken as Gaussian in one direction and uniform across it, which is the direction of
the looseness. Bins are points with two kinds of error, so distances are orthogonal: a sample lies
anywhere in its bin, and counts scatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import MissingExtra
from loose_env.statistics import axial_difference, wrap_axial
from loose_env.typing import Array
from scripts.thesis.planar_motion import Histogram, histogram

HALF_WIDTH = 3.0
"""Half the range of the uniform component, in deviations of the Gaussian one."""
ANGLE = math.radians(34.0)
"""Direction of the Gaussian component [rad]."""
_STEEPEST = 50.0  # Exponents are cut here, so that a wild step of a search does not overflow.


def along(points: ArrayLike, angle: float) -> Array:
    """Component of points (2, N) along a direction of the plane (4.4)."""
    x, y = np.asarray(points, dtype=float)
    return np.asarray(np.cos(angle) * x + np.sin(angle) * y)


def planar_ridge(points: ArrayLike, a: ArrayLike) -> Array:
    """Height of the ridge: z = a0 exp(a1 (cos a2 x + sin a2 y)^2) (4.3, 4.5, 4.6).

    ``a``: height, exponent (negative, -1 / (2 sd^2) (4.8)) and direction [rad] of the Gaussian
    component.
    """
    a0, a1, a2 = np.asarray(a, dtype=float)
    return np.asarray(a0 * np.exp(np.minimum(a1 * along(points, a2) ** 2, _STEEPEST)))


def variance_trial(found: Histogram) -> float:
    """Trial variance of a direction: half the mean squared distance from the origin (4.7).

    It is the mean over the counts: the sum as printed needs the division by their sum.
    """
    squared = np.sum(found.points() ** 2, axis=0)
    return float(np.average(squared, weights=found.counts.ravel())) / 2


def match(found: Histogram, trial: ArrayLike) -> Array:
    """Fit the ridge to the filled bins from trial parameters (3,); a2 is put in [0, pi).

    In units of the data's own spread and height: positions weigh by the standard deviation within a
    bin, counts by the root of their mean.
    """
    try:
        from odrpack import odr_fit
    except ImportError as error:
        raise MissingExtra(
            "distribution matching needs odrpack: install it with pip install 'loose-env[report]'"
        ) from error
    counts = found.counts.ravel()
    kept = counts > 0.0
    top, size = float(counts.max()), math.sqrt(variance_trial(found))
    scale = np.array([top, size**-2, 1.0])
    fit = odr_fit(
        planar_ridge,
        found.points()[:, kept] / size,
        counts[kept] / top,
        np.asarray(trial, dtype=float) / scale,
        weight_x=12.0 * (size / found.width) ** 2,
        weight_y=top**2 / float(counts[kept].mean()),
        diff_scheme="forward",
        maxit=200,
    )
    a0, a1, a2 = fit.beta * scale
    return np.array([a0, a1, wrap_axial(float(a2))])


def exact_errors(part: float, bins: int = 20) -> Array:
    """Relative errors on counts that are exactly the model's, from all corners of a box of trials.

    The box is within ``part`` of the true height, exponent and direction (8, 3).
    """
    truth, span = np.array([10.0, -0.5, ANGLE]), 1.2 * HALF_WIDTH
    grid = Histogram(counts=np.ones((bins, bins)), low=np.full(2, -span), width=2.0 * span / bins)
    heights = planar_ridge(grid.points(), truth).reshape(bins, bins)
    found = replace(grid, counts=heights)
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return np.stack([match(found, truth * (1.0 + part * s)) / truth - 1.0 for s in signs])


def sampled_errors(trials: int, bins: int, sets: int, seed: Sequence[int], part: float) -> Array:
    """Errors on data sets of so many samples, from trials within ``part`` of the truth (sets, 3).

    Samples are Gaussian along `ANGLE` and uniform across it. Errors of height and exponent are
    relative, of the direction in rad.
    """
    errors, c, s = [], math.cos(ANGLE), math.sin(ANGLE)
    for k in range(sets):
        rng = np.random.default_rng([*seed, k])
        gauss, flat = rng.standard_normal(trials), rng.uniform(-HALF_WIDTH, HALF_WIDTH, trials)
        data = histogram(np.stack([c * gauss - s * flat, s * gauss + c * flat]), bins)
        height = trials * data.width**2 / (2.0 * HALF_WIDTH * math.sqrt(2.0 * math.pi))
        truth = np.array([height, -0.5, ANGLE])
        close = match(data, truth * (1.0 + (part if k % 2 else -part)))
        errors.append([*(close / truth - 1.0)[:2], axial_difference(float(close[2]), ANGLE)])
    return np.array(errors)
