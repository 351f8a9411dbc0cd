"""Every arm held by brakes, by servos and behind elastic gears."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.arms import (
    Arm,
    Gears,
    LinearArm,
    Mismatch,
    arm_from_file,
    planar,
    scara,
    servoed,
    six_axis,
    vera,
    with_compliance,
)
from loose_env.arms.holding import BARE_ROTOR
from loose_env.diagnosis import SensorFloor, predict, statistics_of, variants
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, hypotheses
from loose_env.rig import SimulatedRig
from loose_env.sensors import SensorSuite
from scripts.thesis.rigs import cylindrical

QUIET = SensorFloor(joint=0.0, tool=0.0)

BARE_FILE = """<mujoco><compiler autolimits="true"/><worldbody>
<body name="upper"><joint name="gear1" axis="0 1 0" range="-90 90" actuatorfrcrange="-60 60"/>
  <inertial pos=".2 0 0" mass="3" diaginertia=".01 .04 .04"/>
  <body name="lower" pos=".4 0 0"><joint name="lift" type="slide" axis="1 0 0" range="-.1 .1"
      actuatorfrcrange="-200 200" armature="1"/>
    <inertial pos=".1 0 0" mass="1.5" diaginertia=".003 .01 .01"/>
    <body name="hand" pos=".2 0 0"><joint name="turn" axis="0 0 1" range="-90 90"
        actuatorfrcrange="-20 20" armature=".02"/>
      <inertial pos=".1 0 0" mass=".8" diaginertia=".001 .003 .003"/>
      <site name="tool" pos=".2 .05 0"/></body></body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def bare_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "bare.xml"
    path.write_text(BARE_FILE)
    return path


ARMS: dict[str, Any] = {
    "planar3": lambda hold: planar(3, hold=hold),
    "planar4v": lambda hold: planar(4, vertical=True, hold=hold),
    "vera": lambda hold: vera(hold=hold),
    "six_axis": lambda hold: six_axis(hold=hold),
    "scara": lambda hold: scara(hold=hold),
    "cylindrical": lambda hold: cylindrical(hold=hold),
}


def arm_of(name: str, hold: str, bare_file: Path) -> Arm:
    if name == "bare":
        return arm_from_file(bare_file, hold=hold)  # type: ignore[arg-type]
    made: Arm = ARMS[name](hold)
    return made


EVERY = [*ARMS, "bare"]


@pytest.mark.parametrize("name", EVERY)
def test_every_arm_has_all_three_holdings(name: str, bare_file: Path) -> None:
    brake, servo, soft = (arm_of(name, h, bare_file) for h in ("brake", "servo", "compliant"))
    assert (brake.name, servo.name, soft.name) == (name, f"{name}-servo", f"{name}-compliant")
    assert (brake.hold, servo.hold, soft.hold) == ("brake", "servo", "compliant")
    assert servo.holding == brake.servo
    assert soft.holding == brake.brake  # motors are braked
    assert brake.gear_joints == () == servo.gear_joints
    assert len(soft.gear_joints) == soft.n
    assert soft.joints == brake.joints  # a file may call a joint as a gear would be called
    assert not set(soft.gear_joints) & set(soft.joints)
    for joint, gear in zip(soft.joints, soft.gear_joints, strict=True):
        motor, spring = soft.model.joint(joint), soft.model.joint(gear)
        assert spring.type[0] == motor.type[0]
        assert spring.bodyid[0] == motor.bodyid[0]
        assert spring.dofadr[0] == motor.dofadr[0] + 1  # the motor is nearer the base
        np.testing.assert_array_equal(spring.axis, motor.axis)
        assert spring.stiffness[0] > 0
        assert soft.model.dof_damping[spring.dofadr[0]] > 0


@pytest.mark.parametrize("name", EVERY)
def test_with_stiff_gears_the_arm_feels_as_before(name: str, bare_file: Path) -> None:
    rigid, soft = (arm_of(name, h, bare_file) for h in ("brake", "compliant"))
    before, after = LinearArm(rigid, points=2), LinearArm(soft, points=2)
    pose = rigid.random_pose(np.random.default_rng(1))
    a, b = before.at(pose), after.at(pose)
    np.testing.assert_allclose(b.kinematic, a.kinematic, atol=1e-12)
    np.testing.assert_allclose(b.gravity_torque, a.gravity_torque, rtol=1e-3, atol=1e-9)
    old = a.inertia[np.ix_(before.joint_dofs, before.joint_dofs)]
    new = b.inertia[np.ix_(after.joint_dofs, after.joint_dofs)]
    if name == "bare":  # a joint without a rotor gets one, and nothing else changes
        added = BARE_ROTOR * old[0, 0]
        assert 0 < new[0, 0] - old[0, 0] <= 1.5 * added
        new[0, 0] = old[0, 0]
    scale = np.sqrt(np.outer(np.diag(old), np.diag(old)))
    # Wheels taken off the rotors turn with the joints before them, too.
    assert np.abs((new - old) / scale).max() < 0.02


def test_a_gear_as_stiff_as_a_brake_is_refused() -> None:
    with pytest.raises(InvalidSetting, match=r"joint \d is too stiff.*hold='brake'"):
        with_compliance(planar(3), Gears(mode_hz=3000.0))


# --- settings


def mode_of(arm: Arm, joint: int) -> float:
    """Mode of one gear at the zero pose, everything else held [Hz]."""
    linear = LinearArm(arm, points=2)
    dof = int(linear.model.joint(arm.gear_joints[joint]).dofadr[0])
    inertia = linear.at(np.zeros(arm.n)).inertia[dof, dof]
    stiffness = float(arm.model.joint(arm.gear_joints[joint]).stiffness[0])
    return float(np.sqrt(stiffness / inertia) / (2 * np.pi))


def test_a_gear_has_the_mode_that_was_asked_for() -> None:
    arm = with_compliance(planar(3), Gears(mode_hz=(20.0, 30.0, 70.0), damping_ratio=0.1))
    assert [mode_of(arm, j) for j in range(3)] == pytest.approx([20, 30, 70], rel=0.02)
    spring = arm.model.joint("gear2")
    ratio = spring.damping[0] / (2 * spring.stiffness[0] / (2 * np.pi * 30.0))
    assert ratio == pytest.approx(0.1, rel=0.02)


def test_stiffness_is_taken_as_given_and_gears_can_be_changed() -> None:
    arm = with_compliance(six_axis(), Gears(stiffness=2e4))
    assert {float(arm.model.joint(g).stiffness[0]) for g in arm.gear_joints} == {2e4}
    again = with_compliance(arm, Gears(mode_hz=20.0))
    assert again.rigid is arm.rigid
    assert again.gear_joints == arm.gear_joints
    assert again.model.nq == arm.model.nq


def test_servos_take_a_bandwidth_and_stand_behind_gears() -> None:
    arm = servoed(planar(3), mode_hz=(10.0, 20.0, 40.0), damping_ratio=0.7)
    inertia = np.array(planar(3).servo.stiffness) / (2 * np.pi * 25.0) ** 2
    wanted = inertia * (2 * np.pi * np.array([10.0, 20.0, 40.0])) ** 2
    np.testing.assert_allclose(arm.holding.stiffness, wanted, rtol=0.01)
    damping = 2 * 0.7 * np.sqrt(wanted * inertia)
    np.testing.assert_allclose(arm.holding.damping, damping, rtol=0.01)
    both = servoed(with_compliance(planar(3)))
    assert (both.name, both.hold) == ("planar3-compliant-servo", "servo")
    assert both.gear_joints == ("gear1", "gear2", "gear3")
    assert with_compliance(servoed(planar(3))).hold == "compliant"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"stiffness": (1e4, 1e4)}, "one for each of 3 joints"),
        ({"stiffness": -1.0}, "positive"),
        ({"stiffness": "stiff"}, "positive"),
        ({"mode_hz": 0.0}, "positive"),
        ({"mode_hz": float("nan")}, "positive"),
        ({"damping_ratio": -0.1}, "positive"),
    ],
)
def test_figures_that_make_no_gear_are_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidSetting, match=words):
        with_compliance(planar(3), Gears(**arguments))


def test_other_mistakes_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="one for each of 3 joints"):
        servoed(planar(3), mode_hz=(10.0, 20.0))
    with pytest.raises(InvalidSetting, match="stiffness of the gears"):
        Gears(stiffness=(1e4, -2.0))
    with pytest.raises(InvalidSetting, match="one for each of 3"):
        with_compliance(planar(3), Gears(stiffness=(1e4, 2e4)))
    with pytest.raises(UnknownName, match="'compliant'"):
        planar(3, hold="glue")  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match=r"with_compliance"):
        dataclasses.replace(planar(3), hold="compliant")


# --- on the rig

RECORDS = 6


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("planar3", "bare") else pytest.param(name, marks=pytest.mark.slow)
        for name in EVERY
    ],
)
def test_a_healthy_arm_with_elastic_gears_answers_as_predicted(name: str, bare_file: Path) -> None:
    arm = arm_of(name, "compliant", bare_file)
    rig = SimulatedRig(arm, slots=RECORDS, sensors=SensorSuite.ideal())
    linear = LinearArm(arm)
    rng = np.random.default_rng(5)
    for j in (0, arm.n - 1):
        levels = np.zeros(arm.n)
        levels[j] = 0.5 * arm.levels[0]
        at = linear.at(0.7 * arm.random_pose(rng))
        excitation, _ = at_levels(at, levels, duration=2.4)
        rngs = [np.random.default_rng([5, j, k]) for k in range(RECORDS)]
        measured = rig.measure_all(range(RECORDS), at.pose, excitation, rngs)
        found = [statistics_of(m) for m in measured]
        b = np.array([r.transmission[:, j] for r in found])
        expected = predict(at, excitation, QUIET).transmission[:, 0]
        scatter = np.linalg.norm(b.std(axis=0, ddof=1)) / np.sqrt(RECORDS)
        error = np.linalg.norm(b.mean(axis=0) - expected)
        assert error < 4 * scatter + 0.01 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", ["planar3", "six_axis", "scara", "bare"])
def test_no_fault_makes_an_arm_with_elastic_gears_diverge(name: str, bare_file: Path) -> None:
    arm = arm_of(name, "compliant", bare_file)
    linear = LinearArm(arm)
    sampler = FaultSampler(linear, Difficulty())
    places = hypotheses(arm)[1:]
    rig = SimulatedRig(arm, slots=len(places))
    rng = np.random.default_rng(8)
    trials = []
    for slot, place in enumerate(places):
        fault = sampler.draw(rng, hypothesis=place)
        if isinstance(fault, Backlash):
            assert min(fault.stiffness) > 0
        rig.mount(slot, fault, Mismatch().draw(arm, rng))
        at = linear.at(arm.random_pose(rng))
        excitation, _ = at_levels(at, np.full(arm.n, arm.levels[-1]), duration=0.3)
        trials.append((slot, at.pose, excitation, rng.spawn(1)[0]))
    found = rig.measure_all(*zip(*trials, strict=True))
    assert [m.failure for m in found] == [None] * len(places)


def test_the_posterior_tries_softer_and_stiffer_gears() -> None:
    arms, weights = variants(LinearArm(planar(3, hold="compliant")), 0.1)
    stiffness = [float(a.model.joint("gear1").stiffness[0]) for a in arms]
    assert len(arms) > 1
    assert np.all(np.diff(stiffness) > 0)
    assert np.exp(weights).sum() == pytest.approx(1.0)
