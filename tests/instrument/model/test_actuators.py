"""What a model's actuators do to its joints."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.instrument.model.actuators import drives_of
from loose_env.instrument.model.clearance import Collisions, Ground
from loose_env.instrument.model.holding_commands import holding_commands
from loose_env.instrument.model.instrumented_arm import read_arm
from tests.instrument.arms.plan_arms import SERVOED, written
from tests.instrument.arms.playing import held


def test_a_servo_behind_a_gear_is_told_at_the_joint() -> None:
    model = mujoco.MjModel.from_xml_string(SERVOED)
    (elbow,), notes = drives_of(model, ["elbow"])
    assert not notes
    assert elbow is not None
    assert (elbow.gain, elbow.stiffness, elbow.damping) == (900.0, 1800.0, 48.0)
    assert (elbow.limit, elbow.lag, elbow.command_range) == (50.0, 0.002, (-5.3, 5.3))


@pytest.mark.parametrize(
    ("actuator", "why"),
    [
        ('<intvelocity name="a" joint="pan" kp="5" actrange="-1 1"/>', "INTEGRATOR"),
        ('<general name="a" joint="pan" gaintype="affine" gainprm="1 2 0"/>', "depends on the"),
        ('<motor name="a" joint="pan" gear="0"/>', "no gain"),
    ],
)
def test_an_actuator_that_is_no_spring_and_gain_is_passed_over(actuator: str, why: str) -> None:
    start, end = SERVOED.index("<actuator>"), SERVOED.index("</mujoco>")
    text = f"{SERVOED[:start]}<actuator>{actuator}</actuator>{SERVOED[end:]}"
    found, notes = drives_of(mujoco.MjModel.from_xml_string(text), ["pan"])
    assert found == (None,)
    assert len(notes) == 1
    assert re.search(why, notes[0])


def test_the_commands_hold_the_model_where_it_is_asked_to_be(tmp_path: Path) -> None:
    machine = read_arm(written(tmp_path, SERVOED))
    pose = np.array([0.2, -0.4, 0.9])
    commands, load_torques = holding_commands(machine, pose)
    data = held(machine.recording_model.model, pose, commands)
    assert data.qacc == pytest.approx(0.0, abs=1e-6)
    assert data.qfrc_actuator == pytest.approx(load_torques)


def test_bodies_that_always_touch_are_no_collision() -> None:
    text = SERVOED.replace('fromto="0 0 0 .4 0 0"', 'fromto="-.2 0 -.25 .4 0 0"')
    look = Collisions.of(mujoco.MjSpec.from_string(text), ["pan", "lift", "elbow"])
    assert not look.touch([0.0, 0.0, 0.0])


def test_a_way_through_the_floor_is_seen_between_two_poses_above_it() -> None:
    look = Collisions.of(mujoco.MjSpec.from_string(SERVOED), ["pan", "lift", "elbow"])
    folded, other = [0.0, -0.5, 0.3], [0.0, 0.9, -0.9]
    assert not look.touch(folded)
    assert not look.touch(other)
    low = [0.0, 1.3, 0.2]
    assert look.touch_between(folded, low)


def test_a_way_below_the_ground_is_seen_between_two_poses_above_it(tmp_path: Path) -> None:
    ground = Ground.of(read_arm(written(tmp_path, SERVOED)).nominal)
    up, down = np.array([0.0, -0.5, 0.3]), np.array([0.0, 1.3, 0.2])
    over, other = np.array([0.0, 0.0, -1.5]), np.array([0.0, 0.0, 4.7])  # the forearm up
    assert ground.clear(up)
    assert not ground.clear(down)
    assert ground.clear_between(up, over)
    assert ground.clear_between(down, up)  # an arm that stands too low is let out
    assert not ground.clear_between(up, down)
    high = Ground.of(ground.arm, 0.3)
    assert high.clear(over) and high.clear(other)
    assert not high.clear_between(over, other)


def test_links_without_shapes_are_named() -> None:
    geom = '<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" density="900"/>'
    bare = '<inertial mass="1" pos=".2 0 0" diaginertia=".01 .01 .01"/>'
    text = SERVOED.replace(geom, bare)
    look = Collisions.of(mujoco.MjSpec.from_string(text), ["pan", "lift", "elbow"])
    assert look.known
    assert look.unseen == ("upper",)
    whole = Collisions.of(mujoco.MjSpec.from_string(SERVOED), ["pan", "lift", "elbow"])
    assert whole.unseen == ()


def test_an_arm_that_hangs_has_no_ground(tmp_path: Path) -> None:
    hanging = SERVOED.replace(
        '<body name="post" pos="0 0 .25">', '<body name="post" pos="0 0 2" quat="0 1 0 0">'
    )
    arm = read_arm(written(tmp_path, hanging)).nominal
    assert Ground.of(arm).height == -float("inf")
    assert Ground.of(arm, 0.5).height == 0.5
