"""Which pose a run holds, and what is said where nobody knows."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from loose_env.errors import InvalidData
from loose_env.instrument.data.held_pose import run_setup
from loose_env.instrument.model.instrumented_arm import read_recorded_arm
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.planning.prior_knowledge import known_of
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run
from tests.instrument.arms.blind_arm import runs, write_model


def without(run: Run, *sensors: str) -> Run:
    left = {name: values for name, values in run.sensors.items() if name not in sensors}
    return dataclasses.replace(run, sensors=left)


def test_actuators_that_are_named_like_joints_do_not_make_a_pose_known(tmp_path: Path) -> None:
    path = write_model(tmp_path)
    text = path.read_text("utf-8")
    for joint in ("1", "2", "3"):
        text = text.replace(f'name="motor{joint}"', f'name="joint{joint}"')
    path.write_text(text, encoding="utf-8")
    run = without(runs("healthy", 1)[0], "joint1_pos", "joint2_pos", "joint3_pos")
    named = {name.replace("motor", "joint"): u for name, u in run.controls.items()}
    run = dataclasses.replace(run, controls=named, pose=None)
    with pytest.raises(InvalidData, match="the pose is not known"):
        run_setup(read_recorded_arm(path), run)


def test_a_pose_that_leaves_out_a_joint_that_nothing_reads_is_refused(tmp_path: Path) -> None:
    machine = read_recorded_arm(write_model(tmp_path))
    run = runs("healthy", 1)[0]
    assert run.pose is not None
    partial = {joint: q for joint, q in run.pose.items() if joint != "joint2"}
    run = dataclasses.replace(run, pose=partial)
    assert run_setup(machine, run).pose[1] == pytest.approx(0.62, abs=0.02)  # its encoder says
    with pytest.raises(InvalidData, match="position of joint2 was recorded"):
        run_setup(machine, without(run, "joint2_pos"))


@pytest.mark.parametrize(
    ("without_commands", "torque", "source"),
    [(False, False, "commands"), (True, True, "torques"), (True, False, "positions")],
)
def test_a_note_says_which_columns_tell_the_excited_joint(
    tmp_path: Path, without_commands: bool, torque: bool, source: str
) -> None:
    machine = read_recorded_arm(write_model(tmp_path))
    run = dataclasses.replace(runs("healthy", 1)[0], excited=())
    noise = max(run.controls.values(), key=lambda u: float(u.std()))
    if without_commands:
        run = dataclasses.replace(run, controls={}, torques={"joint1": noise} if torque else {})
    assert any(f"taken from the {source}: " in note for note in run_setup(machine, run).notes)


def test_the_pose_of_a_record_is_the_one_that_was_reckoned_with(tmp_path: Path) -> None:
    run = runs("healthy", 1)[0]
    assert run.pose is not None
    bench = Workbench(write_model(tmp_path), DiagnoseSettings(poses=2, seconds=1.0))
    bench.add(dataclasses.replace(run, pose={**run.pose, "joint1": 0.5}))
    seen = bench.diagnosis(plan=False).records[0]
    assert seen.pose["joint1"] == pytest.approx(run.pose["joint1"], abs=0.02)
    assert seen.pose["joint2"] == run.pose["joint2"]  # as it was noted, a round number
    assert any("joint1 by" in note for note in seen.notes)


def test_a_run_that_could_not_be_used_has_no_pose_but_what_was_noted(tmp_path: Path) -> None:
    run = without(runs("healthy", 1)[0], "tool_acc")
    bench = Workbench(write_model(tmp_path), DiagnoseSettings(poses=2, seconds=1.0))
    bench.leave_out(dataclasses.replace(run, pose={"joint1": 0.5}), "no accelerometer")
    bench.add(runs("healthy", 1)[0])
    found = bench.diagnosis(plan=False)
    assert found.records[0].pose == {"joint1": 0.5}
    known = known_of(found, bench.arm.links, bench.arm.joints)
    assert len(known.records) == 1
