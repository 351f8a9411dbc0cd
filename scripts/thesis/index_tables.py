"""Thesis tables 6.3 to 6.7 recomputed from its data: direction errors and comparative index."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from loose_env.envs import INK, MEASURED
from loose_env.statistics import axial_difference, comparative_index
from loose_env.typing import Array
from scripts.charts import Panel, chart, points
from scripts.thesis.page import Rows, Section, printed, section
from scripts.thesis.plots import rms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEP = 5.0
"""The thesis reads directions to the nearest 5 degrees; a difference of two may be a step off."""
CHANGE, TURN = "|1\u00a0−\u00a0C*|", "φn\u00a0−\u00a0φ"  # a hyphen would allow a line break
_HUNDREDTH = 0.0101  # the tables print hundredths, some rounded and some cut off
_MARKERS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("mag_d", "here", {"color": MEASURED}),
    ("mag_d_printed", "printed", {"markersize": 9, "color": INK, "markerfacecolor": "none"}),
)


Errors = Mapping[str, tuple[float, float, float]]
"""`error_summary` of each fault."""


def turns(a: ArrayLike, b: ArrayLike) -> Array:
    """Turn from axes b to axes a the short way, -90 to 90 degrees."""
    found = axial_difference(np.radians(np.asarray(a)), np.radians(np.asarray(b)))
    return np.asarray(np.degrees(found).round(9), dtype=np.float64)


def error_summary(found: ArrayLike, true: ArrayLike) -> tuple[float, float, float]:
    """Signed mean, root of the mean square and largest of errors of directions, as axes [deg]."""
    errors = turns(found, true)
    three = (errors.mean(), rms(errors), np.abs(errors).max())
    mean, size, largest = (round(float(x), 9) for x in three)
    return mean, size, largest


@dataclass(frozen=True, kw_only=True)
class IndexRow:
    """The comparative index at one pose: as printed, and from tables and text."""

    theta2: int
    """Joint 2 [deg]."""
    change_printed: float
    """|1 - C*| in the table [1]."""
    change: float
    """|1 - C*| from the maximum correlations of table 6.4 [1]."""
    turn_printed: float
    """phi_n - phi in the table [deg]."""
    turn: float
    """phi_n - phi from the directions in the text, as axes, -90 to 90 [deg]."""
    mag_d_printed: float
    """mag(D) in the table [1]."""
    mag_d_columns: float
    """mag(D) (6.18) from the table's own two columns [1]."""
    mag_d: float
    """mag(D) (6.18) from table 6.4 and the text [1]."""
    mag_e: float | None
    """mag(E) (6.17) from the same; None where C* itself is not known [1]."""

    @property
    def change_off(self) -> float:
        """Deviation of the printed |1 - C*| from the recomputed one, 0 within rounding [1]."""
        off = abs(self.change_printed - self.change)
        return off if off > _HUNDREDTH else 0.0

    @property
    def turn_off(self) -> float:
        """Deviation of the printed angle from the recomputed one, without its sign [deg]."""
        angles = [self.turn_printed - self.turn, self.turn_printed + self.turn]
        return round(float(np.abs(turns(angles, [0.0, 0.0])).min()), 6)

    @property
    def remark(self) -> str:
        """The differences as text."""
        parts = [f"magnitude {self.change_off:.2f} off"] if self.change_off else []
        if self.turn_off:
            far = self.turn_off > STEP
            parts.append(f"angle {self.turn_off:.0f}° off" if far else "angle one step off")
        return "; ".join(parts) or "agrees"

    @property
    def known(self) -> tuple[str, str]:
        """|1 - C*| and mag(E) recomputed, dashes where C* itself is not known."""
        return ("–", "–") if self.mag_e is None else (f"{self.change:.2f}", f"{self.mag_e:.2f}")


def index_rows(condition: str) -> list[IndexRow]:
    """Work out a table again: "looseness" (6.5), "low_preload" (6.6) or "backlash" (6.7)."""
    number = {"looseness": "6_5", "low_preload": "6_6", "backlash": "6_7"}[condition]
    source = printed("index_tables")
    table, rows = source[f"table_{number}_{condition}"], []
    cases = source["backlash_cases" if condition == "backlash" else "looseness_cases"]
    for k, theta2 in enumerate(source["theta2_deg"]):
        # The direction when tight is printed once, among the looseness cases.
        nominal = source["looseness_cases"][k]["lowest_high_preload_deg"]
        nominal = cases[k].get("lowest_high_preload_deg", nominal)
        compared = cases[k][f"lowest_{condition}_deg"]
        change, turn = table["one_minus_c"][k], table["turn_deg"][k]
        # Table 6.4 has no C_p: its printed change stands in, with C* = 1 - change.
        known = condition != "low_preload"
        c_n = source["table_6_4"]["c_n"][k] if known else 1.0
        c = source["table_6_4"][f"c_{condition[0].replace('l', 'f')}"][k] if known else 1 - change
        here = comparative_index(c_n, math.radians(nominal), c, math.radians(compared))
        rows.append(
            IndexRow(
                theta2=theta2,
                change_printed=change,
                change=abs(1.0 - c / c_n),
                turn_printed=turn,
                turn=float(turns(nominal, compared)),
                mag_d_printed=table["mag_d"][k],
                mag_d_columns=comparative_index(1.0, math.radians(turn), 1.0 - change, 0.0).mag_d,
                mag_d=here.mag_d,
                mag_e=here.mag_e if known else None,
            )
        )
    return rows


def directions(fault: str) -> tuple[list[float], list[float]]:
    """Direction of lowest correlation and the fault's own [deg], by pose."""
    cases = printed("index_tables")[f"{fault}_cases"]
    return [c[f"lowest_{fault}_deg"] for c in cases], [c[f"{fault}_deg"] for c in cases]


def index_tables(seed: int) -> Section:
    """Compare tables 6.3 to 6.7 with values recomputed from the thesis's own data."""
    source = printed("index_tables")
    loose, preload, backlash = map(index_rows, ("looseness", "low_preload", "backlash"))
    errors = {name: error_summary(*directions(name)) for name in ("looseness", "backlash")}
    slips = _slips({"6.5": loose, "6.6": preload, "6.7": backlash}, errors)
    least, most = min(loose, key=lambda r: r.mag_d), max(preload, key=lambda r: r.mag_d)
    worst = max(abs(v) for fault in errors for v in source["table_6_3"][f"{fault}_error_deg"])
    largest, n_slips = max(e[2] for e in errors.values()), len(slips)

    def misread(row: IndexRow, step: float) -> float:
        turn = min(max(abs(row.turn) + step, 0.0), 90.0)
        return row.change * math.sin(math.radians(turn))

    low, high = min(misread(r, -STEP) for r in loose), max(misread(r, STEP) for r in preload)
    missed = [f"{r.theta2}°" for r in backlash if r.mag_d < least.mag_d]
    gained = [r.theta2 for r in backlash if r.mag_d >= least.mag_d > r.mag_d_printed]
    more = "".join(f"; at {theta2}° it does so in print but not here" for theta2 in gained)
    n_missed, missed_poses = len(missed), ", ".join(missed[:-1]) + " and " + missed[-1]
    lowest_e = min(row.mag_e for row in loose if row.mag_e is not None)
    rival = max((1 + r.change) * abs(math.sin(math.radians(r.turn))) for r in preload)
    table = source["table_6_4"]
    above = ", ".join(
        f"{fault} at {k}°"
        for fault, name in (("looseness", "c_f"), ("backlash", "c_b"))
        for k, c, n in zip(source["theta2_deg"], table[name], table["c_n"], strict=True)
        if c > n
    )
    figure = index_figure(
        {"looseness": loose, "low preload, no fault": preload, "backlash": backlash}
    )
    indices = [[(row,) for row in rows] for rows in (loose, preload, backlash)]
    return section("index_tables", locals(), [_error_rows(errors), *indices, slips], [figure])


def _slips(tables: Mapping[str, Sequence[IndexRow]], errors: Errors) -> Rows:
    """Printed figures that contradict others: where, quantity, printed, follows."""
    source = printed("index_tables")
    found: list[tuple[str, ...]] = []
    for fault, (mean, _, _) in errors.items():
        table = source["table_6_3"]
        said = table[f"{fault}_error_deg"]
        for theta2, a, b in zip(source["theta2_deg"], said, turns(*directions(fault)), strict=True):
            if abs(a - b) > 1e-6:
                found.append((f"Table 6.3, {theta2}°", f"error, {fault}", f"{a:.0f}°", f"{b:.0f}°"))
        average = table[f"{fault}_average_deg"]
        if abs(average - mean) > 0.5:
            found.append(("Table 6.3", f"average, {fault}", f"{average}°", f"{mean:.0f}°"))
    for number, rows in tables.items():
        for row in rows:
            where = f"Table {number}, {row.theta2}°"
            if row.change_off:
                found.append((where, CHANGE, f"{row.change_printed:.2f}", f"{row.change:.2f}"))
            if row.turn_off > STEP:
                found.append((where, TURN, f"{row.turn_printed:.0f}°", f"{row.turn:.0f}°"))
    return found


def _error_rows(errors: Errors) -> Rows:
    source = printed("index_tables")
    table, columns = source["table_6_3"], [[f"{t}°" for t in source["theta2_deg"]]]
    columns[0] += ["signed mean", "RMS", "largest"]
    for fault, (mean, size, largest) in errors.items():
        said = table[f"{fault}_error_deg"]
        _, *own = error_summary(said, np.zeros(len(said)))
        ends = [f"{table[f'{fault}_average_deg']}°", f"{own[0]:.1f}°", f"{own[1]:.0f}°"]
        columns.append([*(f"{v}°" for v in said), *ends])
        ends = [f"{mean:.0f}°", f"{size:.1f}°", f"{largest:.0f}°"]
        columns.append([*(f"{v:.0f}°" for v in turns(*directions(fault))), *ends])
    return list(zip(*columns, strict=True))


def index_figure(groups: Mapping[str, Sequence[IndexRow]]) -> Figure:
    """Draw one line a pose and one panel a condition."""
    first = next(iter(groups.values()))
    threshold, panels = min(row.mag_d for row in first), []
    for name, rows in groups.items():
        places = -np.arange(len(rows), dtype=float)
        printed_here = [points([getattr(r, of) for r in rows], places, words, **look)
                        for of, words, look in _MARKERS]  # fmt: skip
        ticks = {"yticks": places, "yticklabels": [f"{row.theta2}°" for row in rows]}
        look = {**ticks, "xlim": (0.0, 0.9)}
        panels.append(Panel(title=name, curves=printed_here, marks=[threshold], look=look))
    return chart(panels, across="comparative index mag(D)", height=1.5)
