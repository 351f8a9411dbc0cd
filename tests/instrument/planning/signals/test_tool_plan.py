"""Plans whose tool is struck by a hammer or shaken by a shaker."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.errors import InvalidSetting
from loose_env.instrument.model.instrumented_arm import read_arm
from loose_env.instrument.planning.next_measurement import NextSettings
from loose_env.instrument.planning.signals.tool_plan import ToolPlan, plan_tool
from loose_env.instrument.result import Diagnosis, Fault, RecordSeen
from loose_env.instrument.settings.arm_and_plan import ModelSettings, PlanSettings
from tests.instrument.arms.plan_arms import SERVOED, written

FEW = NextSettings(poses=4, seconds=1.0)
HAMMER = ModelSettings(excitation="hammer")


@pytest.fixture(scope="module")
def servoed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("servoed"), SERVOED)


@pytest.fixture(scope="module")
def struck(servoed: Path) -> ToolPlan:
    return plan_tool(servoed, arm=HAMMER, choice=FEW)


def test_the_model_of_the_recording_has_a_sensor_for_the_force(struck: ToolPlan) -> None:
    model = struck.arm.recording_model.model
    sensor = model.sensor("tool_force")
    assert int(sensor.dim[0]) == 3
    assert int(sensor.type[0]) == int(mujoco.mjtSensor.mjSENS_USER)
    assert struck.columns[1:4] == tuple(f"sensor.tool_force.{axis}" for axis in "xyz")


def test_without_a_hammer_the_model_is_as_before(servoed: Path) -> None:
    assert read_arm(servoed).tool_force is None
    assert "tool_force" not in read_arm(servoed).recording_model.xml


def test_directions_are_of_several_axes_and_open_more_with_more_force(
    servoed: Path, struck: ToolPlan
) -> None:
    assert len({run.name[1] for run in struck.runs}) == 2
    pose = tuple(np.degrees(struck.pose))
    weak, hard = (
        plan_tool(servoed, arm=HAMMER, choice=FEW, own=PlanSettings(force_n=f, pose_deg=pose))
        for f in (2.0, 200.0)
    )
    for link in struck.arm.links:
        low = max(run.opens[link] for run in weak.runs)
        high = max(run.opens[link] for run in hard.runs)
        assert low <= high <= 1.0
    assert any("strike harder" in warning for warning in weak.warnings)


def test_a_shaker_gets_a_force_in_the_band(servoed: Path) -> None:
    own = PlanSettings(force_n=12.0)
    made = plan_tool(servoed, arm=ModelSettings(excitation="shaker"), choice=FEW, own=own)
    assert made.signal is not None
    time, force = made.signal["time"], made.signal["force.tool"]
    steady = (time >= 0.25) & (time < 1.25)
    assert np.sqrt(np.mean(force[steady] ** 2)) == pytest.approx(12.0, rel=0.01)
    power = np.abs(np.fft.rfft(force[steady])) ** 2
    frequency = np.fft.rfftfreq(int(steady.sum()), time[1])
    low, high = made.band_hz
    outside = (frequency < low - 2) | (frequency > high + 2)
    assert power[outside].sum() < 1e-3 * power.sum()


def test_poses_that_were_measured_are_not_taken_again(servoed: Path, struck: ToolPlan) -> None:
    names = struck.arm.hypotheses
    posterior = dict.fromkeys(names, 1 / len(names))
    record = RecordSeen(
        file="run-01.csv", pose=struck.next_pose, excited=(), condition="suspect",
        probabilities=posterior,
    )  # fmt: skip
    known = Diagnosis(
        fault=Fault(kind="healthy"), probability=posterior["healthy"], posterior=posterior,
        records=(record,),
    )  # fmt: skip
    later = plan_tool(servoed, known, arm=HAMMER, choice=FEW)
    assert np.abs(later.pose - struck.pose).max() > 0.2
    assert later.start_origin == "the pose of the last run"


def test_a_force_that_makes_no_sense_is_refused() -> None:
    with pytest.raises(InvalidSetting, match="force_n is above 0"):
        PlanSettings(force_n=0.0)


@pytest.mark.parametrize("kind", ["hammer", "shaker"])
def test_the_command_writes_the_sheet_and_the_recording(
    servoed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    out = tmp_path / "session"
    command = ["plan", str(servoed), "--out", str(out), "--excitation", kind, "--poses", "3"]
    assert main([*command, "--reference", "--force-n", "15"]) == 0
    said = capsys.readouterr().out
    assert f"{'strike' if kind == 'hammer' else 'shake'} the tool along" in said
    assert (out / "signal.csv").is_file() == (kind == "shaker")
    listed = json.loads((out / "recording" / "recording.json").read_text("utf-8"))["runs"]
    assert [run["file"] for run in listed] == [
        "run-01.csv", "run-02.csv", "repeat-01.csv", "reference-01.csv", "reference-02.csv",
    ]  # fmt: skip
    assert all("excited" not in run for run in listed)
    whole = json.loads((out / "plan.json").read_text("utf-8"))
    assert whole["excitation"] == kind
    assert whole["force_sensor"] == "tool_force"
    page = (out / "plan.html").read_text("utf-8")
    assert "sensor.tool_force.x" in page
    assert main(command) == 0  # goes on with the settings of before
    assert "--force-n 15" in capsys.readouterr().err
