"""A session at the machine on the command line alone: plan, measure, diagnose, plan again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.recording import write_csv
from tests.instrument.arms.plan_arms import SERVOED, written

STEP = 2e-4


def measured(session: Path) -> Path:
    """What somebody at the machine does with the folder: play the signal, save the readings."""
    plan = read(session / "plan.json")
    (one,) = plan["signals"]
    signal = np.genfromtxt(session / one["csv"], delimiter=",", names=True, deletechars="")
    spec = mujoco.MjSpec.from_file(str(session / "recording" / "model.xml"))
    spec.option.timestep = STEP
    model = spec.compile()
    data = mujoco.MjData(model)
    for joint, q in plan["pose"].items():
        data.qpos[model.joint(joint).qposadr[0]] = q
    given = np.array([signal[f"ctrl.{model.actuator(a).name}"] for a in range(model.nu)]).T
    data.ctrl[:] = given[0]
    for _ in range(round(1.0 / STEP)):
        mujoco.mj_step(model, data)
    columns: dict[str, list[float]] = {name: [] for name in plan["columns"]}
    each = round(1 / (STEP * plan["rate_hz"]))
    rng = np.random.default_rng(1)
    for row, command in zip(signal, given, strict=True):
        mujoco.mj_forward(model, data)
        for name, values in columns.items():
            values.append(reading(model, data, name, row, rng))
        data.ctrl[:] = command
        for _ in range(each):
            mujoco.mj_step(model, data)
    path = session / one["run"]
    write_csv(path, {name: np.array(values) for name, values in columns.items()})
    return path


def reading(model: Any, data: Any, name: str, row: Any, rng: np.random.Generator) -> float:
    group, _, rest = name.partition(".")
    if group != "sensor":
        return float(row[name])
    sensor, _, axis = rest.partition(".")
    at = int(model.sensor(sensor).adr[0]) + ("xyz".index(axis) if axis else 0)
    return float(data.sensordata[at] + rng.normal(0, 0.01 if axis else 1e-6))


def read(path: Path) -> dict[str, Any]:
    whole: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return whole


def test_plan_and_diagnosis_take_turns_in_one_folder_under_the_limits_of_the_first_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, session = str(written(tmp_path, SERVOED)), tmp_path / "session"
    found = session / "diagnosis"
    limits = ["--most-tool", "4", "--ground-m", "0.1", "--poses", "4", "--seconds", "1.2"]
    limits += ["--max-speed-rad-s", "4"]
    assert main(["plan", model, "--out", str(session), *limits]) == 0
    poses = [read(session / "plan.json")["pose"]]
    for number in (1, 2):
        assert measured(session).name == f"run-0{number}.csv"
        capsys.readouterr()
        given = ["diagnose", str(session / "recording"), "--out", str(found), "--quiet"]
        assert main(given) == 0
        said = capsys.readouterr().err
        assert "as the plan beside the recording has it:" in said and "--most-tool 4" in said
        result = read(found / "result.json")
        assert len(result["records"]) == number
        assert sum(result["posterior"].values()) == pytest.approx(1.0, abs=1e-5)
        assert result["verdict"] == "open"  # two short runs decide nothing about a sound arm
        assert result["settings"]["most_tool"] == 4.0
        asked = result["next"]
        assert asked is not None
        assert asked["settings"]["most_tool"] == 4.0
        assert asked["settings"]["ground_m"] == 0.1
        assert main(["plan", model, "--out", str(session), "--known", str(found)]) == 0
        assert "asks for next" not in capsys.readouterr().err
        made = read(session / "plan.json")
        assert made["pose"] == pytest.approx(asked["pose"])
        assert made["joints"] == asked["joints"]
        assert made["seconds"] == 1.2
        assert made["signals"][0]["tool_acceleration_rms"] < 4.4
        poses.append(made["pose"])
    listed = read(session / "recording" / "recording.json")["runs"]
    files = ["run-01.csv", "run-02.csv", "run-03.csv", "repeat-01.csv"]
    assert [run["file"] for run in listed] == files
    assert [run["pose"] for run in listed] == [pytest.approx(q) for q in (*poses, poses[0])]


def test_an_option_of_the_diagnosis_takes_the_place_of_the_plans(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, session = str(written(tmp_path, SERVOED)), tmp_path / "session"
    few = ["--poses", "2", "--seconds", "1"]
    assert main(["plan", model, "--out", str(session), "--most-tool", "4", *few]) == 0
    measured(session)
    given = ["diagnose", str(session / "recording"), "--out", str(tmp_path / "d"), "--quiet"]
    assert main([*given, "--most-tool", "3"]) == 0
    assert read(tmp_path / "d" / "result.json")["settings"]["most_tool"] == 3.0
    plan = read(session / "plan.json")
    for changed in ({"most_tool": "a"}, {"poses": 1e9}, None, []):
        plan["settings"] = changed
        (session / "plan.json").write_text(json.dumps(plan), "utf-8")
        capsys.readouterr()
        assert main(given) == 1
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "plan.json: settings" in said


def test_a_later_plan_goes_on_with_what_was_given_last(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Limits of the machine, how it is held, and the layout of the signal."""
    model, session = str(written(tmp_path, SERVOED)), tmp_path / "session"
    few = ["--poses", "2", "--seconds", "1"]
    first = [*few, "--hold", "brake", "--ramp-s", "0.4", "--payload-kg", "0.5"]
    assert main(["plan", model, "--out", str(session), *first]) == 0
    measured(session)
    found = ["--known", str(tmp_path / "d")]
    given = ["diagnose", str(session / "recording"), "--out", str(tmp_path / "d"), "--quiet"]
    assert main(given) == 0
    assert main(["plan", model, "--out", str(session), *found, "--most-tool", "5"]) == 0
    assert read(session / "plan.json")["settings"]["hold"] == "brake"
    capsys.readouterr()
    assert main(["plan", model, "--out", str(session), *found, "--joint", "elbow"]) == 0
    said = capsys.readouterr().err
    settings = read(session / "plan.json")["settings"]
    assert settings["most_tool"] == 5.0
    assert (settings["ramp_s"], settings["hold_s"], settings["payload_kg"]) == (0.4, 0.5, 0.5)
    assert settings["joint"] == "elbow"
    for words in ("--most-tool 5", "--hold brake", "--ramp-s 0.4", "--payload-kg 0.5"):
        assert words in said
