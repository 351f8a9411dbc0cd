"""Figures of a trend: control charts and levels over the sessions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.instrument import SeriesTrend, Trend
from loose_env.report.pages.figures import WIDTH, new_figure, quiet_axes
from loose_env.report.pages.legend import draw_legend, legend_height, shortened
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["chart_figure", "level_figure", "percent_change"]

_PANEL, _TITLE, _BELOW = 0.95, 0.32, 0.62
"""Height of a panel, of its title and of the axis below the last [inch]."""
_LEFT = 0.55 / WIDTH
_TICKS = 6
"""Dates on the axis, at most."""
_HIGHEST = 3.0
"""Largest statistic over its limit that is drawn."""


def percent_change(series: SeriesTrend) -> Array:
    """Change of a transmission or a free travel from its baseline (n,) [%]; of odds, their log.

    Examples
    --------
    >>> import numpy as np
    >>> one = SeriesTrend(
    ...     quantity="transmission",
    ...     joint="elbow",
    ...     channel="tool.x",
    ...     band_hz=(5.0, 30.0),
    ...     pose={},
    ...     values=(0.0, np.log(1.1)),
    ...     change=(0.0, np.log(1.1)),
    ...     scatter=(0.01, 0.01),
    ...     statistic=(0.0, 2.0),
    ...     alarm=1,
    ...     alarms=(1,),
    ... )
    >>> percent_change(one).round(3).tolist()
    [0.0, 10.0]
    """
    change = np.array(series.change)
    return change if series.quantity == "probability" else 100 * np.expm1(change)


def chart_figure(
    trend: Trend, by_place: Mapping[str, Sequence[SeriesTrend]], titles: Mapping[str, str]
) -> Figure:
    """Statistic over its limit by session, a panel for each place: the highest of its series.

    Parameters
    ----------
    trend : Trend
        The sessions.
    by_place : mapping
        Place -> its series.
    titles : mapping
        Place -> title of its panel.
    """
    entries = [
        ("●", MEASURED, "statistic over its limit"),
        ("- -", INK, "limit"),
        ("●", TRUTH, "alarm"),
        *([("|", MUTED, "maintenance")] if trend.maintenance else []),
    ]
    figure, panels = _panels(trend, list(by_place), titles, entries)
    x = np.arange(1, len(trend.sessions) + 1)
    for axes, (place, many) in zip(panels, by_place.items(), strict=True):
        rows = np.array([each.statistic for each in many], dtype=float)
        known = np.isfinite(rows).any(axis=0)
        highest = np.full(len(x), np.nan)
        highest[known] = np.nanmax(rows[:, known], axis=0)
        shown = np.minimum(highest, _HIGHEST)
        axes.axhline(1.0, color=INK, linewidth=1.1, linestyle=(0, (4, 2)), zorder=2)
        _course(axes, trend, place, shown, many)
        axes.set_ylim(-0.08, max(1.35, 1.08 * float(np.nanmax(np.append(shown, 1.0)))))
    return figure


def level_figure(
    trend: Trend, strongest: Mapping[str, SeriesTrend], titles: Mapping[str, str]
) -> Figure:
    """Change from the baseline by session, a panel for each place: its strongest series.

    Parameters
    ----------
    trend : Trend
        The sessions.
    strongest : mapping
        Place -> one of its series.
    titles : mapping
        Place -> title of its panel.
    """
    entries = [
        ("●", MEASURED, "change from the baseline [%]"),
        ("■", FAINT, "±2 standard deviations of a healthy arm"),
        ("●", TRUTH, "alarm"),
    ]
    figure, panels = _panels(trend, list(strongest), titles, entries)
    x = np.arange(1, len(trend.sessions) + 1)
    for axes, (place, one) in zip(panels, strongest.items(), strict=True):
        change = percent_change(one)
        expected = 200 * np.array(one.scatter)
        axes.fill_between(
            x, -expected, expected, where=np.isfinite(change), color=FAINT, alpha=0.45,
            linewidth=0, zorder=1,
        )  # fmt: skip
        _course(axes, trend, place, change, [one])
        axes.margins(y=0.15)
    return figure


def _panels(
    trend: Trend,
    places: Sequence[str],
    titles: Mapping[str, str],
    entries: Sequence[tuple[str, str, str]],
) -> tuple[Figure, list[Axes]]:
    """Figure with a panel for each place, one axis of sessions below."""
    above = legend_height(entries)
    height = above + len(places) * (_PANEL + _TITLE) + _BELOW
    figure = new_figure(height)
    draw_legend(figure, entries, height)
    found = []
    count = len(trend.sessions)
    ticks = np.unique(np.linspace(1, count, min(_TICKS, count)).round().astype(int))
    labels = [trend.sessions[k - 1].date[:10] or str(k) for k in ticks]
    for k, place in enumerate(places):
        bottom = height - above - (k + 1) * (_PANEL + _TITLE)
        axes = figure.add_axes((_LEFT, bottom / height, 0.97 - _LEFT, _PANEL / height))
        quiet_axes(axes, grid="y")
        axes.set_xlim(0.5, count + 0.5)
        axes.set_xticks(ticks, labels if k + 1 == len(places) else [""] * len(ticks))
        figure.text(
            _LEFT, (bottom + _PANEL + 0.06) / height, shortened(titles[place], 58), color=INK,
            fontsize=9, ha="left", va="bottom", parse_math=False,
        )  # fmt: skip
        found.append(axes)
    for label in found[-1].get_xticklabels():
        label.set(rotation=20, ha="right")
    return figure, found


def _course(
    axes: Axes, trend: Trend, place: str, values: Array, many: Sequence[SeriesTrend]
) -> None:
    """Draw values by session (n,), alarms of their series, and maintenance.

    Maintenance stands before the first session after it; that of the place itself is darker.
    """
    x = np.arange(1, len(values) + 1)
    axes.plot(x, values, "o-", color=MEASURED, markersize=4, linewidth=1.4, zorder=3)
    alarmed = _standing(many, len(x)) & np.isfinite(values)
    axes.plot(x[alarmed], values[alarmed], "o", color=TRUTH, markersize=6.5, zorder=4)
    for where, sessions in (trend.restarts or {}).items():
        for session in sessions:
            axes.axvline(
                session + 0.5, color=INK if where == place else MUTED,
                linewidth=1.6 if where == place else 0.9, zorder=1.5,
            )  # fmt: skip


def _standing(many: Sequence[SeriesTrend], count: int) -> Array:
    """True for sessions in which an alarm of one of the series was raised, or still stands (n,)."""
    found = np.zeros(count, dtype=bool)
    for each in many:
        for first in each.alarms:
            found[first] = True
        if each.alarm is not None:
            found[each.alarm :] = True
    return found
