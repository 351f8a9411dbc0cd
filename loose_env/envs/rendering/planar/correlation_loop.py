"""The correlation loop: how well the tool follows the shaken joints, direction by direction.

Drawing the correlation loop on the tool.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loose_env.diagnosis.records.prediction import Prediction
from loose_env.envs.rendering.palette import FAINT, MEASURED, MUTED
from loose_env.envs.rendering.planar.view import PlanarPose
from loose_env.rig.measurement import Measurement
from loose_env.statistics import (
    Covariances,
    acceleration_from_angle,
    axial_angle,
    bandpass,
    correlation_loop_from,
    covariances,
    lowest_coherence_direction_from,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "Loop",
    "LoopPair",
    "draw_healthy",
    "draw_measured",
    "draw_scale",
    "loop_of",
    "measured_loop",
    "predicted_loop",
    "record_of",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The correlation loop of one record, in the plane of the tool."""

    points: Array
    """r(phi) along every direction phi of the tool frame [1] (K, 2)."""
    lowest: Array
    """Direction of lowest correlation, tool frame, unit vector (2,)."""
    maximum: float
    """Highest correlation over directions [1]."""
    peak: Array
    """Covariance with the excitation: the side to which the loop lies (2,)."""

    def facing(self, other: Loop) -> Loop:
        """Turn the loop to the same side as another one."""
        if self.peak @ other.peak >= 0:
            return self
        return Loop(points=-self.points, lowest=self.lowest, maximum=self.maximum, peak=-self.peak)


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopPair:
    """What a record shows, and what it would show on the healthy arm."""

    measured: Loop
    healthy: Loop


def loop_of(cov: Covariances) -> Loop:
    """Trace the loop of a record with one or several shaken joints.

    Of several joints, the sum that correlates highest with the tool counts: the first
    canonical variate. It is uncorrelated with the tool along the direction of lowest
    coherence, so the loop has its notch there.

    Examples
    --------
    >>> x = [[1.0, -1.0, 1.0, -1.0]]
    >>> a = [[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]
    >>> loop = loop_of(covariances(x, a))
    >>> loop.lowest.tolist(), loop.maximum
    ([0.0, 1.0], 1.0)
    """
    lowest = lowest_coherence_direction_from(cov)
    # The canonical directions of the tool are perpendicular under its covariance.
    across = cov.aa @ lowest.direction
    weights = np.linalg.solve(cov.xx, cov.xa @ np.array([across[1], -across[0]]))
    # The sign of a sum is free: take the one in which most of it counts upwards.
    if np.sum(weights * np.sqrt(np.diag(cov.xx))) < 0:
        weights = -weights
    one = Covariances(
        xx=np.array([[weights @ cov.xx @ weights]]),
        xa=(weights @ cov.xa)[None],
        aa=cov.aa,
        count=cov.count,
    )
    # Close to the notch the correlation turns fast, so the angles crowd there.
    near = np.geomspace(1e-5, 0.1, 60)
    turn = np.unique(np.concatenate([np.linspace(0.0, np.pi, 361), near, np.pi - near]))
    angles = axial_angle(lowest.direction) + turn
    radius = correlation_loop_from(one, angles)
    return Loop(
        points=radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1),
        lowest=lowest.direction,
        maximum=float(np.sqrt(lowest.coherences.max())),
        peak=one.xa[0],
    )


def record_of(measurement: Measurement) -> tuple[Array, Array]:
    """Accelerations of the shaken joints (m, N) and of the tool (d, N), in the band."""
    on = np.flatnonzero(measurement.excited)
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[on], rate, band)
    return joint, bandpass(measurement.tool, rate, band)


def measured_loop(measurement: Measurement) -> Loop:
    """Trace the loop of a measurement in the plane."""
    return loop_of(covariances(*record_of(measurement)))


def predicted_loop(prediction: Prediction) -> Loop:
    """Trace the loop that the nominal, healthy arm would show."""
    return loop_of(
        Covariances(xx=prediction.joint, xa=prediction.joint_tool, aa=prediction.tool, count=0)
    )


def draw_scale(axes: Axes, pose: PlanarPose, radius: float) -> None:
    """Draw the circle on which the correlation would be 1, and name it."""
    from matplotlib.patches import Circle

    x, y = float(pose.tool[0]), float(pose.tool[1])
    axes.add_patch(
        Circle((x, y), radius, facecolor="none", edgecolor=FAINT, linewidth=1.1, zorder=3)
    )
    side = _clear_side(axes, pose, radius)
    label = pose.tool + 1.06 * radius * side
    axes.text(
        label[0],
        label[1],
        "r = 1",
        color=MUTED,
        fontsize=8,
        ha="left" if side[0] > 0 else "right",
        va="bottom" if side[1] > 0 else "top",
        zorder=9,
    )


def draw_healthy(axes: Axes, pose: PlanarPose, radius: float, loop: Loop) -> None:
    """Draw what the nominal, healthy arm would show: dashed and grey."""
    points = pose.tool + radius * loop.points @ pose.frame.T
    axes.plot(*points.T, color=MUTED, linewidth=1.3, linestyle=(0, (4, 2.5)), zorder=7.3)
    _axis(axes, pose, 1.08 * radius, loop.lowest, color=MUTED, width=1.3, dashes=(4, 2.5))


def draw_measured(axes: Axes, pose: PlanarPose, radius: float, loop: Loop) -> None:
    """Draw the loop of the record and its direction of lowest correlation."""
    from matplotlib.patches import Polygon

    points = pose.tool + radius * loop.points @ pose.frame.T
    axes.add_patch(Polygon(points, facecolor=MEASURED, alpha=0.22, linewidth=0, zorder=3.1))
    axes.plot(*points.T, color=MEASURED, linewidth=2.0, solid_joinstyle="round", zorder=7.4)
    _axis(axes, pose, 1.3 * radius, loop.lowest, color=MEASURED, width=2.6, dashes=None)


def _axis(
    axes: Axes,
    pose: PlanarPose,
    half: float,
    direction: Array,
    *,
    color: str,
    width: float,
    dashes: tuple[float, float] | None,
) -> None:
    along = half * (pose.frame @ direction)
    line = np.array([pose.tool - along, pose.tool + along])
    axes.plot(
        *line.T,
        color=color,
        linewidth=width,
        linestyle="-" if dashes is None else (0, dashes),
        dash_capstyle="butt",
        solid_capstyle="round",
        zorder=7.5 if dashes is None else 7.3,
    )


def _clear_side(axes: Axes, pose: PlanarPose, radius: float) -> Array:
    """Direction from the tool in which a label is farthest from the arm and inside the frame."""
    corners = np.vstack([pose.joints, pose.tool])
    share = np.linspace(0.0, 1.0, 20)[:, None]
    along = np.vstack([start + share * (end - start) for start, end in pairwise(corners)])
    angles = np.radians(np.arange(20.0, 380.0, 40.0))
    sides = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    labels = pose.tool + 1.17 * radius * sides
    gaps = np.linalg.norm(labels[:, None] - along, axis=2).min(axis=1)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    margin = 0.4 * radius
    inside = (labels[:, 0] > left + margin) & (labels[:, 0] < right - margin)
    inside &= (labels[:, 1] > low + margin) & (labels[:, 1] < high - margin)
    # The ends of the tool frame's arrows stay clear as well.
    gaps = np.minimum(gaps, 0.9 * radius)
    best: Array = sides[int(np.argmax(np.where(inside, gaps, -1.0)))]
    return best
