"""Change since earlier sessions: what is compared, and what it is not mistaken for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument import Maintenance, Trend, TrendSettings, change_since
from tests.instrument.trend.sessions_of_an_arm import named, session


def test_an_arm_that_stays_as_it_is_has_not_changed() -> None:
    found = change_since(session(8), named(8))
    assert len(found.sessions) == 9 and not found.changed
    assert len(found.compared) == 3 * 3 * 4 + 1  # joints, axes, bands; and the probability
    assert not found.warnings


def test_healthy_arms_alarm_at_most_at_the_stated_rate_all_series_together() -> None:
    settings = TrendSettings(false_alarm_rate=0.1)
    alarmed = tested = 0
    for arm in range(40):
        many = [(str(k), session(1000 * arm + k, dated=False)) for k in range(14)]
        found = change_since(many[-1][1], many[:-1], settings=settings)
        alarmed += len({k for series in found.series for k in series.alarms})
        tested += len(many) - 2
    assert alarmed / tested < 0.1 + 2 * math.sqrt(0.1 / tested)


def test_a_changed_transmission_is_named_by_joint_and_band() -> None:
    found = change_since(session(12, factor={"elbow": 1.25}), named(12))
    assert {each.joint for each in found.changed} == {"elbow"}
    first = found.changed[0]
    assert first.alarm == 12 and first.band_hz is not None and first.band_hz[0] > 50
    assert np.exp(first.change[-1]) == pytest.approx(1.25, rel=0.05)


def test_slow_wear_is_found_though_no_step_stands_out() -> None:
    before = named(10)
    before += [(f"worn {k}", session(10 + k, factor={"shoulder": 1 + 0.012 * k})) for k in range(8)]
    found = change_since(session(18, factor={"shoulder": 1.1}), before)
    assert {each.joint for each in found.changed} == {"shoulder"}
    assert found.changed[0].alarm is not None and found.changed[0].alarm > 10


def test_sessions_are_taken_by_date_not_as_they_are_given() -> None:
    new = session(12, factor={"elbow": 1.25})
    found = change_since(new, named(12)[::-1])
    assert found.to_json() == change_since(new, named(12)).to_json()
    dates = [each.date for each in found.sessions]
    assert dates == sorted(dates)


def test_other_poses_and_levels_are_not_compared() -> None:
    elsewhere = change_since(session(6, pose=0.5), named(6))
    assert all(each.quantity == "probability" for each in elsewhere.compared)
    assert any("same pose" in words for words in elsewhere.warnings)
    louder = session(6)
    louder = replace(
        louder, spectra=tuple(replace(s, drive_rms=2 * s.drive_rms) for s in louder.spectra)
    )
    assert all(each.quantity == "probability" for each in change_since(louder, named(6)).compared)


def test_free_travel_that_grows_and_a_probability_that_rises_are_changes() -> None:
    before = [(str(k), session(k, gap_m=1e-3 * (1 + 0.02 * (k % 3)))) for k in range(6)]
    found = change_since(session(6, gap_m=5e-3), before)
    assert [each.quantity for each in found.changed] == ["free_travel"]
    faulty = change_since(session(30, faulty=0.999), named(30))
    assert "probability" in {each.quantity for each in faulty.changed}


def test_maintenance_starts_the_baseline_anew_for_what_passes_the_joint() -> None:
    factor = {"base": 1.3, "shoulder": 1.3, "elbow": 1.3}
    before = named(8) + [(f"later {k}", session(8 + k, factor=factor)) for k in range(4)]
    new = session(12, factor=factor)
    work = [Maintenance(date="2025-01-09", joint="shoulder", work="gear replaced")]
    found = change_since(new, before, maintenance=work)
    assert found.restarts == {"shoulder": (8,)}
    assert {each.joint for each in found.changed} == {"elbow"}  # outside the work
    whole = [Maintenance(date="2025-01-09", link="forearm", work="bolts tightened")]
    assert not change_since(new, before, maintenance=whole).changed


def test_maintenance_needs_dates_and_other_arms_are_refused() -> None:
    work = [Maintenance(date="2025-01-05", joint="elbow", work="oil")]
    undated = [("old", session(1, dated=False))]
    with pytest.raises(InvalidData, match=r"old has none.*--date"):
        change_since(session(9), undated, maintenance=work)
    other = replace(session(2), posterior={"healthy": 0.5, "backlash@wrist": 0.5})
    with pytest.raises(InvalidData, match=r"old is of another arm.*wrist.*base"):
        change_since(session(9), [("old", other)])
    with pytest.raises(InvalidData, match="--before"):
        change_since(session(9), [])
    with pytest.raises(InvalidSetting, match="shift is"):
        TrendSettings(shift=9.0)


def test_what_earlier_versions_did_not_measure_is_said() -> None:
    old = [(str(k), replace(session(k), spectra=())) for k in range(3)]
    found = change_since(session(5), old)
    assert any("3 of 3 earlier sessions have no transmission" in w for w in found.warnings)
    undated = change_since(session(5), [("old", session(1, dated=False))])
    assert any("old has no date" in words for words in undated.warnings)


def test_a_trend_reads_back_as_it_was() -> None:
    work = [Maintenance(date="2025-01-03", joint="elbow", work="oil", note="as every year")]
    found = change_since(session(8), named(8), maintenance=work)
    again = Trend.from_json(found.to_json())
    assert again.to_json() == found.to_json() and again.maintenance == found.maintenance
    assert [each.alarm for each in again.series] == [each.alarm for each in found.series]
    with pytest.raises(InvalidData, match="loose-trend/1"):
        Trend.from_json("{}")
