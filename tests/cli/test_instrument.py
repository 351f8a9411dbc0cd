"""``loose inspect``, ``loose plan`` and ``loose diagnose`` as somebody types them."""

from __future__ import annotations

import json
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.instrument import (
    Diagnosis,
    Fault,
    NextSettings,
    diagnose,
    next_for,
    read_arm,
    read_recorded_arm,
)
from loose_env.recording import read_recording, write_csv, write_recording
from scripts.suites.diagnosis.months import machine, session_runs
from scripts.suites.gap.arms import model_xml
from scripts.suites.golden import DIAGNOSES, write_shaken_recording
from tests.instrument.arms import MOTORS, SERVOED, written

MONTHS = 5
Capture = pytest.CaptureFixture[str]


def read(path: Path) -> dict[str, Any]:
    whole: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return whole


def refused(capsys: Capture, *words: str) -> str:
    """The one line that a command says which refuses what it was given."""
    capsys.readouterr()
    assert main(words) == 1
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and said.err.startswith(f"loose {words[0]}: ") and not said.out
    return said.err


def undecided_of(hypotheses: tuple[str, ...], **more: Any) -> Diagnosis:
    posterior = dict.fromkeys(hypotheses, 1 / len(hypotheses))
    fault = Fault(kind="healthy")
    return Diagnosis(fault=fault, probability=posterior["healthy"], posterior=posterior, **more)


@pytest.fixture(scope="module")
def motors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("motors"), MOTORS)


@pytest.fixture(scope="module")
def undecided(motors: Path) -> Diagnosis:
    """A diagnosis that settles nothing, and asks for a measurement."""
    arm = read_arm(motors)
    wanted = next_for(arm, settings=NextSettings(poses=2, seconds=1.4, seed=3))
    return undecided_of(arm.hypotheses, next=wanted, settings={"poses": 2})


def test_plan_writes_everything_it_names(motors: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "session"
    assert main(["plan", str(motors), "--out", str(out), "--poses", "2", "--joint", "elbow"]) == 0
    said = capsys.readouterr().out
    assert "shake elbow" in said
    for name in ("plan.html", "plan.json", "signal.csv", "signal.parquet"):
        assert (out / name).is_file() and name in said
    assert {p.name for p in (out / "recording").iterdir()} == {"model.xml", "recording.json"}
    page = (out / "plan.html").read_text("utf-8")
    assert "Next: shake elbow" in page and "<script" not in page
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_options_count_with_what_is_known_and_those_left_out_are_the_diagnosis_own(
    motors: Path, undecided: Diagnosis, tmp_path: Path
) -> None:
    undecided.write(tmp_path / "result.json")
    command = ["plan", str(motors), "--known", str(tmp_path / "result.json")]
    assert main([*command, "--out", str(tmp_path / "a")]) == 0
    made = read(tmp_path / "a" / "plan.json")
    assert undecided.next is not None
    assert made["pose"] == pytest.approx(undecided.next.pose)
    assert made["seconds"] == made["settings"]["seconds"] == 1.4
    assert made["settings"]["poses"] == 2
    # The length of the command's own default, where somebody asks for it.
    assert main([*command, "--seconds", "4", "--most-tool", "2", "--out", str(tmp_path / "b")]) == 0
    made = read(tmp_path / "b" / "plan.json")
    assert made["seconds"] == made["settings"]["seconds"] == 4.0
    assert made["signals"][0]["tool_acceleration_rms"] < 2.2
    assert made["settings"]["poses"] == 2
    assert "--most-tool 2" in (tmp_path / "b" / "plan.html").read_text("utf-8")


def test_the_commands_on_the_page_name_paths_as_they_were_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").mkdir()
    written(tmp_path / "models", MOTORS, "my desk.xml")
    given = ["plan", "models/my desk.xml", "--out", "runs/my session"]
    assert main([*given, "--poses", "2", "--most-tool", "3"]) == 0
    page = unescape((tmp_path / "runs/my session/plan.html").read_text("utf-8"))
    for command in (
        "loose diagnose 'runs/my session/recording' --out 'runs/my session/diagnosis' ",
        "loose plan 'models/my desk.xml' --out 'runs/my session' --known 'runs/my session/diag"
        "nosis' ",
    ):
        assert f"{command}--most-tool 3 --poses 2" in page


def test_limits_are_printed_with_their_sources_and_hold_for_the_session(
    tmp_path: Path, capsys: Capture
) -> None:
    model, out = written(tmp_path, SERVOED), tmp_path / "session"
    command = ["plan", str(model), "--out", str(out), "--poses", "2", "--seconds", "1"]
    limits = ["--max-speed-rad-s", "1", "2", "1.5", "--command-rate-hz", "500"]
    assert main([*command, *limits, "--commands", "position", "--reference"]) == 0
    said = capsys.readouterr().out
    for words in (
        "speed: pan 1 rad/s (--max-speed-rad-s); lift 2 rad/s", "jerk: no limit stated",
        "peak speed of the command", "reference-01.csv", "repeat-01.csv",
    ):  # fmt: skip
        assert words in said
    assert "transit.csv" in said or "is there already" in said
    header = (out / "signal.csv").read_text("utf-8").partition("\n")[0]
    assert header == "time,position.pan,position.lift,position.elbow"
    page = unescape((out / "plan.html").read_text("utf-8"))
    for words in ("Peaks and limits", "--max-speed-rad-s 1 2 1.5", "reference-01.csv"):
        assert words in page
    assert main(command) == 0
    kept = capsys.readouterr().err
    assert "as the earlier plan has it: --max-speed-rad-s 1 2 1.5" in kept
    assert "--reference" in kept
    whole = read(out / "plan.json")
    assert whole["settings"]["max_speed_rad_s"] == [1.0, 2.0, 1.5]
    assert whole["limits"]["speed"]["pan"]["source"] == "--max-speed-rad-s"
    assert main([*command, "--no-reference", "--repeat", "0"]) == 0
    assert [run["kind"] for run in read(out / "plan.json")["runs"]] == ["run"]
    assert not (out / "first-signal.csv").exists()


def test_a_later_command_goes_on_with_what_was_given_last(tmp_path: Path, capsys: Capture) -> None:
    """Limits of the machine, how it is held, and the layout of the signal."""
    model, home = written(tmp_path, SERVOED), tmp_path / "session"
    plan = ["plan", str(model), "--out", str(home)]
    first = ["--poses", "2", "--seconds", "1", "--hold", "brake", "--ramp-s", "0.4"]
    assert main([*plan, *first, "--payload-kg", "0.5", "--most-tool", "4"]) == 0
    hypotheses = read_arm(model).hypotheses
    undecided_of(hypotheses, settings={"most_tool": 3.0}).write(tmp_path / "d" / "result.json")
    plan += ["--known", str(tmp_path / "d")]
    assert main([*plan, "--most-tool", "5"]) == 0
    assert read(home / "plan.json")["settings"]["hold"] == "brake"
    capsys.readouterr()
    assert main([*plan, "--joint", "elbow"]) == 0
    said = capsys.readouterr().err
    settings = read(home / "plan.json")["settings"]
    assert settings["most_tool"] == 5.0 and settings["joint"] == "elbow"
    assert (settings["ramp_s"], settings["hold_s"], settings["payload_kg"]) == (0.4, 0.5, 0.5)
    for words in ("--most-tool 5", "--hold brake", "--ramp-s 0.4", "--payload-kg 0.5"):
        assert words in said


@pytest.mark.parametrize("where", ["next", None])
def test_settings_of_a_result_that_make_no_sense_are_refused_with_file_and_field(
    motors: Path, undecided: Diagnosis, tmp_path: Path, capsys: Capture, where: str | None
) -> None:
    command = ["plan", str(motors), "--known", str(tmp_path / "result.json")]
    for changed, words in (
        ({"gap_mm": "a"}, "gap_mm is a finite number, got 'a'"),
        ({"poses": None}, "poses is a whole number, got None"),
        ({"in_turn": [1]}, r"in_turn is a whole number, got [1]"),
        ({"seconds": 1e9}, "seconds is a length of 0.2 to 600 s"),
        ({"rate_hz": 10**400}, "rate_hz is a finite number"),
    ):
        damaged = json.loads(undecided.to_json())
        if where:
            damaged["next"]["settings"] = changed
        else:
            damaged |= {"settings": changed, "next": None}
        (tmp_path / "result.json").write_text(json.dumps(damaged), "utf-8")
        said = refused(capsys, *command, "--out", str(tmp_path / "o"))
        assert "result.json: " in said and "settings: " in said and words in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{dir}/none.xml", "--out", "{dir}/o"], "there is no file"),
        (["{model}", "--out", "{model}"], "is a file"),
        (["{model}", "--out", "{model}/inside"], "a file lies where a folder is needed"),
        (["{model}", "--out", "{dir}/o", "--known", "{dir}/none.json"], "cannot be read"),
        (["{model}", "--out", "{dir}/o", "--known", "{model}"], "no JSON"),
        (["{model}", "--out", "{dir}/o", "--tool", "hammer"], "no site or body 'hammer'"),
        (["{model}", "--out", "{dir}/o", "--seconds", "-1"], "seconds is a length of 0.2 to 600 s"),
        (["{model}", "--out", "{dir}/o", "--max-jerk-rad-s3", "1", "2", "3"], "of lift, elbow"),
        (["{model}", "--out", "{dir}/o", "--repeat", "-1"], "repeat is a whole number from 0 to"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    motors: Path, tmp_path: Path, capsys: Capture, arguments: list[str], words: str
) -> None:
    given = [a.format(dir=tmp_path, model=motors) for a in arguments]
    assert words in refused(capsys, "plan", *given, "--poses", "2")
    assert not (tmp_path / "o").exists()


def measured(home: Path) -> Path:
    """What somebody at the machine does with the folder: play the signal, save the readings."""
    plan, step = read(home / "plan.json"), 2e-4
    (one,) = plan["signals"]
    signal = np.genfromtxt(home / one["csv"], delimiter=",", names=True, deletechars="")
    spec = mujoco.MjSpec.from_file(str(home / "recording" / "model.xml"))
    spec.option.timestep = step
    model = spec.compile()
    data = mujoco.MjData(model)
    for joint, q in plan["pose"].items():
        data.qpos[model.joint(joint).qposadr[0]] = q
    given = np.array([signal[f"ctrl.{model.actuator(a).name}"] for a in range(model.nu)]).T
    data.ctrl[:] = given[0]
    mujoco.mj_step(model, data, round(1.0 / step))
    rows, rng = [], np.random.default_rng(1)
    for command in given:
        mujoco.mj_forward(model, data)
        rows.append(data.sensordata.copy())
        data.ctrl[:] = command
        mujoco.mj_step(model, data, round(1 / (step * plan["rate_hz"])))
    columns, readings = {}, np.array(rows)
    for name in plan["columns"]:
        group, _, rest = name.partition(".")
        sensor, _, axis = rest.partition(".")
        if group == "sensor":
            at = int(model.sensor(sensor).adr[0]) + ("xyz".index(axis) if axis else 0)
            columns[name] = readings[:, at] + rng.normal(0, 0.01 if axis else 1e-6, len(rows))
        else:
            columns[name] = signal[name]
    write_csv(home / one["run"], columns)
    return home / str(one["run"])


@pytest.mark.slow
def test_plan_and_diagnosis_take_turns_in_one_folder_under_the_limits_of_the_first_plan(
    tmp_path: Path, capsys: Capture
) -> None:
    model, home = str(written(tmp_path, SERVOED)), tmp_path / "session"
    found, plan = home / "diagnosis", ["plan", model, "--out", str(home)]
    limits = ["--most-tool", "4", "--ground-m", "0.1", "--poses", "4", "--seconds", "1.2"]
    assert main([*plan, *limits, "--max-speed-rad-s", "4"]) == 0
    poses = [read(home / "plan.json")["pose"]]
    for number in (1, 2):
        assert measured(home).name == f"run-0{number}.csv"
        capsys.readouterr()
        given = ["diagnose", str(home / "recording"), "--out", str(found), "--quiet"]
        assert main(given) == 0
        said = capsys.readouterr().err
        assert "as the plan beside the recording has it:" in said and "--most-tool 4" in said
        result = read(found / "result.json")
        assert len(result["records"]) == number
        assert sum(result["posterior"].values()) == pytest.approx(1.0, abs=1e-5)
        assert result["verdict"] == "open"  # two short runs decide nothing about a sound arm
        asked = result["next"]
        assert result["settings"]["most_tool"] == asked["settings"]["most_tool"] == 4.0
        assert asked["settings"]["ground_m"] == 0.1
        assert main([*plan, "--known", str(found)]) == 0
        assert "asks for next" not in capsys.readouterr().err
        made = read(home / "plan.json")
        assert made["pose"] == pytest.approx(asked["pose"])
        assert made["joints"] == asked["joints"] and made["seconds"] == 1.2
        assert made["signals"][0]["tool_acceleration_rms"] < 4.4
        poses.append(made["pose"])
    listed = read(home / "recording" / "recording.json")["runs"]
    files = ["run-01.csv", "run-02.csv", "run-03.csv", "repeat-01.csv"]
    assert [run["file"] for run in listed] == files
    assert [run["pose"] for run in listed] == [pytest.approx(q) for q in (*poses, poses[0])]
    damaged = read(home / "plan.json")
    for changed in ({"most_tool": "a"}, {"poses": 1e9}, None, []):
        damaged["settings"] = changed
        (home / "plan.json").write_text(json.dumps(damaged), "utf-8")
        assert "plan.json: settings" in refused(capsys, *given)


def of_a_month(folder: Path, month: int, *, worn: int = 0) -> Path:
    case = machine(0, 3)
    runs = session_runs(case, month, "play", worn)
    write_recording(folder, model_xml=model_xml(case.arm.figures), runs=runs)
    return folder


@pytest.mark.slow
def test_a_machine_that_got_play_has_changed_and_pages_say_since_when(
    tmp_path: Path, capsys: Capture
) -> None:
    pytest.importorskip("numba")
    old = [tmp_path / f"m{month}" for month in range(MONTHS)]
    for month, folder in enumerate(old):
        of_a_month(folder / "recording", month)
        if month:  # the first is without a result, and diagnosed
            found = diagnose(read_recording(folder / "recording"), plan=False)
            replace(found, date=f"2026-0{month + 1}-10").write(folder / "result.json")
    new = of_a_month(tmp_path / "new", MONTHS, worn=8)
    work = tmp_path / "work.json"
    work.write_text(json.dumps([{"date": "2026-01-02", "joint": "joint1", "work": "oil"}]))
    given = [str(new), "--out", str(tmp_path / "out"), "--poses", "2", "--date", "2026-09-01"]
    more = ["--maintenance", str(work), "--false-alarm-rate", "0.1"]
    assert main(["diagnose", *given, "--before", *map(str, old[1:]), *more]) == 0
    said = capsys.readouterr().out
    assert "changed since earlier sessions" in said and "since 2026-09-01" in said
    whole = read(tmp_path / "out" / "trend.json")
    assert [each["date"] for each in whole["sessions"]][-1] == "2026-09-01"
    assert "alarm since 2026-09-01" in (tmp_path / "out" / "trend.html").read_text("utf-8")
    result = read(tmp_path / "out" / "result.json")
    assert result["date"] == "2026-09-01" and len(result["model_hash"]) == 16
    assert main(["diagnose", *given, "--before", str(old[0])]) == 0
    said_both = capsys.readouterr()
    assert "diagnosing the earlier session" in said_both.err
    assert "not compared" in said_both.out  # one earlier session has no scatter
    # Without --before the same folder no longer tells of a trend.
    assert main(["diagnose", *given, "--quiet"]) == 0
    assert not (tmp_path / "out" / "trend.html").exists()
    assert not (tmp_path / "out" / "trend.json").exists()


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, and beside it the result of an earlier session."""
    home = tmp_path_factory.mktemp("healthy")
    write_shaken_recording(home / "recording", **DIAGNOSES["healthy, flat"])
    arm = read_recorded_arm(home / "recording" / "model.xml")
    undecided_of(arm.hypotheses).write(home / "earlier" / "result.json")
    return home


@pytest.mark.parametrize(
    ("options", "work", "words"),
    [
        (["--before", "no/such/session"], None, "no such file or folder"),
        (["--maintenance", "work.json"], None, "--before"),
        (["--date", "yesterday"], None, "2026-05-04"),
        (["--false-alarm-rate", "2"], None, "at most 0.2"),
        ([], "", "no JSON from line 1 on; records are as"),
        ([], '[{"date": "2026-05-04", "joint": "knee", "work": "oil"}]', "no joint or link 'knee'"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_diagnosed(
    options: list[str], work: str | None, words: str, healthy: Path, tmp_path: Path, capsys: Capture
) -> None:
    if work is not None:
        (tmp_path / "work.json").write_text(work)
        maintenance = ["--maintenance", str(tmp_path / "work.json")]
        options = ["--before", str(healthy / "earlier"), *maintenance]
    given = ["diagnose", str(healthy / "recording"), "--out", str(tmp_path / "out")]
    said = refused(capsys, *given, *options)
    assert words in said and (work is None or "work.json" in said)
    assert not (tmp_path / "out").exists()
