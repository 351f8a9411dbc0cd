"""Direction of the slide's motion from two perpendicular accelerometers (6.3.1).

How much the direction by rms depends on the pair of accelerometers that measures it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.statistics import bandpass
from loose_env.thesis.ch6_experiments.slide.records import SlideRecords, slide_records
from loose_env.thesis.methods.motion.signals import instantaneous_motion, line_of_motion, rms_motion
from loose_env.thesis.shared.plots import centred
from loose_env.thesis.shared.sections import Table
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Angles:
    """Direction of the slide's motion by each method, one entry an angle of the cube."""

    alpha: Array
    """Angle of the cube as read [deg]."""
    by_rms: Array
    """Direction from rms accelerations (6.8) [deg]."""
    by_line: Array
    """Direction of the regression line [deg]."""
    correlation: Array
    """Correlation r of that line, by size [1]."""
    spread: Array
    """Spread of the instantaneous direction about its middle [deg]."""


def angles(records: SlideRecords, band: tuple[float, float]) -> Angles:
    """Estimate the direction of motion at every angle of the cube.

    The rms is taken within `band` [Hz]; line and instantaneous direction use the whole signal. The
    instantaneous direction is that of samples larger than the rms; its spread is half the
    range that holds 68 % of them.
    """
    x = bandpass(centred(records.x), records.rate, band)
    y = bandpass(centred(records.y), records.rate, band)
    by_line, correlation, spread = [], [], []
    for one, other in zip(centred(records.x), centred(records.y), strict=True):
        fit = line_of_motion(one, other)
        by_line.append(np.degrees(fit.direction))
        correlation.append(abs(fit.correlation))
        now = instantaneous_motion(one, other)
        large = now.magnitude > np.sqrt(np.mean(now.magnitude**2))
        # Turn the line upright before taking the spread: its direction has no ends there.
        middle = rms_motion(one, other).direction
        turned = (now.direction[large] - middle + np.pi / 2) % np.pi - np.pi / 2
        low, high = np.percentile(turned, [16, 84])
        spread.append(np.degrees(high - low) / 2)
    return Angles(
        alpha=np.degrees(records.alpha),
        by_rms=np.degrees(rms_motion(x, y).direction),
        by_line=np.array(by_line),
        correlation=np.array(correlation),
        spread=np.array(spread),
    )


def angle_part(found: Angles, told: Mapping[str, Any]) -> tuple[list[str], Table]:
    """Set the directions found beside the angles read and the printed errors."""
    low, high = told["angle_range_deg"]
    within, share = told["angle_within_percent"], told["angle_share_percent"]
    off = np.abs(found.by_rms - found.alpha)
    inside = (found.alpha >= low) & (found.alpha <= high)
    of_angle = 100 * np.mean(off[inside] <= within / 100 * found.alpha[inside])
    of_right = 100 * np.mean(off[inside] <= within / 100 * 90)
    ends = 100 * off[[0, -1]] / 90
    middle = (found.alpha >= 20) & (found.alpha <= 70)
    lowest = found.correlation[middle].min()
    best = found.alpha[np.argmax(found.correlation)]
    line_off = np.abs(found.by_line - found.alpha)[inside]
    words = [
        f"From rms accelerations between {told['rms_band_hz'][0]} and {told['rms_band_hz'][1]} "
        f"Hz, {of_angle:.0f} % of the angles from {low}° to {high}° come out within {within} % "
        f"of the angle, and {of_right:.0f} % within {within} % of a right angle; the thesis "
        f"printed {share} % and does not say of what. With the cube along the motion and across "
        f"it the error is {ends[0]:.1f} % and {ends[1]:.1f} % of a right angle (printed: within "
        f"{told['perpendicular_within_percent'][0]} % and "
        f"{told['perpendicular_within_percent'][1]} %). "
        + (
            "Near the axes the direction is drawn towards 45°: an rms cannot tell the bench's own "
            "motion and the tape's noise from the slide's. "
            if found.by_rms[0] > found.alpha[0] and found.by_rms[-1] < found.alpha[-1]
            else ""
        )
        + "An idle axis with 5 % of the motion by itself is read as 2.9°, yet it adds only 0.4° at "
        "10°.",
        f"The regression of one signal on the other is off by {np.median(line_off):.2f}° in the "
        f"median against {np.median(off[inside]):.2f}° by rms. Its correlation is highest at "
        f"{best:.0f}° and at least {lowest:.3f} from 20° to 70° (printed: above "
        f"{told['regression_correlation_above']} near 45°). The spread of the instantaneous "
        f"direction is {found.spread[inside].min():.1f}° to {found.spread[inside].max():.1f}° "
        f"over {low}° to {high}°, {_at(found, 45):.1f}° at 45°: "
        + (
            "it hardly depends on the angle, since noise of equal size on both axes turns a vector "
            "by the same amount wherever it points; what improves near 45° is the correlation."
            if found.spread[inside].max() < 1.5 * found.spread[inside].min()
            else "it depends on the angle."
        ),
    ]
    rows = tuple(
        (f"{a:.0f}°", f"{r:.1f}°", f"{line:.1f}°", f"{c:.3f}", f"{s:.1f}°")
        for a, r, line, c, s in zip(
            found.alpha[::2],
            found.by_rms[::2],
            found.by_line[::2],
            found.correlation[::2],
            found.spread[::2],
            strict=True,
        )
    )
    return words, Table(
        caption="Direction of the slide's motion from two perpendicular accelerometers (figures "
        "6.18 and 6.19).",
        columns=("α", "by rms (6.8)", "by regression", "|r|", "spread, each instant"),
        rows=rows,
    )


def _at(found: Angles, degrees: float) -> float:
    return float(found.spread[np.argmin(np.abs(found.alpha - degrees))])


def shares_within(
    seed: int, pairs: int, *, band: tuple[float, float], angles: tuple[float, float], percent: float
) -> NDArray[np.float64]:
    """Share of the cube's angles that come out right by rms (6.8), for several pairs.

    The motion is the same for all; gains, cross-axis sensitivities, protractor and tape
    are drawn for each. Pair 0 is that of `slide_records` by default.

    ``band``: band of the rms [Hz]. ``angles``: lowest and highest angle of the cube that count
    [deg]. Returns (pairs,): shares [%].
    """
    found = []
    for pair in range(pairs):
        records = slide_records(seed, pair=pair)
        x, y = (
            bandpass(s - s.mean(axis=-1, keepdims=True), records.rate, band)
            for s in (records.x, records.y)
        )
        alpha = np.degrees(records.alpha)
        inside = (alpha >= angles[0]) & (alpha <= angles[1])
        off = np.abs(np.degrees(rms_motion(x, y).direction) - alpha)[inside]
        found.append(100 * np.mean(off <= percent / 100 * alpha[inside]))
    return np.array(found)
