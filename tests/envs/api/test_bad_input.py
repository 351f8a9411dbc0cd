"""What cannot be done is refused with an error that says what was given and what is allowed."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import loose_env
from loose_env.arms import Mismatch
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.settings import DiagnosisSettings, Difficulty, Prices
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.errors import InvalidAction, InvalidData, InvalidSetting, LooseEnvError, UnknownName
from loose_env.faults import Backlash, Fault, StructuralLooseness
from loose_env.registration import IDS

MakeEnv = Callable[..., DiagnosisEnv]
MakeVector = Callable[..., DiagnosisVectorEnv]
NAN, INF = float("nan"), float("inf")


def refused(error: type[LooseEnvError], *words: str) -> Any:
    """The package's own error, naming all of the words in order."""
    return pytest.raises(error, match="(?s)" + ".*".join(re.escape(word) for word in words))


# ---- making an environment


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_an_unknown_argument_is_refused_with_those_that_exist(make: Callable[..., Any]) -> None:
    loose_env.register()
    for env_id, arguments, known in (
        ("loose_env/Planar-v0", {"links": 3}, ("links", "n_links", "vertical", "hold")),
        ("loose_env/Vera-v0", {"n_links": 3}, ("n_links", "hold")),
        ("loose_env/Vera-v0", {"rewards": 3}, ("rewards", "threads", "difficulty", "prices")),
        ("loose_env/SixAxis-v0", {"model": "arm.xml"}, ("model", "hold")),
        ("loose_env/Scara-v0", {"n_links": 3}, ("n_links", "hold")),
        ("loose_env/Arm-v0", {"path": "arm.xml"}, ("path", "model", "tool", "joints", "hold")),
    ):
        with refused(UnknownName, *known):
            make(env_id, **arguments)


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"model": "nowhere.xml"}, InvalidSetting, ("'nowhere.xml'", "MJCF or URDF")),
        ({"model": 3}, InvalidSetting, ("path of an MJCF or URDF", "3")),
        ({"tool": "hook"}, UnknownName, ("'hook'", "sites: 'tool'", "bodies: 'column'")),
        ({"joints": ["left_finger"]}, UnknownName, ("do not move the tool", "'left_finger'")),
        ({"joints": ["hip"]}, UnknownName, ("no such joints", "'hip'", "'base', 'shoulder'")),
        ({"joints": []}, InvalidData, ("names none", "'base', 'shoulder'")),
        ({"joints": 2}, InvalidSetting, ("list of names", "2", "'base', 'shoulder'")),
    ],
)
def test_a_file_or_a_part_of_it_that_is_not_there_is_refused(
    make: Callable[..., Any],
    arguments: dict[str, Any],
    error: type[LooseEnvError],
    words: tuple[str, ...],
) -> None:
    with refused(error, *words):
        make("loose_env/Arm-v0", **arguments)


@pytest.mark.parametrize("n_links", [1, 8, 0, -3, 2.5, "4", None, True])
def test_a_planar_arm_of_other_than_2_to_7_links_is_refused(n_links: Any) -> None:
    with refused(InvalidSetting, "2 to 7 links", f"n_links={n_links!r}"):
        gymnasium.make("loose_env/Planar-v0", n_links=n_links)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("hold", ["glue", None, 1])
def test_an_unknown_way_of_holding_is_refused(env_id: str, hold: Any) -> None:
    with refused(UnknownName, repr(hold), "'compliant'"):
        gymnasium.make(env_id, hold=hold)


@pytest.mark.parametrize("difficulty", ["impossible", "", 3, None, ["easy"]])
def test_an_unknown_difficulty_is_refused(difficulty: Any) -> None:
    with refused(UnknownName, repr(difficulty), "'easy', 'default', 'hard'"):
        DiagnosisSettings(difficulty=difficulty)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("max_records", 0, ("whole number, 1 or more", "0")),
        ("max_records", -1, ("whole number, 1 or more", "-1")),
        ("max_records", 2.5, ("whole number, 1 or more", "2.5")),
        ("max_records", "12", ("whole number, 1 or more", "'12'")),
        ("max_records", True, ("whole number, 1 or more", "True")),
        ("moves", (-45.0, 45.0), ("0 among them", "(-45.0, 45.0)")),
        ("moves", (), ("0 among them", "()")),
        ("moves", (0.0, NAN), ("finite degrees", "nan")),
        ("moves", (0.0, "45"), ("finite degrees", "'45'")),
        ("durations", (), ("positive seconds", "()")),
        ("durations", (0.2, 0.0), ("positive seconds", "0.0")),
        ("durations", (0.2, -1.0), ("positive seconds", "-1.0")),
        ("durations", (NAN,), ("positive seconds", "nan")),
        ("durations", (INF,), ("positive seconds", "inf")),
        ("prices", {"record": 0.1}, ("prices must be a Prices", "{'record': 0.1}")),
        ("prices", None, ("prices must be a Prices", "None")),
        ("sensors", 1000.0, ("sensors must be a SensorSuite", "1000.0")),
    ],
)
def test_a_bad_setting_is_refused(name: str, value: Any, words: tuple[str, ...]) -> None:
    arguments: dict[str, Any] = {name: value}
    with refused(InvalidSetting, *words):
        DiagnosisSettings(**arguments)
    with refused(InvalidSetting, *words):
        gymnasium.make("loose_env/Planar-v0", **arguments)


def test_a_record_too_short_for_the_band_is_refused_before_the_first_step() -> None:
    with refused(InvalidSetting, "0.01 s", "(30.0, 150.0) Hz", "lengthen"):
        gymnasium.make("loose_env/Planar-v0", n_links=2, durations=(0.2, 0.01))


@pytest.mark.parametrize("name", ["record", "second", "level"])
@pytest.mark.parametrize("value", [-0.1, NAN, INF, "1", None])
def test_a_price_is_a_finite_number_zero_or_more(name: str, value: Any) -> None:
    with refused(InvalidSetting, f"Prices.{name}", "finite number, zero or more", repr(value)):
        Prices(**{name: value})


@pytest.mark.parametrize("name", ["correct", "wrong", "false_alarm", "miss", "unsure"])
@pytest.mark.parametrize("value", [NAN, INF, -INF, "1"])
def test_a_reward_is_a_finite_number(name: str, value: Any) -> None:
    with refused(InvalidSetting, f"Prices.{name}", "finite number", repr(value)):
        Prices(**{name: value})


@pytest.mark.parametrize("name", ["correct", "wrong", "unsure"])
def test_only_the_special_rewards_can_be_left_out(name: str) -> None:
    with refused(InvalidSetting, f"Prices.{name}", "None"):
        Prices(**{name: None})
    assert Prices(false_alarm=None, miss=None) == Prices()


@pytest.mark.parametrize("name", ["friction", "gap", "contact_mode", "contact_damping"])
@pytest.mark.parametrize("limits", [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (1.0, INF), (NAN, 1.0)])
def test_a_range_of_a_difficulty_runs_from_above_zero_upward(
    name: str, limits: tuple[float, float]
) -> None:
    ranges: dict[str, Any] = {name: limits}
    with refused(InvalidSetting, name, "0 < low <= high", str(limits)):
        Difficulty(**ranges)


def test_an_unknown_kind_of_fault_is_refused() -> None:
    with refused(UnknownName, "'rust'", "'healthy', 'structural_looseness', 'backlash'"):
        Difficulty(kinds={"healthy": 0.5, "rust": 0.5})


@pytest.mark.parametrize(
    "kinds", [{}, {"healthy": 0.5}, {"healthy": 1.5, "backlash": -0.5}, {"healthy": NAN}]
)
def test_kinds_whose_probabilities_do_not_add_up_are_refused(kinds: dict[str, float]) -> None:
    with refused(InvalidSetting, "sum to 1", str(kinds)):
        Difficulty(kinds=kinds)


@pytest.mark.parametrize("value", [-0.1, NAN, INF])
def test_a_mismatch_below_zero_is_refused(value: float) -> None:
    with refused(InvalidSetting, "mass", "zero or more", repr(value)):
        Mismatch(mass=value)


@pytest.mark.parametrize("num_envs", [0, -1, True])
def test_a_vector_has_at_least_one_environment(make_vector: MakeVector, num_envs: Any) -> None:
    with refused(InvalidSetting, "num_envs", "1 or more", repr(num_envs)):
        make_vector(n_links=2, num_envs=num_envs)


def test_an_unknown_render_mode_is_refused() -> None:
    with refused(UnknownName, "'ascii'", "rgb_array", "human"):
        gymnasium.make("loose_env/Vera-v0", render_mode="ascii", disable_env_checker=True)


def test_rendering_without_a_mode_is_refused(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    with refused(UnknownName, "render_mode", "'rgb_array'"):
        env.render()


# ---- reset


@pytest.mark.parametrize("fault", ["rust", "backlash@joint3", "backlash", "", 3, ["healthy"]])
def test_an_unknown_fault_is_refused_with_the_hypotheses(make_env: MakeEnv, fault: Any) -> None:
    env = make_env(n_links=2)
    with refused(UnknownName, repr(fault), "'healthy'", "'backlash@joint2'"):
        env.reset(seed=0, options={"fault": fault})


@pytest.mark.parametrize(
    ("fault", "place"),
    [
        (Backlash(joint=3, gap=1e-4, stiffness=(1e3, 1e3)), 3),
        (Backlash(joint=0, gap=1e-4, stiffness=(1e3, 1e3)), 0),
        (StructuralLooseness(link=7, direction=(1.0, 0.0, 0.0), gap=1e-4, stiffness=(1e4, 1e4)), 7),
    ],
)
def test_a_fault_of_a_link_the_arm_lacks_is_refused(
    make_env: MakeEnv, fault: Fault, place: int
) -> None:
    env = make_env("vera")
    with refused(UnknownName, "'vera'", "links 1 to 2", f"got {place}"):
        env.reset(seed=0, options={"fault": fault})


def test_a_fault_too_stiff_for_the_step_is_refused(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    stiff = Backlash(joint=1, gap=1e-4, stiffness=(1e12, 1e3))
    with refused(InvalidSetting, "1e+12", "too fast for a step"):
        env.reset(seed=0, options={"fault": stiff})


@pytest.mark.parametrize("pose", [[0.1], [0.1, 0.2, 0.3], [0.1, NAN], [INF, 0.0], "ab", 0.5])
def test_a_pose_is_one_finite_number_for_every_joint(make_env: MakeEnv, pose: Any) -> None:
    env = make_env(n_links=2)
    with refused(InvalidSetting, "2 finite numbers", repr(pose)):
        env.reset(seed=0, options={"pose": pose})


def test_a_pose_past_a_joint_limit_is_refused(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    with refused(InvalidSetting, "[0.0, 3.0]", "ranges", "2.617"):
        env.reset(seed=0, options={"pose": [0.0, 3.0]})


def test_an_unknown_option_is_refused(make_env: MakeEnv, make_vector: MakeVector) -> None:
    for env in (make_env(n_links=2), make_vector(n_links=2)):
        with refused(UnknownName, "'foult'", "fault, pose, mismatch_scale, preload_g"):
            env.reset(seed=0, options={"foult": "healthy"})


@pytest.mark.parametrize("name", ["mismatch_scale", "preload_g"])
@pytest.mark.parametrize("value", [NAN, INF, "3", True, [3.0]])
def test_a_number_among_the_options_is_finite(make_env: MakeEnv, name: str, value: Any) -> None:
    env = make_env(n_links=2)
    with refused(InvalidSetting, name, "finite number", repr(value)):
        env.reset(seed=0, options={name: value})


@pytest.mark.parametrize(("scale", "words"), [(-1.0, "zero or more"), (4.0, "must be below 0.33")])
def test_a_mismatch_that_is_none_is_refused(make_env: MakeEnv, scale: float, words: str) -> None:
    env = make_env(n_links=2)
    with refused(InvalidSetting, "mismatch", words):
        env.reset(seed=0, options={"mismatch_scale": scale})


def test_a_refused_reset_leaves_the_running_episode_alone(make_env: MakeEnv) -> None:
    env, plain = make_env(n_links=2), make_env(n_links=2)
    for e in (env, plain):
        e.reset(seed=0)
    for options in ({"fault": "rust"}, {"pose": [9.0, 9.0]}, {"x": 1}):
        with pytest.raises(LooseEnvError):
            env.reset(options=options)
    action = env.actions.encode(levels=np.array([1, 1]), duration=0)
    np.testing.assert_array_equal(env.step(action)[0], plain.step(action)[0])


@pytest.mark.parametrize("seed", [-1, 1.5, "a"])
def test_a_seed_is_a_whole_number_zero_or_more(
    make_env: MakeEnv, make_vector: MakeVector, seed: Any
) -> None:
    with pytest.raises(gymnasium.error.Error, match="Seed must"):
        make_env(n_links=2).reset(seed=seed)
    env = make_vector(n_links=2)
    for seeds in (seed, [seed, 1], [1, seed]):
        with refused(InvalidSetting, "whole number, zero or more", repr(seed)):
            env.reset(seed=seeds)
    env.reset()  # and nothing of them stays


def test_a_list_of_seeds_has_one_for_each_environment(make_vector: MakeVector) -> None:
    env = make_vector(n_links=2, num_envs=3)
    for seeds in ([], [1], [1, 2, 3, 4]):
        with refused(InvalidSetting, "3 seeds", f"got {len(seeds)}"):
            env.reset(seed=seeds)


@pytest.mark.parametrize(
    "mask", [np.array([True]), np.array([False, False]), np.array([1, 0]), "yes"]
)
def test_a_reset_mask_is_one_boolean_for_each_environment(
    make_vector: MakeVector, mask: Any
) -> None:
    env = make_vector(n_links=2, num_envs=2)
    env.reset(seed=0)
    with refused(InvalidSetting, "reset_mask", "2 booleans", repr(mask)):
        env.reset(options={"reset_mask": mask})


def test_a_refused_reset_leaves_the_sequence_of_episodes_as_it_was(
    make_vector: MakeVector,
) -> None:
    env, expected = make_vector(n_links=2, num_envs=2), make_vector(n_links=2, num_envs=2)
    env.reset(seed=3)
    expected.reset(seed=3)
    for seed, options in (
        (5, {"fault": "nonsense"}),
        (None, {"env_options": [None, {"fault": "nonsense"}]}),
    ):
        with pytest.raises(UnknownName):
            env.reset(seed=seed, options=options)
    assert np.array_equal(env.reset()[0], expected.reset()[0])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"levels": [3]}, "levels: 3 whole numbers from 0 to 3"),
        ({"levels": [4, 0, 0]}, "levels"),
        ({"levels": [0, 0, 2.7]}, "levels"),
        ({"moves": [7, 2, 2]}, "moves: 3 whole numbers from 0 to 4"),
        ({"moves": [2, -1, 2]}, "moves"),
        ({"duration": 3}, "duration and verdict"),
        ({"verdict": -1}, "duration and verdict"),
    ],
)
def test_an_action_is_not_built_of_what_is_no_choice(
    make_env: MakeEnv, given: dict[str, Any], words: str
) -> None:
    for rules in ({}, {"max_excited": 1, "max_moved": 1}):
        with refused(InvalidAction, words):
            make_env(n_links=3, **rules).actions.encode(**given)


# ---- step


@pytest.mark.parametrize(
    "action",
    [
        [2, 2, 1, 0, 0],
        [2, 2, 1, 0, 0, 0, 0],
        [[2, 2, 1, 0, 0, 0]],
        2,
        None,
        "221000",
        [[2], [2, 1]],
        {},
    ],
)
def test_an_action_of_the_wrong_shape_is_refused(make_env: MakeEnv, action: Any) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    with refused(InvalidAction, "2 joints", "6 whole numbers", "got"):
        env.step(action)


@pytest.mark.parametrize(
    "action",
    [
        [2, 2, 1, 0, 0, 0.5],
        [2, 2, 1, 0, 0, NAN],
        [2, 2, 1, 0, 0, 1j],
        ["2", "2", "1", "0", "0", "0"],
        [2, 2, 1, 0, 0, None],
        [True, True, True, False, False, False],
        [2, 2, 1, 0, 0, 10**30],
    ],
)
def test_an_action_that_is_not_of_whole_numbers_is_refused(
    make_env: MakeEnv, action: list[Any]
) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    with refused(InvalidAction, "whole numbers", repr(action[-1]).strip("'")):
        env.step(action)  # type: ignore[arg-type]


@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("value", [-1, 9, INF, -INF, 1e300])
def test_an_entry_out_of_range_is_refused(make_env: MakeEnv, place: int, value: float) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    action: list[float] = [2, 2, 1, 0, 0, 0]
    action[place] = value
    with refused(InvalidAction, "0 to [4, 4, 3, 3, 2, 6]", str(value)):
        env.step(np.array(action))


def test_a_refused_action_leaves_the_episode_as_it_was(make_env: MakeEnv) -> None:
    env, plain = make_env(n_links=2), make_env(n_links=2)
    good = env.actions.encode(levels=np.array([1, 1]), duration=0)
    for e in (env, plain):
        e.reset(seed=0)
        e.step(good)
    for action in ([0], [9] * 6, [0.5] * 6):
        with pytest.raises(InvalidAction):
            env.step(action)  # type: ignore[arg-type]
    np.testing.assert_array_equal(env.step(good)[0], plain.step(good)[0])


def test_one_bad_action_of_a_batch_holds_up_all_of_it(make_vector: MakeVector) -> None:
    env, plain = make_vector(n_links=2), make_vector(n_links=2)
    good = np.stack([env.actions.encode(levels=np.array([1, 1]), duration=0)] * 2)
    bad = good.copy()
    bad[1, -1] = 99
    for e in (env, plain):
        e.reset(seed=0)
    with refused(InvalidAction, "0 to", "99"):
        env.step(bad)
    np.testing.assert_array_equal(env.step(good)[0], plain.step(good)[0])


@pytest.mark.parametrize("shape", [(6,), (3, 6), (1, 6), (2, 6, 1)])
def test_actions_of_a_batch_are_one_row_for_each_environment(
    make_vector: MakeVector, shape: tuple[int, ...]
) -> None:
    env = make_vector(n_links=2)
    env.reset(seed=0)
    with refused(InvalidAction, "shape (2, 6)", f"got {shape}"):
        env.step(np.zeros(shape, dtype=int))
    with refused(InvalidAction, "shape (2, 6)"):
        env.step([[2, 2, 1, 0, 0, 0], [2]])


def test_whole_numbers_may_come_in_any_type(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    seen = []
    for kind in (np.int64, np.int8, np.uint16, np.float32, list):
        env.reset(seed=0)
        action = env.actions.encode(levels=np.array([1, 2]), duration=0)
        seen.append(env.step(action.tolist() if kind is list else action.astype(kind))[0])
    for other in seen[1:]:
        np.testing.assert_array_equal(other, seen[0])


def test_nothing_goes_before_the_first_reset(make_env: MakeEnv, make_vector: MakeVector) -> None:
    env = make_env(n_links=2)
    batch = make_vector(n_links=2)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(env.actions.encode())
    with pytest.raises(ResetNeeded, match="reset"):
        env.action_masks()
    with pytest.raises(ResetNeeded, match="reset"):
        batch.step(np.stack([env.actions.encode()] * 2))
    with pytest.raises(ResetNeeded, match="reset"):
        batch.action_masks()
    with pytest.raises(ResetNeeded, match="reset"):
        batch.reset(options={"reset_mask": np.array([True, False])})
    batch.reset()


def test_a_picture_needs_a_reset_too() -> None:
    env = gymnasium.make("loose_env/Vera-v0", render_mode="rgb_array").unwrapped
    with pytest.raises(ResetNeeded, match="reset"):
        env.render()
    env.close()
