"""Sections of a report, and how its numbers are written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.template import shown


def group(
    heading: str,
    intro: str,
    *,
    tables: Sequence[dict[str, Any]] = (),
    cards: Sequence[FigureCard] = (),
    points: Sequence[str] = (),
    code: str = "",
    beside: bool = False,
) -> dict[str, Any]:
    """A section of the page; nothing where it would be empty.

    With ``beside`` the first table stands beside the first picture where there is room.
    """
    if not (tables or cards or points or code):
        return {}
    name = "".join(c for c in heading.lower() if c.isalpha())
    return {
        "heading": heading,
        "intro": intro,
        "tables": [
            {
                "title": t.get("title", ""),
                "note": t["note"],
                "columns": list(t["rows"][0]),
                "rows": [[str(v) for v in row.values()] for row in t["rows"]],
            }
            for t in tables
            if t["rows"]
        ],
        "cards": [shown(card, f"{name}{k}") for k, card in enumerate(cards)],
        "points": list(points),
        "code": code,
        "beside": beside and bool(cards) and bool(tables),
    }


_SEVERITIES = {
    "critical": "Invalidates the result",
    "warning": "Limits the result",
    "note": "Notes",
}


def graded(warnings: Sequence[tuple[str, str]]) -> list[dict[str, Any]]:
    """Warnings by severity, the most severe first.

    Examples
    --------
    >>> [(each["severity"], each["said"]) for each in graded([("note", "a"), ("critical", "b")])]
    [('critical', ['b']), ('note', ['a'])]
    """
    return [
        {"severity": severity, "label": label, "said": said}
        for severity, label in _SEVERITIES.items()
        if (said := [words for own, words in warnings if own == severity])
    ]


def spread(values: Sequence[float]) -> str:
    """Smallest and largest value; one where they are the same to two digits."""
    low, high = f"{min(values):.2f}", f"{max(values):.2f}"
    return low if low == high else f"{low} to {high}"


def signed(value: float, digits: int = 2) -> str:
    """A number with a true minus sign."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")
