"""Comparative index and direction errors, recomputed from the thesis's own data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.statistics import axial_difference, comparative_index
from loose_env.thesis.printed import printed

STEP = 5.0
"""The thesis reads directions to the nearest 5 degrees; a difference of two may be a step off."""
_HUNDREDTH = 0.0101  # the tables print hundredths, some rounded and some cut off


class ErrorSummary(NamedTuple):
    """Errors of several poses, boiled down in three ways."""

    mean: float
    """Signed mean [deg]: errors of opposite sign cancel."""
    rms: float
    """Root of the mean square [deg]."""
    largest: float
    """Largest magnitude [deg]."""


def error_summary(found: ArrayLike, true: ArrayLike) -> ErrorSummary:
    """Boil down the errors of directions found against true ones, as axes.

    ``found``, ``true`` (K,): directions, degrees; a direction and its opposite are the same.
    Returns signed mean, RMS and largest magnitude, degrees.

    Examples
    --------
    Two errors of opposite sign cancel in the mean:

    >>> error_summary([10.0, 170.0], [0.0, 0.0])
    ErrorSummary(mean=0.0, rms=10.0, largest=10.0)
    """
    errors = turns(np.asarray(found, dtype=float), np.asarray(true, dtype=float))
    mean, rms = float(errors.mean()), float(np.sqrt(np.mean(errors**2)))
    return ErrorSummary(round(mean, 9), round(rms, 9), round(float(np.abs(errors).max()), 9))


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
        angles = np.array([self.turn_printed - self.turn, self.turn_printed + self.turn])
        return round(float(np.abs(turns(angles, np.zeros(2))).min()), 6)

    @property
    def slip(self) -> bool:
        """True if magnitude or angle contradict table 6.4 and the text."""
        return self.change_off > 0.0 or self.turn_off > STEP

    @property
    def remark(self) -> str:
        """The differences as text."""
        parts = []
        if self.change_off:
            parts.append(f"magnitude {self.change_off:.2f} off")
        if self.turn_off > STEP:
            parts.append(f"angle {self.turn_off:.0f}° off")
        elif self.turn_off:
            parts.append("angle one step off")
        return "; ".join(parts) or "agrees"


def index_rows(condition: str) -> list[IndexRow]:
    """Work out a table of the comparative index again.

    ``condition``: ``"looseness"`` (table 6.5), ``"low_preload"`` (6.6) or ``"backlash"`` (6.7).

    Examples
    --------
    >>> row = index_rows("looseness")[2]
    >>> row.theta2, row.mag_d_printed, round(row.mag_d, 2), row.remark
    (56, 0.75, 0.47, 'magnitude 0.30 off')
    """
    tables = {"looseness": "6_5", "low_preload": "6_6", "backlash": "6_7"}
    source = printed("tables")
    table = source[f"table_{tables[condition]}_{condition}"]
    rows = []
    for k, theta2 in enumerate(source["theta2_deg"]):
        nominal, compared = _lowest(condition, k)
        change, turn = table["one_minus_c"][k], table["turn_deg"][k]
        # Table 6.4 has no C_p: its printed change stands in, with C* = 1 - change.
        known = condition != "low_preload"
        c_n = source["table_6_4"]["c_n"][k] if known else 1.0
        c = source["table_6_4"][f"c_{condition[0].replace('l', 'f')}"][k] if known else 1 - change
        here = comparative_index(c_n, math.radians(nominal), c, math.radians(compared))
        columns = comparative_index(1.0, math.radians(turn), 1.0 - change, 0.0)
        rows.append(
            IndexRow(
                theta2=theta2,
                change_printed=change,
                change=abs(1.0 - c / c_n),
                turn_printed=turn,
                turn=float(turns(np.array([nominal]), np.array([compared]))[0]),
                mag_d_printed=table["mag_d"][k],
                mag_d_columns=columns.mag_d,
                mag_d=here.mag_d,
                mag_e=here.mag_e if known else None,
            )
        )
    return rows


def turns(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Turn from axes b to axes a the short way, -90 to 90 degrees."""
    degrees = np.degrees(axial_difference(np.radians(a), np.radians(b)))
    return np.asarray(degrees.round(9), dtype=np.float64)


def _cases(condition: str) -> list[dict[str, Any]]:
    kind = "backlash" if condition == "backlash" else "looseness"
    found: list[dict[str, Any]] = printed("tables")[f"{kind}_cases"]
    return found


def _lowest(condition: str, k: int) -> tuple[float, float]:
    """Direction of lowest correlation, tight and in the condition [deg], from the text."""
    case = _cases(condition)[k]
    nominal = case["lowest_high_preload_deg"]
    if nominal is None:  # printed once, among the looseness cases: the pose is the same
        nominal = _cases("looseness")[k]["lowest_high_preload_deg"]
    return float(nominal), float(case[f"lowest_{condition}_deg"])


def directions(fault: str) -> tuple[list[float], list[float]]:
    """Direction of lowest correlation and the fault's own [deg], by pose.

    ``fault``: ``"looseness"`` or ``"backlash"``.
    """
    cases = _cases(fault)
    return [c[f"lowest_{fault}_deg"] for c in cases], [c[f"{fault}_deg"] for c in cases]
