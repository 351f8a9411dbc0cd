"""Tables of a page with their text, and the tables of a comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from loose_env.evaluation import Calibration, Crossing, Division, Interval, percent, ratio_names


@dataclass(frozen=True, kw_only=True, eq=False)
class PageTable:
    """A table with its text."""

    rows: Sequence[Mapping[str, object]]
    """The keys of the first row are the columns; the first of them names the row."""
    heading: str = ""
    """Section heading; a table without one joins the section before."""
    intro: str = ""
    """A paragraph below the heading."""
    title: str = ""
    """A name that stands on the table."""
    note: str = ""
    """A sentence below the table: what the columns mean."""


def crossed_page_table(found: Crossing) -> PageTable:
    """Estimators crossed with policies."""
    rows = []
    for policy in found.policies:
        row = {"Poses chosen by": policy}
        for estimator in found.estimators:
            s = found.cells.get((policy, estimator))
            row[estimator] = (
                "not played"
                if s is None
                else f"{percent(s.success)} · {s.records:.2f} · {s.reward:.3f}"
            )
        rows.append(row)
    return PageTable(
        rows=[
            {k: v.replace("-", "−") if k in found.estimators else v for k, v in r.items()}
            for r in rows
        ],
        heading="Estimator and choice of poses",
        intro="Along a line the estimator changes, down a column the choice of poses.",
        note="In each cell: accuracy, mean records, mean return.",
    )


def division_page_table(division: Division, *, heading: str = "") -> PageTable:
    """One division of the episodes."""
    first = next(iter(division.cells.values()))
    columns = [
        f"{name} ({cell.episodes} arms)" for name, cell in zip(division.groups, first, strict=True)
    ]
    rows = []
    for agent, cells in division.cells.items():
        shown = [
            "none" if math.isnan(c.success) else f"{percent(c.success)} · {c.records:.2f}"
            for c in cells
        ]
        rows.append({"Agent": agent, **dict(zip(columns, shown, strict=True))})
    return PageTable(
        rows=rows,
        heading=heading,
        title=f"By {division.heading}",
        note="In each cell: accuracy, mean records.",
    )


def calibration_tables(found: Sequence[Calibration]) -> list[PageTable]:
    """Calibration of the probabilities, in all, by record and by friction."""
    most = len(found[0].by_record)
    after = [*(f"after {k}" for k in range(1, most)), f"after {most} or more"]
    whole = [
        {
            "Agent": c.agent,
            "All records": f"{c.error:.3f}",
            "At the verdict": f"{c.at_verdict:.3f}",
            **{name: _error(e) for name, e in zip(after, c.by_record, strict=True)},
            "Log score": f"{c.score:.3f}".replace("-", "−"),
        }
        for c in found
    ]
    ratios = [
        {"Agent": c.agent, **{n: _error(e) for n, e in zip(ratio_names(), c.by_ratio, strict=True)}}
        for c in found
    ]
    return [
        PageTable(
            rows=whole,
            heading="Calibration",
            intro="After every record the best hypothesis has a probability. Of all predictions "
            "with a probability of 80 %, 80 % should be correct. The expected calibration error is "
            "the mean distance from that; 0 is perfect.",
            note="Expected calibration error over all records, at the verdicts, and after each "
            "record; log score: mean natural logarithm of the truth's probability at the verdicts, "
            "0 at best.",
        ),
        PageTable(
            rows=ratios,
            title="Calibration error by seat drive over friction (faulty arms)",
            note="No agent observes the friction. Conditional on it even the exact posterior is "
            "miscalibrated: it misses stuck faults and is underconfident on free ones.",
        ),
    ]


def trainings_page_table(
    found: Mapping[str, Mapping[str, Interval]], runs: Mapping[str, int]
) -> PageTable:
    """Interquartile means of agents that were trained several times."""
    rows = [
        {
            "Agent": agent,
            "Trainings": str(runs[agent]),
            "Accuracy": _range(by["success"], 100, 1),
            "Records": _range(by["records"], 1, 2),
            "Return": _range(by["reward"], 1, 3),
        }
        for agent, by in found.items()
    ]
    return PageTable(
        rows=rows,
        heading="Variation over training seeds",
        intro="The same training with other seeds.",
        note="Interquartile mean over trainings, with stratified bootstrap intervals (95 %), after "
        "Agarwal et al., NeurIPS 2021.",
    )


def _error(value: float) -> str:
    return "none" if math.isnan(value) else f"{value:.3f}"


def _range(i: Interval, scale: float, digits: int) -> str:
    low, high = (f"{scale * end:.{digits}f}" for end in (i.low, i.high))
    return f"{scale * i.estimate:.{digits}f} ({low} to {high})".replace("-", "−")
