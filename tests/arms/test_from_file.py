"""Arms read from MJCF and URDF files: the file's dynamics, its chain, and what is refused."""

from __future__ import annotations

import dataclasses
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.arms import DESK_ARM, Arm, LinearArm, MismatchDraw, arm_from_file, describe_file
from loose_env.errors import InvalidData, InvalidSetting, LooseEnvError, UnknownName
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, Fault, Healthy, StructuralLooseness
from loose_env.rig import SimulatedRig

MODELS = Path(__file__).parents[3] / "shared" / "models"
Write = Callable[..., Path]

# Degrees, a reference that is not zero, nested defaults, a slide among hinges, off-axis joint
# anchors, a fixed body on a link, a two-finger gripper, rotor inertia on actuators, and all that
# a file holds besides an arm.
MIXED = """
<mujoco model="mixed">
  <option timestep="0.01" integrator="RK4" gravity="0 3 -9" wind="1 2 3" density="5"/>
  <compiler angle="degree" autolimits="true" eulerseq="zyx"/>
  <default>
    <joint damping="2" armature="0.01"/>
    <default class="big"><joint armature="0.2" damping="5"/>
      <default class="turned"><joint axis="0 1 0" range="-90 45" actuatorfrcrange="-40 40"/>
      </default>
    </default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="crate" pos="3 0 0"><freejoint name="crate"/><geom size=".1"/></body>
    <body name="stand" pos="0.1 0.2 0.5" euler="30 0 0"><geom type="box" size=".1 .1 .2"/>
      <body name="upper" pos="0 0 0.2">
        <joint name="swing" class="big" axis="0 0 1" ref="20" range="-180 180"/>
        <inertial pos="0.1 0 0.02" mass="4" fullinertia="0.05 0.06 0.04 0.003 0.002 0.001"/>
        <body name="lower" pos="0.3 0 0" euler="0 10 0">
          <joint name="bend" class="turned" pos="0.02 0 0.01" ref="-30"/>
          <geom type="capsule" fromto="0 0 0 0.3 0.02 0" size="0.03" density="900"/>
          <body name="carriage" pos="0.3 0 0">
            <joint name="reach" type="slide" axis="1 0.2 0" ref="0.05" range="0 0.2"/>
            <inertial pos="0.05 0.01 0" mass="1.5" diaginertia="0.004 0.003 0.002"/>
            <body name="bracket" pos="0.05 0 0"><geom type="box" size=".02 .03 .04"/></body>
            <body name="hand" pos="0.1 0 0" quat="1 0.2 0 0">
              <joint axis="1 0 0"/>
              <inertial pos="0.02 0 0.01" mass="0.6" diaginertia="0.001 0.0009 0.0008"/>
              <site name="camera" pos="0 0 0.1"/>
              <site pos="0.1 0.03 0.02" euler="0 40 0"/>
              <body name="left" pos="0.1 0.02 0">
                <joint name="left" type="slide" axis="0 1 0" ref="0.01" range="0 0.02"/>
                <geom type="box" size=".03 .005 .01"/>
              </body>
              <body name="right" pos="0.1 -0.02 0">
                <joint name="right" type="slide" axis="0 -1 0" range="0 0.02"/>
                <geom type="box" size=".03 .005 .01"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="left" body2="right"/></contact>
  <tendon><fixed name="grip"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed>
  </tendon>
  <equality><joint joint1="left" joint2="right"/></equality>
  <actuator>
    <motor name="m1" joint="swing" gear="50" ctrlrange="-2 2" armature="1e-4"/>
    <position name="m2" joint="bend" kp="100" forcerange="-60 60"/>
    <motor joint="reach" gear="10" forcerange="-7 9"/>
    <general name="hand" joint="joint5" gear="3" forcerange="-2 2"/>
    <position tendon="grip" kp="1"/>
  </actuator>
  <sensor><jointpos joint="left"/><touch site="camera"/></sensor>
  <keyframe><key name="home" qpos="0 0 0 1 0 0 0 0 0 0 0 0 0"/></keyframe>
</mujoco>
"""

URDF = """
<robot name="lift">
  <link name="base"><visual><geometry><mesh filename="package://lift/base.stl"/></geometry></visual>
  </link>
  <link name="arm">
    <inertial><origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/><mass value="2"/>
      <inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0.001" ixz="0" iyz="0"/></inertial>
    <collision><geometry><mesh filename="arm.stl"/></geometry></collision>
  </link>
  <link name="fore">
    <inertial><origin xyz="0.1 0 0"/><mass value="1"/>
      <inertia ixx="0.002" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="flange"><inertial><origin xyz="0 0 0.01"/><mass value="0.2"/>
      <inertia ixx="0.0002" iyy="0.0002" izz="0.0003" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool0"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 0.4" rpy="0 0 0.5"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="30" velocity="1"/><dynamics damping="1.5" friction="0.2"/>
  </joint>
  <joint name="elbow" type="continuous"><parent link="arm"/><child link="fore"/>
    <origin xyz="0.3 0 0" rpy="1.57 0 0"/><axis xyz="0 1 0"/>
    <limit effort="12" velocity="1"/></joint>
  <joint name="mount" type="fixed"><parent link="fore"/><child link="flange"/>
    <origin xyz="0.25 0 0" rpy="0 0.7 0"/></joint>
  <joint name="end" type="fixed"><parent link="flange"/><child link="tool0"/>
    <origin xyz="0 0 0.05"/></joint>
</robot>
"""


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_one(text: str, name: str = "arm.xml") -> Path:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    return write_one


def simple(
    *,
    joint: str = '<joint name="a" actuatorfrcrange="-9 9"/>',
    inner: str = "",
    extra: str = "",
    mass: str = '<inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>',
    attributes: str = "",
) -> str:
    """Two links; the parts of a test go into the first of them or beside them."""
    return f"""<mujoco {attributes}><worldbody><body name="one">{joint}{mass}
      <body name="two" pos=".3 0 0"><joint name="b" axis="0 1 0" actuatorfrcrange="-5 5"/>
        <inertial pos=".1 0 0" mass="0.5" diaginertia=".004 .004 .004"/>
        <site name="tip" pos=".2 .05 0"/></body>{inner}</body></worldbody>{extra}</mujoco>"""


def dynamics(
    model: mujoco.MjModel,
    joints: tuple[str, ...],
    pose: NDArray[np.float64],
    speed: NDArray[np.float64],
    site: str,
) -> tuple[NDArray[np.float64], ...]:
    """Inertia, bias forces and the tool's place and axes, of the named joints."""
    data = mujoco.MjData(model)
    dofs = [int(model.joint(j).dofadr[0]) for j in joints]
    data.qpos[[int(model.joint(j).qposadr[0]) for j in joints]] = pose
    data.qvel[dofs] = speed
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    place = data.site(site)
    return (full[np.ix_(dofs, dofs)], data.qfrc_bias[dofs], place.xpos, place.xmat)


def require_same_dynamics(
    arm: Arm, file: mujoco.MjModel, site: str, joints: tuple[str, ...] | None = None
) -> None:
    rng = np.random.default_rng(5)
    for _ in range(8):
        pose, speed = arm.random_pose(rng), rng.normal(size=arm.n)
        own = dynamics(arm.model, arm.joints, pose, speed, arm.tool)
        theirs = dynamics(file, joints or arm.joints, pose, speed, site)
        for mine, given in zip(own, theirs, strict=True):
            np.testing.assert_allclose(mine, given, rtol=1e-9, atol=1e-9 * np.abs(given).max())


def compiled(text: str, site: tuple[str, str] | None = None) -> mujoco.MjModel:
    """The file's own model, unnamed joint and site named, without fluid forces."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    for joint in spec.joints:
        joint.name = joint.name or "joint5"
    for unnamed in spec.sites:
        unnamed.name = unnamed.name or "site2"
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    if site is not None:
        spec.body(site[1]).add_site(name=site[0])
    for geom in list(spec.geoms):
        if geom.meshname:
            spec.delete(geom)
    return spec.compile()


def test_a_mixed_file_keeps_its_dynamics(write: Write) -> None:
    arm = arm_from_file(write(MIXED))
    assert arm.joints == ("swing", "bend", "reach", "joint5")
    assert arm.seat_bodies == ("upper", "lower", "carriage", "hand")
    require_same_dynamics(arm, compiled(MIXED), "site2")
    np.testing.assert_allclose(arm.model.opt.gravity, (0, 3, -9))
    assert arm.model.opt.density == 0
    assert arm.model.nu == arm.model.neq == arm.model.nsensor == arm.model.ngeom == 0

    # Those of nested defaults and actuators too.
    np.testing.assert_allclose(arm.model.dof_damping, (5, 5, 2, 2))
    np.testing.assert_allclose(arm.model.dof_armature, (0.2 + 1e-4 * 50**2, 0.2, 0.01, 0.01))
    # motor 50 x 2; joint 40 below actuator 60; 10 x 9; 3 x 2
    assert arm.torque_limits == pytest.approx((100.0, 40.0, 90.0, 6.0))
    assert arm.joint_ranges[0] == pytest.approx((-np.pi, np.pi))
    assert arm.joint_ranges[1] == pytest.approx((-np.pi / 2, np.pi / 4))
    assert arm.joint_ranges[2] == pytest.approx((0.0, 0.2))
    assert arm.joint_ranges[3] is None


def test_a_report_names_what_was_found(write: Write) -> None:
    found = describe_file(write(MIXED, "mixed.xml"))
    assert [(j.name, j.kind) for j in found.joints] == [
        ("swing", "hinge"),
        ("bend", "hinge"),
        ("reach", "slide"),
        ("joint5", "hinge"),
    ]
    assert found.tool == "site2"
    assert "last site" in found.tool_origin
    assert [(p.body, p.link, p.joints) for p in found.payload] == [
        ("left", "hand", ("left",)),
        ("right", "hand", ("right",)),
    ]
    box = 1000 * 8 * 0.03 * 0.005 * 0.01
    assert found.link_masses[3] == pytest.approx(0.6 + 2 * box)
    assert any("crate" in w for w in found.warnings)
    text = str(found)
    assert text.startswith("mixed.xml (MJCF): 4 joints")
    for word in ("reach", "slide", "0 to 0.2 m", "90 N", "payload: left on hand", "no limits"):
        assert word in text
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.tool = "other"  # type: ignore[misc]


def test_a_urdf_keeps_its_dynamics_without_its_meshes(write: Write) -> None:
    file = write(URDF, "lift.urdf")
    arm = arm_from_file(file, tool="tool0")
    assert arm.torque_limits == (30.0, 12.0)
    assert arm.joint_ranges == ((-2.0, 2.0), None)
    require_same_dynamics(arm, compiled(URDF, ("end", "tool0")), "end")
    found = describe_file(file, tool="tool0")
    assert found.format == "URDF"
    assert found.tool == "tool0"
    assert any("dry friction of 0.2 in joint shoulder" in w for w in found.warnings)
    # Without a tool, and without sites, the last body's own frame is the tool.
    assert describe_file(file).tool == "fore"


def test_a_chosen_tool_shortens_the_chain(write: Write) -> None:
    file = write(MIXED)
    arm = arm_from_file(file, tool="lower")
    assert arm.joints == ("swing", "bend")
    carried = describe_file(file, tool="lower").payload
    assert [(p.body, p.joints) for p in carried] == [
        ("carriage", ("reach", "joint5", "left", "right"))
    ]
    require_same_dynamics(arm, compiled(MIXED, ("end", "lower")), "end")
    assert describe_file(file, tool="camera").tool_origin == "the site asked for"


def test_chosen_joints_freeze_the_others(write: Write) -> None:
    arm = arm_from_file(write(MIXED), joints=["joint5", "swing"])
    assert arm.joints == ("swing", "joint5")
    require_same_dynamics(arm, compiled(MIXED), "site2")


@pytest.mark.filterwarnings("ignore:.*lies on the axis")
def test_a_site_called_tool_comes_before_a_deeper_finger(write: Write) -> None:
    finger = """<site name="tool" pos="0 0 .1"/><body pos="0 0 .2"><joint name="jaw"/>
      <geom size=".01"/></body>"""
    text = simple().replace('<site name="tip" pos=".2 .05 0"/>', finger)
    assert arm_from_file(write(text)).joints == ("a", "b")
    without = text.replace('name="tool"', 'name="tip"')
    with pytest.warns(UserWarning, match="no torque limits for some joints.*jaw"):
        assert arm_from_file(write(without)).joints == ("a", "b", "jaw")


def test_limits_a_file_does_not_give_are_proposed_and_hold_gravity(write: Write) -> None:
    text = simple(joint='<joint name="a" axis="0 1 0"/>').replace('actuatorfrcrange="-5 5"', "")
    with pytest.warns(UserWarning, match="proposed from gravity load and inertia: a .* N·m, b"):
        arm = arm_from_file(write(text))
    worst = 9.81 * (1 * 0.1 + 0.5 * 0.4)  # stretched level
    assert worst < arm.torque_limits[0] < 8 * worst
    assert 9.81 * 0.5 * 0.1 < arm.torque_limits[1] < arm.torque_limits[0]


def test_a_slide_without_limits_is_given_some(write: Write) -> None:
    text = simple(joint='<joint name="a" type="slide" ref="0.4" actuatorfrcrange="-9 9"/>')
    with pytest.warns(UserWarning, match="slide a has no limits"):
        arm = arm_from_file(write(text))
    assert arm.joint_ranges[0] == pytest.approx((0.15, 0.65))


def test_most_poses_reach_the_top_level(write: Write) -> None:
    arm = arm_from_file(write(MIXED))
    assert len(arm.levels) == 3
    rng, shares, linear = np.random.default_rng(9), [], LinearArm(arm)
    for _ in range(20):
        at = linear.at(arm.random_pose(rng))
        for j in range(arm.n):
            share = at_levels(at, np.eye(arm.n)[j] * arm.levels[-1], duration=1.0)[1]
            shares.append(share[j])
    assert 0.35 < np.mean(np.array(shares) >= 1.0) < 0.65


def test_brakes_hold_the_heaviest_pose_at_their_mode(write: Write) -> None:
    """The second link folds over the first: at zero the first joint carries least."""
    folded = simple().replace('pos=".3 0 0"', 'pos=".3 0 0" quat="0 0 0 1"')
    arm = arm_from_file(write(folded.replace('axis="0 1 0"', "")))
    poses = np.stack([np.zeros(24), np.linspace(-np.pi, np.pi, 24)], axis=1)
    largest = max(LinearArm(arm).at(p).inertia[0, 0] for p in poses)
    mode = np.sqrt(arm.brake.stiffness[0] / largest) / (2 * np.pi)
    assert mode == pytest.approx(800, rel=0.03)


def test_links_inertias_may_come_from_meshes_and_includes_of_the_folder(write: Write) -> None:
    write("<mujoco><option gravity='0 0 -1.6'/></mujoco>", "parts/moon.xml")
    text = simple(
        mass='<geom type="mesh" mesh="m"/>',
        extra="""<include file="parts/moon.xml"/><asset>
          <mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>""",
    )
    arm = arm_from_file(write(text))
    assert arm.model.opt.gravity[2] == -1.6
    volume = 1000 / 6
    assert arm.model.body("one").mass[0] + arm.model.body("one_flange").mass[0] == pytest.approx(
        volume
    )


def test_a_mesh_is_read_only_where_an_inertia_needs_it(write: Write) -> None:
    obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    write(obj, "assets/tetra.obj")
    text = """<mujoco><compiler meshdir="assets"/><asset><mesh file="tetra.obj"/>
      <mesh file="gone.obj"/><texture name="t" type="2d" file="gone.png"/>
      <material name="m" texture="t"/></asset>
      <worldbody><body name="base"><geom type="mesh" mesh="gone" material="m"/><body name="one">
        <joint name="a" actuatorfrcrange="-900 900"/>
        <geom type="mesh" mesh="tetra" material="m"/>
        <geom type="mesh" mesh="gone" mass="0"/><site pos="1 0 0"/></body></body></worldbody>
      </mujoco>"""
    write(text, "robot.xml")
    scene = write('<mujoco><include file="robot.xml"/></mujoco>', "scene.xml")
    assert describe_file(scene).link_masses == pytest.approx((1000 / 6,))


def test_gravity_that_a_file_switches_off_stays_off(write: Write) -> None:
    arm = arm_from_file(write(simple(extra='<option><flag gravity="disable"/></option>')))
    assert not arm.model.opt.gravity.any()


def test_a_loop_within_the_payload_is_frozen_with_it(write: Write) -> None:
    text = MIXED.replace(
        "<equality>", '<equality><connect body1="left" body2="right" anchor="0 0 0"/>'
    )
    assert arm_from_file(write(text)).n == 4


MASS = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
ACTUATED = 'actuatorfrcrange="-9 9"'


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("no xml <", InvalidData, "arm.xml: not XML"),
        ("<sdf/>", InvalidData, "outermost element is <sdf>"),
        ("<!DOCTYPE a SYSTEM '/etc/hostname'><mujoco/>", InvalidData, "DOCTYPE"),
        (
            "<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:macro name='a'/></robot>",
            InvalidData,
            "xacro",
        ),
        ("<mujoco><worldbody/></mujoco>", InvalidData, "no joint at all"),
        (simple(joint='<freejoint name="base"/>'), InvalidData, "'one' floats on the free joint"),
        (
            """<robot name="r"><link name="base"/><link name="l1"><inertial><mass value="3"/>
            <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="up" type="floating"><parent link="base"/><child link="l1"/></joint>
            </robot>""",
            InvalidData,
            "stands on the ground: fix its base",
        ),
        (simple(joint='<joint name="s" type="ball"/>'), InvalidData, "'s' of body 'one' is a ball"),
        (
            simple(joint='<joint name="a"/><joint name="a2" axis="1 0 0"/>'),
            InvalidData,
            "'one' has two joints, 'a' and 'a2'",
        ),
        (simple(mass=""), InvalidData, "mjMINVAL.*'?one.*needs mass"),
        (
            simple(extra='<equality><connect body1="two" anchor="0 0 0"/></equality>'),
            InvalidData,
            "ties bodies 'two' and 'world' and closes a loop",
        ),
        (
            simple(extra='<equality><weld body1="two" body2="one"/></equality>'),
            InvalidData,
            "ties bodies 'two' and 'one'",
        ),
        (
            simple(extra='<equality><joint joint1="a" joint2="b"/></equality>'),
            InvalidData,
            "'a' and 'b' are coupled",
        ),
        (simple(extra='<include file="../other.xml"/>'), InvalidData, "outside the file's folder"),
        (simple(extra='<include file="/etc/passwd"/>'), InvalidData, "outside the file's folder"),
        (
            simple(extra='<asset><mesh file="http://a.b/c.stl"/></asset>'),
            InvalidData,
            "outside the file's folder",
        ),
        (simple(extra='<compiler meshdir="../meshes"/>'), InvalidData, "meshdir='../meshes'"),
        (
            simple(
                extra='<asset><mesh name="m" file="gone.stl"/></asset>',
                mass='<geom type="mesh" mesh="m"/>',
            ),
            InvalidData,
            "mesh files are missing: 'gone.stl' of body 'one'",
        ),
        (simple(extra="<nonsense/>"), InvalidData, "MuJoCo cannot read it"),
        (
            simple(
                inner=f"""<body name="l"><joint name="l" {ACTUATED}/>{MASS}<body name="l2"><joint/>
                  {MASS}<body name="l3"><joint/>{MASS}</body></body></body><body name="r"><joint/>
                  {MASS}<body name="r2"><joint/>{MASS}<body name="r3"><joint/>{MASS}</body></body>
                  </body>"""
            ),
            InvalidData,
            "several chains of 4 joints.*'l3', 'r3'",
        ),
    ],
)
def test_files_that_are_no_serial_arm_are_refused(
    write: Write, text: str, kind: type[LooseEnvError], message: str
) -> None:
    with pytest.raises(kind, match=message):
        describe_file(write(text))


def test_an_include_outside_the_folder_is_refused_behind_a_link(
    write: Write, tmp_path: Path
) -> None:
    outside = write("<mujoco/>", "outside.xml")
    file = write(simple(extra='<include file="link.xml"/>'), "inner/arm.xml")
    (tmp_path / "inner" / "link.xml").symlink_to(outside)
    with pytest.raises(InvalidData, match="outside the file's folder"):
        describe_file(file)


def test_what_is_wrong_in_an_included_file_is_said_of_both(write: Write) -> None:
    write('<mujoco><include file="../secret.xml"/></mujoco>', "inner/part.xml")
    file = write(simple(extra='<include file="part.xml"/>'), "inner/arm.xml")
    with pytest.raises(InvalidData, match=r"^arm\.xml: it includes part\.xml: .* lies outside"):
        describe_file(file)


def test_names_that_do_not_exist_are_answered_with_those_that_do(write: Write) -> None:
    file = write(MIXED)
    with pytest.raises(UnknownName, match=r"'flange'.*sites: 'camera', 'site2'; bodies: 'crate'"):
        describe_file(file, tool="flange")
    with pytest.raises(UnknownName, match=r"'elbow'.*'swing', 'bend', 'reach', 'joint5'"):
        describe_file(file, joints=["elbow"])
    with pytest.raises(UnknownName, match="'left' do not move the tool"):
        describe_file(file, joints=["left"])
    with pytest.raises(UnknownName, match="twice"):
        describe_file(file, joints=["swing", "swing"])
    with pytest.raises(UnknownName, match="'compliant'"):
        arm_from_file(file, hold="glue")  # type: ignore[arg-type]
    with pytest.raises(InvalidData, match="no joint moves the tool 'stand'"):
        describe_file(file, tool="stand")
    with pytest.raises(InvalidData, match="'crate' floats"):
        describe_file(file, tool="crate")
    with pytest.raises(InvalidSetting, match="no file"):
        describe_file(file.parent / "gone.xml")
    with pytest.raises(InvalidData, match="needs at least one joint"):
        describe_file(file, joints=[])


def faults(n: int) -> list[Fault]:
    loose: list[Fault] = [
        StructuralLooseness(
            link=i, direction=(1, 1, 1), gap=1e-4, stiffness=(2e4, 2e4), damping=(5, 5)
        )
        for i in range(1, n + 1)
    ]
    play: list[Fault] = [
        Backlash(joint=i, gap=1e-3, stiffness=(30.0, 30.0), damping=(0.01, 0.01))
        for i in range(1, n + 1)
    ]
    return [Healthy(), *loose, *play]


def require_records(arm: Arm) -> None:
    rig = SimulatedRig(arm)
    pose = arm.random_pose(np.random.default_rng(2))
    at = rig.nominal.at(pose)
    assert at.kinematic.shape == (3, arm.n)
    levels = np.zeros(arm.n)
    levels[min(1, arm.n - 1)] = arm.levels[1]
    shake, share = at_levels(at, levels, duration=0.3)
    for fault in faults(arm.n):
        rig.mount(0, fault, MismatchDraw.none(arm))
        record = rig.measure(pose, shake, rng=np.random.default_rng(1)).tool
        assert record.shape[0] == 3
        assert np.isfinite(record).all(), fault
        if isinstance(fault, Healthy):
            shaken = record - record.mean(axis=1, keepdims=True)
            rms = np.sqrt((shaken**2).sum(axis=0).mean())
            # The nominal arm foretells the level; a short record scatters about it.
            assert rms == pytest.approx(float(share.min() * arm.levels[1]), rel=0.3)


def test_a_mixed_arm_is_measured_with_every_fault(write: Write) -> None:
    require_records(arm_from_file(write(MIXED)))


def test_an_arm_without_rotors_is_measured_with_every_fault(write: Write) -> None:
    require_records(arm_from_file(write(URDF), tool="tool0"))


def test_a_stiff_damper_shortens_the_step(write: Write) -> None:
    joint = '<joint name="a" actuatorfrcrange="-9 9" damping="{}"/>'
    usual = arm_from_file(write(simple(joint=joint.format(0.1))))
    assert usual.timestep == 2e-4
    short = arm_from_file(write(simple(joint=joint.format(20.0))))
    # Behind an open seat the damper acts on the flange: a quarter of the first link.
    flange = 0.25 * (0.01 + 1 * 0.1**2)
    assert short.timestep * 20.0 / flange <= 1 < 2 * short.timestep * 20.0 / flange
    require_records(short)
    with pytest.raises(InvalidData, match="too large for its inertias"):
        arm_from_file(write(simple(joint=joint.format(1e4))))


def test_figures_that_are_no_numbers_are_refused(
    write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log where it stands
    with pytest.raises(InvalidData, match=r"dof_damping has to be finite, zero or more.*-2"):
        describe_file(write(simple(joint='<joint name="a" damping="-2"/>')))
    with pytest.raises(InvalidData, match="dof_armature has to be finite"):
        describe_file(write(simple(joint='<joint name="a" armature="nan"/>')))


def test_drives_that_cannot_hold_the_arm_are_refused(write: Write) -> None:
    weak = simple(joint='<joint name="a" axis="0 1 0" actuatorfrcrange="-.01 .01"/>')
    with pytest.raises(InvalidData, match="no torque is left to shake the tool"):
        arm_from_file(write(weak.replace("-5 5", "-.01 .01")))
    on_axis = """<mujoco><worldbody><body><joint axis="0 0 1" actuatorfrcrange="-9 9"/>
      <geom size=".1"/><site pos="0 0 .2"/></body></worldbody></mujoco>"""
    with pytest.raises(InvalidData, match=r"no joint moves its tool.*add a site beside the axis"):
        arm_from_file(write(on_axis))


def test_a_body_may_already_be_called_a_flange(write: Write) -> None:
    arm = arm_from_file(write(simple().replace('name="two"', 'name="one_flange"')))
    assert arm.seat_bodies == ("one", "one_flange")


@pytest.mark.parametrize(("name", "n"), [("ur5e_bare", 6), ("so101_bare", 5)])
def test_published_arms_keep_their_dynamics_and_are_measured(
    name: str, n: int, tmp_path: Path
) -> None:
    file = MODELS / f"{name}.xml"
    if not file.is_file():
        pytest.skip("the published arms are not beside the repository")
    shutil.copy(file, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*lies on the axis")
        arm = arm_from_file(tmp_path / file.name)
    assert arm.n == n
    require_same_dynamics(arm, mujoco.MjModel.from_xml_path(str(file)), "tool")
    require_records(arm)


# ---- the arm that ships with the package


def test_the_small_arm_needs_no_assumption_and_carries_its_gripper() -> None:
    found = describe_file(DESK_ARM)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm = arm_from_file(DESK_ARM)
    assert found.warnings == ()
    assert [joint.torque_limit for joint in found.joints] == list(arm.torque_limits)
    assert [(branch.link, branch.joints) for branch in found.payload] == [
        ("hand", ("left_finger",)),
        ("hand", ("right_finger",)),
    ]
    # Every joint moves the tool in a pose drawn at random, the last one too.
    pose = arm.random_pose(np.random.default_rng(0))
    assert (np.linalg.norm(LinearArm(arm).at(pose).kinematic, axis=0) > 0.03).all()
