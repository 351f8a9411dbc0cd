"""Scores of the suite and their table."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from scripts.suites.diagnosis.measuring import SHOWS

Rows = Sequence[dict[str, Any]]
BINS = (0.0, 0.5, 0.7, 0.9, 0.98, 1.0)


def table(rows: Rows, title: str) -> str:
    """Table of one form of the suite."""
    lines = [title, f"  cases: {len(rows)}"]
    healthy = [r for r in rows if r["kind"] == "healthy"]
    lines.append(f"  healthy called healthy: {_share([r['said'] == 'healthy' for r in healthy])}")
    for kind in ("structural_looseness", "backlash"):
        own = [r for r in rows if r["kind"] == kind]
        seen = [r for r in own if r["shown"] > SHOWS]
        lines.append(f"  {kind}: kind and location: {_share(_right(own))}")
        lines.append(f"    detectable faults: {_share(_right(seen))}")
        lines.append(f"    kind: {_share([r['said'].startswith(kind) for r in own])}")
    in_session = bool(rows) and "named" in rows[0]
    for reference in () if in_session else (False, True):
        own = [r for r in rows if r["reference"] == reference]
        words = "with" if reference else "without"
        lines.append(f"  all, {words} healthy runs: {_share(_right(own))}")
    most = max((len(r["steps"]) for r in rows), default=0)
    faulty = [r for r in rows if r["kind"] != "healthy"]
    for count in range(1, most + 1):
        lines.append(
            f"  after {count} run(s): {_share(_right_after(rows, count))}; of faults "
            f"{_share(_right_after(faulty, count))}; calibration error "
            f"{_bins(_said_after(rows, count), _right_after(rows, count))[0]:.3f}"
        )
    lines += _numbers(rows) + _calibration(rows)
    if in_session:
        taken = [r["measurements"] for r in rows]
        lines.append(
            f"  runs taken: median {np.median(taken):g}, mean {np.mean(taken):.2f}; identified "
            f"{_share([r['named'] for r in rows])}; accuracy of those "
            f"{_share(_right([r for r in rows if r['named']]))}"
        )
    return "\n".join(lines)


def _numbers(rows: Rows) -> list[str]:
    right = [r for r in rows if r["said"] == r["true"]]
    angles = [r["angle"] for r in right if r.get("angle") is not None]
    lines = []
    if angles:
        inside = [r["angle"] <= r["half_angle"] for r in right if r.get("angle") is not None]
        lines.append(
            f"  direction: median {np.median(angles):.1f} degrees, nine of ten within "
            f"{np.percentile(angles, 90):.1f}; inside its 95 % cone {_share(inside)}"
        )
    faults = [r for r in right if r["kind"] != "healthy"]
    given = [r for r in faults if r.get("gap_said") is not None]
    if faults:
        lines.append(
            f"  clearance given: {_share([r.get('gap_said') is not None for r in faults])}"
        )
    if given:
        ratio = [abs(r["gap_said"] / r["gap"] - 1) for r in given]
        inside = [r["gap_interval"][0] <= r["gap"] <= r["gap_interval"][1] for r in given]
        lines.append(
            f"  clearance error: median {np.median(ratio):.0%}; inside its 95 % interval "
            f"{_share(inside)}"
        )
    return lines


def _calibration(rows: Rows) -> list[str]:
    if not rows:
        return []
    error, lines = _bins([r["probability"] for r in rows], _right(rows))
    return [f"  calibration error (ECE): {error:.3f}", *lines]


def _bins(probabilities: Sequence[float], outcomes: Sequence[bool]) -> tuple[float, list[str]]:
    """Expected calibration error, and a line for every bin of what was said."""
    said, right = np.array(probabilities), np.array(outcomes, dtype=float)
    error, lines = 0.0, []
    for low, high in itertools.pairwise(BINS):
        inside = (said > low) & (said <= high)
        if inside.any():
            gap = abs(float(said[inside].mean() - right[inside].mean()))
            error += gap * inside.mean()
            lines.append(
                f"    probability {low:.2f} to {high:.2f}: {inside.sum()} cases, mean "
                f"{said[inside].mean():.3f}, accuracy {right[inside].mean():.3f}"
            )
    return error, lines


def _after(row: dict[str, Any], count: int) -> dict[str, float]:
    """Probabilities by the first runs alone; by all where there are fewer."""
    found: dict[str, float] = row["steps"][min(count, len(row["steps"])) - 1]
    return found


def _said_after(rows: Rows, count: int) -> list[float]:
    return [max(_after(r, count).values()) for r in rows]


def _right_after(rows: Rows, count: int) -> list[bool]:
    return [_best(_after(r, count)) == r["true"] for r in rows]


def _best(probabilities: dict[str, float]) -> str:
    return max(probabilities, key=lambda name: probabilities[name])


def _right(rows: Rows) -> list[bool]:
    return [r["said"] == r["true"] for r in rows]


def _share(values: Sequence[bool]) -> str:
    if not values:
        return "no case"
    return f"{sum(values)} of {len(values)} ({sum(values) / len(values):.0%})"
