"""Tables 6.3 to 6.7 recomputed from the thesis's own data: errors and the index.

The comparative index at every pose, printed and worked out again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED
from loose_env.report import WIDTH, FigureCard, new_figure
from loose_env.thesis.ch4_diagnosis.comparative_index import (
    STEP,
    ErrorSummary,
    IndexRow,
    directions,
    error_summary,
    index_rows,
    turns,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


EQUATIONS: dict[str, str] = dict.fromkeys(
    ("6.15", "6.16", "6.17", "6.18"),
    "loose_env.statistics.correlation.comparative_index",
)
"""Function of each equation."""

# No line breaks inside: a hyphen would allow one, a minus does not.
_CHANGE = "|1 − C*|".replace(" ", "\u00a0")
_TURN = "φn − φ".replace(" ", "\u00a0")


def section(seed: int) -> Section:
    """Compare tables 6.3 to 6.7 with values recomputed from the thesis's own data."""
    loose, preload, backlash = map(index_rows, ("looseness", "low_preload", "backlash"))
    errors = {name: error_summary(*directions(name)) for name in ("looseness", "backlash")}
    slips = _slips(loose, preload, backlash, errors)
    return Section(
        key="index_tables",
        title="Direction errors and the comparative index (6.5.1, tables 6.3 to 6.7)",
        finding=(
            f"The index is at least {min(r.mag_d for r in loose):.2f} with looseness and at most "
            f"{max(r.mag_d for r in preload):.2f} with low preload; {len(slips)} printed figures "
            "contradict the thesis's own data."
        ),
        words=[*_words(loose, preload, backlash, errors), _slip_words(slips)],
        tables=[
            _error_table(errors),
            _index_table("6.5, looseness", loose),
            _index_table("6.6, low preload, which is no fault", preload),
            _index_table("6.7, backlash", backlash),
            Table(
                caption="Slips: what the tables print, and what follows from the thesis's own "
                "table 6.4 and the directions in its text.",
                columns=("Where", "Quantity", "Printed", "Follows"),
                rows=tuple(slips),
            ),
        ],
        cards=[
            FigureCard(
                image=index_figure(
                    {"looseness": loose, "low preload, no fault": preload, "backlash": backlash}
                ),
                title="The index at each pose",
                caption="Comparative index mag(D) (6.18) at five poses of joint 2. Open circle: as "
                "printed. Dot: from table 6.4 and the directions in the text. Dashed: the smallest "
                "index under looseness.",
            )
        ],
        equations=EQUATIONS,
        left_out=[
            "Maximum correlations at low preload: table 6.4 does not print them, so table 6.6 is "
            "worked out again from its own magnitudes, with the angles of the text."
        ],
    )


def _poses(rows: Sequence[IndexRow]) -> str:
    names = [f"{row.theta2}°" for row in rows]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _words(
    loose: Sequence[IndexRow],
    preload: Sequence[IndexRow],
    backlash: Sequence[IndexRow],
    errors: dict[str, ErrorSummary],
) -> list[str]:
    source = printed("tables")
    claimed = source["claimed_error_deg"]
    least = min(loose, key=lambda row: row.mag_d)
    most = max(preload, key=lambda row: row.mag_d)
    missed = [row for row in backlash if row.mag_d < least.mag_d]
    gained = [r for r in backlash if r.mag_d >= least.mag_d > r.mag_d_printed]
    own = [abs(v) for f in errors for v in source["table_6_3"][f"{f}_error_deg"]]
    over = max(own) > claimed
    words = [
        "With the arm tight and with a fault, the thesis took two things from a record: the "
        "direction of lowest correlation between the tool and the link before the joint, and the "
        "maximum correlation C over all directions. C* is C divided by its value when tight. The "
        f"comparative index mag(D) = {_CHANGE} |sin({_TURN})| multiplies the change of the one by "
        "the turn of the other. Here nothing is simulated: the tables are worked out again from "
        "the thesis's own figures.",
        f"Table 6.3 averages signed errors, so errors of opposite sign cancel: "
        f"{errors['looseness'].mean:.0f}° for looseness and {errors['backlash'].mean:.0f}° for "
        "backlash, as signed means "
        f"({source['table_6_3']['looseness_average_deg']}° and "
        f"{source['table_6_3']['backlash_average_deg']}° printed). The RMS errors are "
        f"{errors['looseness'].rms:.1f}° and {errors['backlash'].rms:.1f}°. The text says that "
        f"faults were located to within {claimed}°; its own table goes up to {max(own)}°, and its "
        f"directions up to {max(e.largest for e in errors.values()):.0f}°"
        + (", so the claim does not hold at every pose." if over else ", so the claim holds."),
    ]
    if least.mag_d > most.mag_d:
        words.append(
            f"The thesis's conclusion about looseness {_survives(loose, preload)}: the smallest "
            f"index under looseness is {least.mag_d:.2f} (at {least.theta2}°), the largest at low "
            f"preload {most.mag_d:.3f} (at {most.theta2}°). A threshold between them, chosen on "
            f"these same poses, tells the two apart. {_steps(loose, preload)}"
        )
    else:
        words.append(
            f"Worked out again, the index no longer tells looseness from low preload: at "
            f"{least.theta2}° it is {least.mag_d:.3f} under looseness, at {most.theta2}° "
            f"{most.mag_d:.3f} with low preload."
        )
    blind = (
        f"Backlash stays below the smallest looseness index at {len(missed)} of {len(backlash)} "
        f"poses ({_poses(missed)})"
        if missed
        else f"Backlash exceeds the smallest looseness index at all {len(backlash)} poses"
    )
    more = f"; at {_poses(gained)} it does so in print but not here" if gained else ""
    words.append(
        f"{blind}{more}. The thesis names the reason: the product vanishes as soon as either the "
        "maximum correlation or the direction stays the same, so one pose is not enough."
    )
    lowest_e = min(row.mag_e for row in loose if row.mag_e is not None)
    rival = max((1 + r.change) * abs(math.sin(math.radians(r.turn))) for r in preload)
    words.append(
        f"The plain cross product mag(E) = C* |sin({_TURN})| (6.17) does not need the maximum to "
        f"change. Its smallest value under looseness is {lowest_e:.2f}; at low preload it may "
        f"reach {rival:.2f}. "
        + (
            "By itself it would tell the two apart too."
            if lowest_e > rival
            else "By itself it would not tell the two apart at every pose."
        )
    )
    return words


def _steps(loose: Sequence[IndexRow], preload: Sequence[IndexRow]) -> str:
    """Say what is left when every turn is a reading step off to the worse side."""

    def index(row: IndexRow, step: float) -> float:
        turn = min(max(abs(row.turn) + step, 0.0), 90.0)
        return row.change * math.sin(math.radians(turn))

    low, high = min(index(r, -STEP) for r in loose), max(index(r, STEP) for r in preload)
    verdict = "still apart" if low > high else "no longer apart"
    return (
        f"With every turn misread by {STEP:.0f}° to the worse side they are {low:.2f} and "
        f"{high:.2f}, {verdict}."
    )


def _survives(loose: Sequence[IndexRow], preload: Sequence[IndexRow]) -> str:
    as_printed = min(r.mag_d_printed for r in loose) > max(r.mag_d_printed for r in preload)
    return "survives the corrections" if as_printed else "holds only with the corrections"


def _slip_words(slips: Sequence[tuple[str, ...]]) -> str:
    above = [
        f"{name} at {k}°"
        for name in ("c_f", "c_b")
        for k, c, n in zip(
            printed("tables")["theta2_deg"],
            printed("tables")["table_6_4"][name],
            printed("tables")["table_6_4"]["c_n"],
            strict=True,
        )
        if c > n
    ]
    named = ", ".join(above).replace("c_f", "looseness").replace("c_b", "backlash")
    return (
        f"{len(slips)} printed figures contradict others of the thesis; the last table lists them. "
        f"Directions were read in steps of {STEP:.0f}°, so an angle that is one step off is "
        "remarked on but not counted. The maximum correlation exceeds that of the tight arm in "
        f"some poses ({named}); there C* is above one, and the tables use the magnitude of 1 − C*."
    )


def _slips(
    loose: Sequence[IndexRow],
    preload: Sequence[IndexRow],
    backlash: Sequence[IndexRow],
    errors: dict[str, ErrorSummary],
) -> list[tuple[str, ...]]:
    source = printed("tables")
    found: list[tuple[str, ...]] = []
    for fault in ("looseness", "backlash"):
        table = source["table_6_3"]
        here = turns(*map(np.array, directions(fault)))
        for theta2, said, error in zip(
            source["theta2_deg"], table[f"{fault}_error_deg"], here, strict=True
        ):
            if abs(said - error) > 1e-6:
                where = f"Table 6.3, {theta2}°"
                found.append((where, f"error, {fault}", f"{said:.0f}°", f"{error:.0f}°"))
        average, mean = table[f"{fault}_average_deg"], errors[fault].mean
        if abs(average - mean) > 0.5:
            found.append(("Table 6.3", f"average, {fault}", f"{average}°", f"{mean:.0f}°"))
    for number, rows in (("6.5", loose), ("6.6", preload), ("6.7", backlash)):
        for row in (r for r in rows if r.slip):
            where = f"Table {number}, {row.theta2}°"
            if row.change_off:
                pair = (f"{row.change_printed:.2f}", f"{row.change:.2f}")
                found.append((where, _CHANGE, *pair))
            if row.turn_off > STEP:
                pair = (f"{row.turn_printed:.0f}°", f"{row.turn:.0f}°")
                found.append((where, _TURN, *pair))
    return found


def _error_table(errors: dict[str, ErrorSummary]) -> Table:
    source = printed("tables")
    table = source["table_6_3"]
    columns: list[list[str]] = [[f"{t}°" for t in source["theta2_deg"]]]
    columns[0] += ["signed mean", "RMS", "largest"]
    for fault in ("looseness", "backlash"):
        said = table[f"{fault}_error_deg"]
        own = error_summary(said, np.zeros(len(said)))
        average = f"{table[f'{fault}_average_deg']}°"
        columns.append(
            [f"{v}°" for v in said] + [average, f"{own.rms:.1f}°", f"{own.largest:.0f}°"]
        )
        here, e = turns(*map(np.array, directions(fault))), errors[fault]
        columns.append(
            [f"{v:.0f}°" for v in here] + [f"{e.mean:.0f}°", f"{e.rms:.1f}°", f"{e.largest:.0f}°"]
        )
    return Table(
        caption="Table 6.3: error of the direction of lowest correlation against the fault's own, "
        "by pose of joint 2. Here: from the directions in the text, as axes. RMS and largest under "
        "“printed” are those of the printed errors; the thesis prints the average alone.",
        columns=("θ2", "loose, printed", "loose, here", "backlash, printed", "backlash, here"),
        rows=tuple(zip(*columns, strict=True)),
    )


def _index_table(name: str, rows: Sequence[IndexRow]) -> Table:
    def cells(row: IndexRow) -> tuple[str, ...]:
        return (
            f"{row.theta2}°",
            f"{row.change_printed:.2f}",
            f"{row.change:.2f}" if row.mag_e is not None else "–",
            f"{row.turn_printed:.0f}°",
            f"{row.turn:.0f}°",
            f"{row.mag_d_printed:.3g}",
            f"{row.mag_d_columns:.3f}",
            f"{row.mag_d:.3f}",
            "–" if row.mag_e is None else f"{row.mag_e:.2f}",
            row.remark,
        )

    return Table(
        caption=f"Table {name}. Own columns: (6.18) from the two printed columns. Here: from table "
        "6.4 and the directions in the text. The sign of an angle does not matter.",
        columns=(
            "θ2",
            f"{_CHANGE}, printed",
            "here",
            f"{_TURN}, printed",
            "here",
            "mag(D), printed",
            "own columns",
            "here",
            "mag(E), here",
            "printed against here",
        ),
        rows=tuple(cells(row) for row in rows),
    )


_GAP = 1.4  # lines between two blocks
_MOST = 0.8


def index_figure(groups: Mapping[str, Sequence[IndexRow]]) -> Figure:
    """Draw one line a pose and one block a condition.

    ``groups``: rows of each condition by its name; the dashed line marks the least index of the
    first.
    """
    lines = sum(len(rows) + _GAP for rows in groups.values())
    height = 0.235 * lines + 0.55
    figure = new_figure(height)
    left, foot = 0.62, 0.5
    box = (left / WIDTH, foot / height, 1 - (left + 0.1) / WIDTH, 1 - (foot + 0.05) / height)
    axes = figure.add_axes(box)
    first = next(iter(groups.values()))
    threshold = min(row.mag_d for row in first)
    y, ticks = 0.0, {}
    for name, rows in groups.items():
        axes.text(0.0, y, name, color=INK, fontsize=9.5, fontweight="bold", va="center")
        block: dict[str, Any] = {"ymin": y - len(rows) - 0.5, "ymax": y - 0.5, "zorder": 1}
        axes.vlines([0.2 * k for k in range(5)], color=FAINT, linewidth=0.8, **block)
        axes.vlines(threshold, color=MUTED, linewidth=1.1, linestyle=(0, (3, 2)), **block)
        for row in rows:
            y -= 1.0
            ticks[y] = f"{row.theta2}°"
            _pair(axes, row, y)
        y -= _GAP
    widest = max(first, key=lambda row: abs(row.mag_d - row.mag_d_printed))
    _names(axes, widest, -1.0 - list(first).index(widest))
    axes.set(xlim=(0.0, _MOST + 0.1), ylim=(y + _GAP - 0.5, 0.6))
    axes.set_xticks([0.2 * k for k in range(5)])
    axes.set_yticks(list(ticks), list(ticks.values()))
    axes.patch.set_alpha(0.0)
    axes.tick_params(length=0, pad=6, labelsize=9, labelcolor=MUTED)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("comparative index mag(D)", color=MUTED, fontsize=9)
    return figure


def _pair(axes: Axes, row: IndexRow, y: float) -> None:
    """Draw a dot for what follows here and a ring for what was printed."""
    axes.plot([row.mag_d_printed, row.mag_d], [y, y], color=MUTED, linewidth=1.3, zorder=2)
    over: dict[str, Any] = {"marker": "o", "linestyle": "none", "clip_on": False, "zorder": 3}
    axes.plot(row.mag_d, y, color=MEASURED, markersize=5.5, **over)
    ring: dict[str, Any] = {
        "markerfacecolor": "none",
        "markeredgecolor": INK,
        "markeredgewidth": 1.3,
    }
    axes.plot(row.mag_d_printed, y, markersize=9.5, **ring, **over)


def _names(axes: Axes, row: IndexRow, y: float) -> None:
    """Name dot and ring, each on its free side."""
    side = 1.0 if row.mag_d_printed > row.mag_d else -1.0
    words: dict[str, Any] = {"fontsize": 9, "va": "center"}
    here, said = ("right", "left") if side > 0 else ("left", "right")
    axes.text(row.mag_d - 0.018 * side, y, "here", color=MEASURED, ha=here, **words)
    axes.text(row.mag_d_printed + 0.022 * side, y, "printed", color=INK, ha=said, **words)
