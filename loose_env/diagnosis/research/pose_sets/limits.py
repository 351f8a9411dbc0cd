"""Upper bounds on the accuracy of link finding, for any choice of poses.

The model: n links, equally likely; the slide's direction z in its link, uniform over all axes; in
pose t the tool sees the axis R_k(q_t) z with a known scatter. Carrying the axes seen back into link
k turns each of them by an isometry of the axes, so it keeps volumes, even where q_t was chosen in
the light of all axes seen before. Under every link the axes seen are then distributed as a
rearrangement of one density g, that of axes scattered about a common unknown one. A rule that names
links cuts the space of axes into n regions, and none holds more of g than the largest share that
a region of its volume can hold; that share is concave in the volume. So at best

    success = the largest mass of g in 1/n of the volume,

which is the sphere-packing bound of coding theory with feedback, or the converse by hypothesis
testing against uniform axes. For two poses in the plane it is reached.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from loose_env.diagnosis.likelihood.axial_likelihood import log_mean_bingham
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

__all__ = [
    "bingham_width",
    "direction_limit",
    "one_by_one_share",
    "scattered_axes",
]

_POLAR = (np.arange(8192) + 0.5) * np.pi / 2 / 8192
"""Angles from an axis, cell centres up to a right angle [rad]."""


@lru_cache(maxsize=64)
def bingham_width(sd: float, dimension: int) -> float:
    """Width s of the density exp(-sin²/2s²) whose axes scatter with a standard deviation.

    Parameters
    ----------
    sd : float
        Rms angle from the axis, per direction across it [rad].
    dimension : int
        2 for the plane, 3 for space.

    Raises
    ------
    InvalidSetting
        If no density scatters so: axes of no preference have an rms of 52 degrees in the plane
        and, per direction across, of 43 degrees in space.

    Examples
    --------
    >>> round(float(np.degrees(bingham_width(np.radians(5.0), 2))), 2)
    4.96
    """
    if dimension not in (2, 3):
        raise InvalidSetting(f"axes lie in the plane (2) or in space (3), got {dimension!r}")

    def excess(log_width: float) -> float:
        return _rms(np.exp(log_width), dimension) - sd

    low, high = np.log(1e-3), np.log(30.0)
    if not (np.isfinite(sd) and excess(low) < 0 < excess(high)):
        most = np.degrees(_rms(30.0, dimension))
        raise InvalidSetting(
            f"axes scatter with a standard deviation of 0.1 to {most:.0f} degrees, "
            f"got {np.degrees(sd):g}"
        )
    return float(np.exp(brentq(excess, low, high)))


def scattered_axes(true: ArrayLike, width: float, rng: np.random.Generator) -> Array:
    """Draw axes about given ones with density exp(-sin²/2s²).

    Parameters
    ----------
    true : array_like (..., d)
        Unit vectors; d = 2 or 3.
    width : float
        s, as from `bingham_width` [rad].
    rng : numpy.random.Generator
        Source.

    Returns
    -------
    ndarray (..., d)
        Unit vectors.

    Examples
    --------
    >>> drawn = scattered_axes(np.tile([0.0, 0.0, 1.0], (4000, 1)), 0.1, np.random.default_rng(0))
    >>> round(float(np.sqrt(np.mean(np.arccos(drawn[:, 2]) ** 2) / 2)), 2)
    0.1
    """
    axes = np.asarray(true, dtype=float)
    share = _cumulative(width, axes.shape[-1])
    polar = np.interp(rng.random(axes.shape[:-1]), share, _POLAR)[..., None]
    across = rng.standard_normal(axes.shape)
    across -= np.sum(across * axes, axis=-1, keepdims=True) * axes
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.asarray(np.cos(polar) * axes + np.sin(polar) * across)


def direction_limit(
    links: int,
    poses: int,
    sd: float,
    dimension: int,
    rng: np.random.Generator,
    *,
    samples: int = 20_000,
) -> Array:
    """Bound on the success of any choice of poses and any rule, from directions alone.

    Poses may be chosen beforehand or one by one. What the arm's joints can reach is not asked, so
    that the bound need not be reached.

    Parameters
    ----------
    links : int
        Links in question.
    poses : int
        Largest number of poses.
    sd : float
        Standard deviation of a direction, as `bingham_width` takes it [rad].
    dimension : int
        2 or 3.
    rng : numpy.random.Generator
        Source: the volume is found by drawing from g, each draw weighing 1/g.
    samples : int
        Number of draws.

    Returns
    -------
    ndarray (poses,)
        Success with 1 to ``poses`` poses; 1/links with one.

    Examples
    --------
    >>> found = direction_limit(6, 2, np.radians(5.0), 2, np.random.default_rng(0))
    >>> found.round(2).tolist()  # normal scatter has 0.966: erf(pi / (4 n s))
    [0.17, 0.97]
    """
    for name, value in (("links", links), ("poses", poses), ("samples", samples)):
        if isinstance(value, bool) or int(value) != value or value < 1:
            raise InvalidSetting(f"{name} is a whole number from 1, got {value!r}")
    width = bingham_width(sd, dimension)
    common = np.zeros((samples, poses, dimension))
    common[..., 0] = 1.0
    seen = scattered_axes(common, width, rng)
    across = (np.eye(dimension) - seen[..., :, None] * seen[..., None, :]) / width**2
    alone = float(log_mean_bingham(across[0, 0]))
    found = np.empty(poses)
    for t in range(1, poses + 1):
        # Density of the t axes over uniform ones.
        log = log_mean_bingham(across[:, :t].sum(axis=1)) - t * alone
        falling = np.sort(log)[::-1]
        volume = np.cumsum(np.exp(-falling)) / samples
        inside = int(np.searchsorted(volume, 1 / links))
        found[t - 1] = 1 / links if t == 1 else min(1.0, inside / samples)
    return np.maximum.accumulate(found)


def one_by_one_share(links: int, poses: int) -> float:
    """Share found by moving one joint at a time from the base, if directions were perfect.

    Each move settles one link, from 1 on, and the last is left over; among the links not settled
    one is guessed. So t poses name t of the n links. Until the link is settled it takes
    (n-1)(n+2)/2n moves on average.

    Examples
    --------
    >>> [round(one_by_one_share(4, t), 2) for t in (1, 2, 3, 4)]
    [0.25, 0.5, 0.75, 1.0]
    """
    if links < 1 or poses < 1:
        raise InvalidSetting(f"links and poses count from 1, got {links!r} and {poses!r}")
    return min(1.0, poses / links)


def _density(width: float, dimension: int) -> Array:
    """Density of the angle from the axis, unnormalised, on `_POLAR`."""
    return np.asarray(
        np.exp(-0.5 * (np.sin(_POLAR) / width) ** 2) * np.sin(_POLAR) ** (dimension - 2)
    )


@lru_cache(maxsize=64)
def _cumulative(width: float, dimension: int) -> Array:
    """Share of axes within each angle of `_POLAR`."""
    mass = np.cumsum(_density(width, dimension))
    return np.asarray(mass / mass[-1])


def _rms(width: float, dimension: int) -> float:
    weight = _density(width, dimension)
    return float(np.sqrt(weight @ _POLAR**2 / weight.sum() / (dimension - 1)))
