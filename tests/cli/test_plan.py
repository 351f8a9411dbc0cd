"""``loose inspect`` and ``loose plan`` as somebody types them."""

from __future__ import annotations

import json
from html import unescape
from pathlib import Path

import pytest

from loose_env.cli.main import main
from loose_env.instrument import Diagnosis, Fault, NextSettings, next_for
from loose_env.instrument.model.instrumented_arm import read_arm
from tests.instrument.arms.plan_arms import MOTORS, SERVOED, URDF, written


def test_inspect_prints_a_screen_and_writes_the_file_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = written(tmp_path, MOTORS)
    assert main(["inspect", str(model), "--poses", "2", "--json", str(tmp_path / "i.json")]) == 0
    said = capsys.readouterr()
    assert "faults, in 2 poses" in said.out
    assert json.loads((tmp_path / "i.json").read_text("utf-8"))["format"] == "loose-inspection/1"


def test_plan_writes_everything_it_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, out = written(tmp_path, MOTORS), tmp_path / "session"
    command = ["plan", str(model), "--out", str(out), "--poses", "2", "--joint", "elbow"]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "shake elbow" in said
    for name in ("plan.html", "plan.json", "signal.csv", "signal.parquet"):
        assert (out / name).is_file()
        assert name in said
    assert {p.name for p in (out / "recording").iterdir()} == {"model.xml", "recording.json"}
    page = (out / "plan.html").read_text("utf-8")
    assert "Next: shake elbow" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "<script" not in page


def test_options_count_with_what_is_known_and_those_left_out_are_the_diagnosis_own(
    tmp_path: Path,
) -> None:
    model = written(tmp_path, MOTORS)
    machine = read_arm(model)
    chosen = NextSettings(poses=2, seconds=1.4, seed=3)
    posterior = dict.fromkeys(machine.hypotheses, 1 / len(machine.hypotheses))
    wanted = next_for(machine, settings=chosen)
    found = Diagnosis(
        fault=Fault(kind="healthy"), probability=posterior["healthy"], posterior=posterior,
        next=wanted,
    )  # fmt: skip
    found.write(tmp_path / "result.json")
    command = ["plan", str(model), "--known", str(tmp_path / "result.json")]
    assert main([*command, "--out", str(tmp_path / "a")]) == 0
    made = json.loads((tmp_path / "a" / "plan.json").read_text("utf-8"))
    assert made["pose"] == pytest.approx(wanted.pose)
    assert made["seconds"] == made["settings"]["seconds"] == 1.4
    assert made["settings"]["poses"] == 2
    # The length of the command's own default, where somebody asks for it.
    assert main([*command, "--seconds", "3", "--most-tool", "2", "--out", str(tmp_path / "b")]) == 0
    made = json.loads((tmp_path / "b" / "plan.json").read_text("utf-8"))
    assert made["seconds"] == made["settings"]["seconds"] == 3.0
    assert made["signals"][0]["tool_acceleration_rms"] < 2.2
    assert made["settings"]["poses"] == 2
    page = (tmp_path / "b" / "plan.html").read_text("utf-8")
    assert "--seconds 3 --most-tool 2" in page or "--most-tool 2 --seconds 3" in page


def test_the_commands_on_the_page_name_paths_as_they_were_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").mkdir()
    written(tmp_path / "models", MOTORS, "my desk.xml")
    given = ["plan", "models/my desk.xml", "--out", "runs/my session"]
    assert main([*given, "--poses", "2", "--most-tool", "3"]) == 0
    page = unescape((tmp_path / "runs/my session/plan.html").read_text("utf-8"))
    assert (
        "loose diagnose 'runs/my session/recording' --out 'runs/my session/diagnosis' "
        "--most-tool 3 --poses 2" in page
    )
    assert (
        "loose plan 'models/my desk.xml' --out 'runs/my session' --known "
        "'runs/my session/diagnosis' --most-tool 3 --poses 2" in page
    )


def test_a_plan_in_the_folder_of_an_earlier_one_keeps_its_limits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, out = written(tmp_path, MOTORS), tmp_path / "session"
    command = ["plan", str(model), "--out", str(out), "--poses", "2"]
    assert main([*command, "--most-tool", "2"]) == 0
    capsys.readouterr()
    assert main(command) == 0
    assert "as the earlier plan has it: --most-tool 2" in capsys.readouterr().err
    assert json.loads((out / "plan.json").read_text("utf-8"))["settings"]["most_tool"] == 2.0
    assert main([*command, "--most-tool", "4"]) == 0
    assert json.loads((out / "plan.json").read_text("utf-8"))["settings"]["most_tool"] == 4.0


def test_limits_are_printed_with_their_sources_and_hold_for_the_session(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, out = written(tmp_path, SERVOED), tmp_path / "session"
    command = ["plan", str(model), "--out", str(out), "--poses", "2", "--seconds", "1"]
    limits = ["--max-speed-rad-s", "1", "2", "1.5", "--command-rate-hz", "500"]
    assert main([*command, *limits, "--commands", "position", "--reference"]) == 0
    said = capsys.readouterr().out
    assert "speed: pan 1 rad/s (--max-speed-rad-s); lift 2 rad/s" in said
    assert "jerk: no limit stated" in said
    assert "peak speed of the command" in said
    assert "transit.csv" in said or "is there already" in said
    assert "reference-01.csv" in said and "repeat-01.csv" in said
    header = (out / "signal.csv").read_text("utf-8").partition("\n")[0]
    assert header == "time,position.pan,position.lift,position.elbow"
    page = unescape((out / "plan.html").read_text("utf-8"))
    for words in (
        "Peaks and limits",
        "--max-speed-rad-s 1 2 1.5",
        "reference-01.csv",
        "--reference",
    ):
        assert words in page
    assert main(command) == 0
    kept = capsys.readouterr().err
    assert "as the earlier plan has it: --max-speed-rad-s 1 2 1.5" in kept
    assert "--reference" in kept
    whole = json.loads((out / "plan.json").read_text("utf-8"))
    assert whole["settings"]["max_speed_rad_s"] == [1.0, 2.0, 1.5]
    assert whole["limits"]["speed"]["pan"]["source"] == "--max-speed-rad-s"
    assert main([*command, "--no-reference", "--repeat", "0"]) == 0
    runs = json.loads((out / "plan.json").read_text("utf-8"))["runs"]
    assert [run["kind"] for run in runs] == ["run"]
    assert not (out / "first-signal.csv").exists()


def test_the_plan_of_a_urdf_keeps_the_speeds_that_it_states(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, out = written(tmp_path, URDF, "arm.urdf"), tmp_path / "session"
    command = ["plan", str(model), "--out", str(out), "--poses", "2", "--signal-format", "ros2"]
    assert main(command) == 0
    assert 'speed: all joints 2 rad/s (<limit velocity="2"> of arm.urdf)' in capsys.readouterr().out
    assert (out / "signal.yaml").is_file()
    assert not (out / "signal.csv").exists()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"gap_mm": "a"}, "gap_mm is a finite number, got 'a'"),
        ({"poses": None}, "poses is a whole number, got None"),
        ({"poses": 2.5}, "poses is a whole number, got 2.5"),
        ({"poses": 1e9}, "poses is a whole number"),
        ({"poses": 10**9}, "poses is a whole number from 1 to 10000"),
        ({"in_turn": [1]}, r"in_turn is a whole number, got [1]"),
        ({"band_low": "x"}, "band_low is a finite number, got 'x'"),
        ({"seed": 1.5}, "seed is a whole number, got 1.5"),
        ({"seed": True}, "seed is a whole number, got True"),
        ({"seconds": 1e9}, "seconds is a length of 0.2 to 600 s"),
        ({"rate_hz": 10**400}, "rate_hz is a finite number"),
        ({"most_tool": 0}, "most_tool is a positive number"),
    ],
)
def test_settings_of_a_result_that_make_no_sense_are_refused_with_file_and_field(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: dict[str, object], words: str
) -> None:
    model = written(tmp_path, MOTORS)
    machine = read_arm(model)
    posterior = dict.fromkeys(machine.hypotheses, 1 / len(machine.hypotheses))
    found = Diagnosis(
        fault=Fault(kind="healthy"), probability=posterior["healthy"], posterior=posterior,
        next=next_for(machine, settings=NextSettings(poses=2)), settings={"poses": 2},
    )  # fmt: skip
    whole = json.loads(found.to_json())
    for where in ("next", None):
        damaged = json.loads(found.to_json())
        (damaged[where] if where else damaged)["settings"] = changed
        if not where:
            damaged["next"] = None
        (tmp_path / "result.json").write_text(json.dumps(damaged), "utf-8")
        command = ["plan", str(model), "--known", str(tmp_path / "result.json")]
        assert main([*command, "--out", str(tmp_path / "o")]) == 1
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert "result.json: " in said and "settings: " in said and words in said
    assert whole["next"]["settings"]["ground_m"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{dir}/none.xml", "--out", "{dir}/o"], "there is no file"),
        (["{model}", "--out", "{model}"], "is a file"),
        (["{model}", "--out", "{dir}/o", "--known", "{dir}/none.json"], "cannot be read"),
        (["{model}", "--out", "{dir}/o", "--known", "{model}"], "no JSON"),
        (["{model}", "--out", "{dir}/o", "--tool", "hammer"], "no site or body 'hammer'"),
        (["{model}", "--out", "{dir}/o", "--seconds", "-1"], "seconds is a length of 0.2 to 600 s"),
        (["{model}", "--out", "{dir}/o", "--max-speed-rad-s", "-1"], "one positive number for all"),
        (
            ["{model}", "--out", "{dir}/o", "--max-jerk-rad-s3", "1", "2", "3"],
            "of lift, elbow; got",
        ),
        (["{model}", "--out", "{dir}/o", "--signal-format", "mat"], "csv, parquet, ros2, got mat"),
        (["{model}", "--out", "{dir}/o", "--repeat", "-1"], "repeat is a whole number from 0 to"),
        (["{model}", "--out", "{dir}/o", "--command-bandwidth-hz", "1"], "followed up to 1 Hz"),
        (["{model}", "--out", "{dir}/o", "--pose-deg", "1", "2", "3"], "each of lift, elbow"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    model = written(tmp_path, MOTORS)
    given = [a.format(dir=tmp_path, model=model) for a in arguments]
    assert main(["plan", *given, "--poses", "2"]) == 1
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert not (tmp_path / "o").exists()


def test_a_folder_that_cannot_be_made_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = written(tmp_path, MOTORS)
    (tmp_path / "file").write_text("", encoding="utf-8")
    out = tmp_path / "file" / "inside"
    assert main(["plan", str(model), "--out", str(out), "--poses", "2"]) == 1
    said = capsys.readouterr().err
    assert said.splitlines()[-1].startswith("loose plan: ")


def test_the_command_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    listed = capsys.readouterr().out
    assert "inspect" in listed
    assert "plan" in listed
