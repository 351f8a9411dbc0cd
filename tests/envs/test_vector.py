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

from loose_env.envs import ActionLayout, DiagnosisEnv, DiagnosisVectorEnv, batch_seeds
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.rig import Measurement

Make = Callable[..., Any]

ID = "loose_env/Planar-v0"
SHORT: dict[str, Any] = {"n_links": 2, "durations": (0.2,), "max_records": 2, "threads": 1}


def make(mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, **arguments: Any) -> Any:
    return gymnasium.make_vec(ID, num_envs=3, autoreset_mode=mode, **{**SHORT, **arguments})


def drawn(env: DiagnosisVectorEnv, rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.integers(0, env.actions.nvec, (3, len(env.actions.nvec)))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_every_mode_is_what_gymnasium_makes_of_single_environments(mode: AutoresetMode) -> None:
    copies: Any = SyncVectorEnv([lambda: gymnasium.make(ID, **SHORT)] * 3, autoreset_mode=mode)
    native = make(mode)
    seeds = [5, 9, 2]
    first, _ = native.reset(seed=seeds)
    np.testing.assert_array_equal(first, copies.reset(seed=seeds)[0])
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(8):
        actions = drawn(native, rng)
        found, expected = native.step(actions), copies.step(actions)
        for a, b in zip(found[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(found[4]["action_mask"], expected[4]["action_mask"])
        assert ("final_info" in found[4]) == ("final_info" in expected[4])
        over = found[2] | found[3]
        ended += int(over.sum())
        if mode is AutoresetMode.DISABLED and over.any():
            again = native.reset(options={"reset_mask": over})[0]
            other = copies.reset(options={"reset_mask": over})[0]
            np.testing.assert_array_equal(again, other)
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
    assert env.call("render")[0].shape == frames[0].shape
    with pytest.raises(UnknownName, match="rgb_array"):
        make(render_mode="human")
    plain = make()
    plain.reset(seed=0)
    with pytest.raises(UnknownName, match="no render_mode"):
        plain.render()


def test_attributes_and_methods_of_each_environment() -> None:
    env = make()
    env.reset(seed=0)
    assert env.get_attr("hypotheses") == (env.hypotheses,) * 3
    assert env.call("action_space") == (env.single_action_space,) * 3
    np.testing.assert_array_equal(np.stack(env.call("action_masks")), env.action_masks())
    with pytest.raises(UnknownName, match="action_masks"):
        env.call("batch")
    with pytest.raises(InvalidSetting, match="options of reset"):
        env.set_attr("settings", None)


def test_each_environment_takes_options_of_its_own() -> None:
    env = make()
    options = [{"fault": "backlash@joint1"}, None, {"fault": "backlash@joint2"}]
    env.reset(seed=0, options={"fault": "healthy", "env_options": options})
    truths = [env.batch.episode(i).fault.hypothesis for i in range(3)]
    assert truths == ["backlash@joint1", "healthy", "backlash@joint2"]
    for wrong in ({"fault": "healthy"}, [None], ["healthy"] * 3):
        with pytest.raises(InvalidSetting, match="env_options"):
            env.reset(options={"env_options": wrong})


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


RECORDS = 2
NAMES = ["planar", "vera", "six_axis", "scara", "desk"]

Episode = list[Any]
"""First observation, then observation, reward and ends of every step, then the truth."""


def plan(layout: ActionLayout, seed: int, number: int) -> list[NDArray[np.int64]]:
    """What is done in an episode: two records and a verdict, different from episode to episode."""
    rng = np.random.default_rng([seed, number])
    n = layout.arm.n
    actions = [
        layout.encode(
            moves=rng.integers(0, 5, n), levels=rng.integers(1, 4, n), duration=rng.integers(0, 2)
        )
        for _ in range(RECORDS)
    ]
    return [*actions, layout.encode(verdict=1 + number % 2)]


def play_single(env: DiagnosisEnv, seed: int, episodes: int) -> list[Episode]:
    found = []
    for number in range(episodes):
        episode: Episode = [env.reset(seed=seed if number == 0 else None)[0]]
        for action in plan(env.actions, seed, number):
            observation, reward, terminated, truncated, info = env.step(action)
            episode.append((observation, reward, terminated, truncated))
        episode.append(info["fault_figures"])
        found.append(episode)
    return found


def play_vector(
    env: DiagnosisVectorEnv, seeds: list[int], episodes: int, **reset: Any
) -> list[list[Episode]]:
    """Play on with autoreset; episodes of every environment."""
    observation, _ = env.reset(**(reset or {"seed": seeds}))
    found: list[list[Episode]] = [[] for _ in seeds]
    for number in range(episodes):
        running: list[Episode] = [[observation[i]] for i in range(len(seeds))]
        plans = [plan(env.actions, seed, number) for seed in seeds]
        for step in range(RECORDS + 1):
            actions = np.stack([p[step] for p in plans])
            observation, rewards, terminated, truncated, infos = env.step(actions)
            for i, episode in enumerate(running):
                seen = infos["final_obs"][i] if terminated[i] else observation[i]
                episode.append((seen, rewards[i], terminated[i], truncated[i]))
        for i, episode in enumerate(running):
            episode.append(infos["final_info"]["fault_figures"][i])
            found[i].append(episode)
    return found


def assert_same(found: list[Episode], expected: list[Episode]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        for step, other_step in zip(one[1:-1], other[1:-1], strict=True):
            for x, y in zip(step, other_step, strict=True):
                np.testing.assert_array_equal(x, y)
        assert one[-1] == other[-1]


def test_what_ran_before_changes_nothing(make_env: Make) -> None:
    expected = play_single(make_env(n_links=3), 7, 2)
    env = make_env(n_links=3)
    play_single(env, 8, 3)
    env.reset(seed=9, options={"fault": "backlash@joint1", "pose": np.zeros(3)})
    env.step(env.actions.encode(levels=np.array([3, 3, 3])))
    assert_same(play_single(env, 7, 2), expected)


@pytest.mark.parametrize(
    ("name", "num_envs", "threads"),
    [
        *(("planar", num, threads) for num, threads in ((1, 1), (8, 1), (8, 3))),
        *((name, 3, 2) for name in ("vera", "six_axis", "scara", "desk")),
    ],
)
def test_a_batch_plays_the_episodes_of_its_seeds_at_any_size_and_thread_count(
    make_env: Make, make_vector: Make, name: str, num_envs: int, threads: int
) -> None:
    # Second and third episodes come from autoreset here and from reset() in the single form.
    seeds = [40 + 3 * i for i in range(num_envs)]
    found = play_vector(make_vector(name, num_envs=num_envs, threads=threads), seeds, 3)
    for i in {0, num_envs // 2, num_envs - 1}:
        assert_same(found[i], play_single(make_env(name), seeds[i], 3))


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


def going_on(env: DiagnosisVectorEnv) -> NDArray[np.int64]:
    """A short record in every environment."""
    levels = np.ones(env.arm.n, dtype=int)
    return np.stack([env.actions.encode(levels=levels, duration=0)] * env.num_envs)


def deciding(env: DiagnosisVectorEnv, which: list[int]) -> NDArray[np.int64]:
    """A verdict in some environments, a short record in the others."""
    actions = going_on(env)
    actions[which, -1] = 1
    return actions


def test_an_ended_episode_starts_anew_in_the_same_step(make_vector: Make) -> None:
    env = make_vector(n_links=2, num_envs=3)
    env.reset(seed=0)
    before = env.step(going_on(env))[0]
    observation, rewards, terminated, truncated, infos = env.step(deciding(env, [1]))
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert abs(rewards[1]) == 1.0

    # The observation is the new episode's first one; that of the ended one is kept.
    assert not env.layout.slots_of(observation)[1].any()
    assert infos["_final_obs"].tolist() == infos["_final_info"].tolist() == [False, True, False]
    assert [o is None for o in infos["final_obs"]] == [True, False, True]
    np.testing.assert_array_equal(infos["final_obs"][1], before[1])
    assert infos["final_info"]["records"][1] == 1
    assert infos["final_info"]["is_success"][1] == (rewards[1] == 1.0)

    # The others have gone on.
    valid = env.layout.physical(observation, "valid")[:, :2, 0]
    assert valid.tolist() == [[1, 1], [0, 0], [1, 1]]
    # And the new episode runs.
    observation, _, terminated, _, infos = env.step(going_on(env))
    assert not terminated.any() and "final_obs" not in infos
    valid = env.layout.physical(observation, "valid")[:, :3, 0]
    assert valid.tolist() == [[1, 1, 1], [1, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize("raw", [False, True])
def test_records_of_different_length_can_be_taken_together(make_vector: Make, raw: bool) -> None:
    env = make_vector(n_links=2, num_envs=3, raw=raw)
    env.reset(seed=0)
    actions = going_on(env)
    actions[:, -2] = [0, 2, 1]
    actions[2, 2:4] = 0  # which excites the last joint
    observation = env.step(actions)[0]
    assert observation in env.observation_space
    flat = observation["statistics"] if raw else observation
    seen = env.layout.physical(flat, "duration")[:, 0, 0]
    np.testing.assert_allclose(seen, [0.2, 1.2, 0.4], rtol=1e-6)


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
