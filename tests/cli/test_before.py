"""The command `loose diagnose --before`: change since earlier sessions, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from loose_env.cli.diagnose import trend_summary
from loose_env.cli.main import main
from loose_env.instrument import Diagnosis, change_since, diagnose
from loose_env.recording import read_recording, write_recording
from scripts.suites.diagnosis.months import machine, session_runs
from scripts.suites.gap.arms import model_xml
from tests.instrument.trend.sessions_of_an_arm import named, session

MONTHS = 5


def recording(folder: Path, month: int, *, worn: int = 0) -> Path:
    case = machine(0, 3)
    runs = session_runs(case, month, "play", worn)
    write_recording(folder, model_xml=model_xml(case.arm.figures), runs=runs)
    return folder


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sessions of a healthy machine: results, and one recording without a result."""
    pytest.importorskip("numba")
    home = tmp_path_factory.mktemp("months")
    for month in range(MONTHS):
        folder = recording(home / f"m{month}" / "recording", month)
        if month:
            found = diagnose(read_recording(folder), plan=False)
            replace(found, date=f"2026-0{month + 1}-10").write(home / f"m{month}" / "result.json")
    return home


def test_a_machine_that_got_play_has_changed_and_pages_say_since_when(
    earlier: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = recording(tmp_path / "new", MONTHS, worn=8)
    work = tmp_path / "work.json"
    work.write_text(json.dumps([{"date": "2026-01-02", "joint": "joint1", "work": "oil"}]))
    old = [str(earlier / f"m{month}") for month in range(1, MONTHS)]
    given = [str(new), "--out", str(tmp_path / "out"), "--poses", "2", "--date", "2026-09-01"]
    more = ["--maintenance", str(work), "--false-alarm-rate", "0.1", "--quiet"]
    assert main(["diagnose", *given, "--before", *old, *more]) == 0
    said = capsys.readouterr().out
    assert "changed since earlier sessions" in said and "since 2026-09-01" in said
    whole = json.loads((tmp_path / "out" / "trend.json").read_text("utf-8"))
    assert [each["date"] for each in whole["sessions"]][-1] == "2026-09-01"
    assert "alarm since 2026-09-01" in (tmp_path / "out" / "trend.html").read_text("utf-8")
    result = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert result["date"] == "2026-09-01" and len(result["model_hash"]) == 16
    # Without --before the same folder no longer tells of a trend.
    assert main(["diagnose", *given, "--quiet"]) == 0
    assert not (tmp_path / "out" / "trend.html").exists()
    assert not (tmp_path / "out" / "trend.json").exists()


def test_a_recording_without_a_result_is_diagnosed_first(
    earlier: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = recording(tmp_path / "new", MONTHS)
    given = ["diagnose", str(new), "--out", str(tmp_path / "out"), "--poses", "2"]
    assert main([*given, "--before", str(earlier / "m0")]) == 0
    said = capsys.readouterr()
    assert "diagnosing the earlier session" in said.err
    assert "not compared" in said.out  # one earlier session has no scatter


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--before", "no/such/session"], "no such file or folder"),
        (["--maintenance", "work.json"], "--before"),
        (["--date", "yesterday"], "2026-05-04"),
        (["--false-alarm-rate", "2"], "at most 0.2"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_diagnosed(
    options: list[str],
    words: str,
    earlier: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = ["diagnose", str(earlier / "m0" / "recording"), "--out", str(tmp_path / "out")]
    assert main([*given, *options]) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "No such file"),
        ("{", "no JSON from line 1 on; records are as"),
        ('[{"date": "2026-05-04", "joint": "knee", "work": "oil"}]', "no joint or link 'knee'"),
        ('[{"date": "May", "joint": "joint1", "work": "oil"}]', "a date is as 2026-05-04"),
    ],
)
def test_maintenance_records_are_checked_before_anything_is_diagnosed(
    text: str | None,
    words: str,
    earlier: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    work = tmp_path / "work.json"
    if text is not None:
        work.write_text(text)
    given = ["diagnose", str(earlier / "m0" / "recording"), "--out", str(tmp_path / "out")]
    assert main([*given, "--before", str(earlier / "m1"), "--maintenance", str(work)]) == 1
    said = capsys.readouterr().err
    assert words in said and "work.json" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_console_says_what_changed_and_the_rate_of_false_alarms() -> None:
    before = named(10)
    assert trend_summary(change_since(session(10), before)).startswith("no change since 10")
    changed: Diagnosis = session(10, factor={"elbow": 1.4})
    words = trend_summary(change_since(changed, before))
    assert "transmission from elbow to tool." in words and "1 %" in words
