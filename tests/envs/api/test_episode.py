"""Episodes: rewards, ends, what is told and when, and what is hidden."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray
from scipy import stats

from loose_env.arms import MismatchDraw
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.settings import Prices
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.excitation import Excitation
from loose_env.faults import Backlash, Fault, Healthy, Preload, StructuralLooseness
from loose_env.rig import SimulatedRig

MakeEnv = Callable[..., DiagnosisEnv]
MakeVector = Callable[..., DiagnosisVectorEnv]

LOOSE = StructuralLooseness(
    link=2, direction=(0.0, 1.0, 0.0), gap=1e-4, stiffness=(2e4, 3e4), damping=(1.0, 1.0)
)
PLAY = Backlash(joint=1, gap=2e-4, stiffness=(2e3, 3e3), damping=(0.1, 0.1))


def verdict(env: DiagnosisEnv, name: str) -> NDArray[np.int64]:
    return env.actions.encode(verdict=1 + env.hypotheses.index(name))


def shake(env: DiagnosisEnv, *levels: int, duration: int = 0) -> NDArray[np.int64]:
    return env.actions.encode(levels=np.array(levels), duration=duration)


# ---- rewards


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
    make_env: MakeEnv, fault: str, named: str, reward: float
) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0, options={"fault": fault})
    env.step(env.actions.encode())
    _, got, terminated, truncated, info = env.step(verdict(env, named))
    assert (got, terminated, truncated) == (reward, True, False)
    assert info["is_success"] == (fault == named)


@pytest.mark.parametrize(
    ("fault", "named", "reward"),
    [
        ("healthy", "healthy", 2.0),
        ("healthy", "backlash@joint2", -0.5),
        ("backlash@joint2", "healthy", -4.0),
        ("backlash@joint2", "backlash@joint1", -1.5),
    ],
)
def test_a_false_alarm_and_a_miss_can_have_prices_of_their_own(
    make_env: MakeEnv, fault: str, named: str, reward: float
) -> None:
    prices = Prices(correct=2.0, wrong=-1.5, false_alarm=-0.5, miss=-4.0)
    env = make_env(n_links=2, prices=prices)
    env.reset(seed=0, options={"fault": fault})
    env.step(env.actions.encode())
    assert env.step(verdict(env, named))[1] == reward


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
    make_env: MakeEnv, levels: tuple[int, ...], duration: int, price: float
) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    reward = env.step(shake(env, *levels, duration=duration))[1]
    assert reward == pytest.approx(-price, abs=1e-12)


def test_prices_can_be_set(make_env: MakeEnv) -> None:
    env = make_env(n_links=2, prices=Prices(record=0.5, second=1.0, level=0.25))
    env.reset(seed=0)
    reward = env.step(shake(env, 1, 2, duration=1))[1]
    assert reward == pytest.approx(-(0.5 + 0.4 + 0.75))


@pytest.mark.parametrize("fault", ["healthy", "backlash@joint1"])
def test_running_out_of_records_is_a_wrong_verdict(make_env: MakeEnv, fault: str) -> None:
    env = make_env(n_links=2, max_records=2, prices=Prices(wrong=-1.5, false_alarm=0.0, miss=0.0))
    env.reset(seed=0, options={"fault": fault})
    for _ in range(2):
        assert env.step(env.actions.encode())[2:4] == (False, False)
    _, reward, terminated, truncated, info = env.step(shake(env, 1, 1))
    assert (reward, terminated, truncated) == (-1.5, True, False)
    assert (info["is_success"], info["link_success"], info["records"]) == (False, False, 2)
    assert info["verdict"] is None


def test_after_the_end_a_reset_is_needed(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    env.step(env.actions.encode())
    env.step(env.actions.encode(verdict=1))
    with pytest.raises(ResetNeeded):
        env.step(env.actions.encode())
    env.reset()
    env.step(env.actions.encode())


# ---- divergence


def poison(rig: Any, slot: int) -> None:
    """Make the arm in a slot one that no simulation can follow."""
    assert isinstance(rig, SimulatedRig)
    rig.plants[slot].model.body_mass[-1] = np.nan


def test_a_diverging_simulation_truncates_and_says_why(make_env: MakeEnv) -> None:
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


def test_divergences_are_counted_by_kind_of_fault(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    faults = ["healthy", "backlash@joint1", "backlash@joint2", "structural_looseness@link1"]
    for fault in faults:
        env.reset(seed=0, options={"fault": fault})
        poison(env.batch.rig, 0)
        assert env.step(shake(env, 1, 0))[3]
    assert env.divergences == {"healthy": 1, "backlash": 2, "structural_looseness": 1}


def test_a_diverging_arm_leaves_the_others_of_its_batch_unharmed(make_vector: MakeVector) -> None:
    sound, harmed = (make_vector(n_links=2, num_envs=4) for _ in range(2))
    for env in (sound, harmed):
        env.reset(seed=5)
    poison(harmed.batch.rig, 2)
    kind = harmed.batch.episode(2).fault.kind  # type: ignore[union-attr]
    others = [0, 1, 3]
    for step in range(3):
        actions = np.stack([sound.actions.encode(levels=np.array([1, 2]), duration=0)] * 4)
        expected, found = sound.step(actions), harmed.step(actions)
        for a, b in zip(expected[:4], found[:4], strict=True):
            np.testing.assert_array_equal(a[others], b[others])
        assert found[3].tolist() == [False, False, step == 0, False]
        assert not found[2].any() and not expected[3].any()
    assert harmed.divergences == {kind: 1}
    assert sound.divergences == {}


def test_nothing_but_a_divergence_truncates(make_vector: MakeVector) -> None:
    env = make_vector("vera", num_envs=4, max_records=3, difficulty="hard")
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(12):
        actions = rng.integers(0, env.actions.nvec, (4, len(env.actions.nvec)))
        actions[:, -2] = 0
        assert not env.step(actions)[3].any()
    assert env.divergences == {}


# ---- what is told


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
    make_env: MakeEnv, fault: str, raw: bool
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
    make_vector: MakeVector, raw: bool
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
    make_env: MakeEnv, named: str, success: bool, link_success: bool
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


@pytest.mark.parametrize("name", ["planar", "vera"])
def test_going_there_and_back_is_the_same_pose(make_env: MakeEnv, name: str) -> None:
    env = make_env(name)
    n = env.arm.n
    stay, there, back = (
        env.actions.encode(
            moves=np.full(n, choice), levels=np.where(np.arange(n) == 1, 1, 0), duration=0
        )
        for choice in (2, 3, 1)
    )
    for seed in range(8):
        pose = np.random.default_rng(seed).uniform(-0.5, 0.5, n)
        env.reset(seed=seed, options={"pose": pose})
        for action in (stay, there, back):
            env.step(action)
        assert env.step(env.actions.encode(verdict=1))[-1]["poses"] == 2


def test_on_a_healthy_arm_only_healthy_names_the_right_place(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    for name in env.hypotheses:
        env.reset(seed=0, options={"fault": "healthy"})
        env.step(env.actions.encode())
        assert env.step(verdict(env, name))[-1]["link_success"] == (name == "healthy")


# ---- what is hidden


@pytest.mark.parametrize(
    "fault",
    [
        Healthy(),
        LOOSE,
        PLAY,
        Preload(link=1, direction=(1.0, 0.0, 0.0), stiffness=1e6, damping=50.0),
    ],
    ids=lambda fault: type(fault).__name__,
)
def test_a_given_fault_is_the_one_that_is_hidden(make_env: MakeEnv, fault: Fault) -> None:
    env = make_env("vera")
    env.reset(seed=0, options={"fault": fault})
    rig = env.batch.rig
    assert isinstance(rig, SimulatedRig)
    assert rig.plants[0].fault is fault
    _, _, _, truncated, _ = env.step(shake(env, 2, 2))
    assert not truncated
    info = env.step(verdict(env, fault.hypothesis))[-1]
    assert info["fault_figures"] == fault
    assert info["is_success"]


def test_a_hypothesis_by_name_hides_a_fault_drawn_under_it(make_env: MakeEnv) -> None:
    env = make_env(n_links=3)
    for name in env.hypotheses:
        found = set()
        for seed in range(3):
            env.reset(seed=seed, options={"fault": name})
            env.step(env.actions.encode())
            info = env.step(env.actions.encode(verdict=1))[-1]
            assert info["fault"] == name
            found.add(info["fault_figures"])
        assert len(found) == (1 if name == "healthy" else 3)


def test_options_hold_for_one_episode(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    kinds = set()
    env.reset(seed=0, options={"fault": LOOSE, "pose": [0.5, 0.25]})
    np.testing.assert_allclose(env.batch.episode(0).pose, [0.5, 0.25])  # type: ignore[union-attr]
    for _ in range(10):
        env.reset()
        kinds.add(env.batch.episode(0).fault.kind)  # type: ignore[union-attr]
    assert len(kinds) == 3


def test_a_third_of_the_arms_is_of_each_kind_and_places_are_equally_likely(
    make_env: MakeEnv,
) -> None:
    env = make_env(n_links=4)
    rng = np.random.default_rng(0)
    draws = 3000
    found = Counter(env.batch.sampler.draw(rng).hypothesis for _ in range(draws))
    assert set(found) == set(env.hypotheses)
    expected = [draws / 3] + [draws / 3 / 4] * 8
    assert stats.chisquare([found[name] for name in env.hypotheses], expected).pvalue > 0.01


def test_episodes_hide_the_kinds_as_the_sampler_draws_them(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    env.reset(seed=1)
    found: Counter[str] = Counter()
    for _ in range(300):
        env.reset()
        found[env.batch.episode(0).fault.hypothesis] += 1  # type: ignore[union-attr]
    expected = [100] + [50] * 4
    assert stats.chisquare([found[name] for name in env.hypotheses], expected).pvalue > 0.01


# ---- outside an episode


def test_simulate_measures_an_arm_with_a_given_fault(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    shaking = Excitation(torque_rms=(3.0, 0.0), duration=0.2, band=env.arm.band)
    pose = np.array([0.3, 0.6])
    none = MismatchDraw.none(env.arm)

    def measured(fault: Fault, seed: int = 0, mismatch: MismatchDraw | None = none) -> Any:
        rng = np.random.default_rng(seed)
        return env.simulate(fault, pose, shaking, rng, mismatch=mismatch)

    healthy = measured(Healthy())
    assert healthy.failure is None
    np.testing.assert_array_equal(healthy.pose, pose)
    assert healthy.excitation == shaking
    np.testing.assert_array_equal(measured(Healthy()).tool, healthy.tool)
    for other in (
        measured(LOOSE),
        measured(PLAY),
        measured(Healthy(), seed=1),
        measured(Healthy(), mismatch=None),
    ):
        assert other.tool.shape == healthy.tool.shape
        assert np.abs(other.tool - healthy.tool).max() > 1e-2


def test_simulate_leaves_the_running_episode_alone(make_env: MakeEnv) -> None:
    plain, disturbed = make_env(n_links=2), make_env(n_links=2)
    shaking = Excitation(torque_rms=(3.0, 0.0), duration=0.2, band=plain.arm.band)
    for env in (plain, disturbed):
        env.reset(seed=0)
    for _ in range(2):
        disturbed.simulate(LOOSE, np.zeros(2), shaking, np.random.default_rng(0))
        disturbed.batch.sampler.draw(np.random.default_rng(0))
        expected, found = (env.step(shake(env, 1, 1))[0] for env in (plain, disturbed))
        np.testing.assert_array_equal(found, expected)


def test_a_sampled_fault_can_be_simulated_and_hidden(make_env: MakeEnv) -> None:
    env = make_env("vera")
    rng = np.random.default_rng(2)
    shaking = Excitation(torque_rms=(0.5, 0.5), duration=0.2, band=env.arm.band)
    for _ in range(6):
        fault = env.batch.sampler.draw(rng)
        assert env.simulate(fault, np.zeros(2), shaking, rng).failure is None
        env.reset(seed=0, options={"fault": fault})


def test_the_registered_environment_offers_both() -> None:
    env = gymnasium.make("loose_env:loose_env/Vera-v0").unwrapped
    assert isinstance(env, DiagnosisEnv)
    first, again = (env.batch.sampler.draw(np.random.default_rng(3)) for _ in range(2))
    assert first == again
    env.close()
