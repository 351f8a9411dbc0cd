"""Page of a trend: change of an arm's transmission and free travel over its sessions."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.instrument import SeriesTrend, Trend
from loose_env.io import write_text
from loose_env.report.figures import DASHED, labels, legend, panels
from loose_env.report.page import (
    FigureCard,
    Section,
    Table,
    render_page,
    typographic,
    warnings_section,
)
from loose_env.report.words import percent
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROWS, _TICKS = 12, 6  # rows of the table of changes, and dates on an axis
_HIGHEST = 3.0  # largest statistic over its limit that is drawn
_ARM = "arm"  # location of the probability, which is of the whole arm


def write_trend_page(path: str | os.PathLike[str], trend: Trend, *, recording: str = "") -> Path:
    """Write the page of a trend.

    Parameters
    ----------
    path : path-like
        Path of the page; its folder is made if missing.
    trend : Trend
        The trend.
    recording : str
        Name of the recording, for the head of the page.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    by = " ".join(filter(None, ["loose-env", trend.version]))
    hashed = f" Model: SHA-256 {trend.model_hash}." if trend.model_hash else ""
    summary = []
    if trend.changed:
        summary.append(f"Strongest: {_series_words(trend.changed[0])}.")
    summary.append(
        f"A healthy machine raises an alarm in at most {100 * trend.false_alarm_rate:.2g} % of its "
        f"sessions: {len(trend.compared)} series share that rate."
    )
    page = render_page(
        trend_headline(trend),
        [
            Section(heading="What to do next", points=_steps(trend)),
            _changes_section(trend),
            _charts_section(trend),
            warnings_section(("warning", words) for words in trend.warnings),
            _sessions_section(trend),
            _maintenance_section(trend),
        ],
        kicker=[recording, "change since earlier sessions", trend.sessions[-1].date[:10]],
        text=summary,
        notes=f"Compared by {by}.{hashed} All numbers stand in trend.json.",
    )
    return write_text(Path(path), page)


def trend_headline(trend: Trend) -> str:
    """Outcome of a trend in one line."""
    count = len(trend.sessions) - 1
    if trend.changed:
        first = min(each.alarm for each in trend.changed if each.alarm is not None)
        return f"The arm has changed: alarm since {_day(trend, first)}."
    if not trend.compared:
        return "Not compared: too few earlier sessions are like this one."
    return (
        f"No change since {'one earlier session' if count == 1 else f'{count} earlier sessions'}."
    )


def _day(trend: Trend, session: int) -> str:
    return trend.sessions[session].date[:10] or trend.sessions[session].name


def percent_change(series: SeriesTrend) -> Array:
    """Change of a transmission or a free travel from its baseline (n,) [%]; of odds, their log."""
    change = np.array(series.change)
    return change if series.quantity == "probability" else 100 * np.expm1(change)


def _series_words(series: SeriesTrend) -> str:
    change = percent_change(series)
    known = change[np.isfinite(change)]
    if series.quantity == "probability":
        return "the probability that the arm is faulty has risen"
    value = typographic(f"{known[-1]:+.1f} %") if len(known) else "unknown"
    if series.quantity == "free_travel":
        return f"free travel of {series.joint} {value}"
    return (
        f"transmission from {series.joint} to {series.channel}, {_band(series)}: {value} from the "
        "baseline"
    )


def _band(series: SeriesTrend) -> str:
    if series.band_hz is None:
        return "–"
    return f"{series.band_hz[0]:.0f} to {series.band_hz[1]:.0f} Hz"


def _steps(trend: Trend) -> list[str]:
    if not trend.compared:
        return [
            "Repeat a session: take the poses, joints and signals of an earlier one. Two earlier "
            "sessions are needed, five or more give a sharp comparison."
        ]
    if not trend.changed:
        return [
            "Nothing needs to be done. Keep this session: it sharpens the next comparison.",
            "Play the same poses and signals next time.",
        ]
    steps = ["Read the diagnosis of this session (report.html): it names the location, if any."]
    joints = dict.fromkeys(s.joint for s in trend.changed if s.quantity == "transmission")
    if joints:
        steps.append(
            f"Repeat the runs that excite {', '.join(joints)} in the same poses: a change of the "
            "machine stays, a wrong mounting of the accelerometer does not."
        )
    return [
        *steps,
        "After work on the arm, or an inspection that found nothing, add a maintenance record: the "
        "baseline starts anew.",
    ]


def _by_place(trend: Trend) -> dict[str, list[SeriesTrend]]:
    """Location -> its series with a chart, in the order of the trend."""
    found: dict[str, list[SeriesTrend]] = {}
    for each in trend.series:
        if np.isfinite(each.statistic).any():
            found.setdefault(_place(each), []).append(each)
    return found


def _place(series: SeriesTrend) -> str:
    if series.quantity == "probability":
        return _ARM
    return series.joint if series.quantity == "transmission" else f"travel of {series.joint}"


def _strength(series: SeriesTrend) -> float:
    """Statistic of the last session that has one; standing alarms come before all others."""
    known = [value for value in series.statistic if np.isfinite(value)]
    return (known[-1] if known else 0.0) + (1e3 if series.alarm is not None else 0.0)


def _charts_section(trend: Trend) -> Section:
    places = _by_place(trend)
    titles = {p: p if p.startswith("travel of ") else f"{p} excited" for p in places}
    titles |= {_ARM: "probability that the arm is faulty"} if _ARM in places else {}
    strongest = {p: max(many, key=_strength) for p, many in places.items() if p != _ARM}
    named = {
        p: f"{titles[p]}: {s.channel}, {_band(s)}" if s.quantity == "transmission" else titles[p]
        for p, s in strongest.items()
    }
    charts = (
        "Control charts",
        _chart_figure(trend, places, titles) if places else None,
        "For each excited joint the highest statistic of its axes and bands: cumulative sum or "
        "single score, whichever is closer to its limit. Above is an alarm; it stands until a "
        "maintenance record. Vertical lines: maintenance.",
    )
    levels = (
        "Strongest changes",
        _level_figure(trend, strongest, named) if strongest else None,
        "The axis and band that changed most, over the mean of the sessions before it since the "
        "last maintenance.",
    )
    cards = [
        FigureCard(title=title, image=image, caption=caption)
        for title, image, caption in (charts, levels)
        if image is not None
    ]
    return Section(heading="Over the sessions", cards=cards)


def _changes_section(trend: Trend) -> Section:
    """The one table: what changed most, by location."""
    chosen = [max(many, key=_strength) for many in _by_place(trend).values()]
    chosen += [each for each in trend.changed if each not in chosen]
    chosen = sorted(chosen, key=_strength, reverse=True)[:_ROWS]
    more = len(trend.compared) - len(chosen)
    note = (
        "Change: this session over the mean of its baseline. Scatter: standard deviation that a "
        "healthy machine shows. Statistic: over its limit; above 1 is an alarm."
    )
    if more > 0:
        note += f" {more} further series are within their limits or belong to the same alarms."
    table = Table(rows=[_change_row(trend, each) for each in chosen], note=note)
    return Section(heading="Changes", tables=[table])


def _change_row(trend: Trend, series: SeriesTrend) -> dict[str, str]:
    change, scatter = percent_change(series)[-1], 100 * series.scatter[-1]
    if series.quantity == "probability":
        change = scatter = np.nan
    what = {
        "probability": f"Arm is faulty: {percent(trend.sessions[-1].faulty)}",
        "free_travel": f"Free travel of {series.joint}",
        "transmission": f"{series.joint} to {series.channel}",
    }[series.quantity]
    numbers = {"Change": (change, "+.1f", " %"), "Scatter": (scatter, ".1f", " %")}
    numbers["Statistic"] = (series.statistic[-1], ".2f", "")
    return {
        "Series": what,
        "Band": _band(series),
        **{k: f"{v:{form}}{u}" if np.isfinite(v) else "–" for k, (v, form, u) in numbers.items()},
        "Alarm since": "no" if series.alarm is None else _day(trend, series.alarm),
    }


def _sessions_section(trend: Trend) -> Section:
    rows = [
        {
            "Session": session.name,
            "Date": session.date[:10] or "unknown",
            "Verdict": session.verdict.replace("_", " "),
            "P(faulty)": percent(session.faulty),
            "Alarms raised": ", ".join(sorted({_place(s) for s in trend.series if k in s.alarms}))
            or "none",
        }
        for k, session in enumerate(trend.sessions)
    ]
    return Section(heading="Sessions", tables=[Table(rows=rows)])


def _maintenance_section(trend: Trend) -> Section:
    rows = [
        {
            "Joint or link": record.where,
            "Date": record.date[:10],
            "Work": record.work,
            "Note": record.note or "–",
        }
        for record in trend.maintenance
    ]
    note = (
        "Each starts the baseline anew: of every transmission that passes the joint or link, of "
        "the probability and of the free travel."
    )
    return Section(heading="Maintenance", tables=[Table(rows=rows, note=note)])


def _chart_figure(
    trend: Trend, by_place: Mapping[str, Sequence[SeriesTrend]], titles: Mapping[str, str]
) -> Figure:
    """Statistic over its limit by session, a panel for each location: the highest of its series."""
    figure, many = panels(len(by_place), 1.25, rows=2)
    for axes, (place, series) in zip(many, by_place.items(), strict=True):
        rows = np.array([each.statistic for each in series], dtype=float)
        highest = np.where(np.isfinite(rows), rows, -np.inf).max(axis=0)
        shown = np.where(np.isfinite(highest), np.minimum(highest, _HIGHEST), np.nan)
        axes.axhline(1.0, color=INK, linewidth=1.1, linestyle=DASHED, label="limit")
        _course(axes, trend, place, shown, series, "statistic over its limit")
        axes.set_ylim(-0.08, max(1.35, 1.08 * float(np.nanmax(np.append(shown, 1.0)))))
        labels(axes, above=titles[place])
    _dates(many, trend)
    legend(figure, *many)
    return figure


def _level_figure(
    trend: Trend, strongest: Mapping[str, SeriesTrend], titles: Mapping[str, str]
) -> Figure:
    """Change from the baseline by session, a panel for each location: its strongest series."""
    figure, many = panels(len(strongest), 1.25, rows=2)
    x = np.arange(1, len(trend.sessions) + 1)
    for axes, (place, one) in zip(many, strongest.items(), strict=True):
        change, expected = percent_change(one), 200 * np.array(one.scatter)
        axes.fill_between(
            x, -expected, expected, where=np.isfinite(change).tolist(), color=FAINT, alpha=0.45,
            linewidth=0, label="±2 standard deviations of a healthy arm",
        )  # fmt: skip
        _course(axes, trend, place, change, [one], "change from the baseline [%]")
        axes.margins(y=0.15)
        labels(axes, above=titles[place])
    _dates(many, trend)
    legend(figure, *many)
    return figure


def _dates(many: Sequence[Axes], trend: Trend) -> None:
    """Mark the sessions by their dates, below the last panel."""
    count = len(trend.sessions)
    ticks = np.unique(np.linspace(1, count, min(_TICKS, count)).round().astype(int))
    for axes in many:
        axes.set_xlim(0.5, count + 0.5)
        axes.set_xticks(ticks, [])
    dates = [trend.sessions[k - 1].date[:10] or str(k) for k in ticks]
    many[-1].set_xticks(ticks, dates, rotation=20, ha="right")


def _course(
    axes: Axes, trend: Trend, place: str, values: Array, many: Sequence[SeriesTrend], label: str
) -> None:
    """Draw values by session (n,), alarms of their series, and maintenance.

    Maintenance stands before the first session after it; that of the location itself is darker.
    """
    x = np.arange(1, len(values) + 1)
    standing = np.zeros(len(x), dtype=bool)
    for each in many:
        standing[list(each.alarms)] = True
        standing[len(x) if each.alarm is None else each.alarm :] = True
    alarmed = standing & np.isfinite(values)
    axes.plot(x, values, "o-", color=MEASURED, markersize=4, linewidth=1.4, zorder=3, label=label)
    axes.plot(
        x[alarmed], values[alarmed], "o", color=TRUTH, markersize=6.5, zorder=4, label="alarm"
    )
    for where, sessions in (trend.restarts or {}).items():
        colour, width = (INK, 1.6) if where == place else (MUTED, 0.9)
        for session in sessions:
            axes.axvline(session + 0.5, color=colour, linewidth=width, label="maintenance")
