"""Marks of the suite's rows and their tables."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from loose_env.evaluation import wilson
from scripts.suites.machines.disturbances import KINDS

Rows = Sequence[dict[str, Any]]
BINS = (0.0, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
"""Ends of the bins of probability."""


def sure_fault(row: dict[str, Any]) -> bool:
    """Return True if a fault was surely named."""
    return bool(row.get("verdict") == "faulty")


def right(row: dict[str, Any]) -> bool:
    """Return True if the most probable hypothesis is the truth."""
    return bool(row.get("named") == row["truth"])


def right_link(row: dict[str, Any]) -> bool:
    """Return True if the most probable hypothesis lies at the true link or its joint."""
    return row["link"] is not None and row.get("named_link") == row["link"]


def tables(rows: Rows) -> str:
    """All tables in Markdown; machines that could not be played are counted apart."""
    played = [row for row in rows if "unplayed" not in row]
    apart = len(rows) - len(played)
    said = f" {apart} more machines could not be played: no servo loop held their pose."
    rows = played
    found = [
        f"{len(rows)} cases{_spread(rows)}.{said if apart else ''}",
        "",
        _head(("", "to reach", "measured")),
    ]
    found += [_line(line) for line in _summary(rows)]
    found += ["", "Probability of the most probable hypothesis against its accuracy:", ""]
    found += [_head(("probability", "cases", "mean", "accuracy"))]
    found += [_line(line) for line in calibration(rows)[1]]
    found += ["", "By disturbance present (a case has several) and by recorder:", ""]
    found += [_head(("cases with", "sure false alarms", "right link of faults that open",
                     "sure wrong link", "calibration error"))]  # fmt: skip
    found += [_line(line) for line in _strata(rows)]
    return "\n".join(found)


def calibration(rows: Rows) -> tuple[float, list[tuple[str, ...]]]:
    """Expected calibration error, and the lines of its bins."""
    rows = [row for row in rows if "probability" in row]
    told = np.array([row["probability"] for row in rows])
    hit = np.array([right(row) for row in rows], dtype=float)
    error = 0.0
    lines: list[tuple[str, ...]] = []
    for low, high in itertools.pairwise(BINS):
        inside = (told > low) & (told <= high)
        if inside.any():
            error += abs(float(told[inside].mean() - hit[inside].mean())) * float(inside.mean())
            lines.append((f"{low:g} to {high:g}", str(int(inside.sum())),
                          f"{told[inside].mean():.3f}", f"{hit[inside].mean():.3f}"))  # fmt: skip
    return error, lines


def _summary(rows: Rows) -> list[tuple[str, str, str]]:
    healthy = [row for row in rows if row["link"] is None]
    faulty = [row for row in rows if row["link"] is not None]
    opening = [row for row in faulty if row["opens"]]
    settled = [row for row in opening if sure_fault(row)]
    rest = [row for row in opening if not right_link(row)]
    lines = []
    for reference, most in ((False, "at most 2 %"), (True, "at most 0.5 %")):
        own = [row for row in healthy if row["reference"] == reference]
        words = "with" if reference else "without"
        lines.append((f"sure false alarms, {words} reference", most, _share(own, sure_fault)))
    for verdict in ("healthy", "open", "model_mismatch"):
        lines.append((f"healthy arms: {verdict}", "", _share(healthy, _verdict(verdict))))
    lines += [
        ("faults that open", "", _share(faulty, lambda row: row["opens"])),
        ("surely healthy of faults that open", "", _share(opening, _verdict("healthy"))),
        ("surely healthy of the others", "",
         _share([row for row in faulty if not row["opens"]], _verdict("healthy"))),
        ("right link of faults that open", "at least 85 %", _share(opening, right_link)),
        ("right hypothesis of faults that open", "", _share(opening, right)),
        ("settled of faults that open", "", _share(opening, sure_fault)),
        ("right link of those", "", _share(settled, right_link)),
        ("no sure wrong name where the link is not right", "at least 90 %",
         _share(rest, lambda row: not sure_fault(row))),
        ("the model is not this arm's, of the same", "",
         _share(rest, _verdict("model_mismatch"))),
        ("direction error, median and 90th percentile [degrees]", "",
         _spread_of([row["angle"] for row in opening
                     if right(row) and row.get("angle") is not None])),
        ("free travel over the truth, median and 90th percentile of its ratio", "",
         _spread_of([_ratio(row) for row in opening if right(row) and row.get("gap_named")])),
        ("runs to a sure result, median and 90th percentile", "",
         _spread_of([row["used"] for row in rows if row.get("used")])),
        ("calibration error", "at most 0.03", f"{calibration(rows)[0]:.3f}"),
        ("seconds of a diagnosis, median and 90th percentile", "",
         _spread_of([row["seconds"] for row in rows])),
        ("refused recordings", "", _share(rows, lambda row: "error" in row)),
    ]  # fmt: skip
    return lines


def _strata(rows: Rows) -> list[tuple[str, ...]]:
    groups: list[tuple[str, Rows]] = []
    for name in KINDS:
        own = [row for row in rows if name in row["disturbances"]]
        if own:
            groups.append((f"`{name}`", own))
    groups += [
        ("position servos", [row for row in rows if row["servoed"]]),
        ("torque motors", [row for row in rows if not row["servoed"]]),
        ("recorder below 1 kHz", [row for row in rows if row["rate"] < 1000]),
        ("recorder of 1 kHz or more", [row for row in rows if row["rate"] >= 1000]),
    ]
    groups += [(f"{n} joints", [row for row in rows if row["joints"] == n]) for n in range(3, 8)]
    lines: list[tuple[str, ...]] = []
    for name, group in groups:
        healthy = [row for row in group if row["link"] is None]
        opening = [row for row in group if row["link"] is not None and row["opens"]]
        wrong = [sure_fault(row) and not right_link(row) for row in opening]
        lines.append((name, _share(healthy, sure_fault), _share(opening, right_link),
                      f"{sum(wrong)} of {len(wrong)}", f"{calibration(group)[0]:.3f}"))  # fmt: skip
    return lines


def _verdict(name: str) -> Callable[[dict[str, Any]], bool]:
    return lambda row: bool(row.get("verdict") == name)


def _share(rows: Rows, mark: Callable[[dict[str, Any]], bool]) -> str:
    if not rows:
        return "no case"
    count = sum(bool(mark(row)) for row in rows)
    low, high = wilson(count, len(rows))
    return f"{count} of {len(rows)} = {count / len(rows):.1%} ({low:.1%} to {high:.1%})"


def _ratio(row: dict[str, Any]) -> float:
    ratio = float(row["gap_named"] / row["gap"])
    return max(ratio, 1 / ratio)


def _spread_of(values: Sequence[float]) -> str:
    if not values:
        return "no case"
    return f"{np.median(values):.3g}, {np.percentile(values, 90):.3g} ({len(values)})"


def _spread(rows: Rows) -> str:
    seeds = sorted({row["seed"] for row in rows})
    return f", seed {', '.join(map(str, seeds))}" if seeds else ""


def _head(names: Iterable[str]) -> str:
    names = list(names)
    return f"{_line(names)}\n|{'---|' * len(names)}"


def _line(values: Iterable[str]) -> str:
    return "| " + " | ".join(values) + " |"
