"""The checkers of Gymnasium and stable-baselines3 find nothing, not even a warning."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

import loose_env
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.registration import IDS, MAX_EPISODE_STEPS

ROOT = Path(__file__).resolve().parents[3]
FORMS = [
    ("loose_env/Vera-v0", {}),
    ("loose_env/Vera-v0", {"hold": "servo", "difficulty": "hard"}),
    ("loose_env/Planar-v0", {}),
    ("loose_env/Planar-v0", {"n_links": 2, "vertical": True, "difficulty": "easy"}),
    ("loose_env/Planar-v0", {"n_links": 7, "hold": "servo"}),
    ("loose_env/SixAxis-v0", {}),
    ("loose_env/Scara-v0", {"hold": "servo"}),
    ("loose_env/Arm-v0", {}),
    ("loose_env/Arm-v0", {"joints": ["base", "elbow"], "tool": "hand", "difficulty": "easy"}),
]
SHORT = {"durations": (0.2,)}


@pytest.fixture(autouse=True)
def no_warning_is_let_through() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_all_ids_are_registered() -> None:
    names = ("Vera", "Planar", "SixAxis", "Scara", "Arm")
    assert tuple(f"loose_env/{name}-v0" for name in names) == IDS
    assert set(IDS) <= set(gymnasium.registry)
    loose_env.register()  # once more does no harm


@pytest.mark.parametrize("env_id", IDS)
def test_a_fresh_process_makes_the_environment_without_importing_the_package(env_id: str) -> None:
    code = (
        "import sys, gymnasium\n"
        "assert 'loose_env' not in sys.modules\n"
        f"env = gymnasium.make('loose_env:{env_id}')\n"
        "env.reset(seed=0)\n"
        "env.step(env.action_space.sample())\n"
        f"env = gymnasium.make_vec('loose_env:{env_id}', num_envs=2)\n"
        "env.reset(seed=0)\n"
        "env.step(env.action_space.sample())\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr


def test_the_planar_arm_has_four_links_in_a_horizontal_plane_unless_told_otherwise() -> None:
    plain = gymnasium.make("loose_env/Planar-v0").unwrapped
    assert isinstance(plain, DiagnosisEnv)
    assert (plain.arm.name, plain.arm.n, plain.arm.hold) == ("planar4", 4, "brake")
    told = gymnasium.make("loose_env/Planar-v0", n_links=7, vertical=True, hold="servo").unwrapped
    assert isinstance(told, DiagnosisEnv)
    assert (told.arm.name, told.arm.n, told.arm.hold) == ("planar7v-servo", 7, "servo")
    for env in (plain, told):
        env.close()


def test_spatial_ids_are_their_arms() -> None:
    for env_id, name, joints in (("SixAxis", "six_axis", 6), ("Scara", "scara", 4)):
        env = gymnasium.make(f"loose_env/{env_id}-v0", hold="servo").unwrapped
        assert isinstance(env, DiagnosisEnv)
        assert (env.arm.name, env.arm.n, env.arm.axes) == (f"{name}-servo", joints, (0, 1, 2))
        env.close()


def test_any_arm_is_the_one_in_the_file_named_or_a_small_one(tmp_path: Path) -> None:
    plain = gymnasium.make("loose_env/Arm-v0").unwrapped
    assert isinstance(plain, DiagnosisEnv)
    assert (plain.arm.name, plain.arm.n) == ("desk_arm", 6)
    path = tmp_path / "pendulum.xml"
    path.write_text(
        """<mujoco><worldbody><body name="rod"><joint name="pivot" axis="0 1 0"
        actuatorfrcrange="-9 9"/><inertial pos="0 0 .2" mass="1" diaginertia=".01 .01 .001"/>
        <site name="first" pos="0 0 .3"/><site name="last" pos="0 0 .5"/>
        <body name="bob" pos="0 0 .4"><joint name="swing" axis="0 1 0" actuatorfrcrange="-4 4"/>
        <inertial pos="0 0 .1" mass=".5" diaginertia=".005 .005 .0005"/>
        </body></body></worldbody></mujoco>"""
    )
    for form in (gymnasium.make, gymnasium.make_vec):
        with pytest.warns(UserWarning, match="axis of swing"):
            named = form("loose_env/Arm-v0", model=str(path)).unwrapped
        assert (named.arm.name, named.arm.joints) == ("pendulum", ("pivot", "swing"))
        assert named.arm.torque_limits == (9.0, 4.0)
        # The outermost body has no site: its frame is the tool.
        assert named.arm.reach == pytest.approx(0.4)
        chosen = form("loose_env/Arm-v0", model=path, tool="last", joints=["pivot"]).unwrapped
        assert (chosen.arm.joints, chosen.arm.reach) == (("pivot",), pytest.approx(0.5))
        named.close()
        chosen.close()
    plain.close()


def test_the_small_arm_s_file_ships_with_the_package() -> None:
    from hatchling.builders.wheel import WheelBuilder

    from loose_env.arms import DESK_ARM

    shipped = {file.distribution_path for file in WheelBuilder(str(ROOT)).recurse_included_files()}
    assert DESK_ARM.relative_to(ROOT).as_posix() in shipped
    assert DESK_ARM.is_file()


@pytest.mark.parametrize(("env_id", "arguments"), FORMS)
def test_gymnasium_s_checker_finds_nothing(env_id: str, arguments: dict[str, Any]) -> None:
    env = gymnasium.make(env_id, **arguments, **SHORT)
    # Windows and pictures have tests of their own.
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("env_id", IDS)
def test_gymnasium_s_checker_finds_nothing_with_raw_signals(env_id: str) -> None:
    env = gymnasium.make(env_id, raw=True, **SHORT)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("env_id", IDS)
def test_a_raw_measurement_in_info_compares_by_value(env_id: str) -> None:
    # The checker plays one action of its own; here are more.
    env = gymnasium.make(env_id, raw=True, **SHORT).unwrapped
    assert isinstance(env, DiagnosisEnv)
    taken = []
    for seed in (1, 1, 2):
        env.reset(seed=seed)
        action = env.actions.encode(levels=np.ones(env.arm.n, dtype=int))
        taken.append(env.step(action)[-1]["measurement"])
    assert taken[0] == taken[1] != taken[2]
    assert taken[0] is not taken[1]
    env.close()


@pytest.mark.parametrize(("env_id", "arguments"), FORMS)
def test_the_checker_of_stable_baselines3_finds_nothing(
    env_id: str, arguments: dict[str, Any]
) -> None:
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    env = gymnasium.make(env_id, **arguments, **SHORT)
    check_for_sb3(env.unwrapped)
    env.close()


@pytest.mark.parametrize("env_id", IDS)
def test_gymnasium_s_wrappers_see_nothing_amiss_over_whole_episodes(env_id: str) -> None:
    # make() puts the passive checker and the order checker around the environment.
    env = gymnasium.make(env_id, max_records=3, **SHORT)
    env.action_space.seed(0)
    env.reset(seed=0)
    ended = 0
    for _ in range(30):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
            ended += 1
    assert ended > 3
    env.close()


@pytest.mark.parametrize("env_id", IDS)
def test_the_native_vector_form_is_what_gymnasium_makes_of_single_ones(env_id: str) -> None:
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    copies = SyncVectorEnv(
        [lambda: gymnasium.make(env_id, max_records=3, **SHORT)] * 3, autoreset_mode=mode
    )
    native = gymnasium.make_vec(env_id, num_envs=3, max_records=3, threads=1, **SHORT)
    assert isinstance(native, DiagnosisVectorEnv)
    assert native.single_observation_space == copies.single_observation_space
    assert native.observation_space == copies.observation_space
    assert native.action_space == copies.action_space
    rng = np.random.default_rng(0)
    seeds = [3, 4, 5]
    first, expected = native.reset(seed=seeds)[0], copies.reset(seed=seeds)[0]
    np.testing.assert_array_equal(first, expected)
    ended = 0
    for _ in range(8):
        actions = rng.integers(0, native.actions.nvec, (3, len(native.actions.nvec)))
        found, expected = native.step(actions), copies.step(actions)
        for a, b in zip(found[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        infos, other = found[4], expected[4]
        np.testing.assert_array_equal(infos["action_mask"], other["action_mask"])
        assert ("final_info" in infos) == ("final_info" in other)
        if "final_info" in infos:
            ended += int(infos["_final_info"].sum())
            for key in ("fault", "is_success", "link_success", "poses", "records"):
                np.testing.assert_array_equal(infos["final_info"][key], other["final_info"][key])
            for own, copy in zip(infos["final_obs"], other["final_obs"], strict=True):
                np.testing.assert_array_equal(own, copy)
    assert ended > 3
    native.close()
    copies.close()


@pytest.mark.parametrize("env_id", IDS)
def test_the_spec_says_how_long_episodes_are(env_id: str) -> None:
    spec = gymnasium.spec(env_id)
    assert spec.max_episode_steps == MAX_EPISODE_STEPS
    assert spec.reward_threshold is None or 0 < spec.reward_threshold < 1
    # The limit lies beyond the longest episode: it ends by itself, terminated and not truncated.
    env = gymnasium.make(env_id, durations=(0.1,))
    env.reset(seed=0)
    layout: Any = env.unwrapped.actions  # type: ignore[attr-defined]
    record = layout.encode(levels=np.eye(layout.arm.n, dtype=int)[-1])
    for step in range(MAX_EPISODE_STEPS - 1):
        *_, terminated, truncated, _ = env.step(record)
        assert (terminated, truncated) == (step == MAX_EPISODE_STEPS - 2, False)


def test_more_records_than_the_limit_are_warned_of() -> None:
    with pytest.warns(UserWarning, match="max_episode_steps=22"):
        gymnasium.make(IDS[1], n_links=2, max_records=20)
    assert gymnasium.make_vec(IDS[1], n_links=2, max_records=20).settings.max_records == 20  # type: ignore[attr-defined]
