"""Tables of Experiments Five and Six: a state beside the healthy arm, by pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import COIL
from loose_env.sensors import STANDARD_GRAVITY
from loose_env.statistics import (
    axial_difference,
    bandpass,
    comparative_index,
    kurtosis,
    lowest_correlation_direction,
    maximum_correlation,
    skewness,
    transfer_function,
    transmission,
)
from loose_env.thesis.ch6_experiments.shaken_vera.cases import (
    RATE,
    Cases,
    CaseStatistics,
    Spread,
    from_y,
    poses,
    printed_healthy,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.rigs.shaken_vera import SHAKEN_BAND
from loose_env.thesis.shared.plots import Points
from loose_env.thesis.shared.sections import Table
from loose_env.typing import Array

LOW_BAND = (20.0, 60.0)
"""Band below the arm's first mode, in which the pinned arm moves as a rigid body [Hz]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Errors:
    """Errors of four estimators at one pose, record by record [deg]."""

    lowest: Array
    """Direction of lowest correlation with link 1, the thesis's method, local form (R,)."""
    general: Array
    """The same with the shaker's own motion instead of link 1's, the general form (R,)."""
    coherence: Array
    """Direction of lowest mean coherence with link 1 (R,)."""
    change: Array
    """Direction in which the transmission in the low band has changed (R,)."""
    change_size: float
    """That change, relative to the healthy transmission."""


def direction_errors(case: CaseStatistics, healthy: CaseStatistics, direction: float) -> Errors:
    """Compare four estimators on the same records.

    ``case``, ``healthy``: records with the fault and without it, at the same pose. ``direction``:
    true direction of the fault [rad].
    """

    def error(angle: float) -> float:
        return float(np.degrees(axial_difference(angle, direction)))

    def low_transmission(x: ArrayLike, a: ArrayLike) -> Array:
        b = transmission(bandpass(x, RATE, LOW_BAND), bandpass(a, RATE, LOW_BAND))
        return np.asarray(b).reshape(2)

    reference = np.mean([low_transmission(x, a) for x, a in healthy.pairs], axis=0)
    changes = np.array([low_transmission(x, a) - reference for x, a in case.pairs])
    return Errors(
        lowest=np.array([error(lowest_correlation_direction(x, a)) for x, a in case.pairs]),
        general=np.array(
            [
                error(lowest_correlation_direction(m.probes[COIL][0], m.tool))
                for m in case.measurements
            ]
        ),
        coherence=np.array([error(lowest_coherence(x, a)) for x, a in case.pairs]),
        change=np.array([error(float(np.arctan2(c[1], c[0]))) for c in changes]),
        change_size=float(np.median(np.hypot(*changes.T)) / np.hypot(*reference)),
    )


def coherence_by_direction(x: ArrayLike, a: ArrayLike, angles: Array) -> Array:
    """Coherence of the motion along each direction with x, mean over the band (K,)."""
    along = np.stack([np.cos(angles), np.sin(angles)]).T @ np.asarray(a)
    found = transfer_function(x, along, RATE)
    low, high = SHAKEN_BAND
    inside = (found.frequencies >= low) & (found.frequencies <= high)
    return np.asarray(found.coherence[:, inside].mean(axis=1))


def lowest_coherence(x: ArrayLike, a: ArrayLike) -> float:
    """Direction of lowest mean coherence, to 3 degrees [rad] (3.4, 4.1.2)."""
    angles = np.radians(np.arange(0.0, 180.0, 3.0))
    return float(angles[np.argmin(coherence_by_direction(x, a, angles))])


def rms_over_poses(errors: Sequence[Array]) -> Spread:
    """RMS error over the poses, for every set of single records [deg]."""
    count = min(len(e) for e in errors)
    return Spread.of([float(np.sqrt(np.mean([e[k] ** 2 for e in errors]))) for k in range(count)])


def index_spread(case: CaseStatistics, healthy: CaseStatistics) -> Spread:
    """Comparative index D (6.18) of single records against the mean of the healthy ones."""
    c_n, phi_n = healthy.maximum.mean, healthy.lowest.mean
    return Spread.of(
        [
            comparative_index(
                c_n, phi_n, maximum_correlation(x, a).value, lowest_correlation_direction(x, a)
            ).mag_d
            for x, a in case.pairs
        ]
    )


def moment_points(
    cases: Sequence[CaseStatistics], direction: float, name: str, *, third: bool
) -> Points:
    """Skewness (third moment) or kurtosis of the tool along a direction, pose by pose."""
    unit = np.array([np.cos(direction), np.sin(direction)])
    moment = skewness if third else kurtosis
    spreads = [Spread.of([float(moment(a, unit)) for _, a in case.pairs]) for case in cases]
    return Points(
        name=name,
        values=[s.mean for s in spreads],
        low=[s.low for s in spreads],
        high=[s.high for s in spreads],
    )


def tool_peaks(case: CaseStatistics) -> tuple[float, float]:
    """Median over the records of the lowest and the highest tool acceleration [g]."""
    low = np.median([a.min() for _, a in case.pairs])
    high = np.median([a.max() for _, a in case.pairs])
    return float(low / STANDARD_GRAVITY), float(high / STANDARD_GRAVITY)


def peak_table(
    cases: Cases,
    ranges: Mapping[str, Sequence[Sequence[float]]],
    states: Mapping[str, str],
    *,
    number: str,
) -> Table:
    """Range of the tool's acceleration, printed beside found.

    ``ranges``: printed ranges of every state, pose by pose [g].
    """
    rows = []
    for k, theta2 in enumerate(poses()):
        row = [f"{np.degrees(theta2):.0f}°"]
        for state, key in states.items():
            low, high = tool_peaks(cases[state][k])
            was_low, was_high = ranges[key][k]
            row += [f"{was_low:.1f} to {was_high:.1f}", f"{low:.1f} to {high:.1f}"]
        rows.append(tuple(row))
    return Table(
        caption=f"Range of the tool's acceleration in 1.2 s [g] (table {number})",
        columns=("θ₂", *(cell for state in states for cell in (f"{state}, printed", "here"))),
        rows=tuple(rows),
    )


def spread_words(spread: Spread, digits: int = 2) -> str:
    """Format a value with its interval."""
    return f"{spread.mean:.{digits}f} ({spread.low:.{digits}f} to {spread.high:.{digits}f})"


def axis_words(spread: Spread) -> str:
    """Write a direction with its interval, in degrees from the tool's y axis."""
    half = np.degrees(spread.high - spread.low) / 2
    return f"{from_y(spread.mean):.0f}° ± {half:.0f}°"


def percent(share: float, digits: int = 0) -> str:
    """Write a share in per cent."""
    return f"{100 * share:.{digits}f} %"


def turn_words(found: float, other_deg: float) -> str:
    """Write the angle from a printed axis [deg from y] to one found [rad from x]."""
    return f"{axial_turn(found, other_deg):+.0f}°"


def error_table(
    errors: Sequence[Errors], printed_errors: Sequence[float], *, caption: str
) -> Table:
    """Errors of the four estimators beside the printed ones, pose by pose and altogether."""

    def words(values: Array) -> str:
        return f"{np.mean(values):+.0f}° (RMS {np.sqrt(np.mean(values**2)):.0f}°)"

    rows: list[tuple[str, ...]] = [
        (
            f"{np.degrees(theta2):.0f}°",
            f"{theirs:+g}°",
            words(e.lowest),
            words(e.general),
            words(e.coherence),
            words(e.change),
            f"{percent(e.change_size)}",
        )
        for theta2, theirs, e in zip(poses(), printed_errors, errors, strict=True)
    ]
    rows.append(
        (
            "RMS",
            f"{np.sqrt(np.mean(np.square(printed_errors))):.1f}°",
            *(
                spread_words(rms_over_poses([getattr(e, name) for e in errors]), 1)
                for name in ("lowest", "general", "coherence", "change")
            ),
            "",
        )
    )
    return Table(
        caption=caption,
        columns=(
            "θ₂",
            "lowest correlation, printed",
            "here",
            "general form: with the shaker",
            "lowest coherence",
            "change of transmission",
            "size of that change",
        ),
        rows=tuple(rows),
    )


def pin_table(tight: Sequence[CaseStatistics], released: Sequence[CaseStatistics]) -> Table:
    """Maximum correlation and direction with the pin in and half drawn out (6.5.3)."""
    rows = [
        (
            f"{np.degrees(n.theta2):.0f}°",
            spread_words(n.maximum),
            spread_words(p.maximum),
            axis_words(n.lowest),
            axis_words(p.lowest),
            f"{np.degrees(axial_difference(p.lowest.mean, n.lowest.mean)):+.0f}°",
        )
        for n, p in zip(tight, released, strict=True)
    ]
    return Table(
        caption="The pin half drawn out (6.5.3; the thesis found a lower maximum correlation "
        "and the same direction)",
        columns=("θ₂", "C, pin in", "C, half out", "φ, pin in", "φ, half out", "turn"),
        rows=tuple(rows),
    )


def axial_turn(found: float, other_deg: float) -> float:
    """Angle from a printed axis [deg from y] to one found [rad from x], in degrees."""
    return float(np.degrees(axial_difference(found, np.radians(other_deg + 90.0))))


TIGHT, FINGER, LOOSE = "high preload", "low preload", "looseness"
"""States of the looseness joint, keys of `STATES`."""


def healthy_table(tight: Sequence[CaseStatistics], closed: Mapping[str, Sequence[float]]) -> Table:
    """The healthy arm: directions and magnitudes, with what simpler models give."""
    rows = []
    for k, (case, (theta2, phi, c)) in enumerate(zip(tight, printed_healthy(), strict=True)):
        rows.append(
            (
                f"{np.degrees(theta2):.0f}°",
                f"{from_y(phi):.0f}°",
                f"{from_y(closed['rigid'][k]):.0f}°",
                f"{from_y(closed['bending'][k]):.0f}°",
                f"{from_y(closed['stiff refitted'][k]):.0f}°",
                axis_words(case.lowest),
                turn_words(case.lowest.mean, from_y(phi)),
                f"{c:.2f}",
                spread_words(case.maximum),
            )
        )
    return Table(
        caption="Healthy arm, high preload: direction of lowest correlation and maximum "
        "correlation (6.4.1, table 6.4)",
        columns=(
            "θ₂",
            "φn printed",
            "rigid arm",
            "bending, stiff pin",
            "stiff pin, refitted",
            "here",
            "difference",
            "Cn printed",
            "here",
        ),
        rows=tuple(rows),
    )


def loose_table(cases: Cases) -> Table:
    """Looseness: direction, maximum correlation and index."""
    table = printed("tables")
    rows = []
    for k, (n, f) in enumerate(zip(cases[TIGHT], cases[LOOSE], strict=True)):
        case = table["looseness_cases"][k]
        rows.append(
            (
                f"{np.degrees(n.theta2):.0f}°",
                f"{case['lowest_looseness_deg'] % 180}°",
                axis_words(f.lowest),
                f"{table['table_6_4']['c_f'][k]:.2f}",
                spread_words(f.maximum),
                f"{table['table_6_5_looseness']['mag_d'][k]:.2f}",
                spread_words(index_spread(f, n)),
            )
        )
    return Table(
        caption="Looseness: direction, maximum correlation and index (6.4.1, tables 6.4 and 6.5; "
        "the printed D at 56° is a slip for 0.47)",
        columns=("θ₂", "φf printed", "here", "Cf printed", "here", "D printed", "here"),
        rows=tuple(rows),
    )


def preload_table(cases: Cases) -> Table:
    """Low preload: direction, maximum correlation and index."""
    table = printed("tables")
    rows = [
        (
            f"{np.degrees(n.theta2):.0f}°",
            f"{table['looseness_cases'][k]['lowest_low_preload_deg'] % 180}°",
            axis_words(p.lowest),
            spread_words(p.maximum),
            f"{table['table_6_6_low_preload']['mag_d'][k]:.3f}",
            spread_words(index_spread(p, n), 3),
        )
        for k, (n, p) in enumerate(zip(cases[TIGHT], cases[FINGER], strict=True))
    ]
    return Table(
        caption="Low preload, which is no fault: direction, maximum correlation and index (6.4.1, "
        "table 6.6; the thesis prints no maximum correlation)",
        columns=("θ₂", "φp printed", "here", "Cp here", "D printed", "here"),
        rows=tuple(rows),
    )


def axis_table(cases: Cases) -> Table:
    """Long axis and aspect of the tool's acceleration."""
    rows = []
    for k, case in enumerate(printed("tables")["looseness_cases"]):
        row = [f"{case['theta2_deg']}°"]
        for state, axis, aspect in (
            (TIGHT, "histogram_axis_preload_deg", "aspect_preload"),
            (LOOSE, "histogram_axis_looseness_deg", "aspect_looseness"),
        ):
            angle, ratio = principal_axis(cases[state][k])
            was = "-" if case[axis] is None else f"{case[axis] % 180}°"
            was += "" if case[aspect] is None else f", {case[aspect]:g}:1"
            row += [was, f"{from_y(angle):.0f}°, {ratio:.1f}:1"]
        rows.append(tuple(row))
    return Table(
        caption="Long axis and aspect of the tool's acceleration (6.4.1, figures 6.34 to 6.38)",
        columns=("θ₂", "preload, printed", "here", "loose, printed", "here"),
        rows=tuple(rows),
    )


def principal_axis(case: CaseStatistics) -> tuple[float, float]:
    """Direction of the long axis of the tool's acceleration, and the aspect ratio.

    Returns direction from the tool's x axis [rad]; ratio of the standard deviations along the long
    and the short axis.
    """
    covariance = np.mean([np.cov(a) for _, a in case.pairs], axis=0)
    power, axes = np.linalg.eigh(covariance)
    return float(np.arctan2(axes[1, 1], axes[0, 1])), float(np.sqrt(power[1] / power[0]))
