"""Files of a plan: JointTrajectory messages, repeats of the first run, references."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.planning.files.plan_files import PlanFiles, write_plan
from loose_env.instrument.planning.files.ros_trajectory import trajectory_text
from loose_env.instrument.planning.next_measurement import NextSettings
from loose_env.instrument.planning.plan import Plan, plan
from loose_env.instrument.settings.arm_and_plan import PlanSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.recording import read_recording, write_csv
from tests.instrument.arms.plan_arms import MOTORS, SERVOED, written
from tests.instrument.arms.playing import play

FEW = NextSettings(poses=2, seconds=1.0)
ROS = MotionSettings(signal_format=("ros2",), command_rate_hz=250.0)


@pytest.fixture(scope="module")
def servoed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("servoed"), SERVOED)


@pytest.fixture(scope="module")
def first(servoed: Path) -> Plan:
    return plan(servoed, choice=FEW, own=PlanSettings(reference=True, repeat=2))


def files(folder: Path, made: Plan) -> PlanFiles:
    return PlanFiles(folder, made.arm.recording_model.xml)


def message(path: Path) -> dict[str, object]:
    whole = yaml.safe_load(path.read_text("utf-8"))
    assert isinstance(whole, dict)
    return whole


def test_a_trajectory_has_the_fields_of_the_message(servoed: Path, tmp_path: Path) -> None:
    made = plan(servoed, choice=FEW, motion=ROS)
    write_plan(files(tmp_path, made), made)
    assert not (tmp_path / "signal.csv").exists()
    whole = message(tmp_path / "signal.yaml")
    assert set(whole) == {"header", "joint_names", "points"}
    assert whole["joint_names"] == ["pan", "lift", "elbow"]
    points = whole["points"]
    assert isinstance(points, list)
    assert len(points) == len(made.signals[0].time)
    for point in (points[0], points[-1]):
        assert set(point) == {
            "positions", "velocities", "accelerations", "effort", "time_from_start",
        }  # fmt: skip
        assert all(isinstance(x, int | float) for x in point["positions"])
        assert point["velocities"] == [0, 0, 0]
    assert points[0]["positions"] == pytest.approx(made.pose)
    at = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    assert np.diff(at) == pytest.approx(np.full(len(at) - 1, 0.004))
    assert at[0] == pytest.approx(0.004)


def test_a_trajectory_of_servos_with_gears_holds_positions_of_the_joints(
    servoed: Path, tmp_path: Path
) -> None:
    made = plan(servoed, choice=FEW, own=PlanSettings(joint="elbow"), motion=ROS)
    write_plan(files(tmp_path, made), made)
    points = message(tmp_path / "signal.yaml")["points"]
    assert isinstance(points, list)
    elbow = np.array([point["positions"][2] for point in points])
    assert elbow == pytest.approx(made.signals[0].commands["elbow_servo"] / 2, abs=1e-8)


@pytest.mark.parametrize("kind", ["velocity", "torque"])
def test_a_trajectory_of_another_kind_says_where_the_joints_are_too(
    servoed: Path, tmp_path: Path, kind: str
) -> None:
    motion = MotionSettings(signal_format=("ros2", "csv"), commands=kind)  # type: ignore[arg-type]
    made = plan(servoed, choice=FEW, motion=motion)
    write_plan(files(tmp_path, made), made)
    points = message(tmp_path / "signal.yaml")["points"]
    assert isinstance(points, list)
    j = made.arm.joints.index(made.signals[0].joint)
    field = "velocities" if kind == "velocity" else "effort"
    played = made.signals[0].played[f"{kind}.{made.signals[0].joint}"]
    assert [point[field][j] for point in points] == pytest.approx(played, rel=1e-7, abs=1e-12)
    assert points[-1]["positions"] == pytest.approx(made.pose, abs=1e-6)


def test_numbers_with_exponents_are_numbers_in_yaml() -> None:
    values = np.array([[1e-7], [-2.5e-12], [1e22]])
    text = trajectory_text(("a",), "torque", np.arange(3) / 10, values, np.zeros(1))
    efforts = [point["effort"][0] for point in yaml.safe_load(text)["points"]]
    assert efforts == pytest.approx([1e-7, -2.5e-12, 1e22])


def test_a_trajectory_of_several_kinds_is_refused_before_anything_is_written(
    tmp_path: Path,
) -> None:
    mixed = SERVOED.replace(
        '<position name="pan_servo" joint="pan" kp="800" kv="30" forcerange="-80 80" '
        'ctrlrange="-3 3"/>',
        '<motor name="pan_servo" joint="pan" ctrlrange="-80 80"/>',
    )
    made = plan(written(tmp_path, mixed), choice=FEW, motion=ROS)
    with pytest.raises(InvalidSetting, match=r"one kind of command for all joints.*--commands"):
        write_plan(files(tmp_path / "out", made), made)
    assert not (tmp_path / "out").exists()


def test_motors_make_a_trajectory_of_torques(tmp_path: Path) -> None:
    made = plan(written(tmp_path, MOTORS), choice=FEW, motion=ROS)
    write_plan(files(tmp_path / "out", made), made)
    point = message(tmp_path / "out" / "signal.yaml")["points"][0]  # type: ignore[index]
    assert point["effort"][1] == pytest.approx(20 * made.signals[0].commands["m2"][0], rel=1e-6)


def test_repeats_and_references_are_listed_with_reasons_and_may_be_missing(
    first: Plan, tmp_path: Path
) -> None:
    write_plan(files(tmp_path, first), first)
    listed = json.loads((tmp_path / "recording" / "recording.json").read_text("utf-8"))["runs"]
    assert [run["file"] for run in listed] == [
        "run-01.csv", "repeat-01.csv", "repeat-02.csv", "reference-01.csv",
    ]  # fmt: skip
    assert [run.get("planned", False) for run in listed] == [False, True, True, True]
    assert listed[-1]["condition"] == "healthy"
    runs = json.loads((tmp_path / "plan.json").read_text("utf-8"))["runs"]
    assert "drift and scatter" in runs[1]["reason"]
    assert "healthy machine" in runs[3]["reason"]
    recording = tmp_path / "recording"
    write_csv(recording / "run-01.csv", play(first).columns)
    assert [run.name for run in read_recording(recording).runs] == ["run-01.csv"]
    write_csv(recording / "reference-01.csv", play(first).columns)
    found = read_recording(recording).runs
    assert [run.condition for run in found] == ["suspect", "healthy"]


def test_later_plans_repeat_the_first_run_of_the_session(
    servoed: Path, first: Plan, tmp_path: Path
) -> None:
    write_plan(files(tmp_path, first), first)
    signal = (tmp_path / "first-signal.csv").read_text("utf-8")
    assert signal == (tmp_path / "signal.csv").read_text("utf-8")
    write_csv(tmp_path / "recording" / "run-01.csv", play(first).columns)
    own = PlanSettings(pose_deg=(20.0, -60.0, 70.0), joint="elbow")
    later = plan(servoed, choice=FEW, own=own)
    write_plan(files(tmp_path, later), later)
    assert (tmp_path / "first-signal.csv").read_text("utf-8") == signal
    runs = json.loads((tmp_path / "plan.json").read_text("utf-8"))["runs"]
    repeat = next(run for run in runs if run["kind"] == "repeat")
    assert repeat["pose"] == pytest.approx(dict(first.next.pose))
    assert repeat["joint"] == first.next.joints[0]
    assert repeat["signal"] == "first-signal"


def test_a_plan_keeps_its_limits_and_their_sources(first: Plan, tmp_path: Path) -> None:
    write_plan(files(tmp_path, first), first)
    whole = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    assert whole["limits"]["speed"]["lift"] == {"limit": 3.14, "source": "assumed"}
    assert whole["limits"]["jerk"]["lift"] == {"limit": None, "source": None}
    peaks = whole["signals"][0]["peaks"]
    assert {"joint", "quantity", "of", "value", "limit", "source", "unit"} == set(peaks[0])
    assert all(p["limit"] is None or p["value"] <= p["limit"] * (1 + 1e-9) for p in peaks)


def test_the_way_to_the_pose_is_written_with_its_duration(servoed: Path, tmp_path: Path) -> None:
    own = PlanSettings(from_deg=(40.0, -30.0, 50.0), pose_deg=(20.0, -60.0, 70.0))
    made = plan(servoed, choice=FEW, own=own)
    write_plan(files(tmp_path, made), made)
    whole = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    table = np.genfromtxt(tmp_path / "transit.csv", delimiter=",", names=True)
    assert table["time"][-1] == pytest.approx(whole["transit"]["duration_s"])
    begin, end = ([table[f"position{j}"][k] for j in made.arm.joints] for k in (0, -1))
    assert begin == pytest.approx(np.radians([40.0, -30.0, 50.0]))
    assert end == pytest.approx(made.pose)
    assert whole["transit"]["from_origin"] == "as given"


def test_a_recording_of_planned_runs_alone_says_that_none_is_measured(tmp_path: Path) -> None:
    (tmp_path / "model.xml").write_text(MOTORS, "utf-8")
    runs = [{"file": "repeat-01.csv", "planned": True}]
    whole = {"format": "loose-recording/1", "model": "model.xml", "runs": runs}
    (tmp_path / "recording.json").write_text(json.dumps(whole), "utf-8")
    with pytest.raises(InvalidData, match=r"none of the planned runs .* repeat-01\.csv"):
        read_recording(tmp_path)
    whole["runs"] = [{"file": "repeat-01.csv", "planned": "yes"}]
    (tmp_path / "recording.json").write_text(json.dumps(whole), "utf-8")
    with pytest.raises(InvalidData, match=r"planned: true or false is needed"):
        read_recording(tmp_path)
