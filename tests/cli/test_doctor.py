"""The command `loose doctor`, and the preflight of `loose diagnose` and `loose gap`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.doctor import examine
from loose_env.instrument import read_diagnosis
from loose_env.recording import read_recording, write_recording
from tests.doctor.machine import late, record, with_sensors, xml


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("doctor") / "arm").folder


@pytest.fixture(scope="module")
def wrong(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("doctor")
    recording = with_sensors(record(folder / "right"), "q_", np.degrees)
    write_recording(folder / "degrees", model_xml=xml(), runs=recording.runs)
    return folder / "degrees"


def test_a_clean_recording_exits_with_zero(clean: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(clean)]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("arm (3 runs, 5.997 s): nothing found")
    assert not said.err


def test_errors_are_listed_and_exit_with_one(
    wrong: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", str(wrong), "--json", str(tmp_path / "found.json")]) == 1
    said = capsys.readouterr()
    assert "error: sensor.q_base" in said.out and "remedy:" in said.out
    assert "1 error" in said.out.splitlines()[0]
    assert json.loads((tmp_path / "found.json").read_text())["errors"] == 3


def test_json_can_go_to_the_output(wrong: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(wrong), "--json", "-"]) == 1
    assert json.loads(capsys.readouterr().out)["recording"] == "degrees"


@pytest.mark.parametrize("command", ["diagnose", "gap"])
def test_other_commands_stop_at_errors_before_they_write(
    command: str, wrong: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main([command, str(wrong), "--out", str(out), "--quiet"]) == 1
    said = capsys.readouterr().err
    assert "error: sensor.q_base" in said
    assert "--ignore-doctor" in said.splitlines()[-1]
    assert not out.exists()


def test_findings_stand_in_the_result_and_on_the_page_of_a_diagnosis(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    recording = with_sensors(record(tmp_path / "right"), "acc", lambda v: late(v, 0.004))
    write_recording(tmp_path / "late", model_xml=xml(), runs=recording.runs)
    given = ["diagnose", str(tmp_path / "late"), "--out", str(tmp_path / "out"), "--poses", "2"]
    assert main([*given, "--quiet"]) == 0
    assert "the accelerometer's clock is 4." in capsys.readouterr().err
    result = read_diagnosis(tmp_path / "out")
    own = examine(read_recording(tmp_path / "late")).findings
    assert [each.found for each in result.preflight] == [each.found for each in own]
    assert {each.check for each in result.preflight} == {"clock"}
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    shown = page[page.index("Limits the result") :]
    assert "may pass for a loose link" in shown


def test_what_is_no_recording_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["doctor", str(tmp_path), "--clock-s", "-1"]) == 1
    assert "clock_s is a positive number" in capsys.readouterr().err
