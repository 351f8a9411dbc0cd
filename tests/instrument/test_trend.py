"""Change since earlier sessions: what is compared, and what it is not mistaken for; its files."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument import (
    Diagnosis,
    Maintenance,
    Trend,
    TrendSettings,
    change_since,
    read_maintenance,
    read_sessions,
)
from tests.instrument.arms import named, session


def test_an_arm_that_stays_as_it_is_has_not_changed() -> None:
    found = change_since(session(8), named(8))
    assert len(found.sessions) == 9 and not found.changed
    assert len(found.compared) == 3 * 3 * 4 + 1  # joints, axes, bands; and the probability
    assert not found.warnings


def test_healthy_arms_alarm_at_most_at_the_stated_rate_all_series_together() -> None:
    rate = 0.1
    settings = TrendSettings(false_alarm_rate=rate)
    alarmed = tested = 0
    for arm in range(40):
        many = [(str(k), session(1000 * arm + k, dated=False)) for k in range(14)]
        found = change_since(many[-1][1], many[:-1], settings=settings)
        alarmed += len({k for series in found.series for k in series.alarms})
        tested += len(many) - 2
    assert alarmed / tested < rate + 2 * math.sqrt(rate / tested)


def test_a_changed_transmission_is_named_by_joint_and_band_by_date() -> None:
    new = session(12, factor={"elbow": 1.25})
    found = change_since(new, named(12)[::-1])  # sessions are taken by date, not as given
    assert {each.joint for each in found.changed} == {"elbow"}
    first = found.changed[0]
    assert first.alarm == 12 and first.band_hz is not None and first.band_hz[0] > 50
    assert np.exp(first.change[-1]) == pytest.approx(1.25, rel=0.05)
    assert found.to_json() == change_since(new, named(12)).to_json()
    dates = [each.date for each in found.sessions]
    assert dates == sorted(dates)


def test_slow_wear_is_found_though_no_step_stands_out() -> None:
    before = named(10)
    before += [(f"worn {k}", session(10 + k, factor={"shoulder": 1 + 0.012 * k})) for k in range(8)]
    found = change_since(session(18, factor={"shoulder": 1.1}), before)
    assert {each.joint for each in found.changed} == {"shoulder"}
    assert found.changed[0].alarm is not None and found.changed[0].alarm > 10


def test_other_poses_and_levels_are_not_compared() -> None:
    elsewhere = change_since(session(6, pose=0.5), named(6))
    assert all(each.quantity == "probability" for each in elsewhere.compared)
    assert any("same pose" in words for words in elsewhere.warnings)
    louder = session(6)
    spectra = tuple(replace(s, drive_rms=2 * s.drive_rms) for s in louder.spectra)
    found = change_since(replace(louder, spectra=spectra), named(6))
    assert all(each.quantity == "probability" for each in found.compared)


def test_free_travel_that_grows_and_a_probability_that_rises_are_changes() -> None:
    before = [(str(k), session(k, gap_m=1e-3 * (1 + 0.02 * (k % 3)))) for k in range(6)]
    found = change_since(session(6, gap_m=5e-3), before)
    assert [each.quantity for each in found.changed] == ["free_travel"]
    shrunk = change_since(session(6, gap_m=2e-4), before)
    assert "free_travel" not in {each.quantity for each in shrunk.changed}  # it does not heal
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
    for wrong in ({"shift": 9.0}, {"false_alarm_rate": 0.0}, {"false_alarm_rate": 0.7}):
        with pytest.raises(InvalidSetting, match=f"{next(iter(wrong))} is"):
            TrendSettings(**wrong)


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


# ------------------------------------------------------------------------- files


def maintenance_file(folder: Path, whole: Any) -> Path:
    path = folder / "maintenance.json"
    path.write_text(whole if isinstance(whole, str) else json.dumps(whole), encoding="utf-8")
    return path


def test_records_are_read_by_date(tmp_path: Path) -> None:
    oil = {"date": "2025-03-01", "joint": "elbow", "work": "oil", "note": "yearly"}
    bolts = {"date": "2025-02-01T10:30", "link": "forearm", "work": "bolts"}
    found = read_maintenance(maintenance_file(tmp_path, [oil, bolts]), ["elbow", "forearm"])
    assert [each.where for each in found] == ["forearm", "elbow"]
    assert found[1].note == "yearly"


WORK = {"date": "2025-03-01", "joint": "elbow", "work": "oil"}


@pytest.mark.parametrize(
    ("whole", "words"),
    [
        ("[", "no JSON from line 1 on; records are as"),
        ('[\n{"date": 2026,\n}]', "no JSON from line 3 on; records are as"),
        ("[" * 100_000, "no JSON; records are as"),
        ("\ufffe\xff", "no JSON"),
        ({}, "a list of records"),
        ([3], "record 1: an object is needed"),
        ([{"date": "2025-03-01", "joint": "elbow"}], "record 1: 'work' is a text"),
        ([WORK | {"date": "1 March"}], "as 2026-05-04"),
        ([{"date": "2025-03-01", "work": "oil"}], "a joint or a link"),
        ([WORK | {"link": "b"}], "one of the two"),
        ([WORK | {"joint": "knee"}], "no joint or link 'knee'"),
        ([WORK | {"by": "me"}], "'by' is none"),
        ([WORK | {"note": 3}], "'note' is a text"),
    ],
)
def test_what_is_no_record_is_refused_with_file_and_entry(
    tmp_path: Path, whole: Any, words: str
) -> None:
    with pytest.raises(InvalidData, match=words) as refused:
        read_maintenance(maintenance_file(tmp_path, whole), ["elbow", "forearm"])
    assert "maintenance.json" in str(refused.value) and "\n" not in str(refused.value)


def test_sessions_are_results_folders_or_recordings(tmp_path: Path) -> None:
    asked: list[Path] = []

    def diagnose(folder: Path) -> Diagnosis:
        asked.append(folder)
        return session(7)

    file = session(1).write(tmp_path / "a" / "result.json")
    session(2).write(tmp_path / "b" / "diagnosis" / "result.json")
    replace(session(3), spectra=()).write(tmp_path / "c" / "found" / "result.json")
    (tmp_path / "c" / "recording").mkdir()
    (tmp_path / "c" / "recording" / "recording.json").write_text("{}")
    paths = [file, file.parent, tmp_path / "b", tmp_path / "c", file]
    found = read_sessions(paths, diagnose)
    assert [s.date for _, s in found] == [session(k).date for k in (1, 1, 2, 7)]
    assert asked == [tmp_path / "c" / "recording"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidData, match=r"neither a result\.json nor a recording\.json"):
        read_sessions([tmp_path / "empty"], diagnose)
    for name in ("one", "two"):
        session(1).write(tmp_path / "d" / name / "result.json")
    with pytest.raises(InvalidData, match=r"several folders.*one, two"):
        read_sessions([tmp_path / "d"], diagnose)
    (tmp_path / "text.json").write_text("no json")
    with pytest.raises(InvalidData, match=r"text\.json"):
        read_sessions([tmp_path / "text.json"], diagnose)
