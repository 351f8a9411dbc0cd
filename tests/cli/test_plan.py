"""``loose inspect`` and ``loose plan`` as somebody types them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from loose_env.cli.main import main
from loose_env.instrument.next_settings import NextSettings
from loose_env.instrument.plan import load, next_for
from loose_env.instrument.result import Diagnosis, Fault
from tests.instrument.plan_arms import MOTORS, written


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
    machine = load(model)
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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{dir}/none.xml", "--out", "{dir}/o"], "there is no file"),
        (["{model}", "--out", "{model}"], "is a file"),
        (["{model}", "--out", "{dir}/o", "--known", "{dir}/none.json"], "cannot be read"),
        (["{model}", "--out", "{dir}/o", "--known", "{model}"], "no JSON"),
        (["{model}", "--out", "{dir}/o", "--tool", "hammer"], "no site or body 'hammer'"),
        (["{model}", "--out", "{dir}/o", "--seconds", "-1"], "seconds is a positive number"),
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
