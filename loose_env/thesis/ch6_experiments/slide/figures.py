"""Figures of Experiments Two and Three."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import INK, MEASURED, MUTED, SHAKEN, TRUTH
from loose_env.report import FigureCard
from loose_env.thesis.ch6_experiments.slide.records import (
    RESOLVER_UNIT,
    ResolverRecords,
    SlideRecords,
)
from loose_env.thesis.methods.motion.signals import (
    differentiate,
    instantaneous_motion,
    integrate,
    quadrature_steps,
)
from loose_env.thesis.shared.plots import panels

if TYPE_CHECKING:
    from loose_env.thesis.ch6_experiments.slide.directions import Angles


def angle_card(found: Angles) -> FigureCard:
    """Draw the error of the direction and the correlation against the angle of the cube."""
    figure, (upper, lower) = panels(
        ["error of the direction found [°]", "correlation |r| of one axis with the other"],
        across="angle α of the cube [°]",
        up=["", ""],
        height=1.35,
    )
    off = found.by_rms - found.alpha
    line = found.by_line - found.alpha
    inside = slice(1, -1)  # at the ends the regression has nothing to go by
    upper.axhline(0, color=MUTED, linewidth=0.9)
    upper.plot(found.alpha, off, "o-", color=MEASURED, markersize=3.5, linewidth=1.2)
    upper.plot(found.alpha[inside], line[inside], "s-", color=SHAKEN, markersize=3, linewidth=1.2)
    top = 1.15 * float(max(np.abs(off).max(), np.abs(line[inside]).max()))
    upper.set(xlim=(-2, 92), ylim=(-top, top))
    upper.text(8, 0.72 * top, "rms", color=MEASURED, fontsize=9)
    upper.text(74, 0.3 * top, "regression", color="#a06c00", fontsize=9)
    lower.plot(found.alpha, found.correlation, "o-", color=INK, markersize=3.5, linewidth=1.2)
    lower.set(xlim=(-2, 92), ylim=(0, 1.08))
    for panel in (upper, lower):
        panel.set_xticks(range(0, 91, 15))
    return FigureCard(
        image=figure,
        title="Direction from two perpendicular accelerometers",
        caption="The rms direction is drawn towards 45° near the axes, where the bench and noise "
        "make up most of the idle axis's signal (figure 6.18).",
    )


def moment_card(records: SlideRecords) -> FigureCard:
    """Draw the direction at every instant for three angles of the cube."""
    shown = [int(np.argmin(np.abs(np.degrees(records.alpha) - a))) for a in (10, 45, 80)]
    count = round(0.02 * records.rate)
    figure, axes = panels(
        [f"direction [°], α = {np.degrees(records.alpha[k]):.0f}°" for k in shown],
        across="time [ms]",
        up=[""] * 3,
        height=0.9,
    )
    time = 1000 * np.arange(count) / records.rate
    for panel, k in zip(axes, shown, strict=True):
        x, y = records.x[k] - records.x[k].mean(), records.y[k] - records.y[k].mean()
        now = instantaneous_motion(x[:count], y[:count])
        # Within half a turn about the cube's angle.
        true = records.alpha[k]
        direction = np.degrees((now.direction - true + np.pi / 2) % np.pi - np.pi / 2 + true)
        size = 2 + 40 * (now.magnitude / now.magnitude.max()) ** 2
        panel.axhline(np.degrees(true), color=TRUTH, linewidth=1.1)
        panel.scatter(time, direction, s=size, color=MEASURED, alpha=0.6, linewidth=0)
        panel.set(xlim=(0, time[-1]), ylim=(np.degrees(true) - 30, np.degrees(true) + 30))
    return FigureCard(
        image=figure,
        title="Direction at every instant",
        caption="A dot a sample, larger where the acceleration is larger; the line is the cube's "
        "angle (figure 6.19). Where the acceleration passes through zero the direction is that "
        "of the noise.",
    )


def velocity_card(records: SlideRecords, case: int, told: Mapping[str, Any]) -> FigureCard:
    """Draw velocities by quadrature, step by step and summed, of one record."""
    short, long = told["velocity_windows_s"]
    rate = records.rate
    x, y = records.x[case], records.y[case]
    figure, axes = panels(
        [
            f"two-point rule step by step, {short} s",
            f"two-point rule summed, {long} s",
            f"Newton-Cotes summed, {long} s",
        ],
        across="time [ms]",
        up=["mm/s"] * 3,
        height=1.0,
    )
    plans: tuple[tuple[Any, str, float], ...] = (
        (quadrature_steps, "two_point", short),
        (integrate, "two_point", long),
        (integrate, "newton_cotes", long),
    )
    for panel, (method, rule, window) in zip(axes, plans, strict=True):
        part = slice(0, round(window * rate))
        for signal, colour in ((x, MEASURED), (y, SHAKEN)):
            v = 1000 * method(signal[part], 1 / rate, rule)
            panel.plot(1000 * np.arange(len(v)) / rate, v, color=colour, linewidth=0.9)
        panel.set_xlim(0, 1000 * window)
    axes[0].text(
        1.0,
        1.07,
        "x of the cube",
        transform=axes[0].transAxes,
        color=MEASURED,
        fontsize=9,
        ha="right",
    )
    axes[1].text(
        1.0,
        1.07,
        "y of the cube",
        transform=axes[1].transAxes,
        color="#a06c00",
        fontsize=9,
        ha="right",
    )
    return FigureCard(
        image=figure,
        title=f"Velocity by quadrature, α = {told['velocity_angle_deg']}°",
        caption="One step of the rule is an acceleration in other units and stays about zero "
        "(figure 6.21). The sums wander with the offset and the noise of the tape, by either rule "
        "alike (figures 6.23 and 6.24).",
    )


def resolver_card(turned: ResolverRecords) -> FigureCard:
    """Draw angle and velocity by the resolver beside those of the link."""
    count = round(0.12 * turned.rate)
    time = 1000 * np.arange(count) / turned.rate
    figure, (upper, lower) = panels(
        ["angle [resolver units]: link, and resolver behind the gear", "velocity of the link"],
        across="time [ms]",
        up=["units", "rad/s"],
        height=1.3,
    )
    middle = np.median(turned.angle[:count]) / RESOLVER_UNIT
    upper.plot(time, turned.angle[:count] / RESOLVER_UNIT - middle, color=TRUTH, linewidth=1.2)
    steps = turned.resolver[:count] - np.median(turned.resolver[:count])
    upper.step(time, steps, where="post", color=MEASURED, linewidth=1.2)
    rate = differentiate(RESOLVER_UNIT * turned.resolver, 1 / turned.rate, "two_point")
    lower.step(time, rate[:count], where="post", color=MEASURED, linewidth=0.9)
    lower.plot(time, turned.velocity[:count], color=TRUTH, linewidth=1.2)
    for panel in (upper, lower):
        panel.set_xlim(0, time[-1])
    upper.text(1.0, 1.06, "link", transform=upper.transAxes, color=TRUTH, fontsize=9, ha="right")
    lower.text(
        1.0, 1.06, "by 6.13", transform=lower.transAxes, color=MEASURED, fontsize=9, ha="right"
    )
    return FigureCard(
        image=figure,
        title="A resolver behind a gear with play",
        caption="The resolver follows late, in steps, and stands still while the link crosses the "
        "play; its differences are spikes of whole units.",
    )
