"""A true arm beside the nominal one: what is hidden, what is predicted, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.evaluation import evaluate
from loose_agents.registry import belief_agent

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import Arm, LinearArm, Mismatch, planar, servoed, with_compliance
from loose_env.diagnosis import predict
from loose_env.envs.diagnosis_env import DiagnosisEnv
from loose_env.envs.faults.difficulty import Difficulty
from loose_env.envs.settings import DiagnosisSettings
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.errors import InvalidSetting

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


def test_without_a_true_arm_the_nominal_one_is_measured() -> None:
    _, without, _ = played(planar(2), None)
    _, same, _ = played(planar(2), planar(2))
    for key, value in without.items():
        np.testing.assert_array_equal(value, same[key])


def test_the_vector_environment_plays_the_same_episodes() -> None:
    env, single, _ = played(planar(2), TRUE)
    many = DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=2, threads=1, true_arm=TRUE)
    many.reset(seed=3)
    observation, *_ = many.step(np.stack([shake(env)] * 2))
    for key, value in single.items():
        np.testing.assert_array_equal(observation[key][0], value)


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


def test_agents_are_evaluated_on_the_true_arm() -> None:
    arm, rules = planar(2), DiagnosisSettings(engine="reduced")
    agent = belief_agent("posterior", "random", Problem.of(arm, rules))
    rows = [
        evaluate(agent, "random", arm, rules, episodes=4, seed=1, true_arm=true, threads=1)
        for true in (None, arm, TRUE)
    ]
    assert rows[0] == rows[1]
    assert [r.truth for r in rows[0]] != [] and rows[0] != rows[2]
