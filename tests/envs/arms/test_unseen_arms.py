"""Arms from files as users have them: from the file to records, verdicts and pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import MismatchDraw, arm_from_file
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidData
from loose_env.excitation import at_levels
from loose_env.faults import KINDS, Backlash
from loose_env.rig import SimulatedRig


def rod(length: float, radius: float = 0.03) -> str:
    return f'<geom type="capsule" fromto="0 0 0 {length} 0 0" size="{radius}"/>'


def chain(joints: list[str], links: list[str], step: float, end: str = "") -> str:
    """A chain of bodies, each ``step`` metres along x from the one before."""
    bodies = "".join(
        f'<body name="l{k}" pos="{step if k else 0.0} 0 0">{joint}{link}'
        for k, (joint, link) in enumerate(zip(joints, links, strict=True))
    )
    return f"<mujoco><worldbody>{bodies}{end}{'</body>' * len(joints)}</worldbody></mujoco>"


def urdf_link(name: str, mass: float, moment: float) -> str:
    moments = " ".join(f'i{a}{a}="{moment}"' for a in "xyz")
    return (
        f'<link name="{name}"><inertial><origin xyz=".1 0 0"/><mass value="{mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def urdf_joint(name: str, kind: str, ends: tuple[str, str], axis: str, more: str = "") -> str:
    limits = '<limit lower="-.5" upper=".9" effort="40" velocity="2"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<origin xyz=".3 0 .02" rpy="0.2 0 0.1"/><axis xyz="{axis}"/>{limits}{more}</joint>'
    )


AXES = ("0 0 1", "0 1 0", "1 0 0")
TURNS = [f'<joint name="j{k}" axis="{AXES[k % 3]}"/>' for k in range(8)]

GANTRY = """<mujoco><compiler autolimits="true"/><worldbody>
  <body name="x"><joint name="x" type="slide" axis="1 0 0" range="0 1"/>
    <geom type="box" size=".5 .05 .05" mass="30"/>
    <body name="y"><joint name="y" type="slide" axis="0 1 0" ref=".4" range="0 1"/>
      <geom type="box" size=".1 .1 .1" mass="10"/>
      <body name="z"><joint name="z" type="slide" axis="0 0 1" range="-.5 0"/>
        <geom type="box" size=".03 .03 .3" mass="4"/><site name="tool" pos="0 0 -.3"/>
  </body></body></body></worldbody>
  <actuator><motor joint="x" gear="-100" ctrlrange="-5 5"/>
    <motor joint="y" gear="100" ctrlrange="-3 3"/></actuator></mujoco>"""

RAIL = """<mujoco><option gravity="0 0 0"/><worldbody>
  <body name="cart"><joint name="rail" type="slide" axis="1 0 0" damping="5"/>
    <geom type="box" size=".2 .2 .1" mass="20"/>
    <body name="arm" pos="0 0 .2"><joint name="turn" axis="0 1 0" ref="35" range="-90 110"/>
      <geom type="capsule" fromto="0 0 0 .5 0 0" size=".04"/>
  </body></body></worldbody></mujoco>"""

# Nested frames and classes, an included file, degrees with an order of angles, off-axis anchors.
FRAMES = """<mujoco><compiler angle="degree" eulerseq="ZYX" autolimits="true"/>
  <default><default class="j"><joint range="-120 100" damping=".3" frictionloss=".1"/></default>
    <default class="g"><geom type="capsule" size=".02" density="2000"/></default></default>
  <worldbody><frame pos="0 0 .3" euler="0 20 0"><body name="base">
    <geom type="box" size=".1 .1 .1"/>
    <body name="upper" pos="0 0 .1" axisangle="0 1 0 33">
      <joint class="j" name="j1" axis="1 1 1" ref="-40"/><geom class="g" fromto="0 0 0 .3 0 0"/>
      <include file="wrist.xml"/></body></body></frame></worldbody></mujoco>"""
WRIST = """<mujocoinclude><body name="wrist" pos=".3 0 0" euler="0 0 30">
  <joint class="j" name="w1" axis="1 0 0" ref="15"/><geom class="g" fromto="0 0 0 .1 .02 0"/>
  <frame pos="0.1 0 0" euler="10 20 30"><frame euler="0 0 90"><body name="hand">
    <joint class="j" name="w2" axis="0 0 1" pos=".01 .02 0"/><geom class="g" fromto="0 0 0 0 0 .1"/>
    <site name="tool" pos="0.05 0 .1" euler="10 20 30"/></body></frame></frame>
  </body></mujocoinclude>"""

MIMIC_FINGERS = (
    '<robot name="r"><link name="world"/><link name="tcp"/>'
    + urdf_link("l1", 1.5, 0.03)
    + urdf_link("l2", 1, 0.02)
    + urdf_link("l3", 0.5, 0.002)
    + urdf_link("f1", 0.05, 1e-5)
    + urdf_link("f2", 0.05, 1e-5)
    + urdf_joint("lift", "prismatic", ("world", "l1"), "0 0 1", '<dynamics damping="4"/>')
    + urdf_joint("j2", "revolute", ("l1", "l2"), "0 1 0")
    + urdf_joint("j3", "continuous", ("l2", "l3"), "1 0 0")
    + urdf_joint("end", "fixed", ("l3", "tcp"), "1 0 0")
    + urdf_joint("g1", "prismatic", ("l3", "f1"), "0 1 0")
    + urdf_joint("g2", "prismatic", ("l3", "f2"), "0 -1 0", '<mimic joint="g1"/>')
    + "</robot>"
)

HEAVY = """<mujoco><worldbody>
  <body name="a"><joint name="a" axis="0 0 1" armature="50" damping="100"/>
    <geom type="box" size=".4 .4 .4" mass="250"/>
    <body name="b" pos=".3 0 .4"><joint name="b" axis="0 1 0" range="-120 60" armature="50"/>
      <geom type="capsule" fromto="0 0 0 0 0 1.2" size=".15" mass="150"/>
      <body name="c" pos="0 0 1.2"><joint name="c" axis="0 1 0" range="-150 100" armature="30"/>
        <geom type="capsule" fromto="0 0 0 1.5 0 0" size=".1" mass="90"/>
        <body name="d" pos="1.5 0 0"><joint name="d" axis="1 0 0" armature="2"/>
          <geom type="box" size=".1 .1 .1" mass="10"/><site name="tool" pos=".2 .1 0"/>
  </body></body></body></body></worldbody></mujoco>"""

SMALL = chain(
    ['<joint axis="0 0 1" range="-150 150"/>', '<joint axis="0 1 0"/>', '<joint axis="1 0 0"/>'],
    [rod(0.05, 0.004), rod(0.03, 0.003), rod(0.02, 0.002)],
    0.04,
    '<site name="tip" pos=".02 .005 0"/>',
)
NAMES_OF_THE_RIG = chain(
    ['<joint name="seat"/>', '<joint name="gear1" axis="0 1 0"/>', '<joint name="hold_seat"/>'],
    [rod(0.4)] * 3,
    0.4,
    '<site name="accelerometer1" pos=".2 .2 0"/>',
)
BARE_LONG = chain(TURNS, [rod(0.15)] * 8, 0.15)
# Bodies of a wrist without mass of their own, which the compiler gives a least one.
LIGHT_WRIST = chain(
    [*TURNS[:2], TURNS[2], TURNS[4], TURNS[6]],
    [rod(0.4), rod(0.4), "", "", '<geom size=".05"/>'],
    0.1,
    '<site pos=".1 .1 0"/>',
).replace("<worldbody>", '<compiler boundmass="0.01" boundinertia="0.0001"/><worldbody>')

ARMS = {
    "gantry.xml": GANTRY,
    "rail.xml": RAIL,
    "frames.xml": FRAMES,
    "mimic.urdf": MIMIC_FINGERS,
    "heavy.xml": HEAVY,
    "small.xml": SMALL,
    "names.xml": NAMES_OF_THE_RIG,
    "bare_long.xml": BARE_LONG,
    "light_wrist.xml": LIGHT_WRIST,
}
JOINTS = {
    "gantry.xml": "slide slide slide",
    "rail.xml": "slide hinge",
    "mimic.urdf": "slide hinge hinge",
    "light_wrist.xml": "hinge hinge hinge hinge hinge",
}


@pytest.fixture
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The file of the arm that a test is about."""
    (tmp_path / "wrist.xml").write_text(WRIST)
    path = tmp_path / request.param
    path.write_text(ARMS[request.param])
    return path


@pytest.mark.filterwarnings("ignore:.*(no torque limits|no limits):UserWarning")
@pytest.mark.parametrize("hold", ["brake", "servo", "compliant"])
@pytest.mark.parametrize("file", ARMS, indirect=True)
def test_every_kind_of_fault_is_measured_on_it(file: Path, hold: str) -> None:
    env = gymnasium.make(
        "loose_env/Arm-v0", model=str(file), hold=hold, kinds=KINDS, durations=(0.1,), threads=1
    ).unwrapped
    assert isinstance(env, DiagnosisEnv)
    n = env.arm.n
    slides = ["slide" if s else "hinge" for s in env.arm.sliding]
    assert slides == JOINTS.get(file.name, " ".join(slides)).split()
    unfelt = len(env.arm.unfelt_joints)  # play there is no hypothesis
    assert len(env.hypotheses) == 1 + 4 * n - unfelt
    for number, kind in enumerate(KINDS):
        named = [h for h in env.hypotheses if h.startswith(kind)]
        fault = named[number % len(named)]
        observation, info = env.reset(seed=number, options={"fault": fault})
        levels = np.zeros(n, dtype=int)
        levels[[0, number % n]] = 2
        observation, _, _, truncated, info = env.step(env.actions.encode(levels=levels, duration=0))
        assert not truncated, info
        assert env.observation_space.contains(observation)
        assert env.layout.physical(observation, "tool_rms")[0].max() > 0
        verdict = env.hypotheses.index(fault) + 1
        *_, info = env.step(env.actions.encode(verdict=verdict))
        assert info["is_success"] and info["fault"] == fault


@pytest.mark.filterwarnings("ignore:.*(no torque limits|no limits):UserWarning")
@pytest.mark.parametrize("file", ["rail.xml", "frames.xml", "heavy.xml"], indirect=True)
def test_it_is_drawn_whatever_its_size(file: Path) -> None:
    pytest.importorskip("matplotlib")
    settings = DiagnosisSettings(kinds=KINDS, durations=(0.1,))
    env = DiagnosisEnv(arm_from_file(file), settings, render_mode="rgb_array", threads=1)
    env.reset(seed=1, options={"fault": "compound_looseness@link1"})
    env.step(env.actions.encode(levels=np.full(env.arm.n, 1), duration=0))
    measured = env.render()
    env.step(env.actions.encode(verdict=1))
    assert np.any(env.render() != measured)


def test_a_drive_too_weak_for_its_load_shakes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "weak.urdf"
    path.write_text(MIMIC_FINGERS.replace('effort="40"', 'effort="20"', 1))  # the lift bears 30 N
    settings = DiagnosisSettings(kinds=KINDS, durations=(0.1,))
    env = DiagnosisEnv(arm_from_file(path), settings, threads=1)
    env.reset(seed=0, options={"fault": "backlash@joint2"})
    for levels, filled in (([3, 0, 0], 0), ([3, 3, 0], 1)):
        observation, _, _, truncated, info = env.step(
            env.actions.encode(levels=np.array(levels), duration=0)
        )
        assert not truncated
        assert info["level_share"][0] == 0
        assert np.sum(env.layout.physical(observation, "valid")) == filled


@pytest.mark.filterwarnings("ignore:.*no torque limits:UserWarning")
@pytest.mark.parametrize("file", ["bare_long.xml"], indirect=True)
def test_without_rotors_the_worst_mismatch_does_not_let_it_diverge(file: Path) -> None:
    # Behind play in joint 3 only a flange of 5e-5 kg·m² is left of the 0.2 that the joint holds.
    arm = arm_from_file(file)
    exact = MismatchDraw.none(arm)
    worst = replace(exact, rotor=0.91 * exact.rotor, damping=1.3 * exact.damping)
    rig = SimulatedRig(arm, threads=1)
    for number in range(4):
        pose = arm.random_pose(np.random.default_rng(number))
        shake, _ = at_levels(rig.nominal.at(pose), np.full(arm.n, arm.levels[-1]), duration=0.2)
        rig.mount(0, Backlash(joint=3, gap=6e-5, stiffness=(3e3, 3e3), damping=(0.1, 0.1)), worst)
        measurement = rig.measure(pose, shake, rng=np.random.default_rng(number))
        assert measurement.failure is None


@pytest.mark.filterwarnings("ignore:.*no torque limits:UserWarning")
def test_what_stops_it_is_said(tmp_path: Path) -> None:
    floating = urdf_joint("up", "floating", ("base", "l1"), "0 0 1")
    robot = '<robot name="r"><link name="base"/>' + urdf_link("l1", 3, 0.03)
    mimic = (
        urdf_joint("j1", "revolute", ("base", "l1"), "0 1 0")
        + urdf_link("l2", 2, 0.02)
        + urdf_joint("j2", "revolute", ("l1", "l2"), "0 1 0", '<mimic joint="j1"/>')
    )
    on_axis = chain(['<joint axis="0 0 1"/>'], [rod(0.4)], 0.0, '<site pos="0 0 .2"/>')
    for text, said in (
        (f"{robot}{floating}</robot>", "stands on the ground: fix its base"),
        (f"{robot}{mimic}</robot>", "mimics the other"),
        (on_axis, "no joint moves its tool.*add a site beside the axis"),
    ):
        path = tmp_path / "arm.xml"
        path.write_text(text)
        with pytest.raises(InvalidData, match=said):
            arm_from_file(path)
