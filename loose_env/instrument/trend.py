"""Sessions of several months: what left the band of the first ones, and since when."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.decide import Numbers, knock_limit
from loose_env.instrument.pipeline import DiagnoseSettings, diagnose
from loose_env.instrument.result import Diagnosis
from loose_env.io import JsonFile, read_result_file
from loose_env.recording import Recording

FORMAT = "loose-trend/2"
BASELINE = 3
"""Sessions whose scatter makes the band."""
_SPREADS = 4.0
"""Standard deviations of the first sessions' scatter that the band reaches beyond their mean: with
three sessions a tenth of a per cent of a healthy arm's values lies above (Student, 2 degrees)."""
_STATISTICS = ("knocks", "top_db")


@dataclass(frozen=True, kw_only=True)
class Visit:
    """One session of a series."""

    name: str
    date: str
    values: dict[str, float]
    """Statistic -> value against the first session."""
    alarm: bool
    """True if something left its band."""
    diagnosis: Diagnosis | None
    """Against the first session; None for the first itself."""


@dataclass(frozen=True, kw_only=True)
class Trend(JsonFile):
    """The content of ``trend.json``."""

    noun = "trend"

    headline: str
    visits: tuple[Visit, ...]
    bands: dict[str, float]
    """Statistic -> upper end of its band."""
    since: str | None
    """Name of the first session of the lasting alarm; None where the last one has none."""
    format: str = FORMAT

    @property
    def last(self) -> Diagnosis:
        """Diagnosis of the last session against the first."""
        found = self.visits[-1].diagnosis
        assert found is not None
        return found


def read_trend(path: str | Path) -> Trend:
    """Read a trend, from its file or from the folder that holds it."""
    return read_result_file(path, Trend.from_json, noun="trend")


def trend(
    sessions: Sequence[Recording],
    names: Sequence[str],
    settings: DiagnoseSettings | None = None,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> Trend:
    """Compare sessions of one plan, oldest first, each with the first.

    From the second session on a change is told by the limits of a healthy reference; from the
    fourth on by the band of the first three where that is wider.

    Parameters
    ----------
    sessions : sequence of Recording
        Recordings of the same plan, oldest first.
    names : sequence of str
        What each is called.
    settings : DiagnoseSettings, optional
        As for a diagnosis.
    say : callable
        Receives what is being done, line by line.

    Raises
    ------
    InvalidSetting
        If there are fewer than two sessions.
    InvalidData
        If one has no run in the poses of the first.
    """
    if len(sessions) < 2:
        raise InvalidSetting(f"a trend needs two sessions or more, got {len(sessions)}")
    healthy = [
        replace(run, condition="healthy", name=f"{names[0]}: {run.name}")
        for run in sessions[0].runs
        if run.condition == "suspect"
    ]
    own = replace(settings or DiagnoseSettings(), reference=True)
    visits = [Visit(name=names[0], date="", values={}, alarm=False, diagnosis=None)]
    for session, name in zip(sessions[1:], names[1:], strict=True):
        say(f"comparing {name} with {names[0]}")
        now = [run for run in session.runs if run.condition == "suspect"]
        found = diagnose(replace(session, runs=(*now, *healthy)), own)
        if not found.reference:
            raise InvalidData(
                f"{name} has no {BASELINE} runs in the poses of {names[0]}: play the same plan "
                "every month"
            )
        values = {s: found.evidence[s] for s in _STATISTICS if s in found.evidence}
        visits.append(
            Visit(name=name, date=found.date, values=values, alarm=False, diagnosis=found)
        )
    bands = _bands(visits)
    judged = [_judged(visit, bands, k >= BASELINE) for k, visit in enumerate(visits)]
    since = None
    for visit in reversed(judged):
        if not visit.alarm:
            break
        since = visit.name
    last = judged[-1].diagnosis
    assert last is not None
    if since is None:
        headline = f"No change in {len(judged)} sessions."
    else:
        headline = f"Changed since {since}: {last.headline}"
    return Trend(headline=headline, visits=tuple(judged), bands=bands, since=since)


def _bands(visits: Sequence[Visit]) -> dict[str, float]:
    """Upper end of each statistic's band: a reference's limit, or the first sessions' scatter."""
    places = max(len(v.diagnosis.places) for v in visits if v.diagnosis is not None)
    found = {"knocks": knock_limit(places), "top_db": Numbers.top_db}
    first = [v.values for v in visits[1:BASELINE]]
    if len(visits) > BASELINE and len(first) >= 2:
        for name in found:
            seen = np.array([values.get(name, 0.0) for values in first])
            wide = float(seen.mean() + _SPREADS * seen.std(ddof=1))
            # A change as large as a fault's within the first months is no scatter.
            found[name] = min(max(found[name], wide), 2 * found[name])
    return found


def _judged(visit: Visit, bands: dict[str, float], banded: bool) -> Visit:
    """Visit with its alarm."""
    if visit.diagnosis is None:
        return visit
    out = any(visit.values.get(name, 0.0) > limit for name, limit in bands.items())
    return replace(visit, alarm=visit.diagnosis.verdict == "loose" and (out or not banded))
