"""Maintenance records and earlier sessions from the disk; what is none is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from loose_env.errors import InvalidData
from loose_env.instrument import Diagnosis, read_maintenance, read_sessions
from tests.instrument.trend.sessions_of_an_arm import session


def written(folder: Path, whole: Any) -> Path:
    path = folder / "maintenance.json"
    path.write_text(whole if isinstance(whole, str) else json.dumps(whole), encoding="utf-8")
    return path


def test_records_are_read_by_date(tmp_path: Path) -> None:
    oil = {"date": "2025-03-01", "joint": "elbow", "work": "oil", "note": "yearly"}
    bolts = {"date": "2025-02-01T10:30", "link": "forearm", "work": "bolts"}
    found = read_maintenance(written(tmp_path, [oil, bolts]), ["elbow", "forearm"])
    assert [each.where for each in found] == ["forearm", "elbow"]
    assert found[1].note == "yearly"


@pytest.mark.parametrize(
    ("whole", "words"),
    [
        ("[", "no JSON from line 1 on; records are as"),
        ('[\n{"date": 2026,\n}]', "no JSON from line 3 on; records are as"),
        ("[" * 100_000, "no JSON; records are as"),
        ({}, "a list of records"),
        ([3], "record 1: an object is needed"),
        ([{"date": "2025-03-01", "joint": "elbow"}], "record 1: 'work' is a text"),
        ([{"date": "1 March", "joint": "elbow", "work": "oil"}], "as 2026-05-04"),
        ([{"date": "2025-03-01", "work": "oil"}], "a joint or a link"),
        ([{"date": "2025-03-01", "joint": "a", "link": "b", "work": "oil"}], "one of the two"),
        ([{"date": "2025-03-01", "joint": "knee", "work": "oil"}], "no joint or link 'knee'"),
        ([{"date": "2025-03-01", "joint": "elbow", "work": "oil", "by": "me"}], "'by' is none"),
        ([{"date": "2025-03-01", "joint": "elbow", "work": "oil", "note": 3}], "'note' is a text"),
    ],
)
def test_what_is_no_record_is_refused_with_file_and_entry(
    tmp_path: Path, whole: Any, words: str
) -> None:
    with pytest.raises(InvalidData, match=words) as refused:
        read_maintenance(written(tmp_path, whole), ["elbow", "forearm"])
    assert "maintenance.json" in str(refused.value)


def test_a_file_that_cannot_be_read_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "photo.json").write_bytes(b"\xff\xd8\xff\xe0")
    for name, words in (
        ("photo.json", "no JSON"),
        ("none.json", "No such file"),
        (".", "director"),
    ):
        with pytest.raises(InvalidData, match=words) as refused:
            read_maintenance(tmp_path / name)
        assert "\n" not in str(refused.value) and "codec" not in str(refused.value)


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


def test_what_is_no_session_is_refused(tmp_path: Path) -> None:
    def never(folder: Path) -> Diagnosis:
        raise AssertionError(folder)

    with pytest.raises(InvalidData, match=r"neither a result\.json nor a recording\.json"):
        read_sessions([tmp_path], never)
    for name in ("one", "two"):
        session(1).write(tmp_path / name / "result.json")
    with pytest.raises(InvalidData, match=r"several folders.*one, two"):
        read_sessions([tmp_path], never)
    (tmp_path / "text.json").write_text("no json")
    with pytest.raises(InvalidData, match=r"text\.json"):
        read_sessions([tmp_path / "text.json"], never)
