from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import Excitation
from loose_env.instrument.result import NextMeasurement
from loose_env.instrument.session import Session, find_fault
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import read_recording, write_recording
from loose_env.rig import RecordedRig
from scripts.suites.diagnosis.cases import BlindArm
from tests.instrument.arms.blind_arm import case, runs, write_model

QUICK = DiagnoseSettings(poses=3, seconds=1.5)
JOINTS = ("joint1", "joint2", "joint3")


def test_a_session_asks_measures_and_names_the_link(tmp_path: Path) -> None:
    machine = BlindArm(case("slide"))
    seen = []
    ended = find_fault(machine, write_model(tmp_path), QUICK, most=4, say=seen.append)
    assert ended.named and ended.measurements == len(machine.played) == len(seen)
    assert ended.diagnosis.fault.hypothesis == "structural_looseness@link2"
    assert ended.diagnosis.next is None


def test_a_session_begins_with_what_nothing_is_known_of(tmp_path: Path) -> None:
    session = Session(write_model(tmp_path), QUICK)
    wanted = session.next()
    assert wanted is not None and wanted.joints[0] in JOINTS
    assert session.pose(wanted).shape == (3,)
    played = session.excitation(wanted, wanted.joints[0])
    assert played.duration == 1.5 and sum(played.excited) == 1


def test_a_measurement_that_cannot_be_used_changes_nothing(tmp_path: Path) -> None:
    session = Session(write_model(tmp_path), QUICK)
    run = runs("healthy", 1)[0]
    sensors = {k: v for k, v in run.sensors.items() if k != "tool_acc"}
    broken = type(run)(name="x", time=run.time, sensors=sensors, excited=run.excited, pose=run.pose)
    with pytest.raises(InvalidData):
        session.add(broken)
    assert session.add(run).records[0].file == run.name


@pytest.mark.slow
def test_measurements_of_one_name_are_listed_apart(tmp_path: Path) -> None:
    session = Session(write_model(tmp_path), QUICK)
    for run in runs("slide"):
        found = session.add(replace(run, name="run"))
    assert [record.file for record in found.records] == ["run", "run-02"]


@pytest.mark.slow
def test_a_session_that_ends_for_want_of_a_pose_has_named_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Session(write_model(tmp_path), QUICK).next()
    wanted = iter([first])

    def once(*_: object, **__: object) -> NextMeasurement:
        for one in wanted:
            assert one is not None
            return one
        raise InvalidData("no pose will do")

    monkeypatch.setattr("loose_env.instrument.pipeline.next_for", once)
    ended = find_fault(BlindArm(case("slide")), write_model(tmp_path), QUICK, most=4)
    assert ended.measurements == 1
    assert ended.diagnosis.next is None
    assert not ended.named


def test_most_is_one_or_more(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetting, match="most is a number of runs"):
        find_fault(BlindArm(case("slide")), write_model(tmp_path), QUICK, most=0)


def shake(joint: int) -> Excitation:
    torque = np.zeros(3)
    torque[joint] = 1.0
    return Excitation(torque_rms=tuple(torque), duration=1.0, band=(4.0, 100.0))


def test_a_recorded_rig_gives_out_the_nearest_run_once(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", model_xml=write_model(tmp_path), runs=runs("slide"))
    rig = RecordedRig(read_recording(tmp_path / "r"), JOINTS)
    second = runs("slide")[1]
    assert second.pose is not None
    pose = np.array([second.pose[joint] for joint in JOINTS])
    assert rig.measure(pose, shake(2)).name == "run-2.parquet"
    assert rig.measure(pose, shake(2)).name == "run-1.parquet"
    assert rig.left == 0
    with pytest.raises(InvalidData, match="all runs of the recording were given out"):
        rig.measure(pose, shake(2))


def test_a_recording_without_poses_cannot_stand_in_for_a_rig(tmp_path: Path) -> None:
    sound = runs("slide", 1, sound=True)
    write_recording(tmp_path / "r", model_xml=write_model(tmp_path), runs=sound)
    with pytest.raises(InvalidData, match="'pose' and 'excited'"):
        RecordedRig(read_recording(tmp_path / "r"), JOINTS)
