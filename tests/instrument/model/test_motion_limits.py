"""Limits of joint motion: of the settings, of the model file, assumed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.model.instrumented_arm import read_arm
from loose_env.instrument.model.motion_limits import motion_limits
from loose_env.instrument.settings.motion import MotionSettings
from tests.instrument.arms.plan_arms import MOTORS, SERVOED, URDF, written


def test_a_urdf_states_its_speeds(tmp_path: Path) -> None:
    text = URDF.replace('effort="80" velocity="2"', 'effort="80" velocity="1.5" jerk="900"')
    limits = motion_limits(read_arm(written(tmp_path, text, "arm.urdf")))
    assert limits.values["speed"].tolist() == [1.5, 2.0]
    assert limits.values["jerk"].tolist() == [900.0, np.inf]
    assert limits.sources["speed"][0] == '<limit velocity="1.5"> of arm.urdf'
    assert limits.sources["acceleration"] == ("", "")


def test_of_several_statements_in_a_urdf_the_tightest_counts(tmp_path: Path) -> None:
    control = """<ros2_control name="x" type="system"><joint name="j2">
    <command_interface name="velocity"><param name="min">-1.1</param><param name="max">1.2</param>
    </command_interface></joint></ros2_control></robot>"""
    path = written(tmp_path, URDF.replace("</robot>", control), "arm.urdf")
    limits = motion_limits(read_arm(path))
    assert limits.values["speed"].tolist() == [2.0, 1.1]
    assert "ros2_control velocity command_interface" in limits.sources["speed"][1]


def test_an_mjcf_states_limits_by_the_names_of_the_settings(tmp_path: Path) -> None:
    stated = '<custom><numeric name="max_jerk_rad_s3" data="700 800"/></custom></mujoco>'
    path = written(tmp_path, MOTORS.replace("</mujoco>", stated))
    limits = motion_limits(read_arm(path))
    assert limits.values["jerk"].tolist() == [700.0, 800.0]
    assert limits.sources["jerk"][0] == "<numeric name='max_jerk_rad_s3'> of arm.xml"


def test_a_velocity_actuator_states_the_speed_of_its_joint(tmp_path: Path) -> None:
    text = MOTORS.replace(
        '<motor name="m2" joint="elbow" gear="20" ctrlrange="-1 1"/>',
        '<velocity name="m2" joint="elbow" kv="5" gear="2" ctrlrange="-3 3"/>',
    )
    limits = motion_limits(read_arm(written(tmp_path, text)))
    assert limits.limit("speed", 1) == 1.5
    assert "'m2'" in limits.sources["speed"][1]
    assert limits.sources["speed"][0] == "assumed"


def test_what_is_given_takes_the_place_of_what_is_stated(tmp_path: Path) -> None:
    arm = read_arm(written(tmp_path, URDF, "arm.urdf"))
    limits = motion_limits(arm, MotionSettings(max_speed_rad_s=(4.0, 5.0)))
    assert limits.values["speed"].tolist() == [4.0, 5.0]
    assert limits.sources["speed"] == ("--max-speed-rad-s",) * 2


def test_a_speed_is_assumed_where_none_is_stated(tmp_path: Path) -> None:
    limits = motion_limits(read_arm(written(tmp_path, SERVOED)))
    assert limits.values["speed"].tolist() == [3.14] * 3
    assert set(limits.sources["speed"]) == {"assumed"}
    assert not np.isfinite(limits.values["acceleration"]).any()


def test_limits_of_another_number_of_joints_are_refused(tmp_path: Path) -> None:
    arm = read_arm(written(tmp_path, SERVOED))
    with pytest.raises(InvalidSetting, match=r"max_speed_rad_s .* pan, lift, elbow; got 2"):
        motion_limits(arm, MotionSettings(max_speed_rad_s=(1.0, 2.0)))


@pytest.mark.parametrize("value", ["-2", "fast", "inf"])
def test_a_stated_limit_that_is_no_positive_number_is_refused(tmp_path: Path, value: str) -> None:
    path = written(tmp_path, URDF.replace('velocity="2"', f'velocity="{value}"', 1), "arm.urdf")
    try:
        arm = read_arm(path)
    except InvalidData:
        return  # MuJoCo itself does not read it
    with pytest.raises(InvalidData, match=r"joint 'j1' has a speed limit .*--max-speed-rad-s"):
        motion_limits(arm)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"max_speed_rad_s": (0.0,)}, "max_speed_rad_s is one positive number"),
        ({"max_jerk_rad_s3": (float("nan"),)}, "max_jerk_rad_s3"),
        ({"command_bandwidth_hz": -1.0}, "command_bandwidth_hz is above 0"),
        ({"commands": "force"}, "commands is"),
        ({"signal_format": ("csv", "mat")}, "csv, parquet, ros2, got csv mat"),
        ({"signal_format": ()}, "got none"),
    ],
)
def test_settings_that_make_no_sense_are_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidSetting, match=words):
        MotionSettings(**given)  # type: ignore[arg-type]
