"""Episodes: rewards, ends, what is told and when, what is hidden, copies and states."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from loose_env.arms import (
    Arm,
    LinearArm,
    MismatchDraw,
    planar,
    scara,
    six_axis,
    vera,
)
from loose_env.envs import (
    DIFFICULTIES,
    DiagnosisEnv,
    DiagnosisSettings,
    DiagnosisVectorEnv,
    Difficulty,
    FaultSampler,
    Prices,
)
from loose_env.errors import InvalidSetting
from loose_env.faults import (
    KINDS,
    UNSURE,
    Backlash,
    Fault,
    Healthy,
    Preload,
    SeveralFaults,
    StructuralLooseness,
    parts_of,
    preloaded,
    seat_weight,
)
from loose_env.rig import PlantShop, SimulatedRig

Make = Callable[..., Any]

LOOSE = StructuralLooseness(
    link=2, direction=(0.0, 1.0, 0.0), gap=1e-4, stiffness=(2e4, 3e4), damping=(1.0, 1.0)
)
PLAY = Backlash(joint=1, gap=2e-4, stiffness=(2e3, 3e3), damping=(0.1, 0.1))


def verdict(env: DiagnosisEnv, name: str) -> NDArray[np.int64]:
    return env.actions.encode(verdict=1 + env.hypotheses.index(name))


def shake(env: DiagnosisEnv, *levels: int, duration: int = 0) -> NDArray[np.int64]:
    return env.actions.encode(levels=np.array(levels), duration=duration)


@pytest.mark.parametrize(
    ("fault", "named", "reward"),
    [
        ("healthy", "healthy", 1.0),
        ("backlash@joint2", "backlash@joint2", 1.0),
        ("healthy", "backlash@joint2", -1.0),
        ("backlash@joint2", "healthy", -1.0),
        ("backlash@joint2", "backlash@joint1", -1.0),
        ("backlash@joint2", "structural_looseness@link2", -1.0),
    ],
)
def test_the_right_verdict_earns_one_and_a_wrong_one_costs_one(
    make_env: Make, fault: str, named: str, reward: float
) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0, options={"fault": fault})
    env.step(env.actions.encode())
    _, got, terminated, truncated, info = env.step(verdict(env, named))
    assert (got, terminated, truncated) == (reward, True, False)
    assert info["is_success"] == (fault == named)


@pytest.mark.parametrize(
    ("levels", "duration", "price"),
    [
        ((0, 0), 2, 0.05 + 1.2 * 0.02 + 3 * 0.002),
        ((1, 0), 0, 0.05 + 0.2 * 0.02 + 0.002),
        ((3, 2), 1, 0.05 + 0.4 * 0.02 + 5 * 0.002),
        ((0, 3), 2, 0.05 + 1.2 * 0.02 + 3 * 0.002),
    ],
)
def test_a_record_costs_its_price_its_seconds_and_its_levels(
    make_env: Make, levels: tuple[int, ...], duration: int, price: float
) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    reward = env.step(shake(env, *levels, duration=duration))[1]
    assert reward == pytest.approx(-price, abs=1e-12)


@pytest.mark.parametrize("fault", ["healthy", "backlash@joint1"])
def test_running_out_of_records_is_a_wrong_verdict(make_env: Make, fault: str) -> None:
    env = make_env(n_links=2, max_records=2, prices=Prices(wrong=-1.5, false_alarm=0.0, miss=0.0))
    env.reset(seed=0, options={"fault": fault})
    for _ in range(2):
        assert env.step(env.actions.encode())[2:4] == (False, False)
    _, reward, terminated, truncated, info = env.step(shake(env, 1, 1))
    assert (reward, terminated, truncated) == (-1.5, True, False)
    assert (info["is_success"], info["link_success"], info["records"]) == (False, False, 2)
    assert info["verdict"] is None


def poison(rig: Any, slot: int) -> None:
    """Make the arm in a slot one that no simulation can follow."""
    assert isinstance(rig, SimulatedRig)
    rig.plants[slot].model.body_mass[-1] = np.nan


def test_a_diverging_simulation_truncates_and_says_why(make_env: Make) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0, options={"fault": "backlash@joint2"})
    poison(env.batch.rig, 0)
    observation, reward, terminated, truncated, info = env.step(shake(env, 2, 0, duration=1))
    assert (terminated, truncated) == (False, True)
    assert "simulation" in info["failure"]
    assert reward == pytest.approx(-(0.05 + 0.4 * 0.02 + 2 * 0.002))
    assert observation in env.observation_space
    assert not env.layout.slots_of(observation).any()
    assert (info["fault"], info["is_success"]) == ("backlash@joint2", False)
    assert env.divergences == {"backlash": 1}
    with pytest.raises(ResetNeeded):
        env.step(env.actions.encode())
    # The next episode is none the worse for it.
    clean = make_env(n_links=2)
    for e in (env, clean):
        e.reset(seed=1)
    after, expected = (e.step(shake(e, 1, 1)) for e in (env, clean))
    np.testing.assert_array_equal(after[0], expected[0])
    assert env.divergences == {"backlash": 1}


def everything_in(value: Any) -> Iterator[Any]:
    """All that can be reached from a value."""
    yield value
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from everything_in(key)
            yield from everything_in(item)
    elif isinstance(value, (list, tuple, set)):
        for item in value:
            yield from everything_in(item)
    elif isinstance(value, np.ndarray):
        if value.dtype == object or value.dtype.kind in "US":
            yield from everything_in(value.tolist())
    elif is_dataclass(value) and not isinstance(value, type):
        for f in fields(value):
            yield from everything_in(getattr(value, f.name))


def betrayals(info: Any) -> list[Any]:
    """What of the truth an info lets through."""
    truths = (Healthy, Preload, StructuralLooseness, Backlash, MismatchDraw)
    words = ("healthy", "loose", "backlash", "fault", "success", "truth")
    return [
        x
        for x in everything_in(info)
        if isinstance(x, truths) or (isinstance(x, str) and any(w in x for w in words))
    ]


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("fault", ["healthy", "structural_looseness@link2", "backlash@joint1"])
def test_info_says_nothing_of_the_truth_before_the_end(
    make_env: Make, fault: str, raw: bool
) -> None:
    env = make_env("vera", raw=raw)
    _, info = env.reset(seed=0, options={"fault": fault})
    assert not betrayals(info)
    for action in (
        shake(env, 1, 2),
        env.actions.encode(),
        shake(env, 0, 3),
        env.actions.encode(moves=np.array([0, 4]), levels=np.array([3, 3]), duration=0),
    ):
        _, _, terminated, _, info = env.step(action)
        assert not terminated
        assert not betrayals(info)
    # The same search finds the truth where it stands.
    info = env.step(env.actions.encode(verdict=1))[-1]
    assert fault in betrayals(info)


@pytest.mark.parametrize("raw", [False, True])
def test_infos_of_a_batch_tell_the_truth_of_ended_episodes_only(
    make_vector: Make, raw: bool
) -> None:
    env = make_vector(n_links=2, num_envs=3, raw=raw)
    _, infos = env.reset(seed=0)
    assert not betrayals(infos)
    going_on = np.stack([env.actions.encode(levels=np.array([1, 1]), duration=0)] * 3)
    infos = env.step(going_on)[-1]
    assert not betrayals(infos)
    ending = going_on.copy()
    ending[1, -1] = 1
    infos = env.step(ending)[-1]
    final = infos.pop("final_info")
    assert not betrayals(infos)
    assert final["_fault"].tolist() == [False, True, False]
    assert [f is None for f in final["fault_figures"]] == [True, False, True]


@pytest.mark.parametrize(
    ("named", "success", "link_success"),
    [
        ("structural_looseness@link2", True, True),
        ("backlash@joint2", False, True),
        ("structural_looseness@link1", False, False),
        ("healthy", False, False),
    ],
)
def test_the_end_tells_fault_success_and_what_it_took(
    make_env: Make, named: str, success: bool, link_success: bool
) -> None:
    env = make_env("vera", max_records=8)
    env.reset(seed=0, options={"fault": LOOSE})
    stay = shake(env, 1, 0)
    away = env.actions.encode(moves=np.array([2, 4]), levels=np.array([0, 2]), duration=1)
    back = env.actions.encode(moves=np.array([2, 0]), levels=np.array([1, 0]), duration=0)
    on = env.actions.encode(moves=np.array([3, 2]), levels=np.array([1, 0]), duration=0)
    for action in (stay, away, back, stay, on):
        env.step(action)
    info = env.step(verdict(env, named))[-1]
    assert info["fault"] == "structural_looseness@link2"
    assert info["fault_figures"] == LOOSE
    assert (info["is_success"], info["link_success"]) == (success, link_success)
    # Measured in three poses: the first one counts once.
    assert (info["records"], info["poses"]) == (5, 3)
    assert info["seconds"] == pytest.approx(0.2 * 4 + 0.4)


def test_options_hold_for_one_episode(make_env: Make) -> None:
    env = make_env(n_links=2)
    kinds = set()
    env.reset(seed=0, options={"fault": LOOSE, "pose": [0.5, 0.25]})
    np.testing.assert_allclose(env.batch.episode(0).pose, [0.5, 0.25])
    for _ in range(10):
        env.reset()
        kinds.add(env.batch.episode(0).fault.kind)
    assert len(kinds) == 3


SETTINGS = DiagnosisSettings(durations=(0.2,), max_records=3)


def play(env: Any, steps: int, seed: int = 0) -> list[Any]:
    """Take random actions; end and begin episodes as they come."""
    rng = np.random.default_rng(seed)
    nvec = env.unwrapped.actions.nvec
    num = getattr(env, "num_envs", None)
    found: list[Any] = []
    for _ in range(steps):
        action = rng.integers(0, nvec, nvec.shape if num is None else (num, len(nvec)))
        observation, reward, terminated, truncated, _ = env.step(action)
        found += [observation, reward, terminated, truncated]
        if num is None and (terminated or truncated):
            found.append(env.reset()[0])
    return found


def assert_alike(found: list[Any], expected: list[Any]) -> None:
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_a_copy_goes_on_as_the_original(duplicate: Any, engine: str) -> None:
    env = gymnasium.make(
        "loose_env/Planar-v0", n_links=2, durations=(0.2,), max_records=3, engine=engine
    )
    env.reset(seed=4, options={"mismatch_scale": 2.0})
    play(env, 3)
    other = duplicate(env)
    other.action_space.seed(0)
    env.action_space.seed(0)
    assert_alike(play(other, 6, seed=1), play(env, 6, seed=1))
    assert other.unwrapped.batch is not env.unwrapped.batch  # type: ignore[attr-defined]
    assert (other.spec.id, other.spec.kwargs) == (env.spec.id, env.spec.kwargs)


def test_a_state_is_taken_up_again_and_again() -> None:
    env = DiagnosisEnv(planar(2), SETTINGS)
    env.reset(seed=4)
    env.step(env.actions.encode(levels=np.array([0, 1])))
    state = env.get_state()
    expected = play(env, 5)
    for other in (env, DiagnosisEnv(planar(2), SETTINGS)):
        other.set_state(pickle.loads(pickle.dumps(state)))
        assert_alike(play(other, 5), expected)
    dearer = replace(SETTINGS, prices=Prices(record=0.5))
    for wrong in (None, DiagnosisEnv(planar(3), SETTINGS), DiagnosisEnv(planar(2), dearer)):
        given = wrong
        if wrong is not None:
            wrong.reset(seed=0)
            given = wrong.get_state()
        with pytest.raises(InvalidSetting, match="state"):
            env.set_state(given)  # type: ignore[arg-type]
    batch = DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=2)
    batch.reset(seed=0)
    with pytest.raises(InvalidSetting, match="get_state"):
        DiagnosisVectorEnv(planar(2), SETTINGS, num_envs=3).set_state(batch.get_state())


SLIDE1 = StructuralLooseness(link=1, direction=(0.0, 1.0, 0.0), gap=1e-4, stiffness=(2e4, 3e4))
PLAY2 = Backlash(joint=2, gap=2e-4, stiffness=(2e3, 3e3), damping=(0.1, 0.1))
TWO = SeveralFaults(faults=(SLIDE1, PLAY2))


def shake_all(env: DiagnosisEnv, level: int = 2) -> NDArray[np.int64]:
    return env.actions.encode(levels=np.full(env.arm.n, level), duration=0)


def said(env: DiagnosisEnv, named: str) -> NDArray[np.int64]:
    return env.actions.encode(verdict=1 + env.verdicts.index(named))


@pytest.mark.parametrize("fault", ["healthy", "backlash@joint2", TWO])
@pytest.mark.parametrize("price", [-0.25, 0.4])
def test_being_unsure_has_its_price_whatever_the_truth(
    make_env: Make, fault: Fault | str, price: float
) -> None:
    prices = Prices(unsure=price, false_alarm=-3.0, miss=-4.0)
    env = make_env(n_links=2, prices=prices, unsure_after=1)
    env.reset(seed=0, options={"fault": fault})
    env.step(shake_all(env))
    _, reward, terminated, truncated, info = env.step(said(env, UNSURE))
    assert (reward, terminated, truncated) == (price, True, False)
    assert info["verdict"] == UNSURE
    # On a healthy arm too: no place was named.
    assert (info["is_success"], info["link_success"]) == (False, False)


def test_unsure_waits_for_the_third_measured_record(make_env: Make) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    open_ = []
    for _ in range(3):
        *_, terminated, _, info = env.step(
            env.actions.encode(levels=np.array([0, 1]), duration=0, verdict=env.actions.unsure)
        )
        assert info["verdict_ignored"] and not terminated
        open_.append((bool(info["action_mask"][-1]), bool(info["action_mask"][-2])))
    assert open_ == [(False, True), (False, True), (True, True)]
    assert env.step(said(env, UNSURE))[-1]["verdict"] == UNSURE


def test_no_name_is_right_for_a_fault_outside_the_hypotheses(make_env: Make) -> None:
    env, fault = make_env(n_links=2), TWO
    right_places = {
        f"{kind}{n}" for kind in ("structural_looseness@link", "backlash@joint") for n in (1, 2)
    }
    for named in env.hypotheses:
        env.reset(seed=0, options={"fault": fault})
        _, _, _, truncated, _ = env.step(shake_all(env))
        assert not truncated
        _, reward, _, _, info = env.step(said(env, named))
        assert (reward, info["is_success"]) == (-1.0, False)
        assert info["fault_figures"] == fault and info["fault"] == fault.hypothesis
        assert info["link_success"] == (named in right_places)


@pytest.mark.slow
def test_two_faults_are_drawn_by_name_at_two_places_of_the_kinds_that_come_up() -> None:
    for arm in (planar(4), vera(), six_axis(), scara()):
        sampler = FaultSampler(LinearArm(arm), Difficulty(), KINDS)
        kinds, places = set(), set()
        for seed in range(40):
            drawn = sampler.several(np.random.default_rng(seed))
            assert drawn == sampler.several(np.random.default_rng(seed))
            where = [f.joint if isinstance(f, Backlash) else f.link for f in drawn.faults]
            assert len(set(where)) == 2
            kinds |= {f.kind for f in drawn.faults}
            places |= set(where)
        assert kinds == set(KINDS) - {"healthy"}
        assert places == set(range(1, arm.n + 1))


def true_arm(env: DiagnosisEnv | DiagnosisVectorEnv, slot: int = 0) -> MismatchDraw:
    rig = env.batch.rig
    assert isinstance(rig, SimulatedRig)
    return rig.plants[slot].mismatch


def test_the_scale_of_the_mismatch_multiplies_the_same_draw(make_env: Make) -> None:
    env = make_env(n_links=3)
    env.reset(seed=4)
    fault, pose = env.batch.episode(0).fault, env.batch.episode(0).pose
    plain = true_arm(env)
    for scale in (0.0, 0.5, 1.0, 3.0):
        env.reset(seed=4, options={"mismatch_scale": scale})
        episode = env.batch.episode(0)
        assert episode is not None and episode.fault == fault
        np.testing.assert_array_equal(episode.pose, pose)
        found = true_arm(env)
        for name in ("length", "mass", "inertia", "stiffness", "holding_damping", "drive_gain"):
            np.testing.assert_allclose(
                getattr(found, name) - 1, scale * (getattr(plain, name) - 1), atol=1e-12
            )
        for name in ("joint_zero", "tilt"):
            np.testing.assert_allclose(getattr(found, name), scale * getattr(plain, name))


@pytest.mark.parametrize(
    "arm",
    [
        *(planar(4), vera()),
        *(pytest.param(arm, marks=pytest.mark.slow) for arm in (six_axis(), scara())),
    ],
    ids=lambda a: a.name,
)
def test_drawn_faults_fit_the_step_even_with_three_times_the_mismatch(arm: Arm) -> None:
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    sampler = FaultSampler(LinearArm(arm), Difficulty(), KINDS)
    mismatch = DIFFICULTIES["default"].mismatch.scaled(3.0)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        for fault in (sampler.draw(rng), sampler.several(rng)):
            shop.build(fault, mismatch.draw(arm, rng))  # refuses what is too stiff for the step


@pytest.mark.parametrize(
    "name", ["structural_looseness@link2", "backlash@joint1", "several_faults"]
)
@pytest.mark.parametrize("share", [1.0, -0.5])
def test_a_load_presses_the_drawn_seat_with_its_share_of_the_weight(
    make_env: Make, name: str, share: float
) -> None:
    env = make_env(n_links=3, unsure_after=1)
    env.reset(seed=2, options={"fault": name})
    free = env.batch.episode(0).fault
    unloaded = env.step(shake_all(env))[0]
    env.reset(seed=2, options={"fault": name, "preload_g": share})
    pressed = env.batch.episode(0).fault
    assert pressed == preloaded(env.arm, free, share)
    for before, after in zip(parts_of(free), parts_of(pressed), strict=True):
        assert isinstance(before, (StructuralLooseness, Backlash))
        assert after == replace(before, preload=share * seat_weight(env.arm, before))
    loaded, _, _, truncated, _ = env.step(shake_all(env))
    assert not truncated and not np.array_equal(loaded, unloaded)
    info = env.step(said(env, pressed.hypothesis if name != "several_faults" else UNSURE))[-1]
    # A pressed seat is loose all the same: its hypothesis is right.
    assert info["is_success"] == (name != "several_faults")
    assert info["fault_figures"] == pressed
