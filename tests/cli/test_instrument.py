"""`loose inspect`, `plan`, `diagnose` and `trend` as a user types them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.cli.main import main
from loose_env.instrument import read_diagnosis, read_plan
from loose_env.recording import read_recording, write_csv
from tests.instrument.machine import JOINTS, NOMINAL, Truth, played, short_session, simulated

Capture = pytest.CaptureFixture[str]
ARM = str(SIX_AXIS_SERVO_ARM)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a session of a loose arm and one of a healthy arm, the model beside each."""
    folder = tmp_path_factory.mktemp("cli")
    short_session(folder / "june")
    short_session(folder / "may", Truth(mode_hz=40))
    return folder


def last_line(capsys: Capture) -> str:
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_inspect_says_what_a_session_could_test(capsys: Capture) -> None:
    assert main(["inspect", ARM, "--controller", "ros2_jtc"]) == 0
    shown = capsys.readouterr().out
    assert "link3" in shown and "not tested" in shown


def test_inspect_names_drives_and_couplings_as_what_they_are(
    tmp_path: Path, capsys: Capture
) -> None:
    finger = '<body name="{0}" pos=".3 0 0"><joint name="{0}" type="slide" axis="0 1 0"/>'
    finger += '<geom size=".01" mass=".05"/></body>'
    text = f"""<mujoco><worldbody><body name="a"><joint name="lift" axis="0 0 1" armature=".1"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
    <body name="b" pos=".3 0 0"><joint name="bend" axis="0 1 0"/><site name="tip" pos=".3 0 .1"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/>
    {finger.format("left")}{finger.format("right")}</body></body></worldbody>
    <tendon><fixed name="both"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed>
    </tendon><equality><joint joint1="right" joint2="left"/></equality>
    <actuator><position joint="bend" kp="30" timeconst=".02"/>
    <velocity name="v" joint="lift" kv="2e6"/><intvelocity name="i" joint="bend"
    kp="100" actrange="-3 3"/><position name="p" tendon="both" kp="50"/></actuator></mujoco>"""
    (tmp_path / "arm.xml").write_text(text)
    assert main(["inspect", str(tmp_path / "arm.xml")]) == 0
    assert capsys.readouterr().out.splitlines()[-5:] == [
        "drive actuator1: position drive of bend, 30 N·m/rad, through a filter of 0.02 s",
        "drive v: velocity drive of lift, 2e+06 N·m·s/rad",
        "drive i: velocity drive of bend, 100 N·m/rad, which integrates its command",
        "drive p: position drive of left and right by tendon both, 50 N/m",
        "joint right follows left",
    ]


def test_a_plan_is_written_for_the_machine_and_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "session"
    assert main(["plan", ARM, "--controller", "ros2_jtc", "--out", str(out)]) == 0
    made = read_plan(out)
    assert [run.file for run in made.runs] == [f"run-{k:02d}.csv" for k in range(1, 7)]
    table = np.genfromtxt(out / "run-01.csv", delimiter=",", names=True)
    assert table.dtype.names[0] == "time" and len(table) == 1120
    entries = json.loads((out / "recording" / "recording.json").read_text())["runs"]
    assert all(entry["planned"] for entry in entries)


def test_a_sweep_corrects_the_plan(tmp_path: Path, capsys: Capture) -> None:
    out, model = tmp_path / "session", tmp_path / "bench.xml"
    model.write_text(NOMINAL)
    words = ["plan", str(model), "--controller", "ros2_jtc", "--poses", "3", "--out", str(out)]
    assert main(words) == 0
    made = read_plan(out)
    assert made.sweep is not None and max(made.signal.excited) <= 20
    assert "sweep.csv" in (out / "plan.html").read_text()
    given = np.loadtxt(out / "sweep.csv", delimiter=",", skiprows=1)[:, 1:]
    rng, rate = np.random.default_rng(0), made.settings.limits.rate_hz
    time, read = played(simulated(Truth()), given, rate, rng)
    measured = {"time": time, **{f"sensor.{j}_position": read[j] for j in JOINTS}}
    write_csv(out / "recording" / "sweep.csv", {n: v[:2000] for n, v in measured.items()})
    assert main(words) == 1
    assert "sweep.csv: the joints move for" in last_line(capsys)
    noise = {n: rng.normal(0, 1e-3, len(v)) if n != "time" else v for n, v in measured.items()}
    write_csv(out / "recording" / "sweep.csv", noise)
    assert main(words) == 1
    assert "sweep.csv: the joints follow none of its lines" in last_line(capsys)
    assert read_plan(out) == made
    write_csv(out / "recording" / "sweep.csv", measured)
    assert main(["plan", str(model), "--out", str(out)]) == 0
    said, corrected = capsys.readouterr(), read_plan(out)
    assert "20 Hz were assumed" in said.out + said.err
    # Its servos, 22 Hz with 0.7 of critical damping, follow by half up to 29 Hz.
    assert corrected.sweep is None and 27 <= (corrected.settings.bandwidth_hz or 0) <= 31
    assert 25 <= max(corrected.signal.excited) <= 31
    assert [run.file for run in corrected.runs] == ["run-01.csv", "run-02.csv", "run-03.csv"]
    entries = json.loads((out / "recording" / "recording.json").read_text())["runs"]
    assert [entry["file"] for entry in entries] == [run.file for run in corrected.runs]


def test_a_session_is_repeated_with_the_limits_of_the_first(
    home: Path, tmp_path: Path, capsys: Capture
) -> None:
    first, again, arm = tmp_path / "first", tmp_path / "again", str(home / "june" / "bench.xml")
    words = ["plan", arm, "--controller", "ros2_jtc", "--max-speed-rad-s", "0.3", "--poses", "3"]
    assert main([*words, "--out", str(first)]) == 0
    assert main(["plan", arm, "--out", str(again), "--like", str(first / "recording")]) == 0
    for file in ("run-01.csv", "run-02.csv", "run-03.csv"):
        assert (again / file).read_bytes() == (first / file).read_bytes()
    assert read_plan(again).settings == read_plan(first).settings
    assert main(["plan", arm, "--out", str(again), "--like", str(first)]) == 1
    assert "--like is for a new folder" in last_line(capsys)
    assert main(["plan", arm, "--out", str(tmp_path / "new"), "--like", str(tmp_path)]) == 1
    assert "there is no plan.json" in last_line(capsys) and not (tmp_path / "new").exists()


def test_a_session_is_diagnosed_and_planned_on(home: Path, tmp_path: Path, capsys: Capture) -> None:
    june, out = home / "june", tmp_path / "found"
    assert main(["diagnose", str(june / "recording"), "--out", str(out)]) == 0
    found = read_diagnosis(out)
    assert found.verdict == "loose" and found.headline in capsys.readouterr().out
    goes_on = ["--known", str(out), "--out", str(tmp_path / "next"), "--poses", "3"]
    assert main(["plan", str(june / "bench.xml"), *goes_on]) == 0
    assert main(["diagnose", str(june / "recording"), "--out", str(june)]) == 1
    assert "give a new or empty folder" in last_line(capsys)


@pytest.mark.slow
def test_a_healthy_recording_is_a_reference(home: Path, tmp_path: Path) -> None:
    june, may = (str(home / month / "recording") for month in ("june", "may"))
    out = tmp_path / "found"
    assert main(["diagnose", june, "--healthy", may, "--out", str(out), "--quiet"]) == 0
    found = read_diagnosis(out)
    assert found.reference and found.evidence["top_db"] > 3


@pytest.mark.slow
def test_months_are_compared(home: Path, tmp_path: Path) -> None:
    may, june = (str(home / month / "recording") for month in ("may", "june"))
    out = tmp_path / "trend"
    assert main(["trend", may, june, "--out", str(out), "--quiet"]) == 0
    assert json.loads((out / "trend.json").read_text())["since"] == "june"


def test_a_plan_beside_measured_runs_keeps_them(home: Path, tmp_path: Path) -> None:
    shutil.copytree(home / "june", tmp_path / "session")
    recording = tmp_path / "session" / "recording"
    before = {path.name: path.read_bytes() for path in recording.glob("run-*")}
    words = ["plan", str(home / "june" / "bench.xml"), "--controller", "ros2_jtc", "--poses", "3"]
    assert main([*words, "--out", str(recording.parent)]) == 0
    assert [run.name for run in read_recording(recording).runs] == sorted(before)
    assert {path.name: path.read_bytes() for path in recording.glob("run-*")} == before
    planned = [run.file for run in read_plan(recording).runs]
    assert planned[:3] == sorted(before) and planned[3] == "run-04.csv"


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("phases", [[0.0] * 3] * 2, "a phase for each line"),
        ("phases", [], "a crest for each joint"),
        ("period_s", 0.0, "positive period"),
        ("excited", [], "positive lines"),
    ],
)
def test_a_plan_whose_signal_is_damaged_ends_in_a_line(
    key: str, value: object, says: str, home: Path, tmp_path: Path, capsys: Capture
) -> None:
    recording = tmp_path / "recording"
    shutil.copytree(home / "june" / "recording", recording)
    given = json.loads((home / "june" / "plan.json").read_text())
    given["signal"][key] = value
    (recording / "plan.json").write_text(json.dumps(given))
    assert main(["diagnose", str(recording), "--out", str(tmp_path / "found")]) == 1
    assert says in last_line(capsys) and not (tmp_path / "found").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["plan", ARM, "--poses", "2"], "poses is 3 to 24"),
        (["plan", ARM, "--controller", "abb"], "there is no controller 'abb'"),
        (["plan", ARM, "--bandwidth-hz", "5"], "8 Hz or more"),
        (["plan", "none.xml"], "none.xml"),
        (["trend", "HOME/may/recording"], "two sessions or more"),
        (["diagnose", "HOME/nothing"], "there is no folder"),
    ],
)
def test_mistakes_end_in_a_line(
    words: list[str], says: str, home: Path, tmp_path: Path, capsys: Capture
) -> None:
    given = [word.replace("HOME", str(home)) for word in words]
    assert main([*given, "--out", str(tmp_path / "out")]) in (1, 2)
    message = last_line(capsys)
    assert says in message and not (tmp_path / "out").exists()
