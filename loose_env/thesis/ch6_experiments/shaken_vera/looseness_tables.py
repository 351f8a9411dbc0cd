"""Tables of Experiment Five: the looseness cases, printed beside found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from loose_env.thesis.ch6_experiments.shaken_vera.cases import CaseFigures, from_y, printed_healthy
from loose_env.thesis.ch6_experiments.shaken_vera.figures import principal_axis
from loose_env.thesis.ch6_experiments.shaken_vera.tables import (
    axis_words,
    index_spread,
    spread_words,
    turn_words,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.section import Table

__all__ = [
    "FINGER",
    "LOOSE",
    "TIGHT",
    "axis_table",
    "healthy_table",
    "loose_table",
    "preload_table",
]

TIGHT, FINGER, LOOSE = "high preload", "low preload", "looseness"
"""States of the looseness joint, keys of `STATES`."""

Cases = Mapping[str, Sequence[CaseFigures]]


def healthy_table(tight: Sequence[CaseFigures], closed: Mapping[str, Sequence[float]]) -> Table:
    """The healthy arm: directions and magnitudes, with what simpler models give."""
    rows = []
    for k, (case, (theta2, phi, c)) in enumerate(zip(tight, printed_healthy(), strict=True)):
        rows.append(
            (
                f"{np.degrees(theta2):.0f}°",
                f"{from_y(phi):.0f}°",
                f"{from_y(closed['rigid'][k]):.0f}°",
                f"{from_y(closed['bending'][k]):.0f}°",
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
        columns=(
            "θ₂",
            "φf printed",
            "here",
            "Cf printed",
            "here",
            "D printed",
            "here",
        ),
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
