"""Joints with more than one actuator: one holds and plays, the others give nothing."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.instrument.model.actuators import drives_of
from loose_env.instrument.model.holding_commands import holding_commands
from loose_env.instrument.model.instrumented_arm import read_arm, read_recorded_arm
from loose_env.instrument.planning.next_measurement import NextSettings
from loose_env.instrument.planning.plan import plan
from loose_env.instrument.settings.arm_and_plan import PlanSettings
from tests.instrument.arms.plan_arms import doubled, written
from tests.instrument.arms.playing import held, play

MOTOR = '<motor name="lift_motor" joint="lift" gear="30"/>'
SECOND = '<position name="lift_second" joint="lift" kp="300" kv="10"/>'
TACHO = '<velocity name="lift_speed" joint="lift" kv="7"/>'
STIFF = '<general name="lift_spring" joint="lift" gainprm="0" biastype="affine" biasprm="3 -50 0"/>'
POSE = np.array([0.2, -0.4, 0.9])


@pytest.mark.parametrize(
    "further", [(MOTOR,), (SECOND,), (TACHO,), (STIFF,), (MOTOR, SECOND, TACHO, STIFF)]
)
def test_all_together_hold_the_pose_and_none_is_sent_to_zero(
    tmp_path: Path, further: tuple[str, ...]
) -> None:
    machine = read_arm(written(tmp_path, doubled(*further)))
    commands, load_torques = holding_commands(machine, POSE)
    model = machine.recording_model.model
    data = held(model, POSE, commands)
    assert data.qfrc_actuator == pytest.approx(load_torques)
    assert data.qacc == pytest.approx(0.0, abs=1e-6)
    drive = machine.drives[1]
    assert drive is not None and drive.servo  # a servo holds by itself, a motor does not
    for name in ("lift_motor", "lift_second", "lift_speed", "lift_servo"):
        if name in commands and name != drive.actuator:
            force = float(data.actuator_force[model.actuator(name).id])
            assert force == pytest.approx(0.0, abs=1e-9)
    if "lift_second" in commands:
        other = "lift_servo" if drive.actuator == "lift_second" else "lift_second"
        assert commands[other] == pytest.approx(POSE[1])


def test_a_servo_is_played_rather_than_a_motor_listed_before_it() -> None:
    model = mujoco.MjModel.from_xml_string(doubled(MOTOR))
    (drive,), notes = drives_of(model, ["lift"])
    assert drive is not None and drive.actuator == "lift_servo"
    assert any("lift_motor" in note and "no torque" in note for note in notes)


def test_plan_and_diagnosis_reckon_with_the_same_springs(tmp_path: Path) -> None:
    path = written(tmp_path, doubled(MOTOR, SECOND, TACHO, STIFF))
    made = read_arm(path)
    model = tmp_path / "model.xml"
    model.write_text(made.recording_model.xml, encoding="utf-8")
    drives = read_recorded_arm(model).actuators
    lift = made.joints.index("lift")
    assert made.nominal.centring.stiffness[lift] == drives.stiffness[lift] == 900 + 300 + 50
    assert made.nominal.centring.damping[lift] == drives.damping[lift] == 30 + 10 + 7


def test_what_is_played_does_what_the_plan_says(tmp_path: Path) -> None:
    few = NextSettings(poses=4, seconds=1.2)
    path = written(tmp_path, doubled(SECOND, TACHO))
    made = plan(path, choice=few, own=PlanSettings(joint="lift"))
    signal, did = made.signals[0], play(made, step=5e-5)
    assert did.tool_rms == pytest.approx(signal.tool_rms, rel=0.05)
    assert did.joint_rms == pytest.approx(signal.joint_rms, rel=0.05)


def test_the_joint_of_an_actuator_without_gain_is_known(tmp_path: Path) -> None:
    passive = STIFF.replace("lift", "elbow")
    made = read_arm(written(tmp_path, doubled(passive)))
    model = tmp_path / "model.xml"
    model.write_text(made.recording_model.xml, encoding="utf-8")
    machine = read_recorded_arm(model)
    assert machine.joints[machine.actuators.driven_joint("elbow_spring")] == "elbow"
