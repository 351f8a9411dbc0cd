"""Page of a trend: change of an arm over its sessions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.instrument import SeriesTrend, Trend
from loose_env.io import begun, sentence
from loose_env.report.diagnosis.text import percent
from loose_env.report.diagnosis.trend_figure import chart_figure, level_figure, percent_change
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.sections import graded, group
from loose_env.report.pages.template import template, write_whole

__all__ = ["trend_headline", "trend_page", "write_trend_page"]

_ROWS = 12
"""Rows of the table of changes."""
_ARM = "arm"
"""Place of the probability, which is of the whole arm."""


def write_trend_page(path: str | os.PathLike[str], trend: Trend, *, recording: str = "") -> Path:
    """Write the page of a trend, beside its final name first.

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
    return write_whole(path, trend_page(trend, recording=recording))


def trend_page(trend: Trend, *, recording: str = "") -> str:
    """Return the page that `write_trend_page` writes."""
    date = trend.sessions[-1].date[:10]
    first = [
        group("What to do next", "", points=_steps(trend)),
        _changes_group(trend),
        _charts_group(trend),
    ]
    by = " ".join(filter(None, ["loose-env", trend.version]))
    hashed = f" Model: SHA-256 {trend.model_hash}." if trend.model_hash else ""
    page: str = template("loose_env.report/diagnosis_page.html").render(
        title=trend_headline(trend),
        kicker=" · ".join(filter(None, [recording, "change since earlier sessions", date])),
        summary=_summary(trend),
        questions=[],
        first=[each for each in first if each],
        warnings=graded([("warning", begun(sentence(w))) for w in trend.warnings]),
        groups=[each for each in (_sessions_group(trend), _maintenance_group(trend)) if each],
        notes=[f"Compared by {by}.{hashed} All numbers stand in trend.json."],
    )
    return page


def trend_headline(trend: Trend) -> str:
    """Outcome of a trend in one line."""
    count = len(trend.sessions) - 1
    since = "one earlier session" if count == 1 else f"{count} earlier sessions"
    changed = trend.changed
    if changed:
        first = min(each.alarm for each in changed if each.alarm is not None)
        session = trend.sessions[first]
        when = session.date[:10] or session.name
        return f"The arm has changed: alarm since {when}."
    if not trend.compared:
        return "Not compared: too few earlier sessions are like this one."
    return f"No change since {since}."


def _summary(trend: Trend) -> list[str]:
    found = []
    if trend.changed:
        found.append(f"Strongest: {_series_words(trend.changed[0])}.")
    rate = 100 * trend.false_alarm_rate
    found.append(
        f"A healthy machine raises an alarm in at most {rate:.2g} % of its sessions: "
        f"{len(trend.compared)} series share that rate."
    )
    return found


def _series_words(series: SeriesTrend) -> str:
    change = percent_change(series)
    known = change[np.isfinite(change)]
    if series.quantity == "probability":
        return "the probability that the arm is faulty has risen"
    value = f"{known[-1]:+.1f} %".replace("-", "−") if len(known) else "unknown"
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
    joints = list(
        dict.fromkeys(each.joint for each in trend.changed if each.quantity == "transmission")
    )
    steps = ["Read the diagnosis of this session (report.html): it names the location, if any."]
    if joints:
        steps.append(
            f"Repeat the runs that excite {', '.join(joints)} in the same poses: a change of the "
            "machine stays, a wrong mounting of the accelerometer does not."
        )
    steps.append(
        "After work on the arm, or an inspection that found nothing, add a maintenance record: "
        "the baseline starts anew."
    )
    return steps


def _places(trend: Trend) -> dict[str, list[SeriesTrend]]:
    """Place -> its series with a chart, in the order of the trend."""
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
    """Statistic of the last session that has one, after those with a standing alarm."""
    known = [value for value in series.statistic if np.isfinite(value)]
    return (known[-1] if known else 0.0) + (1e3 if series.alarm is not None else 0.0)


def _charts_group(trend: Trend) -> dict[str, Any]:
    places = _places(trend)
    if not places:
        return {}
    titles = {
        place: "probability that the arm is faulty"
        if place == _ARM
        else place
        if place.startswith("travel of ")
        else f"{place} excited"
        for place in places
    }
    strongest = {place: max(many, key=_strength) for place, many in places.items() if place != _ARM}
    named = {
        place: titles[place]
        if one.quantity != "transmission"
        else f"{titles[place]}: {one.channel}, {_band(one)}"
        for place, one in strongest.items()
    }
    cards = [
        FigureCard(
            title="Control charts",
            image=chart_figure(trend, places, titles),
            caption="For each excited joint the highest statistic of its axes and bands: "
            "cumulative sum or single score, whichever is closer to its limit. Above is an alarm; "
            "it stands until a maintenance record. Vertical lines: maintenance.",
        )
    ]
    if strongest:
        cards.append(
            FigureCard(
                title="Strongest changes",
                image=level_figure(trend, strongest, named),
                caption="The axis and band that changed most, over the mean of the sessions before "
                "it since the last maintenance.",
            )
        )
    return group("Over the sessions", "", cards=cards)


def _changes_group(trend: Trend) -> dict[str, Any]:
    """The one table: what changed most, by place."""
    places = _places(trend)
    chosen = [max(many, key=_strength) for many in places.values()]
    chosen += [each for each in trend.changed if each not in chosen]
    chosen = sorted(chosen, key=_strength, reverse=True)[:_ROWS]
    rows = [_change_row(trend, each) for each in chosen]
    more = len(trend.compared) - len(rows)
    note = (
        "Change: this session over the mean of its baseline. Scatter: standard deviation that a "
        "healthy machine shows. Statistic: over its limit; above 1 is an alarm."
    )
    if more > 0:
        note += f" {more} further series are within their limits or belong to the same alarms."
    return group("Changes", "", tables=[{"rows": rows, "note": note}] if rows else [])


def _change_row(trend: Trend, series: SeriesTrend) -> dict[str, str]:
    change, scatter = percent_change(series)[-1], series.scatter[-1]
    statistic = series.statistic[-1]
    odds = series.quantity == "probability"
    faulty = percent(trend.sessions[-1].faulty)
    alarm = "no"
    if series.alarm is not None:
        session = trend.sessions[series.alarm]
        alarm = session.date[:10] or session.name
    what = {
        "probability": f"Arm is faulty: {faulty}",
        "free_travel": f"Free travel of {series.joint}",
        "transmission": f"{series.joint} to {series.channel}",
    }[series.quantity]
    return {
        "Series": what,
        "Band": _band(series),
        "Change": "–" if odds or not np.isfinite(change) else _signed(change),
        "Scatter": "–" if odds or not np.isfinite(scatter) else f"{100 * scatter:.1f} %",
        "Statistic": "–" if not np.isfinite(statistic) else f"{statistic:.2f}",
        "Alarm since": alarm,
    }


def _signed(value: float) -> str:
    return f"{value:+.1f} %".replace("-", "−")


def _sessions_group(trend: Trend) -> dict[str, Any]:
    rows = []
    for k, session in enumerate(trend.sessions):
        raised = sorted({_place(each) for each in trend.series if k in each.alarms})
        rows.append(
            {
                "Session": session.name,
                "Date": session.date[:10] or "unknown",
                "Verdict": session.verdict.replace("_", " "),
                "P(faulty)": percent(session.faulty),
                "Alarms raised": ", ".join(raised) or "none",
            }
        )
    return group("Sessions", "", tables=[{"rows": rows, "note": ""}])


def _maintenance_group(trend: Trend) -> dict[str, Any]:
    rows: Sequence[dict[str, str]] = [
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
    return group("Maintenance", "", tables=[{"rows": rows, "note": note}] if rows else [])
