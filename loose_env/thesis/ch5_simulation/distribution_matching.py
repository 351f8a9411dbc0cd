"""Error of marginal distribution matching for known directions (thesis 5.3.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import INK, MUTED
from loose_env.report import AGENTS, new_figure, quiet_axes
from loose_env.statistics import axial_difference
from loose_env.thesis.methods.motion.distribution_matching import (
    Match,
    MatchSettings,
    match_planar,
    match_spatial,
    search_planar,
    search_spatial,
)
from loose_env.thesis.methods.motion.gaussian_ridge import (
    planar_ridge,
    planar_trial,
    rotation,
    spatial_trial,
)
from loose_env.thesis.methods.motion.histogram import Histogram, histogram
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    settings: MatchSettings = field(default_factory=MatchSettings)


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
    searched_error: float
    """Median error of the direction with several starts [rad]."""
    converged: float
    """Share of single starts that stopped of their own accord [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SpatialFound:
    """Results of matching in space on the data sets of a case."""

    case: Case
    errors: Array
    """Error of the direction by data set and distance of the trial direction [rad] (S, K)."""
    offsets: Array
    """Distances of the trial direction [rad] (K,)."""
    searched: Array
    """Error of the direction with several starts [rad] (S,)."""


def ridge_samples(count: int, rng: np.random.Generator) -> Array:
    """Samples that are Gaussian along `ANGLE` and uniform across it (2, count)."""
    gauss = rng.standard_normal(count)
    flat = rng.uniform(-HALF_WIDTH, HALF_WIDTH, count)
    c, s = math.cos(ANGLE), math.sin(ANGLE)
    return np.stack([c * gauss - s * flat, s * gauss + c * flat])


def exact_surface(bins: int = 20) -> tuple[Histogram, Array]:
    """A histogram whose counts are exactly the model's, and the model's parameters."""
    truth = np.array([10.0, -0.5, ANGLE])
    span = 1.2 * HALF_WIDTH
    grid = Histogram(counts=np.ones((bins, bins)), low=np.full(2, -span), width=2.0 * span / bins)
    heights = planar_ridge(grid.points(), truth).reshape(bins, bins)
    return replace(grid, counts=heights), truth


def near_errors(found: Histogram, truth: Array, part: float) -> Array:
    """Relative errors of a0, a1 and a2 from all corners of a box of trial values (8, 3)."""
    signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    matches = [match_planar(found, truth * (1.0 + part * s)) for s in signs]
    return np.stack([m.parameters / truth - 1.0 for m in matches])


def far_success(found: Histogram, truth: Array) -> tuple[float, Array]:
    """Share of fits that reach the true parameters within 0.1 %, from far trial values.

    Returns ``share`` over heights and exponents wrong by ten either way, and directions up to 80
    degrees off; ``by_offset`` (K,): share of both sides on which the direction is found from the
    trial of (4.7) to (4.9), at each of `OFFSETS`.
    """
    reached = []
    for height in (0.1, 1.0, 10.0):
        for exponent in (0.1, 1.0, 10.0):
            for offset in OFFSETS[:-1:2]:
                trial = truth * [height, exponent, 1.0] + [0.0, 0.0, offset]
                match = match_planar(found, trial)
                size = np.abs(match.parameters[:2] / truth[:2] - 1.0).max()
                reached.append(size < 1e-3 and abs(_error(match)) < 1e-3 * ANGLE)
    by_offset = [
        np.mean(
            [
                abs(_error(match_planar(found, planar_trial(found, ANGLE + sign * offset)))) < GOOD
                for sign in (-1.0, 1.0)
            ]
        )
        for offset in OFFSETS
    ]
    return float(np.mean(reached)), np.array(by_offset, dtype=float)


def planar_study(case: Case, seed: Sequence[int], part: float) -> Found:
    """Match each data set of a case from near, from each distance, and from several starts.

    ``part``: relative error of the near trial values [1].
    """
    sets = [
        histogram(ridge_samples(case.trials, np.random.default_rng([*seed, k])), case.bins)
        for k in range(case.sets)
    ]
    near, right, searched, converged = [], np.zeros(len(OFFSETS)), [], []
    for k, data in enumerate(sets):
        sign = 1.0 if k % 2 else -1.0
        height = case.trials * data.width**2 / (2.0 * HALF_WIDTH * math.sqrt(2.0 * math.pi))
        truth = np.array([height, -0.5, ANGLE])
        close = match_planar(data, truth * (1.0 + sign * part), case.settings)
        relative = close.parameters / truth - 1.0
        near.append([relative[0], relative[1], _error(close)])
        for j, offset in enumerate(OFFSETS):
            trial = planar_trial(data, ANGLE + sign * offset)
            match = match_planar(data, trial, case.settings)
            right[j] += abs(_error(match)) < GOOD
            converged.append(match.converged)
        searched.append(abs(_error(search_planar(data, STARTS, case.settings))))
    return Found(
        case=case,
        near=np.array(near),
        success=right / case.sets,
        searched=float(np.mean(np.array(searched) < GOOD)),
        searched_error=float(np.median(searched)),
        converged=float(np.mean(converged)),
    )


def spatial_study(case: Case, seed: Sequence[int]) -> SpatialFound:
    """Match each spatial data set of a case from several distances, and from several starts."""
    frame = rotation(*AXIS)
    truth = frame[2]
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
            begin = math.cos(offset) * truth + math.sin(offset) * across
            match = match_spatial(data, spatial_trial(data, begin), case.settings)
            errors[k, j] = _angle(match, truth)
        searched.append(_angle(search_spatial(data, STARTS, case.settings), truth))
    return SpatialFound(case=case, errors=errors, offsets=offsets, searched=np.array(searched))


def basin_figure(found: Sequence[Found], exact: Array) -> Figure:
    """Draw the share of right directions against the trial direction's distance from the truth.

    ``exact`` (K,) is that of the model's own counts, drawn dashed.
    """
    figure = new_figure(3.3)
    axes = figure.add_axes((0.10, 0.20, 0.48, 0.70))
    edge = float(np.degrees(OFFSETS[-1]))
    search = edge + 14.0
    heights = np.array([f.searched for f in found])
    order = np.argsort(heights, kind="stable")
    labels = dict(zip(order.tolist(), _apart(heights[order], 0.2), strict=True))
    for k, f in enumerate(found):
        colour = AGENTS[k]
        x = np.degrees(OFFSETS)
        axes.plot(x, f.success, color=colour, linewidth=2.0, marker="os^D"[k], markersize=4.5)
        axes.plot([search], [f.searched], color=colour, marker="os^D"[k], markersize=7)
        axes.plot(
            [edge, search], [f.success[-1], f.searched], color=colour, linewidth=1.0, dashes=(2, 2)
        )
        axes.annotate(
            f.case.name,
            xy=(search, f.searched),
            xytext=(search + 14.0, labels[k]),
            color=INK,
            fontsize=9,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 1.0, "shrinkB": 6},
        )
    axes.plot(np.degrees(OFFSETS), exact, color=INK, linewidth=1.0, dashes=(4, 2), zorder=5)
    axes.text(34.0, 0.955, "the model's own counts", color=INK, fontsize=9, ha="center", va="top")
    ticks = [0, 30, 60, 90]
    axes.set_xticks([*ticks, search], [*(f"{t}°" for t in ticks), f"{STARTS}\nstarts"])
    axes.set_yticks([0.0, 0.5, 1.0], ["0 %", "50 %", "100 %"])
    axes.set(xlim=(-3.0, search + 4.0), ylim=(-0.04, 1.04))
    axes.set_xlabel("trial direction away from the truth", color=MUTED, fontsize=9, x=0.42)
    axes.text(-3.0, 1.09, "within 5° of the truth", color=MUTED, fontsize=9)
    quiet_axes(axes, size=9)
    return figure


def _error(match: Match) -> float:
    """Error of a2 [rad]."""
    return axial_difference(float(match.parameters[2]), ANGLE)


def _angle(match: Match, truth: Array) -> float:
    """Angle between the axis found and the true one [rad]."""
    return math.acos(min(1.0, abs(float(match.direction @ truth))))


def _apart(rising: Array, gap: float) -> list[float]:
    """Move rising heights to at least ``gap`` from each other, and below 1."""
    placed = rising.astype(float).copy()
    for k in range(1, len(placed)):
        placed[k] = max(placed[k], placed[k - 1] + gap)
    limit = 1.0
    for k in reversed(range(len(placed))):
        placed[k] = min(placed[k], limit)
        limit = placed[k] - gap
    return [float(p) for p in placed]
