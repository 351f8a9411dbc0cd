"""Report of a trend as text and page: what left its band over the sessions, and since when."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import INK, MEASURED, TRUTH
from loose_env.instrument import Trend, Visit
from loose_env.io import sentence, write_text
from loose_env.report.figures import DASHED, labels, legend, panels
from loose_env.report.page import Brief, FigureCard, Section, Table, render_page, warnings_section
from loose_env.report.words import light_colours, place_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NAMES = {
    "knocks": "evidence for the best place's knocks [nats]",
    "top_db": "ringing over the first session [dB]",
}
_SHORT = {"knocks": "Knocks", "top_db": "Top band"}
_TICKS = 8  # sessions named on an axis


def trend_text(t: Trend) -> str:
    """A trend in a few lines for a terminal: sessions, then links and joints of the last one."""
    sessions, places = _sessions_table(t), place_table(t.last)
    cells = [sessions.columns, *(list(row.values()) for row in sessions.rows)]
    lights = [places.columns, *(list(row.values()) for row in places.rows)]
    return Brief(
        headline=sentence(t.headline),
        parts=[
            ("", "  ", cells),
            ("", "next: ", [sentence(words) for words in _steps(t)]),
            ("", "  ", lights if t.since and places.rows else []),
        ],
    ).text()


def write_trend_page(path: str | os.PathLike[str], t: Trend) -> Path:
    """Write the page of a trend.

    Parameters
    ----------
    path : path-like
        Path of the page; its folder is made if missing.
    t : Trend
        The trend.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    last = t.last
    caption = (
        "Against the first session. Dashed: upper end of the band, the limit of a healthy "
        "reference or the scatter of the first sessions where that is wider. Above it is an alarm."
    )
    cards = [
        FigureCard(
            title=" and ".join(_SHORT[n] for n in names).capitalize(), image=figure, caption=caption
        )
        for names, figure in _charts(t)
    ]
    page = render_page(
        sentence(t.headline),
        [
            Section(heading="What to do next", points=[sentence(words) for words in _steps(t)]),
            Section(heading="Charts", cards=cards),
            Section(
                heading="Links and joints, last session",
                intro=[sentence(last.headline)],
                tables=[place_table(last)],
            ),
            Section(heading="Sessions", tables=[_sessions_table(t)]),
            warnings_section(("note", words) for words in dict.fromkeys(last.remarks)),
        ],
        kicker=[t.visits[-1].name, "change since the first session", last.date[:10]],
        text=f"{len(t.visits)} sessions of one plan, each compared with {t.visits[0].name}.",
        notes=f"Compared by {' '.join(filter(None, ['loose-env', last.version]))}. All numbers "
        "stand in trend.json.",
        colours=light_colours(last),
    )
    return write_text(Path(path), page)


def _steps(t: Trend) -> list[str]:
    if t.since is None:
        return ["nothing to do; play the same plan next month"]
    return [
        t.last.remedy,
        "play the session once more before anything is taken apart: a change of the machine "
        "stays, a wrongly mounted accelerometer does not",
        "begin a new series after a repair: its first session is the new reference",
    ]


def _sessions_table(t: Trend) -> Table:
    rows = [
        {
            "Session": visit.name,
            "Date": visit.date[:10] or "-",
            **{
                short: f"{visit.values[name]:.2f}" if name in visit.values else "-"
                for name, short in _SHORT.items()
            },
            "Alarm": "reference" if visit.diagnosis is None else "ALARM" if visit.alarm else "no",
        }
        for visit in t.visits
    ]
    limits = {short: f"{t.bands[name]:.2f}" for name, short in _SHORT.items() if name in t.bands}
    band = {"Session": "upper end of the band", "Date": "-"}
    rows.append(
        {**band, **{short: limits.get(short, "-") for short in _SHORT.values()}, "Alarm": "-"}
    )
    return Table(rows=rows, note="Rhythm: correlation. Bands and lines: dB over the first session.")


def _charts(t: Trend) -> list[tuple[list[str], Figure]]:
    """Charts of two statistics each."""
    known = [name for name in _NAMES if any(name in visit.values for visit in t.visits)]
    pairs = [known[k : k + 2] for k in range(0, len(known), 2)]
    return [(names, _chart(t, names)) for names in pairs]


def _chart(t: Trend, names: list[str]) -> Figure:
    """Statistics over the sessions with their bands, a panel for each."""
    figure, many = panels(len(names), 1.6, rows=1)
    x = np.arange(1, len(t.visits) + 1)
    for axes, name in zip(many, names, strict=True):
        y = np.array([visit.values.get(name, np.nan) for visit in t.visits])
        axes.plot(x, y, "o-", color=MEASURED, markersize=4, linewidth=1.4, label="session")
        highest = np.nanmax(np.append(y, 0.0))
        if name in t.bands:
            limit = t.bands[name]
            axes.axhline(limit, color=INK, linewidth=1.1, linestyle=DASHED, label="limit")
            out = np.array([_out(visit, name, limit) for visit in t.visits])
            axes.plot(x[out], y[out], "o", color=TRUTH, markersize=6.5, label="alarm")
            highest = max(highest, limit)
        axes.set_ylim(
            min(0.0, float(np.nanmin(np.append(y, 0.0)))) - 0.05 * highest, 1.15 * highest
        )
        axes.set_xlim(0.5, len(x) + 0.5)
        axes.set_xticks(x, [])
        labels(axes, above=_NAMES[name])
    ticks = np.unique(np.linspace(1, len(x), min(_TICKS, len(x))).round().astype(int))
    many[-1].set_xticks(ticks, [t.visits[k - 1].name for k in ticks], rotation=20, ha="right")
    legend(figure, *many)
    return figure


def _out(visit: Visit, name: str, limit: float) -> bool:
    return visit.alarm and visit.values.get(name, -np.inf) > limit
