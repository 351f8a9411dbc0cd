"""Elastic joints of a file: what they are taken for, and that the arm moves as the file says."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.arms import FASTEST_TURN, Arm, LinearArm, MismatchDraw, arm_from_file, describe_file
from loose_env.arms.holding import fastest_turn
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import Healthy
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.rig import ReducedRig, SimulatedRig

Write = Callable[..., Path]
GEAR = '<joint name="gear" axis="0 1 0" stiffness="{k}" damping="2"/>'


def two_links(
    *, gear: str = "", rotor: str = "0.3", bend: str = "", drives: bool = True, last: str = ""
) -> str:
    """Two links under gravity; a gear behind the second joint, a bend in the first link."""
    limit = 'actuatorfrcrange="-60 60"' if drives else ""
    beam = f"""<body name="beam" pos=".2 0 0">{bend}
        <inertial pos=".05 0 .01" mass=".8" diaginertia=".002 .004 .004"/>"""
    return f"""<mujoco><compiler angle="radian"/><worldbody><body name="one">
      <joint name="a" axis="0 0 1" armature="0.4" damping="1" {limit}/>
      <inertial pos=".1 0 0" mass="2" diaginertia=".01 .02 .02"/>{beam if bend else ""}
      <body name="two" pos="{".1" if bend else ".3"} 0 0">
        <joint name="b" axis="0 1 0" armature="{rotor}" damping="1" range="-2 2" {limit}/>{gear}
        <inertial pos=".15 .01 0" mass="1.5" diaginertia=".003 .02 .02"/>
        {last}<site name="tip" pos=".3 .05 .02"/>
      </body>{"</body>" if bend else ""}</body></worldbody></mujoco>"""


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_one(text: str, name: str = "arm.xml") -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write_one


def read(write: Write, **parts: object) -> Arm:
    return arm_from_file(write(two_links(**parts)))  # type: ignore[arg-type]


def inertia_of(model: mujoco.MjModel, pose: dict[str, float]) -> NDArray[np.float64]:
    data = mujoco.MjData(model)
    for name, angle in pose.items():
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def test_a_spring_behind_a_drive_is_elastic_and_no_joint_of_the_arm(write: Write) -> None:
    path = write(two_links(gear=GEAR.format(k=5000)))
    arm = arm_from_file(path)
    assert arm.joints == ("a", "b")
    assert arm.seat_bodies == ("one", "two")
    assert arm.gear_joints == ("gear",)
    assert arm.hold == "brake"
    assert len(LinearArm(arm).flexible_dofs) == 1
    said = describe_file(path)
    assert said.springs == ("gear",)
    assert "elastic: gear, " in str(said)


@pytest.mark.parametrize("where", ["gear", "bend"])
def test_the_arm_has_the_dynamics_of_the_file(write: Write, where: str) -> None:
    bend = '<joint name="bow" axis="0 1 0" pos="0 0 .01" stiffness="3000" damping="2"/>'
    parts = {"gear": GEAR.format(k=5000)} if where == "gear" else {"bend": bend}
    path = write(two_links(**parts))
    arm, file = arm_from_file(path), mujoco.MjModel.from_xml_path(str(path))
    pose = {"a": 0.4, "b": -0.7, arm.gear_joints[0]: 0.05}
    names = [file.joint(j).name for j in range(file.njnt)]
    assert [arm.model.joint(j).name for j in range(arm.model.njnt)] == names
    np.testing.assert_allclose(inertia_of(arm.model, pose), inertia_of(file, pose), rtol=1e-9)
    spring = arm.gear_joints[0]
    for figure in ("stiffness", "damping"):
        assert getattr(arm.model.joint(spring), figure) == getattr(file.joint(spring), figure)


@pytest.mark.parametrize("engine", [SimulatedRig, ReducedRig])
def test_it_rests_at_the_pose_that_was_asked_for(write: Write, engine: type) -> None:
    arm = read(write, gear=GEAR.format(k=3000))
    rig = engine(arm)
    rig.mount(0, Healthy(), MismatchDraw.none(arm))
    pose = np.array([0.3, -0.4])
    shake, _ = at_levels(LinearArm(arm).at(pose), np.array([arm.levels[0], 0.0]), duration=0.2)
    record = rig.measure(pose, shake, rng=np.random.default_rng(0))
    gravity = record.tool.mean(1)
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(model, data)
    up = data.site(arm.tool).xmat.reshape(3, 3).T @ np.array([0, 0, 9.81])
    # A spring of 3000 N·m/rad would sag by a milliradian or two, 0.02 m/s².
    np.testing.assert_allclose(gravity, up, atol=0.02)


def test_a_flange_too_light_for_its_spring_gets_some_of_the_rotor(write: Write) -> None:
    path = write(two_links(gear=GEAR.format(k=3e5)))
    arm, file = arm_from_file(path), mujoco.MjModel.from_xml_path(str(path))
    before, after = file.joint("b").armature[0], arm.model.joint("b").armature[0]
    assert after < before
    full, whole = inertia_of(arm.model, {"b": 0.3}), inertia_of(file, {"b": 0.3})
    j, k = int(file.joint("b").dofadr[0]), int(file.joint("gear").dofadr[0])
    assert full[j, j] == pytest.approx(whole[j, j])  # rotor and link together
    assert full[k, k] - whole[k, k] == pytest.approx(before - after)
    assert fastest_turn(arm) <= FASTEST_TURN


def test_records_wait_until_the_spring_has_died_away(write: Write) -> None:
    soft = read(write, gear=GEAR.format(k=5000).replace('"2"', '"0.2"'))
    assert soft.settling > read(write).settling


def test_a_spring_that_is_asked_for_is_driven(write: Write) -> None:
    bend = '<joint name="bow" axis="0 1 0" stiffness="300" damping="2"/>'
    path = write(two_links(bend=bend))
    with pytest.warns(UserWarning, match="bow"):  # it has no torque limit
        arm = arm_from_file(path, joints=["a", "bow", "b"])
    assert arm.joints == ("a", "bow", "b")
    assert arm.gear_joints == ()
    assert arm_from_file(path, joints=["a", "b"]).gear_joints == ("bow",)


def test_in_a_file_without_drives_only_a_spring_on_the_axis_before_it_is_elastic(
    write: Write,
) -> None:
    bend = '<joint name="bow" axis="0 1 0" stiffness="300" damping="2"/>'
    with pytest.warns(UserWarning, match="torque limits"):
        arm = read(write, bend=bend, gear=GEAR.format(k=5000), drives=False)
    assert arm.joints == ("a", "bow", "b")
    assert arm.gear_joints == ("gear",)
    with pytest.raises(InvalidData, match="has two joints"):
        read(write, gear=GEAR.format(k=5000).replace("0 1 0", "1 0 0"), drives=False)


def test_what_cannot_be_is_refused_with_the_reason(write: Write) -> None:
    path = write(two_links(gear=GEAR.format(k=5000)))
    with pytest.raises(InvalidSetting, match="elastic joints of its own"):
        arm_from_file(path, hold="compliant")
    with pytest.raises(InvalidData, match="the first needs a rotor inertia"):
        read(write, gear=GEAR.format(k=5000), rotor="0")
    with pytest.raises(InvalidData, match="too stiff to simulate"):
        read(write, gear=GEAR.format(k=1e9))


CORRECTIONS = {
    "joint_compliance": ("b", (5000.0, 0.05)),
    "link_flexibility": ("two", None),
    "backlash": ("b", None),
    "structural_looseness": ("two", None),
    "rotor_inertia": ("b", None),
    "payload": ("tool", None),
}


@pytest.mark.filterwarnings("ignore:.*lies on the axis")
@pytest.mark.parametrize("kind", CORRECTIONS)
def test_every_correction_that_adds_a_joint_is_read(write: Write, kind: str) -> None:
    where, values = CORRECTIONS[kind]
    nominal = write(two_links(), "nominal.xml")
    machine = NominalModel(mujoco.MjSpec.from_file(str(nominal)))
    effect = CATALOGUE[kind](machine, where)
    spec = machine.fresh()
    effect.export(spec, np.array(effect.starts[-1] if values is None else values))
    spec.compile()
    path = write(spec.to_xml(), "corrected.xml")
    arm, before = arm_from_file(path), arm_from_file(nominal)
    assert arm.joints == before.joints
    assert arm.joint_ranges == before.joint_ranges
    assert arm.seat_bodies == before.seat_bodies
    elastic = kind in ("joint_compliance", "link_flexibility")
    assert (len(arm.gear_joints) > 0) == elastic
    if kind in ("backlash", "structural_looseness"):
        assert "has play and no drive" in str(describe_file(path))
    rig = ReducedRig(dataclasses.replace(arm, levels=before.levels))
    shake, _ = at_levels(LinearArm(arm).at([0.2, 0.3]), np.array([1.0, 0.0]), duration=0.2)
    assert rig.measure(np.array([0.2, 0.3]), shake).failure is None
