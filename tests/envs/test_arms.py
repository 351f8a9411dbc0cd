"""Arms as users have them: true arms, drift, unfelt joints, files of every kind."""

from __future__ import annotations

import copy
import itertools
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from loose_env.arms import (
    DESK_ARM,
    Arm,
    Drift,
    LinearArm,
    Mismatch,
    arm_from_file,
    planar,
    servoed,
    with_compliance,
)
from loose_env.diagnosis import FaultPosterior, predict
from loose_env.envs import (
    DiagnosisEnv,
    DiagnosisSettings,
    Difficulty,
    EpisodeBatch,
    FaultSampler,
)
from loose_env.errors import InvalidSetting
from loose_env.faults import KINDS, hypotheses, places_of_kind
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

SETTINGS = DiagnosisSettings(engine="reduced", raw=True)
TRUE = with_compliance(planar(2), mode_hz=60.0)

FILE = """<mujoco><compiler angle="radian"/><worldbody><body name="one">
  <joint name="a" axis="0 0 1" armature="0.4" damping="1" actuatorfrcrange="-60 60"/>
  <inertial pos=".1 0 0" mass="2" diaginertia=".01 .02 .02"/>
  <body name="two" pos=".3 0 0">
    <joint name="b" axis="0 1 0" armature="0.3" damping="1" actuatorfrcrange="-40 40"/>{gear}
    <inertial pos=".15 .01 0" mass="1.5" diaginertia=".003 .02 .02"/>
    <site name="tip" pos=".3 .05 .02"/></body></body></worldbody></mujoco>"""
GEAR = '<joint name="gear" axis="0 1 0" stiffness="5000" damping="2"/>'


def shake(env: DiagnosisEnv) -> np.ndarray:
    return env.actions.encode(levels=np.array([0, 2]), duration=0)


def played(arm: Arm, true: Arm | None, seed: int = 3) -> tuple[DiagnosisEnv, Any, dict[str, Any]]:
    env = DiagnosisEnv(arm, SETTINGS, true_arm=true, threads=1)
    env.reset(seed=seed)
    observation, _, _, _, info = env.step(shake(env))
    return env, observation, info


def test_every_nominal_arm_meets_the_same_hidden_arms() -> None:
    arms = (planar(2), TRUE, servoed(planar(2)))
    for seed in range(4):
        hidden = []
        for arm in arms:
            env, _, _ = played(arm, TRUE, seed)
            episode = env.batch.episode(0)
            assert episode is not None
            plant = env.batch.rig.plants[0]  # type: ignore[attr-defined]
            hidden.append((episode.fault, episode.pose.tolist(), plant.mismatch.mass.tolist()))
        assert hidden[0] == hidden[1] == hidden[2]


def test_the_true_arm_is_measured_and_the_nominal_one_predicted() -> None:
    exact = Difficulty(kinds={"healthy": 1.0}, mismatch=Mismatch().scaled(0.0))
    settings = DiagnosisSettings(engine="reduced", raw=True, difficulty=exact)
    shown, foreseen = {}, {}
    true = with_compliance(planar(2), mode_hz=20.0)  # below the band: no resonance in it
    for name, arm in (("nominal", planar(2)), ("true", true)):
        env = DiagnosisEnv(arm, settings, true_arm=true, threads=1)
        env.reset(seed=5, options={"pose": [0.2, 0.9]})
        _, _, _, _, info = env.step(env.actions.encode(levels=np.array([0, 2])))
        record = info["measurement"]
        by_arm = predict(LinearArm(arm).at(record.pose), record.excitation, env.batch.floor)
        slot = env.layout.slots_of(env.batch.observe(0))[0]
        at = env.layout.groups_of(slot)
        shown[name] = at["transmission_by_instrument"].reshape(2, 2)[1]
        foreseen[name] = by_arm.transmission_by_instrument[:, 0]
        assert env.batch.nominal.arm is arm
        assert record.encoder.shape[0] == 2
    # The gears of the true arm are in the records, whichever arm is taken for it.
    for name in shown:
        away = {of: np.linalg.norm(shown[name] - foreseen[of]) for of in foreseen}
        assert away["true"] < 0.3 * away["nominal"]


def test_it_can_be_made_by_name_and_by_file(tmp_path: Path) -> None:
    env = gymnasium.make("loose_env/Planar-v0", n_links=2, true_arm=TRUE)
    assert env.unwrapped.batch.true_arm is TRUE  # type: ignore[attr-defined]
    nominal, true = tmp_path / "nominal.xml", tmp_path / "true.xml"
    nominal.write_text(FILE.format(gear=""))
    true.write_text(FILE.format(gear=GEAR))
    made = gymnasium.make("loose_env/Arm-v0", model=str(nominal), true_model=str(true))
    batch = made.unwrapped.batch  # type: ignore[attr-defined]
    assert batch.arm.gear_joints == ()
    assert batch.true_arm.gear_joints == ("gear",)
    made.reset(seed=1)
    made.step(batch.actions.encode(levels=np.array([2, 0])))
    many = gymnasium.make_vec(
        "loose_env/Arm-v0", num_envs=2, model=str(nominal), true_model=str(true)
    )
    assert many.unwrapped.batch.true_arm.gear_joints == ("gear",)  # type: ignore[attr-defined]
    with pytest.raises(InvalidSetting, match="not as both"):
        gymnasium.make(
            "loose_env/Arm-v0", model=str(nominal), true_model=str(true), true_arm=batch.true_arm
        )


@pytest.mark.parametrize(
    ("true", "said"),
    [(planar(3), "in joints"), (planar(2, vertical=True), None), ("arm.xml", "true_arm is an Arm")],
)
def test_an_arm_that_is_moved_or_read_otherwise_is_refused(true: Any, said: str | None) -> None:
    if said is None:  # gravity may differ
        assert DiagnosisEnv(planar(2), SETTINGS, true_arm=true).batch.true_arm is true
        return
    with pytest.raises(InvalidSetting, match=said):
        DiagnosisEnv(planar(2), SETTINGS, true_arm=true)


DRIFTING = DiagnosisSettings(engine="reduced", drift=Drift(joint_zero=0.5, gain=0.02))
STEADY = DiagnosisSettings(engine="reduced")
ARM = planar(2)


def drifted(settings: DiagnosisSettings, *, beside: int = 0) -> tuple[list[Array], list[Array]]:
    """Zeros of the joints and observations after each of three records of one episode."""
    batch = EpisodeBatch(ARM, settings, num=1 + beside, threads=1)
    for slot in range(1 + beside):
        batch.start(slot, seed=3, number=slot, options={"fault": "healthy"})
    zeros, seen = [], []
    action = batch.actions.encode(levels=np.array([3, 3]), duration=0)
    for _ in range(3):
        batch.step(list(range(1 + beside)), [action] * (1 + beside))
        mismatch = batch.episode(0).mismatch
        assert mismatch is not None
        zeros.append(mismatch.joint_zero)
        seen.append(batch.observe(0))
    return zeros, seen


def test_the_first_record_is_of_the_arm_as_drawn_and_later_ones_of_one_that_walks() -> None:
    steady, as_drawn = drifted(STEADY)
    walked, seen = drifted(DRIFTING)
    np.testing.assert_array_equal(walked[0], steady[0])
    np.testing.assert_array_equal(seen[0], as_drawn[0])
    for before, after in itertools.pairwise(walked):
        assert np.all(before != after)
        assert np.all(np.abs(after - before) <= np.radians(3 * 0.5))
    assert not np.array_equal(seen[2], as_drawn[2])


def test_nominal_columns_know_nothing_of_the_drift() -> None:
    layout = EpisodeBatch(ARM, DRIFTING, num=1, threads=1).observations
    named = [e.name for e in layout.slot_elements]
    nominal = [k for k, name in enumerate(named) if name.startswith("nominal")]
    assert nominal
    steady, drifting = (layout.slots_of(drifted(s)[1][-1])[2] for s in (STEADY, DRIFTING))
    np.testing.assert_array_equal(steady[nominal], drifting[nominal])


def test_an_episode_drifts_alike_beside_others_and_from_a_saved_state() -> None:
    np.testing.assert_array_equal(drifted(DRIFTING)[1][-1], drifted(DRIFTING, beside=3)[1][-1])
    batch = EpisodeBatch(ARM, DRIFTING, num=2, threads=1)
    batch.start(0, seed=3, number=0)
    action = batch.actions.encode(levels=np.array([3, 3]), duration=0)
    batch.step([0], [action])
    batch.step([0], [action])
    batch.restore(1, copy.deepcopy(batch.episode(0)))
    batch.step([0, 1], [action, action])
    np.testing.assert_array_equal(batch.observe(0), batch.observe(1))


@pytest.fixture(scope="module")
def on_axis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The desk arm with its accelerometer on the axis of the last joint, and no rotors."""
    text = DESK_ARM.read_text("utf-8").replace('pos="0.06 0 0.05"', 'pos="0 0 0.05"')
    path = tmp_path_factory.mktemp("arm") / "axis.xml"
    path.write_text(text.replace('armature="0.05"', ""), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def arm(on_axis: Path) -> Arm:
    with pytest.warns(UserWarning, match=r"axis of turn.*tool_offset"):
        return arm_from_file(on_axis)


def test_play_that_the_tool_does_not_feel_is_no_hypothesis(arm: Arm) -> None:
    assert arm.unfelt_joints == (6,)
    named = hypotheses(arm)
    assert "backlash@joint6" not in named and "structural_looseness@link6" in named
    assert set(hypotheses(arm, everywhere=True)) - set(named) == {"backlash@joint6"}
    assert places_of_kind(arm, "backlash") == (1, 2, 3, 4, 5)
    prior = FaultPosterior(LinearArm(arm), SensorSuite())
    shares = dict(zip(prior.hypotheses, prior.start().probabilities, strict=True))
    assert shares["backlash@joint6"] == 0
    assert shares["backlash@joint1"] == pytest.approx(1 / 15)


def test_no_episode_hides_it_and_an_option_may(arm: Arm, on_axis: Path) -> None:
    sampler = FaultSampler(LinearArm(arm), Difficulty())
    drawn = {sampler.draw(np.random.default_rng(seed)).hypothesis for seed in range(300)}
    assert drawn == set(hypotheses(arm))
    several = [sampler.several(np.random.default_rng(seed)) for seed in range(60)]
    assert not {f.hypothesis for s in several for f in s.faults} & {"backlash@joint6"}
    with pytest.warns(UserWarning, match="turn"):
        env: Any = gymnasium.make("loose_env/Arm-v0", model=on_axis, durations=(0.2,)).unwrapped
    env.reset(seed=0, options={"fault": "backlash@joint6"})
    info = {}
    for action in (env.actions.encode(levels=np.full(6, 2)), env.actions.encode(verdict=1)):
        *_, info = env.step(action)
    assert info["fault"] == "backlash@joint6" and not info["is_success"]


def test_an_offset_moves_the_tool_off_the_axis(on_axis: Path) -> None:
    moved = arm_from_file(on_axis, tool_offset=(0.06, 0.0, 0.0))
    usual = arm_from_file(DESK_ARM)
    assert moved.unfelt_joints == ()
    np.testing.assert_allclose(
        moved.model.site(moved.tool).pos, usual.model.site(usual.tool).pos, atol=1e-12
    )
    env: Any = gymnasium.make("loose_env/Arm-v0", model=on_axis, tool_offset=[0.06, 0, 0])
    assert "backlash@joint6" in env.unwrapped.hypotheses


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

ARMS = {
    "gantry.xml": GANTRY,
    "frames.xml": FRAMES,
    "mimic.urdf": MIMIC_FINGERS,
    "heavy.xml": HEAVY,
    "small.xml": SMALL,
}
JOINTS = {
    "gantry.xml": "slide slide slide",
    "mimic.urdf": "slide hinge hinge",
}


@pytest.fixture
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The file of the arm that a test is about."""
    (tmp_path / "wrist.xml").write_text(WRIST)
    path = tmp_path / request.param
    path.write_text(ARMS[request.param])
    return path


@pytest.mark.filterwarnings("ignore:.*(no torque limits|no limits):UserWarning")
@pytest.mark.parametrize(
    "hold", ["brake", *(pytest.param(h, marks=pytest.mark.slow) for h in ("servo", "compliant"))]
)
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
