"""Arms as users have them: true arms, drift, unfelt joints, files of every kind."""

from __future__ import annotations

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
    Gears,
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
    EnvBatch,
    FaultSampler,
)
from loose_env.errors import InvalidSetting
from loose_env.faults import KINDS, hypotheses, places_of_kind
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

SETTINGS = DiagnosisSettings(engine="reduced", raw=True)
TRUE = with_compliance(planar(2), Gears(mode_hz=60.0))

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
    true = with_compliance(planar(2), Gears(mode_hz=20.0))  # below the band: no resonance in it
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
    made = gymnasium.make("loose_env/Arm-v1", model=str(nominal), true_model=str(true))
    batch = made.unwrapped.batch  # type: ignore[attr-defined]
    assert batch.arm.gear_joints == ()
    assert batch.true_arm.gear_joints == ("gear",)
    made.reset(seed=1)
    made.step(batch.actions.encode(levels=np.array([2, 0])))
    many = gymnasium.make_vec(
        "loose_env/Arm-v1", num_envs=2, model=str(nominal), true_model=str(true)
    )
    assert many.unwrapped.batch.true_arm.gear_joints == ("gear",)  # type: ignore[attr-defined]
    with pytest.raises(InvalidSetting, match="not as both"):
        gymnasium.make(
            "loose_env/Arm-v1", model=str(nominal), true_model=str(true), true_arm=batch.true_arm
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
    batch = EnvBatch(ARM, settings, num=1 + beside, threads=1)
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


def test_an_episode_drifts_alike_beside_others_and_from_a_saved_state() -> None:
    np.testing.assert_array_equal(drifted(DRIFTING)[1][-1], drifted(DRIFTING, beside=3)[1][-1])
    batch = EnvBatch(ARM, DRIFTING, num=2, threads=1)
    batch.start(0, seed=3, number=0)
    action = batch.actions.encode(levels=np.array([3, 3]), duration=0)
    batch.step([0], [action])
    batch.step([0], [action])
    other = EnvBatch(ARM, DRIFTING, num=2, threads=1)
    other.restore(batch.state())
    for each in (batch, other):
        each.step([0], [action])
    np.testing.assert_array_equal(batch.observe(0), other.observe(0))


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
        env: Any = gymnasium.make("loose_env/Arm-v1", model=on_axis, durations=(0.2,)).unwrapped
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
    env: Any = gymnasium.make("loose_env/Arm-v1", model=on_axis, tool_offset=[0.06, 0, 0])
    assert "backlash@joint6" in env.unwrapped.hypotheses


WEAK = """<mujoco><worldbody><body name="lift"><joint name="lift" type="slide" axis="0 0 1"
    range="0 .5" damping="4" actuatorfrcrange="-20 20"/><geom size=".05" mass="2"/>
  <body name="arm" pos=".3 0 0"><joint name="turn" axis="0 1 0" actuatorfrcrange="-40 40"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass="1"/><site pos=".2 .05 0"/>
  </body></body></worldbody></mujoco>"""


def test_a_drive_too_weak_for_its_load_shakes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "weak.xml"
    path.write_text(WEAK)  # the lift bears 29 N
    settings = DiagnosisSettings(kinds=KINDS, durations=(0.1,))
    env = DiagnosisEnv(arm_from_file(path), settings, threads=1)
    env.reset(seed=0, options={"fault": "backlash@joint2"})
    for levels, filled in (([3, 0], 0), ([3, 3], 1)):
        observation, _, _, truncated, info = env.step(
            env.actions.encode(levels=np.array(levels), duration=0)
        )
        assert not truncated
        assert info["level_share"][0] == 0
        assert np.sum(env.layout.physical(observation, "valid")) == filled
