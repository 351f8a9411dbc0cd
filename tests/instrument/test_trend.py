"""Sessions of several months are compared: a change is told and stays, a healthy arm stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument import Trend, read_trend, trend
from loose_env.recording import Recording
from tests.instrument.conftest import Play
from tests.instrument.machine import Truth

MONTHS = ["April", "May", "June", "July", "August"]


@pytest.fixture(scope="module")
def months(play: Play) -> list[Recording]:
    """A seat works loose from the fourth month on."""
    gaps = (0.0, 0.0, 0.0, 1e-4, 3e-4)
    truths = [
        Truth(seat="fore" if gap else "", direction=(0.6, 0, 0.8), clearance=gap, mode_hz=40)
        for gap in gaps
    ]
    return [play(truth, seed=k) for k, truth in enumerate(truths)]


@pytest.fixture(scope="module")
def found(months: list[Recording]) -> Trend:
    return trend(months, MONTHS)


def test_a_fault_that_grows_alarms_and_stays(found: Trend) -> None:
    assert [visit.alarm for visit in found.visits] == [False, False, False, True, True]
    assert found.since == "July" and found.headline.startswith("Changed since July: ")
    assert found.last.places[0].name == "structural_looseness@fore"
    tops = [visit.values["top_db"] for visit in found.visits[1:]]
    assert max(tops[:2]) < 1 and min(tops[2:]) > 10


def test_healthy_months_raise_nothing(found: Trend, months: list[Recording]) -> None:
    same = trend(months[:2], MONTHS[:2])
    assert same.since is None and same.headline == "No change in 2 sessions."
    # A session counts alike, whatever comes after it.
    assert same.visits[1].values == found.visits[1].values and not same.visits[1].alarm


def test_a_trend_is_read_back(found: Trend, tmp_path: Path) -> None:
    read = read_trend(found.write(tmp_path / "trend.json"))
    assert read.to_json() == found.to_json() and read.since == found.since
    assert set(found.bands) == {"knocks", "top_db"}
    assert all(np.isfinite(limit) for limit in found.bands.values())


def test_sessions_that_do_not_compare_are_refused(months: list[Recording]) -> None:
    with pytest.raises(InvalidSetting, match="two sessions or more, got 1"):
        trend(months[:1], MONTHS[:1])
    short = replace(months[1], runs=months[1].runs[:2])
    with pytest.raises(InvalidData, match="May has no 3 runs in the poses of April"):
        trend([months[0], short], MONTHS[:2])
