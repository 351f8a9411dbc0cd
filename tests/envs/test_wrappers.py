"""Wrappers: spaces, what they show and take, and that any library can train through them."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from loose_env.envs import batch_seeds
from loose_env.errors import InvalidAction, InvalidSetting
from loose_env.wrappers import (
    JointSideObservation,
    MacroActions,
    MeasuredMinusNominal,
    PosteriorObservation,
    vector,
)

PLAIN: list[type[Any]] = [
    PosteriorObservation,
    MeasuredMinusNominal,
    JointSideObservation,
    MacroActions,
]


def make(**arguments: Any) -> Any:
    usual = {"n_links": 2, "durations": (0.1,), "max_records": 4, "threads": 1}
    return gymnasium.make("loose_env/Planar-v0", **{**usual, **arguments})


def shake(env: Any, level: int = 2) -> Any:
    return env.unwrapped.actions.encode(levels=np.full(2, level))


@pytest.mark.parametrize("wrapper", PLAIN)
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped.*")
def test_whole_episodes_stay_in_the_spaces_and_masks_fit(wrapper: type[Any]) -> None:
    check_env(wrapper(make().unwrapped), skip_render_check=True)
    env = wrapper(make())
    env.action_space.seed(0)
    inner = env.action_space
    choices = inner.n if isinstance(inner, gymnasium.spaces.Discrete) else inner.nvec.sum()
    ended = 0
    observation, info = env.reset(seed=0)
    for _ in range(20):
        assert observation in env.observation_space
        assert info["action_mask"].shape == (choices,)
        np.testing.assert_array_equal(info["action_mask"], env.action_masks())
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            ended += 1
            observation, info = env.reset()
    assert ended > 2


@pytest.mark.parametrize("wrapper", PLAIN)
def test_a_spec_and_a_pickle_make_the_same_wrapper(wrapper: type[Any]) -> None:
    env = wrapper(make())
    first = env.reset(seed=3)[0]
    for other in (gymnasium.make(env.spec), pickle.loads(pickle.dumps(env))):
        assert isinstance(other, wrapper)
        np.testing.assert_array_equal(other.reset(seed=3)[0], first)


@pytest.mark.parametrize("wrapper", PLAIN)
def test_what_is_no_single_flat_environment_is_refused(wrapper: type[Any]) -> None:
    with pytest.raises(InvalidSetting, match="raw"):
        wrapper(make(raw=True))
    with pytest.raises(InvalidSetting, match="CartPole"):
        wrapper(gymnasium.make("CartPole-v1"))


def test_differences_are_of_twins_and_the_rest_stays() -> None:
    env = MeasuredMinusNominal(make())
    env.reset(seed=1)
    shown = env.step(shake(env))[0]
    _, records = env.layout.split(shown)
    slot = env.unwrapped.layout.slots_of(env.unwrapped.batch.observe(0))[0]
    full = {e.name: slot[k] for k, e in enumerate(env.unwrapped.layout.slot_elements)}
    for k, element in enumerate(env.layout.slot_elements):
        wanted = full[element.name] - full.get(f"nominal_{element.name}", 0.0)
        assert records[0, k] == pytest.approx(wanted, abs=1e-6)
    assert not records[1:].any()


def test_the_posterior_is_that_of_the_estimator() -> None:
    from loose_agents.base import Problem
    from loose_agents.belief import Tracker

    env = PosteriorObservation(make(durations=(0.2,)))
    inner = env.unwrapped
    problem = Problem.of(inner.arm, inner.settings)
    tracker = Tracker(problem)
    memory = tracker.begin()
    env.reset(seed=5, options={"fault": "structural_looseness@link2"})
    for _ in range(3):
        info = env.step(shake(env, 3))[-1]
        (wanted,) = tracker.follow(inner.batch.observe(0)[None], [memory])
        np.testing.assert_allclose(info["probabilities"], wanted, rtol=1e-9)
    assert info["probabilities"].max() > 0.6
    assert env.reset(seed=6)[1]["probabilities"].max() < 0.4
    with pytest.raises(InvalidSetting, match="full observation"):
        PosteriorObservation(MeasuredMinusNominal(make()))
    with pytest.raises(InvalidSetting, match=r"update_all\(\)"):
        PosteriorObservation(make(), 3)  # type: ignore[arg-type]


def test_a_macro_is_the_record_it_stands_for() -> None:
    env, plain = MacroActions(make()), make()
    rng = np.random.default_rng(0)
    for seed in range(3):
        env.reset(seed=seed)
        plain.reset(seed=seed)
        choice = int(rng.choice(np.flatnonzero(env.action_masks())))
        found, expected = env.step(choice), plain.step(env.macros[choice])
        np.testing.assert_array_equal(found[0], expected[0])
        assert found[1] == expected[1]
        assert not found[-1]["move_ignored"].any()
    count = len(env.macros)
    assert env.action_masks()[count:].tolist() == [True] * 5 + [False]
    assert env.step(count + 1)[-1]["verdict"] == env.unwrapped.verdicts[1]
    encode = env.unwrapped.actions.encode
    for wrong in (3, [], [encode(verdict=1)], [encode()]):
        with pytest.raises(InvalidSetting, match="record"):
            MacroActions(make(), wrong)  # type: ignore[arg-type]
    with pytest.raises(InvalidAction, match="0 to"):
        env.step(count + 6)


STACKS = [
    ["PosteriorObservation", "MacroActions"],
    ["MeasuredMinusNominal"],
    ["JointSideObservation"],
]


def make_batch(names: list[str], **arguments: Any) -> Any:
    usual = {"n_links": 2, "durations": (0.1,), "max_records": 3, "engine": "reduced"}
    envs: Any = gymnasium.make_vec("loose_env/Planar-v0", num_envs=3, **{**usual, **arguments})
    for name in names:
        envs = getattr(vector, name)(envs)
    return envs


@pytest.mark.parametrize("names", STACKS, ids="+".join)
@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_a_batch_shows_what_each_environment_shows_alone(names: list[str], mode: str) -> None:
    envs = make_batch(names, autoreset_mode=mode)
    singles = []
    for _ in range(3):
        env = make(max_records=3, engine="reduced")
        for name in names:
            env = globals()[name](env)
        singles.append(env)
    envs.action_space.seed(4)
    observations, infos = envs.reset(seed=11)
    assert observations in envs.observation_space
    seeds = batch_seeds(11, 3)
    alone = [env.reset(seed=seed) for env, seed in zip(singles, seeds, strict=True)]
    over, ended = np.zeros(3, dtype=bool), 0
    for _ in range(14):
        for i, (observation, info) in enumerate(alone):
            np.testing.assert_array_equal(observations[i], observation)
            np.testing.assert_array_equal(infos["action_mask"][i], info["action_mask"])
            if "probabilities" in info:
                np.testing.assert_array_equal(infos["probabilities"][i], info["probabilities"])
        np.testing.assert_array_equal(envs.action_masks()[~over], infos["action_mask"][~over])
        actions = envs.action_space.sample()
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        assert observations in envs.observation_space
        again = over
        over = (terminated | truncated) & (mode == "NextStep")
        for i, env in enumerate(singles):
            if again[i]:
                alone[i] = env.reset()
                continue
            observation, reward, *over_now, info = env.step(actions[i])
            assert (reward, over_now) == (rewards[i], [terminated[i], truncated[i]])
            alone[i] = observation, info
            if any(over_now) and mode == "SameStep":
                ended += 1
                np.testing.assert_array_equal(infos["final_obs"][i], observation)
                final = infos["final_info"]
                np.testing.assert_array_equal(final["action_mask"][i], info["action_mask"])
                assert final["fault"][i] == info["fault"]
                alone[i] = env.reset()
    assert ended > 3 or mode == "NextStep"


def test_stable_baselines3_takes_a_wrapped_batch() -> None:
    sb3 = pytest.importorskip("loose_env.envs.sb3")
    env = sb3.Sb3VecEnv(make_batch(STACKS[0]))
    env.seed(0)
    assert env.reset().shape == (3, *env.observation_space.shape)
    masks = np.array(env.env_method("action_masks"))
    assert masks.shape == (3, env.action_space.n)
    right = env.get_attr("verdicts")[0].index("healthy")
    env.step(np.zeros(3, dtype=int))
    *_, dones, infos = env.step(np.full(3, env.action_space.n - 6 + right))
    assert dones.all()
    assert infos[0]["probabilities"].shape == (5,)
    assert infos[0]["terminal_observation"].shape == env.observation_space.shape


def test_batches_are_copied_and_the_wrong_kind_is_refused() -> None:
    envs = make_batch(STACKS[0])
    envs.reset(seed=3)
    other = pickle.loads(pickle.dumps(envs))
    actions = np.array([0, 1, 2])
    for _ in range(3):
        np.testing.assert_array_equal(envs.step(actions)[0], other.step(actions)[0])
    with pytest.raises(InvalidSetting, match=r"take loose_env\.wrappers\.vector"):
        MacroActions(make_batch([]))
    with pytest.raises(InvalidSetting, match="one environment take"):
        vector.MacroActions(make())
    with pytest.raises(InvalidAction, match="from 0 to"):
        envs.step(np.array([0, 1, 99]))
    with pytest.raises(InvalidAction, match="from 0 to"):
        envs.step(np.zeros((3, 2), dtype=int))


ARGUMENTS = {"n_links": 2, "engine": "reduced", "max_records": 2}


def names_of(env):
    """Elements of the flat observation."""
    layout = env.get_wrapper_attr("layout")
    records = [
        f"record{k + 1}.{each.name}" for k in range(layout.slots) for each in layout.slot_elements
    ]
    return [each.name for each in layout.global_elements] + records


def test_only_what_torque_and_encoders_give_is_left() -> None:
    env = JointSideObservation(gymnasium.make("loose_env/Planar-v0", **ARGUMENTS))
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    names = names_of(env)
    assert len(names) == len(seen)
    words = ("tool", "transmission", "coherence", "kurtosis", "skewness", "direction", "link")
    assert not [name for name in names if any(word in name for word in words)]
    assert {"record2.inertia.joint2", "record2.nominal_inertia.joint2"} <= set(names)
    whole = [element.name for element in env.unwrapped.layout.elements]
    assert {name for name in whole if name.startswith(("now", "spent"))} <= set(names)


def test_it_takes_other_layouts() -> None:
    env = JointSideObservation(gymnasium.make("loose_env/Planar-v0", **ARGUMENTS))
    difference = MeasuredMinusNominal(gymnasium.make("loose_env/Planar-v0", **ARGUMENTS))
    alone = JointSideObservation(difference)
    assert alone.observation_space.contains(alone.reset(seed=1)[0])
    assert not [name for name in names_of(alone) if "nominal" in name]
    with pytest.raises(InvalidSetting, match="inside the wrappers"):
        PosteriorObservation(env)
