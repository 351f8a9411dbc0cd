"""Figures that Experiments Five and Six share.

The tool's motion in the plane: contours of its histogram, and its long axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import FAINT, INK, MUTED
from loose_env.sensors import STANDARD_GRAVITY
from loose_env.statistics import kurtosis
from loose_env.thesis.ch6_experiments.shaken_vera.cases import RATE, Cases, poses
from loose_env.thesis.ch6_experiments.shaken_vera.tables import (
    coherence_by_direction,
    moment_points,
)
from loose_env.thesis.methods.motion.histogram import contour_levels, histogram
from loose_env.thesis.methods.motion.signals import spectral_flatness
from loose_env.thesis.rigs.shaken_vera import SHAKEN_BAND
from loose_env.thesis.shared.plots import (
    COLOURS,
    Curve,
    LoopPanel,
    by_category,
    curves_by_direction,
    loop_panels,
    square_panels,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def loop_figure(cases: Cases, states: Sequence[str], direction: float) -> Figure:
    """Correlation loops of the first record of every case; the fault's direction as a line."""
    panels = [
        LoopPanel(
            title=f"θ₂ = {np.degrees(theta2):.0f}°",
            loops=[cases[state][k].pairs[0] for state in states],
            direction=direction,
        )
        for k, theta2 in enumerate(poses())
    ]
    return loop_panels(panels, states)


def moment_figure(cases: Cases, states: Sequence[str], direction: float, *, third: bool) -> Figure:
    """Skewness or kurtosis along a direction, pose by pose."""
    return by_category(
        [moment_points(cases[s], direction, s, third=third) for s in states],
        [f"{np.degrees(t):.0f}°" for t in poses()],
        ylabel="skewness" if third else "kurtosis",
        xlabel="pose θ₂",
        symlog=1.0,
    )


def direction_figure(
    cases: Cases, states: Sequence[str], direction: float, label: str, *, pose: int = 0
) -> Figure:
    """Kurtosis, flatness of the spectrum and coherence against direction, first record."""
    angles = np.radians(np.arange(90.0, 270.0, 3.0))
    units = np.stack([np.cos(angles), np.sin(angles)])
    panels: dict[str, list[Curve]] = {"kurtosis": [], "flatness": [], "coherence": []}
    for state in states:
        x, a = cases[state][pose].pairs[0]
        for name, values in (
            ("kurtosis", np.array([kurtosis(a, u) for u in units.T])),
            ("flatness", spectral_flatness(units.T @ a, RATE, SHAKEN_BAND)),
            ("coherence", coherence_by_direction(x, a, angles)),
        ):
            panels[name].append(Curve(name=state, angles=angles, values=values))
    return curves_by_direction(list(panels.items()), direction=direction, label=label)


_BINS = 31
_SHARE = 0.9


def histogram_panels(cases: Cases, states: Sequence[str], direction: float) -> Figure:
    """Draw the contour that holds 90 % of the samples, every state in every pose.

    ``cases``: cases of every state, in the order of the poses. ``direction``: direction of the
    fault, from the tool's x axis [rad]; a line marks it.
    """
    count = len(cases[states[0]])
    figure, places = square_panels(count, states)
    samples = {
        (state, k): np.concatenate([a for _, a in cases[state][k].pairs], axis=1) / STANDARD_GRAVITY
        for state in states
        for k in range(count)
    }
    most = 1.15 * max(float(np.quantile(np.abs(a), 0.99)) for a in samples.values())
    tick = 1.0 if most < 3 else 2.0
    for k, axes in enumerate(places):
        axes.set(xlim=(-1.1 * most, 1.1 * most), ylim=(-most, 1.2 * most), aspect="equal")
        end = most * np.array([np.cos(direction), np.sin(direction)])
        axes.plot([-end[0], end[0]], [-end[1], end[1]], color=INK, linewidth=1.0, zorder=1)
        for u in ((1, 0), (0, 1)):
            axes.plot([-most * u[0], most * u[0]], [-most * u[1], most * u[1]], color=FAINT, lw=0.8)
        for state, colour in zip(states, COLOURS, strict=False):
            found = histogram(samples[state, k], bins=_BINS)
            level = contour_levels(found, (_SHARE,))[0]
            axes.contour(
                found.centres(0),
                found.centres(1),
                found.counts.T,
                levels=[level],
                colors=[colour],
                linewidths=1.4,
            )
        theta2 = np.degrees(cases[states[0]][k].theta2)
        axes.text(0.0, 1.05 * most, f"θ₂ = {theta2:.0f}°", color=INK, fontsize=9, ha="center")
        axes.plot([0.1 * most, 0.1 * most + tick], [-0.93 * most] * 2, color=MUTED, linewidth=2)
        axes.text(
            0.1 * most + tick + 0.06 * most,
            -0.93 * most,
            f"{tick:.0f} g",
            color=MUTED,
            fontsize=8,
            va="center",
        )
    return figure
