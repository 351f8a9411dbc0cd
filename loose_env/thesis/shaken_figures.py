"""Figures that Experiments Five and Six share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.statistics import moments_by_direction, spectral_flatness
from loose_env.thesis.plots import (
    Curve,
    LoopPanel,
    by_category,
    curves_by_direction,
    loop_panels,
)
from loose_env.thesis.rigs.shaken_vera import SHAKEN_BAND
from loose_env.thesis.shaken_cases import RATE, CaseFigures, poses
from loose_env.thesis.shaken_tables import coherence_by_direction, moment_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["direction_figure", "loop_figure", "moment_figure"]

Cases = Mapping[str, Sequence[CaseFigures]]


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
            ("kurtosis", moments_by_direction(a, angles).kurtosis),
            ("flatness", spectral_flatness(units.T @ a, RATE, SHAKEN_BAND)),
            ("coherence", coherence_by_direction(x, a, angles)),
        ):
            panels[name].append(Curve(name=state, angles=angles, values=values))
    return curves_by_direction(list(panels.items()), direction=direction, label=label)
