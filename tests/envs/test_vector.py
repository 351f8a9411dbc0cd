"""The vector form: autoreset modes, seeds, masks, options; the episodes of the single form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers
from numpy.typing import NDArray

from loose_env.envs import DiagnosisEnv, DiagnosisVectorEnv, batch_seeds
from loose_env.errors import UnknownName
from loose_env.registration import IDS
from loose_env.rig import Measurement

Make = Callable[..., Any]

ID = "loose_env/Planar-v0"
SHORT: dict[str, Any] = {"n_links": 2, "durations": (0.1,), "max_records": 2, "threads": 1}
SAME_STEP = AutoresetMode.SAME_STEP
FORMS = [
    *((ID, mode, 3, 1) for mode in AutoresetMode),
    (ID, SAME_STEP, 8, 3),
    ("loose_env/Vera-v0", SAME_STEP, 3, 2),
    *(
        pytest.param(env_id, SAME_STEP, 3, 2, marks=pytest.mark.slow)
        for env_id in IDS
        if env_id not in (ID, "loose_env/Vera-v0")
    ),
]
"""Id, autoreset mode, number of arms, threads."""


def make(mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, **arguments: Any) -> Any:
    return gymnasium.make_vec(ID, num_envs=3, autoreset_mode=mode, **{**SHORT, **arguments})


def drawn(env: DiagnosisVectorEnv, rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.integers(0, env.actions.nvec, (3, len(env.actions.nvec)))


@pytest.mark.parametrize(("env_id", "mode", "num", "threads"), FORMS)
def test_a_batch_is_what_gymnasium_makes_of_single_environments(
    env_id: str, mode: AutoresetMode, num: int, threads: int
) -> None:
    short = {k: v for k, v in SHORT.items() if k != "n_links" or env_id == ID}
    single = [lambda: gymnasium.make(env_id, **short)] * num
    copies: Any = SyncVectorEnv(single, autoreset_mode=mode)
    native: Any = gymnasium.make_vec(
        f"loose_env:{env_id}", num_envs=num, autoreset_mode=mode, **short | {"threads": threads}
    )
    assert native.metadata["autoreset_mode"] is mode
    assert native.single_observation_space == copies.single_observation_space
    assert native.observation_space == copies.observation_space
    assert native.action_space == copies.action_space
    seeds = [5 + 4 * k for k in range(num)]
    np.testing.assert_array_equal(native.reset(seed=seeds)[0], copies.reset(seed=seeds)[0])
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(8):
        actions = rng.integers(0, native.actions.nvec, (num, len(native.actions.nvec)))
        found, expected = native.step(actions), copies.step(actions)
        for a, b in zip(found[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        infos, other = found[4], expected[4]
        np.testing.assert_array_equal(infos["action_mask"], other["action_mask"])
        assert ("final_info" in infos) == ("final_info" in other)
        over = found[2] | found[3]
        ended += int(over.sum())
        if "final_info" in infos:
            np.testing.assert_array_equal(infos["_final_obs"], over)
            for key in ("fault", "fault_figures", "is_success", "link_success", "records"):
                np.testing.assert_array_equal(infos["final_info"][key], other["final_info"][key])
            for own, copy in zip(infos["final_obs"], other["final_obs"], strict=True):
                np.testing.assert_array_equal(own, copy)
        if mode is AutoresetMode.DISABLED and over.any():
            again = native.reset(options={"reset_mask": over})[0]
            np.testing.assert_array_equal(again, copies.reset(options={"reset_mask": over})[0])
    assert ended > 3


def test_a_step_after_the_end_is_refused_where_autoreset_is_disabled() -> None:
    env = make("Disabled")
    env.reset(seed=0)
    env.step(np.stack([env.actions.encode(levels=np.array([0, 1]))] * 3))
    verdicts = np.stack([env.actions.encode(levels=np.array([0, 1]))] * 3)
    verdicts[1, -1] = 1
    env.step(verdicts)
    with pytest.raises(ResetNeeded, match=r"environments \[1\]"):
        env.step(verdicts)


@pytest.mark.parametrize(
    "wrap",
    [
        wrappers.RecordEpisodeStatistics,
        wrappers.NormalizeObservation,
        wrappers.NormalizeReward,
        wrappers.DictInfoToList,
        lambda env: wrappers.ClipReward(env, -0.5, 0.5),
        lambda env: wrappers.RescaleObservation(env, np.float32(-1), np.float32(1)),
        lambda env: wrappers.TransformReward(env, lambda reward: 2 * reward),
    ],
)
def test_gymnasium_s_vector_wrappers_go_round_it(wrap: Callable[[Any], Any]) -> None:
    env = wrap(make())
    rng = np.random.default_rng(0)
    env.reset(seed=1)
    for _ in range(6):
        observation, rewards, *_ = env.step(drawn(env.unwrapped, rng))
        assert observation in env.observation_space
        assert np.isfinite(rewards).all()


def test_a_batch_is_drawn_or_refuses_to_be() -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    frames = env.render()
    assert len(frames) == 3 and all(each.ndim == 3 for each in frames)
    with pytest.raises(UnknownName, match="rgb_array"):
        make(render_mode="human")
    plain = make()
    plain.reset(seed=0)
    with pytest.raises(UnknownName, match="no render_mode"):
        plain.render()


def test_each_environment_takes_options_of_its_own() -> None:
    env = make()
    options = [{"fault": "backlash@joint1"}, None, {"fault": "backlash@joint2"}]
    env.reset(seed=0, options={"fault": "healthy", "env_options": options})
    truths = [env.batch.episode(i).fault.hypothesis for i in range(3)]
    assert truths == ["backlash@joint1", "healthy", "backlash@joint2"]


def test_two_batches_share_no_root_seed() -> None:
    found = [seed for root in range(64) for seed in batch_seeds(root, 64)]
    assert len(set(found)) == len(found)
    assert batch_seeds(3, 4)[:2] == batch_seeds(3, 2)
    hidden = []
    for root in (0, 1):
        env = make()
        env.reset(seed=root)
        hidden += [env.batch.episode(i).pose.tobytes() for i in range(3)]
    assert len(set(hidden)) == 6


def test_options_disturb_no_other_draw(make_env: Make) -> None:
    # The same true arm and the same pose, with another fault in it.
    env = make_env(n_links=2)
    poses, arms = [], []
    for options in (None, {"fault": "healthy"}, {"fault": "backlash@joint2"}):
        observation, _ = env.reset(seed=4, options=options)
        poses.append(observation)
        arms.append(env.batch.rig.plants[0].mismatch)  # type: ignore[attr-defined]
    for pose, arm in zip(poses, arms, strict=True):
        np.testing.assert_array_equal(pose, poses[0])
        for field, value in vars(arm).items():
            np.testing.assert_array_equal(value, getattr(arms[0], field))


def last(env: DiagnosisEnv) -> Measurement:
    episode = env.batch.episode(0)
    assert episode is not None and episode.last is not None
    return episode.last


def test_the_excitation_of_a_record_does_not_depend_on_what_was_done_before(
    make_env: Make,
) -> None:
    env = make_env(n_links=3)
    encode = env.actions.encode
    before = [
        [encode(), encode()],
        [encode(levels=np.array([3, 0, 0]), duration=2), encode()],
        [encode(moves=np.array([0, 1, 3]), levels=np.array([1, 2, 3]), duration=1)] * 2,
    ]
    played, readings = [], []
    for actions in before:
        env.reset(seed=6)
        for action in actions:
            env.step(action)
        env.step(encode(levels=np.array([1, 0, 1]), duration=0))
        measurement = last(env)
        torque = np.array(measurement.excitation.torque_rms)[[0, 2], None]
        played.append(measurement.command[[0, 2]] / torque)
        readings.append(measurement.tool)
    np.testing.assert_allclose(played[1:], np.stack([played[0]] * 2), rtol=1e-9, atol=1e-9)
    # In the same pose the readings are the same too, noise included.
    np.testing.assert_array_equal(readings[1], readings[0])


def test_a_reset_mask_takes_seeds_and_options(make_env: Make, make_vector: Make) -> None:
    env = make_vector(n_links=2, num_envs=3)
    env.reset(seed=0)
    options = {"reset_mask": np.array([False, True, False]), "fault": "backlash@joint2"}
    observation, _ = env.reset(seed=[50, 60, 70], options=options)
    single = make_env(n_links=2)
    np.testing.assert_array_equal(observation[1], single.reset(seed=60)[0])
    faults = [env.batch.episode(i).fault.hypothesis for i in range(3)]
    assert faults[1] == "backlash@joint2"
    np.testing.assert_array_equal(observation[0], single.reset(seed=0)[0])
