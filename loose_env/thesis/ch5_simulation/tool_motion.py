"""Simulated motion of the loose planar arm's tool: text, tables and contours (thesis 5.1)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import INK, MEASURED, MUTED, TRUTH
from loose_env.report import FigureCard, new_figure
from loose_env.statistics import kurtosis
from loose_env.thesis.methods.motion.histogram import contour_levels, histogram
from loose_env.thesis.methods.motion.loose_planar_arm import (
    LoosePlanarArm,
    looseness_direction,
    tool_acceleration,
    tool_velocity,
)
from loose_env.thesis.methods.motion.seat_motion import (
    MonteCarlo,
    draw_tool_acceleration,
    draw_tool_displacement,
    draw_tool_velocity,
    region_probabilities,
)
from loose_env.thesis.shared.sections import Table
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Draw = Callable[[MonteCarlo, int, np.random.Generator], Array]

POSES = (30.0, 90.0, 150.0)
"""Angles of joint 2 [deg]; joint 1 is at zero."""
BETA = math.radians(15.0)
"""Angle of the slide from link 2 [rad]."""
SAMPLES = 400_000
"""Draws behind a set of contours."""
STEPS = 200_000
"""Displacements in the chain behind the transition table."""
SHARES = (0.5, 0.9, 0.99)
"""Shares of the data that the contours enclose."""
KINDS: tuple[tuple[str, Draw], ...] = (
    ("displacement", draw_tool_displacement),
    ("velocity", draw_tool_velocity),
    ("acceleration", draw_tool_acceleration),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of the tool in one pose, drawn tight and loose."""

    theta2: float
    """Angle of joint 2 [deg]."""
    slide: Array
    """Unit vector along the slide in the world (2,)."""
    tight: Array
    """Motion without looseness (2, N)."""
    loose: Array
    """Motion with looseness (2, N)."""

    @property
    def across(self) -> Array:
        """Unit vector across the slide (2,)."""
        return np.array([-self.slide[1], self.slide[0]])


def draw_motions(draw: Draw, seed: int, first: int) -> list[Motion]:
    """Draw the motion in each pose, tight and loose, from the seeds ``[seed, first + i]``."""
    found = []
    for k, theta2 in enumerate(POSES):
        loose = MonteCarlo(
            arm=LoosePlanarArm(beta=BETA),
            theta=(0.0, math.radians(theta2)),
            angle_sd=1e-4,
            rate_sd=0.1,
            acceleration_sd=100.0,
        )
        found.append(
            Motion(
                theta2=theta2,
                slide=looseness_direction(loose.arm, loose.theta),
                tight=draw(
                    replace(loose, seat=None), SAMPLES, np.random.default_rng([seed, first + 2 * k])
                ),
                loose=draw(loose, SAMPLES, np.random.default_rng([seed, first + 2 * k + 1])),
            )
        )
    return found


def motion_words(
    motions: dict[str, list[Motion]], table: Array, source: dict[str, object]
) -> list[str]:
    """Say what the motions and the transition table show."""
    along = [kurtosis(m.loose, m.slide) for group in motions.values() for m in group]
    across = [kurtosis(m.loose, m.across) for group in motions.values() for m in group]
    # Twice the deviation of the kurtosis of a Gaussian sample, sqrt(24 / N), for many of them: 4.
    limit = 4.0 * math.sqrt(24.0 / SAMPLES)
    gaussian = all(abs(value) < limit for value in across)
    distinct = sum(abs(value) > limit for value in along)
    here = region_probabilities(table)
    scatter = float(np.abs(here - [0.25, 0.5, 0.25]).max())
    gap = _coriolis_gap()
    return [
        "A planar arm with two revolute joints has a loose slide at the near end of link 2, "
        f"{math.degrees(BETA):.0f}° from the link. Its joints move at random, Gaussian and "
        "independent. The seat is assumed "
        f"to touch each stop with probability {source['point_probability_at_each_stop']}, and to "
        "be anywhere between them else; its velocity is zero or away from the stop in contact, "
        "and uniform between the stops. The tool's motion follows from the kinematics.",
        f"The thesis expects that only one direction loses its Gaussian shape. Across the slide "
        f"the excess kurtosis {'stays' if gaussian else 'does not stay'} within ±{limit:.3f}, "
        f"four sampling deviations, in all {len(across)} cases; along it, "
        f"{distinct} of {len(along)} cases leave that band, between {min(along):.2f} and "
        f"{max(along):.2f}.",
        "The thesis leaves table 5.1 as symbols. A chain of displacements, each the last plus a "
        f"velocity drawn for its region, fills it. Over {STEPS:,} steps the share of time in a "
        f"region differs from the displacement assumed by {scatter:.4f} at most: the assumed "
        f"velocities and displacements, made apart, {'agree' if scatter < 0.01 else 'disagree'}.",
        "The accelerations of equation 5.6 "
        f"{'agree with' if gap < 1e-6 else 'differ from'} the derivative of equation 5.4 taken by "
        f"differences (to {gap:.0e} of their size), Coriolis signs as printed.",
    ]


def _coriolis_gap() -> float:
    """Largest difference of (5.6) from differences of (5.4) along a motion, relative to (5.6)."""
    arm, step = LoosePlanarArm(), 1e-5
    t = np.linspace(0.0, 2.0, 41)
    turn, slide = np.array([[1.0], [0.7]]), 0.1

    def velocity(at: Array) -> Array:
        q = np.sin(turn * at)
        rate = turn * np.cos(turn * at)
        return tool_velocity(arm, q, rate, slide * np.sin(2 * at), 2 * slide * np.cos(2 * at))

    slope = (velocity(t + step) - velocity(t - step)) / (2.0 * step)
    given = tool_acceleration(
        arm,
        np.sin(turn * t),
        turn * np.cos(turn * t),
        -(turn**2) * np.sin(turn * t),
        slide * np.sin(2 * t),
        2 * slide * np.cos(2 * t),
        -4 * slide * np.sin(2 * t),
    )
    return float(np.abs(slope - given).max() / np.abs(given).max())


def kurtosis_table(motions: dict[str, list[Motion]]) -> Table:
    """Excess kurtosis of each motion, along and across the slide."""
    rows = [
        (
            f"{name}, θ₂ = {m.theta2:g}°",
            f"{kurtosis(m.tight, m.slide):+.3f}",
            f"{kurtosis(m.loose, m.slide):+.3f}",
            f"{kurtosis(m.loose, m.across):+.3f}",
        )
        for name, group in motions.items()
        for m in group
    ]
    return Table(
        caption="Excess kurtosis of the tool's motion along and across the slide (0: Gaussian)",
        columns=("motion", "tight, along", "loose, along", "loose, across"),
        rows=tuple(rows),
    )


def transitions(table: Array, source: dict[str, object]) -> Table:
    """Table 5.1, its sums beside what the thesis assumed."""
    names = ("proximal stop", "free", "distal stop")
    end, free = source["point_probability_at_each_stop"], source["probability_free"]
    rows = [
        (f"now: {name}", *(f"{p:.4f}" for p in row), f"{total:.4f}", f"{assumed}")
        for name, row, total, assumed in zip(
            names, table, region_probabilities(table), (end, free, end), strict=True
        )
    ]
    before = (*(f"{p:.4f}" for p in table.sum(axis=0)), f"{table.sum():.4f}", "1")
    return Table(
        caption="Table 5.1: joint probability of the region now and the region before",
        columns=("", *(f"before: {name}" for name in names), "sum here", "assumed in print"),
        rows=(*rows, ("sum", *before)),
    )


def card(motions: list[Motion], name: str, number: str, scale: float, unit: str) -> FigureCard:
    """Contours in all poses, as a card."""
    return FigureCard(
        image=_contours(motions, scale, unit),
        title=f"Distribution of the tool's {name}",
        caption=(
            f"Figure {number}: contours that enclose 50, 90 and 99 % of {SAMPLES:,} draws of the "
            f"tool's {name} in three poses, tight above and loose below. The bar is the direction "
            "of the slide; along it the loose contours lose their ellipses."
        ),
    )


def _contours(motions: list[Motion], scale: float, unit: str) -> Figure:
    figure = new_figure(3.9)
    reach = scale * max(float(np.quantile(np.abs(m.loose), 0.9995)) for m in motions)
    for k, m in enumerate(motions):
        for row, (samples, name, colour) in enumerate(
            ((m.tight, "tight", MEASURED), (m.loose, "loose", TRUTH))
        ):
            axes = figure.add_axes((0.075 + 0.31 * k, 0.475 - 0.43 * row, 0.30, 0.42))
            found = histogram(samples * scale, 50)
            levels = np.unique(contour_levels(found, SHARES))
            axes.contour(
                found.centres(0),
                found.centres(1),
                found.counts.T,
                levels=levels,
                colors=[colour],
                linewidths=np.linspace(0.8, 1.8, len(levels)),
            )
            bar = reach * np.outer(m.slide, [-0.95, 0.95])
            axes.plot(*bar, color=MUTED, linewidth=1.0, dashes=(3, 3), zorder=0)
            axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
            axes.axis("off")
            if row == 0:
                axes.set_title(f"θ₂ = {m.theta2:g}°", fontsize=9.5, color=INK, pad=4)
            if k == 0:
                figure.text(
                    0.03,
                    0.685 - 0.43 * row,
                    name,
                    fontsize=9.5,
                    color=INK,
                    rotation=90,
                    ha="center",
                    va="center",
                )
            if k == 0 and row == 1:
                length = 10.0 ** math.floor(math.log10(reach))
                x, y = -0.95 * reach, -0.93 * reach
                axes.plot([x, x + length], [y, y], color=INK, linewidth=1.6)
                axes.text(x, y + 0.04 * reach, f"{length:g} {unit}", fontsize=8.5, color=INK)
    return figure
