"""A tool on the last joint's axis: said, no hypothesis, a bounded excitation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import loose_env  # noqa: F401
from loose_env.arms import (
    DESK_ARM,
    Arm,
    LinearArm,
    arm_from_file,
    planar,
    scara,
    six_axis,
    unfelt_words,
    vera,
)
from loose_env.diagnosis import FaultPosterior
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidSetting
from loose_env.excitation import UNFELT_LEVER, at_levels
from loose_env.faults import hypotheses, places_of_kind
from loose_env.sensors import SensorSuite


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


@pytest.mark.parametrize("felt", [planar(4), vera(), six_axis(), scara(), arm_from_file(DESK_ARM)])
def test_the_arms_of_the_library_feel_every_joint(felt: Arm) -> None:
    assert felt.unfelt_joints == () and unfelt_words(felt) == ""
    assert hypotheses(felt) == hypotheses(felt, everywhere=True)


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


def test_a_joint_that_is_not_felt_is_shaken_within_reason(arm: Arm) -> None:
    linear = LinearArm(arm)
    pose = np.full(6, 0.3)
    levels = np.array([0, 0, 0, 0, 0, arm.levels[0]])
    excitation, _ = at_levels(linear.at(pose), levels, duration=0.2)
    response = linear.at(pose).response(levels > 0)
    turning = np.sqrt(np.mean(np.abs(response.joint[:, 5, 0]) ** 2)) * excitation.torque_rms[5]
    assert turning <= arm.levels[0] / (UNFELT_LEVER * arm.reach) * (1 + 1e-9)
    assert excitation.torque_rms[5] < 0.5 * arm.torque_limits[5]


def test_an_offset_moves_the_tool_off_the_axis(on_axis: Path) -> None:
    moved = arm_from_file(on_axis, tool_offset=(0.06, 0.0, 0.0))
    usual = arm_from_file(DESK_ARM)
    assert moved.unfelt_joints == ()
    np.testing.assert_allclose(
        moved.model.site(moved.tool).pos, usual.model.site(usual.tool).pos, atol=1e-12
    )
    env: Any = gymnasium.make("loose_env/Arm-v0", model=on_axis, tool_offset=[0.06, 0, 0])
    assert "backlash@joint6" in env.unwrapped.hypotheses


@pytest.mark.parametrize("wrong", [(0.1, 0.2), "far", (np.nan, 0, 0), 0.05])
def test_an_offset_is_three_lengths(on_axis: Path, wrong: Any) -> None:
    with pytest.raises(InvalidSetting, match="tool_offset is three"):
        arm_from_file(on_axis, tool_offset=wrong)
