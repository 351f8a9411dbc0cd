"""Change of an arm since earlier sessions, by control charts, and the file ``trend.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData
from loose_env.instrument.result import HEALTHY, Diagnosis, Verdict
from loose_env.instrument.settings.thresholds import LEAST_SESSIONS
from loose_env.instrument.settings.trend import TrendSettings
from loose_env.instrument.trend.cusum import Chart, control_chart, limits_for
from loose_env.instrument.trend.maintenance import Maintenance, time_of
from loose_env.instrument.trend.series import (
    Quantity,
    Series,
    joints_and_links,
    series_over,
)
from loose_env.io import json_text, restored, whole_of, write_text

FORMAT = "loose-trend/1"
"""Format of the file."""


@dataclass(frozen=True, kw_only=True)
class SessionSeen:
    """One session of a trend."""

    name: str
    """Its name: the folder or file."""
    date: str
    """Date of the measurement; "" if unknown."""
    verdict: Verdict
    """Verdict of its diagnosis."""
    faulty: float
    """Probability that the arm is faulty [1]."""


@dataclass(frozen=True, kw_only=True)
class SeriesTrend:
    """Control chart of one series over n sessions."""

    quantity: Quantity
    """Compared quantity."""
    joint: str
    """Excited joint, or joint or link of the free travel; "" for the probability."""
    channel: str
    """Sensor and axis of a transmission; else ""."""
    band_hz: tuple[float, float] | None
    """Band of a transmission [Hz]."""
    pose: Mapping[str, float]
    """Pose of a transmission [rad, m where a joint slides]; else empty."""
    values: tuple[float, ...]
    """Natural logarithm of amplitude or travel, or log odds of a fault (n,); NaN where a session
    has none."""
    change: tuple[float, ...]
    """Value less the mean of its baseline (n,); NaN where the baseline is too short."""
    scatter: tuple[float, ...]
    """Standard deviation expected of ``change`` on a healthy machine (n,)."""
    statistic: tuple[float, ...]
    """Statistic over its limit (n,); above 1 is an alarm."""
    alarm: int | None
    """Index of the session of the alarm that still stands; None where there is none."""
    alarms: tuple[int, ...]
    """Indices of all sessions in which an alarm was raised."""


@dataclass(frozen=True, kw_only=True)
class Trend:
    """The content of ``trend.json``: an arm over its sessions, the last one under test."""

    sessions: tuple[SessionSeen, ...]
    """Sessions in order of their dates, the last one under test."""
    series: tuple[SeriesTrend, ...]
    """Control charts of everything that was compared."""
    false_alarm_rate: float
    """Alarms per session that a healthy machine raises at most, all series together."""
    maintenance: tuple[Maintenance, ...] = ()
    """Maintenance records."""
    restarts: Mapping[str, tuple[int, ...]] | None = None
    """Joint or link of a maintenance record -> sessions before which the baseline starts anew."""
    warnings: tuple[str, ...] = ()
    """Warnings that limit the comparison."""
    model_hash: str = ""
    """Of the model of the last session."""
    version: str = ""
    """Version of loose-env that wrote the last session."""
    format: str = FORMAT
    """Of the file."""

    @property
    def changed(self) -> tuple[SeriesTrend, ...]:
        """Series with an alarm that still stands, the strongest in the last session first."""
        found = [each for each in self.series if each.alarm is not None]
        return tuple(sorted(found, key=lambda each: -_last(each.statistic)))

    @property
    def compared(self) -> tuple[SeriesTrend, ...]:
        """Series with a statistic in the last session."""
        return tuple(each for each in self.series if np.isfinite(each.statistic[-1]))

    def to_json(self) -> str:
        """Text of ``trend.json``; numbers that are not finite become null."""
        return json_text({"format": self.format, **asdict(self)})

    @classmethod
    def from_json(cls, text: str) -> Trend:
        """Read the text of ``trend.json``.

        Raises
        ------
        InvalidData
            If it is none of the format ``loose-trend/1``.
        """
        return restored(cls, whole_of(text, format=FORMAT, noun="trend"), "trend")

    def write(self, path: str | Path) -> Path:
        """Write ``trend.json`` beside its place and rename it."""
        return write_text(Path(path), self.to_json())


def change_since(
    new: Diagnosis,
    before: Sequence[tuple[str, Diagnosis]],
    *,
    name: str = "this session",
    maintenance: Sequence[Maintenance] = (),
    settings: TrendSettings | None = None,
) -> Trend:
    """Compare a session with earlier ones of the same arm.

    A series is one quantity over the sessions: the transmission from an excited joint to an axis
    of the tool in one of four bands, the log odds that the arm is faulty, the free travel. Each
    has a self-starting control chart whose limits share the false-alarm rate among all series.
    Work on a joint or a link restarts the baseline of every transmission that passes it (of
    joints up to it from the base), of the probability and of the free travel.

    Parameters
    ----------
    new : Diagnosis
        The session under test.
    before : sequence of (str, Diagnosis)
        Name and diagnosis of each earlier session, in any order if all have dates.
    name : str
        Name of the session under test.
    maintenance : sequence of Maintenance
        Work on the arm.
    settings : TrendSettings, optional
        False-alarm rate and sensitivity.

    Returns
    -------
    Trend

    Raises
    ------
    InvalidData
        If there is no earlier session, one is of another arm, or maintenance records are given
        and a session has no date.

    Examples
    --------
    >>> from loose_env.instrument.result import Fault
    >>> fine = Diagnosis(fault=Fault(kind="healthy"), probability=1.0, posterior={"healthy": 1.0})
    >>> found = change_since(fine, [("March", fine), ("April", fine), ("May", fine)])
    >>> len(found.sessions), found.changed
    (4, ())
    """
    chosen = TrendSettings() if settings is None else settings
    if not before:
        raise InvalidData("a trend needs one earlier session or more; give them by --before")
    warnings: list[str] = []
    named = _in_order(before, name, new, dated=bool(maintenance), warnings=warnings)
    sessions = [session for _, session in named]
    _check_arms(named)
    series = series_over(sessions)
    restarts = _restarts(sessions, maintenance)
    charted = [each for each in series if np.isfinite(each.values[:-1]).sum() >= LEAST_SESSIONS]
    rate = chosen.false_alarm_rate / max(len(charted), 1)
    found = [
        _charted(each, rate if each in charted else chosen.false_alarm_rate, new, restarts, chosen)
        for each in series
    ]
    warnings += _lacking(series, sessions)
    if len({s.model_hash for s in sessions if s.model_hash}) > 1:
        warnings.append(
            "the sessions were diagnosed with different models: a change of the probability may be "
            "the model's; diagnose the earlier recordings with the model of this session"
        )
    return Trend(
        sessions=tuple(
            SessionSeen(
                name=own,
                date=session.date,
                verdict=session.verdict,
                faulty=1 - session.posterior.get(HEALTHY, 0.0),
            )
            for own, session in named
        ),
        series=tuple(found),
        false_alarm_rate=chosen.false_alarm_rate,
        maintenance=tuple(maintenance),
        restarts=restarts,
        warnings=tuple(warnings),
        model_hash=new.model_hash,
        version=new.version,
    )


def _last(values: Sequence[float]) -> float:
    return values[-1] if values and np.isfinite(values[-1]) else 0.0


def _charted(
    series: Series,
    rate: float,
    new: Diagnosis,
    restarts: Mapping[str, tuple[int, ...]],
    settings: TrendSettings,
) -> SeriesTrend:
    two_sided = series.quantity == "transmission"
    limits = limits_for(rate, allowance=settings.shift / 2, two_sided=two_sided)
    chart: Chart = control_chart(
        series.values,
        limits,
        least_scatter=series.least_scatter,
        least_baseline=LEAST_SESSIONS,
        restarts=_passing(series, new, restarts),
    )
    return SeriesTrend(
        quantity=series.quantity,
        joint=series.joint,
        channel=series.channel,
        band_hz=series.band_hz,
        pose=series.pose,
        values=tuple(series.values.tolist()),
        change=tuple(chart.change.tolist()),
        scatter=tuple(chart.scatter.tolist()),
        statistic=tuple(chart.statistic.tolist()),
        alarm=chart.alarm,
        alarms=chart.alarms,
    )


def _in_order(
    before: Sequence[tuple[str, Diagnosis]],
    name: str,
    new: Diagnosis,
    *,
    dated: bool,
    warnings: list[str],
) -> list[tuple[str, Diagnosis]]:
    """All sessions by date, the one under test last; as given where dates are missing."""
    missing = [own for own, session in [*before, (name, new)] if not session.date]
    if missing and dated:
        raise InvalidData(
            f"maintenance records need the date of every session; {missing[0]} has none: "
            "diagnose it again, with --date where its files have lost theirs"
        )
    if missing:
        if len(missing) <= len(before):
            warnings.append(
                f"{missing[0]} has no date: the sessions are taken in the order in which they were "
                "given"
            )
        return [*before, (name, new)]
    ordered = sorted(before, key=lambda pair: time_of(pair[1].date))
    later = [own for own, session in ordered if time_of(session.date) > time_of(new.date)]
    if later:
        warnings.append(
            f"{', '.join(later)} is dated after {name} ({new.date}); it is compared as an earlier "
            "session all the same"
        )
    return [*ordered, (name, new)]


def _check_arms(named: Sequence[tuple[str, Diagnosis]]) -> None:
    own = joints_and_links(named[-1][1])
    for name, session in named[:-1]:
        if joints_and_links(session) != own:
            other = ", ".join(joints_and_links(session)[0])
            raise InvalidData(
                f"{name} is of another arm: its joints are {other}; those of this session are "
                f"{', '.join(own[0])}"
            )


def _restarts(
    sessions: Sequence[Diagnosis], maintenance: Sequence[Maintenance]
) -> dict[str, tuple[int, ...]]:
    """Joint or link -> sessions that are the first after work on it."""
    found: dict[str, tuple[int, ...]] = {}
    for record in maintenance:
        done = time_of(record.date)
        after = [k for k, s in enumerate(sessions) if time_of(s.date) >= done]
        if after:
            found[record.where] = tuple(sorted({*found.get(record.where, ()), after[0]}))
    return found


def _passing(
    series: Series, new: Diagnosis, restarts: Mapping[str, tuple[int, ...]]
) -> tuple[int, ...]:
    """Restarts of a series: all, but for work nearer the base than the excited joint."""
    joints, links = joints_and_links(new)
    kept: set[int] = set()
    for where, at in restarts.items():
        order = joints if where in joints else links
        known = where in order and series.joint in joints
        passes = not known or order.index(where) >= joints.index(series.joint)
        if passes or series.quantity != "transmission":
            kept.update(at)
    return tuple(sorted(kept))


def _lacking(series: Sequence[Series], sessions: Sequence[Diagnosis]) -> list[str]:
    """Warnings about what has no earlier sessions to be compared with."""
    said = []
    if not sessions[-1].spectra:
        said.append("this session has no transmission spectra: diagnose its recording again")
    without = sum(not session.spectra for session in sessions[:-1])
    if without:
        said.append(
            f"{without} of {len(sessions) - 1} earlier sessions have no transmission spectra, as "
            "those of earlier versions: diagnose their recordings again, or give the recordings "
            "themselves by --before"
        )
    short: dict[str, int] = {}
    for each in series:
        if each.quantity == "transmission":
            there = int(np.isfinite(each.values[:-1]).sum())
            short[each.joint] = max(short.get(each.joint, 0), there)
    few = [joint for joint, there in short.items() if there < LEAST_SESSIONS]
    if few:
        said.append(
            f"the transmission of {', '.join(few)} is not compared: {LEAST_SESSIONS} earlier "
            "sessions in the same pose and with the same signal are needed. Take the poses and "
            "signals of an earlier plan again"
        )
    return said
