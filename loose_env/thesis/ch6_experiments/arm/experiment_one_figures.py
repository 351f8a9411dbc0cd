"""Figures of Experiment One."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loose_env.envs import INK, MEASURED, MUTED, SHAKEN, TRUTH
from loose_env.report import FigureCard
from loose_env.thesis.ch6_experiments.arm.guideway import Guideway, Strokes
from loose_env.thesis.shared.plots import panels
from loose_env.typing import Array

_LABEL = "m/s²"


def time_card(sets: Mapping[str, Strokes], tight: Strokes) -> FigureCard:
    """Draw three strokes each of poses A, B and C, and of B without play."""
    shown = {f"pose {name}: {words}": sets[name] for name, words in _POSE_WORDS.items()}
    shown["pose B, play taken out of the guide"] = tight
    figure, axes = panels(
        list(shown), across="time since the trigger [s]", up=[_LABEL] * len(shown), height=0.95
    )
    low = min(s.acceleration[:3].min() for s in shown.values())
    for panel, strokes in zip(axes, shown.values(), strict=True):
        for k, colour in enumerate((MEASURED, SHAKEN, INK)):
            panel.plot(strokes.time, strokes.acceleration[k], color=colour, linewidth=0.8)
        panel.set(xlim=(0, strokes.time[-1]), ylim=(1.1 * low, -0.8 * low))
    return FigureCard(
        image=figure,
        title="Three strokes each, one over the other",
        caption="Acceleration of the wrist along the boom in poses A, B and C, three strokes in "
        "each panel (figure 6.15), and pose B once more without play. Within a pose the "
        "strokes fall on one another; the shudder of pose B is gone with the play.",
    )


_POSE_WORDS = {"A": "out and low", "B": "in and low", "C": "out and high"}


def spectrum_card(sets: Mapping[str, Strokes], averages: int, settings: Guideway) -> FigureCard:
    """Draw the spectra of poses A and B, and their difference."""
    frequency, a = _spectrum(sets["A"].acceleration[:averages], settings.rate)
    _, b = _spectrum(sets["B"].acceleration[:averages], settings.rate)
    shown = frequency <= 60.0
    figure, axes = panels(
        ["pose A", "pose B", "A less B"], across="frequency [Hz]", up=[_LABEL] * 3, height=0.95
    )
    for panel, line, colour in zip(axes, (a, b, a - b), (MEASURED, MEASURED, TRUTH), strict=True):
        panel.plot(frequency[shown], line[shown], color=colour, linewidth=1.1)
        panel.set_xlim(0, 60)
    for panel in axes[:2]:
        panel.set_yscale("log")
        panel.set_ylim(0.5 * min(a[shown].min(), b[shown].min()), 2 * a.max())
    top = 1.2 * float(np.abs(a - b)[shown].max())
    axes[2].set_ylim(-top, top)
    return FigureCard(
        image=figure,
        title="Spectra of two poses and their difference",
        caption=f"Amplitude spectra of the wrist's acceleration, averaged over {averages} strokes "
        "(figure 6.16). The stroke itself lies below 10 Hz in both; they differ above, where the "
        "shudder of pose B has its power.",
    )


def _spectrum(strokes: Array, rate: float) -> tuple[Array, Array]:
    """Amplitude spectrum, averaged over strokes: frequency [Hz] and amplitude [m/s²]."""
    window = np.hanning(strokes.shape[1])
    level = strokes - strokes.mean(axis=1, keepdims=True)
    lines = np.abs(np.fft.rfft(level * window)) * 2 / window.sum()
    frequency = np.asarray(np.fft.rfftfreq(strokes.shape[1], 1 / rate), dtype=np.float64)
    return frequency, np.asarray(lines.mean(axis=0))


def end_card(shifted: Mapping[int, Strokes], pose: str) -> FigureCard:
    """Draw the end of the stroke for each end point; keys are shifts [mm]."""
    figure, (panel,) = panels(
        ["end of the stroke, mean of each set"],
        across="time since the trigger [s]",
        up=[_LABEL],
        height=2.1,
    )
    colours = {-4: TRUTH, -2: SHAKEN, 0: INK, 2: "#56b4e9", 4: MEASURED}
    base = shifted[0]
    window = (base.time > 0.86) & (base.time < 1.10)
    spread = base.acceleration.std(axis=0)[window]
    middle = base.acceleration.mean(axis=0)[window]
    panel.fill_between(
        base.time[window], middle - spread, middle + spread, color=INK, alpha=0.15, linewidth=0
    )
    for row, by in enumerate(sorted(shifted)):
        mean = shifted[by].acceleration.mean(axis=0)[window]
        panel.plot(base.time[window], mean, color=colours[by], linewidth=1.4)
        panel.text(
            0.975,
            0.08 + 0.105 * row,
            f"{by:+d} mm" if by else "unmoved",
            transform=panel.transAxes,
            color=colours[by],
            fontsize=9,
            ha="right",
        )
    panel.set_xlim(0.86, 1.10)
    return FigureCard(
        image=figure,
        title=f"End point moved, pose {pose}",
        caption="The stroke stops later when its end lies farther out. The band is one standard "
        "deviation of single strokes about their mean.",
    )


def shudder_card(loose: Strokes, tight: Strokes, weight_over: float) -> FigureCard:
    """Draw acceleration and pitch of the boom against its reach, with play and without."""
    figure, (upper, lower) = panels(
        ["acceleration of the wrist along the boom, mean", "pitch of the boom in its guide"],
        across="reach [m]",
        up=[_LABEL, "mrad"],
        height=1.2,
    )
    for strokes, colour in ((tight, MUTED), (loose, MEASURED)):
        reach = strokes.reach.mean(axis=0)
        upper.plot(reach, strokes.acceleration.mean(axis=0), color=colour, linewidth=1.2)
        lower.plot(reach, 1000 * strokes.pitch.mean(axis=0), color=colour, linewidth=1.2)
    for panel in (upper, lower):
        panel.axvline(weight_over, color=TRUTH, linewidth=1.1, linestyle=(0, (4, 2)))
        panel.set_xlim(0.15, 0.50)
    upper.set_ylim(-1.0, 1.5)
    upper.text(
        weight_over - 0.004, 1.2, "weight over the middle", color=TRUTH, fontsize=8.5, ha="right"
    )
    lower.text(0.495, 0.25, "with play", color=MEASURED, fontsize=8.5, ha="right")
    lower.text(0.495, -0.35, "without play", color=MUTED, fontsize=8.5, ha="right")
    return FigureCard(
        image=figure,
        title="Where the shudder comes from, pose B",
        caption="The boom leaves its rear seat where its weight comes over the middle of the "
        "guide, falls through the play and rings on the other pair of blocks.",
    )
