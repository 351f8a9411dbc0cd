"""The verdict "unsure", and the episodes in which no other one is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.belief import best_verdict
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, MismatchDraw, planar, scara, six_axis, vera
from loose_env.envs.diagnosis_env import DiagnosisEnv
from loose_env.envs.episode.actions import ActionLayout
from loose_env.envs.faults.difficulty import DIFFICULTIES, Difficulty
from loose_env.envs.faults.sampler import FaultSampler
from loose_env.envs.rendering.caption import header_lines
from loose_env.envs.rendering.palette import TRUTH
from loose_env.envs.settings import DiagnosisSettings, Prices
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.errors import InvalidSetting
from loose_env.faults import (
    KINDS,
    UNSURE,
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    SeveralFaults,
    StructuralLooseness,
    parts_of,
    preloaded,
    seat_weight,
)
from loose_env.rig import PlantShop, SimulatedRig

MakeEnv = Callable[..., DiagnosisEnv]
MakeVector = Callable[..., DiagnosisVectorEnv]

SLIDE = StructuralLooseness(link=1, direction=(0.0, 1.0, 0.0), gap=1e-4, stiffness=(2e4, 3e4))
PLAY = Backlash(joint=2, gap=2e-4, stiffness=(2e3, 3e3), damping=(0.1, 0.1))
ACROSS = CompoundLooseness(
    link=2, parts=(replace(SLIDE, link=2), replace(SLIDE, link=2, direction=(1, 0, 0)))
)
TWO = SeveralFaults(faults=(SLIDE, PLAY))


def shake(env: DiagnosisEnv, level: int = 2) -> NDArray[np.int64]:
    return env.actions.encode(levels=np.full(env.arm.n, level), duration=0)


def said(env: DiagnosisEnv, named: str) -> NDArray[np.int64]:
    return env.actions.encode(verdict=1 + env.verdicts.index(named))


# ---- the verdict and its price


@pytest.mark.parametrize("fault", ["healthy", "backlash@joint2", TWO])
@pytest.mark.parametrize("price", [-0.25, 0.4])
def test_being_unsure_has_its_price_whatever_the_truth(
    make_env: MakeEnv, fault: Fault | str, price: float
) -> None:
    prices = Prices(unsure=price, false_alarm=-3.0, miss=-4.0)
    env = make_env(n_links=2, prices=prices, unsure_after=1)
    env.reset(seed=0, options={"fault": fault})
    env.step(shake(env))
    _, reward, terminated, truncated, info = env.step(said(env, UNSURE))
    assert (reward, terminated, truncated) == (price, True, False)
    assert info["verdict"] == UNSURE
    # On a healthy arm too: no place was named.
    assert (info["is_success"], info["link_success"]) == (False, False)


def test_unsure_is_the_last_choice_and_open_from_the_first_record_on(make_env: MakeEnv) -> None:
    env = make_env(n_links=3, max_records=1)
    assert env.verdicts == (*env.hypotheses, UNSURE)
    assert env.actions.unsure == env.action_space.nvec[-1] - 1 == len(env.verdicts)
    _, info = env.reset(seed=0)
    assert not info["action_mask"][-1]
    action = env.actions.encode(levels=np.array([0, 0, 2]), duration=0, verdict=env.actions.unsure)
    _, _, terminated, _, info = env.step(action)
    assert info["verdict_ignored"] and not terminated and info["action_mask"][-1]
    assert env.step(action)[-1]["verdict"] == UNSURE


def test_unsure_waits_for_the_third_measured_record(make_env: MakeEnv) -> None:
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


def test_giving_up_blindly_pays_less_than_the_best_blind_name() -> None:
    # The cheapest records: 0.2 s, one joint, one level up. "healthy" is right on a third.
    settings = DiagnosisSettings()
    prices = settings.prices
    record = prices.record + min(settings.durations) * prices.second + prices.level
    blind = prices.correct / 3 + prices.wrong * 2 / 3 - record
    assert prices.unsure - settings.unsure_after * record < blind
    assert prices.unsure - record > blind  # without the rule it would be the other way round


def test_records_that_show_nothing_open_no_verdict() -> None:
    layout = ActionLayout(planar(2), DiagnosisSettings(max_records=4), hypotheses=5)
    at = {
        (records, measured): layout.mask(np.zeros(2), records, measured)[-7:].tolist()
        for records, measured in ((2, 0), (2, 1), (4, 1), (4, 0))
    }
    assert at[2, 0] == [True] + [False] * 6
    assert at[2, 1] == [True] * 6 + [False]
    assert at[4, 1] == [False] + [True] * 6
    assert at[4, 0] == [False] + [True] * 5 + [False]


def test_every_verdict_survives_being_encoded_and_decoded() -> None:
    problem = Problem.of(planar(3), DiagnosisSettings(kinds=KINDS))
    assert problem.verdicts == (*problem.hypotheses, UNSURE)
    for named in problem.verdicts:
        action = problem.verdict(named)
        assert problem.verdicts[problem.actions.decode(action).verdict - 1] == named
    assert problem.actions.decode(problem.verdict(UNSURE)).verdict == problem.actions.unsure


def test_single_and_vector_environments_say_the_same(
    make_env: MakeEnv, make_vector: MakeVector
) -> None:
    single = make_env(n_links=2, unsure_after=1)
    vector = make_vector(n_links=2, num_envs=2, unsure_after=1)
    assert vector.verdicts == single.verdicts
    vector.reset(seed=0, options={"fault": TWO})
    vector.step(np.stack([shake(single)] * 2))
    rows = np.stack([said(single, UNSURE), said(single, "healthy")])
    _, rewards, terminated, _, infos = vector.step(rows)
    assert rewards.tolist() == [-0.25, -1.0] and terminated.all()
    assert infos["final_info"]["verdict"].tolist() == [UNSURE, "healthy"]


# ---- when it pays


def expected(prices: Prices, hypotheses: tuple[str, ...], p: NDArray[np.float64], k: int) -> float:
    """Expected reward of naming hypothesis k, written out."""
    wrong = prices.wrong
    if k == 0:
        alarm = wrong if prices.miss is None else prices.miss
        return float(p[0] * prices.correct + (1 - p[0]) * alarm)
    alarm = wrong if prices.false_alarm is None else prices.false_alarm
    return float(p[k] * prices.correct + p[0] * alarm + (1 - p[0] - p[k]) * wrong)


def test_unsure_pays_below_three_eighths_at_the_default_prices() -> None:
    problem = Problem.of(planar(2), DiagnosisSettings())
    for k, named in enumerate(problem.hypotheses):
        for best, verdict in ((0.374, UNSURE), (0.376, named)):
            p = np.full(5, (1 - best) / 4)
            p[k] = best
            assert best_verdict(problem, p) == verdict


@pytest.mark.parametrize(
    "prices",
    [
        Prices(),
        Prices(false_alarm=-0.1),
        Prices(false_alarm=-5.0),
        Prices(miss=-0.3),
        Prices(miss=-5.0),
        Prices(correct=2.0, wrong=-3.0, false_alarm=-1.0, miss=-8.0, unsure=-1.5),
    ],
    ids=str,
)
def test_unsure_is_said_exactly_where_it_is_worth_most(prices: Prices) -> None:
    problem = Problem.of(planar(2), DiagnosisSettings(prices=prices))
    rng = np.random.default_rng(0)
    found = set()
    for _ in range(300):
        p = rng.dirichlet(np.full(5, rng.choice([0.3, 1.0, 5.0])))
        worth = [expected(prices, problem.hypotheses, p, k) for k in range(5)]
        wanted = UNSURE if max(worth) < prices.unsure else problem.hypotheses[int(np.argmax(worth))]
        assert best_verdict(problem, p) == wanted
        found.add(wanted == UNSURE)
    assert found == {True, False}


def test_a_high_price_of_being_unsure_means_never() -> None:
    problem = Problem.of(planar(2), DiagnosisSettings(prices=Prices(unsure=-1.0)))
    assert best_verdict(problem, np.full(5, 0.2)) != UNSURE


# ---- faults that no verdict can name


@pytest.mark.parametrize("fault", [TWO, ACROSS], ids=["two places", "across"])
def test_no_name_is_right_for_a_fault_outside_the_hypotheses(
    make_env: MakeEnv, fault: SeveralFaults | CompoundLooseness
) -> None:
    env = make_env(n_links=2)
    right_places = {"structural_looseness@link2", "backlash@joint2"}
    if fault is TWO:
        right_places |= {"structural_looseness@link1", "backlash@joint1"}
    for named in env.hypotheses:
        env.reset(seed=0, options={"fault": fault})
        _, _, _, truncated, _ = env.step(shake(env))
        assert not truncated
        _, reward, _, _, info = env.step(said(env, named))
        assert (reward, info["is_success"]) == (-1.0, False)
        assert info["fault_figures"] == fault and info["fault"] == fault.hypothesis
        assert info["link_success"] == (named in right_places)


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


def test_several_faults_need_as_many_joints_and_something_loose() -> None:
    sampler = FaultSampler(LinearArm(planar(2)), Difficulty())
    with pytest.raises(InvalidSetting, match="2 to 2"):
        sampler.several(np.random.default_rng(0), count=3)
    sound = FaultSampler(LinearArm(planar(2)), Difficulty(kinds={"healthy": 1.0}))
    with pytest.raises(InvalidSetting, match="come up"):
        sound.several(np.random.default_rng(0))


# ---- a true arm further from the nominal one


def true_arm(env: DiagnosisEnv | DiagnosisVectorEnv, slot: int = 0) -> MismatchDraw:
    rig = env.batch.rig
    assert isinstance(rig, SimulatedRig)
    return rig.plants[slot].mismatch


def test_the_scale_of_the_mismatch_multiplies_the_same_draw(make_env: MakeEnv) -> None:
    env = make_env(n_links=3)
    env.reset(seed=4)
    fault, pose = env.batch.episode(0).fault, env.batch.episode(0).pose  # type: ignore[union-attr]
    plain = true_arm(env)
    for scale in (0.0, 0.5, 3.0):
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


def test_scale_one_is_the_episode_without_the_option_bit_for_bit(make_env: MakeEnv) -> None:
    one, plain = make_env("six_axis"), make_env("six_axis")
    one.reset(seed=4, options={"mismatch_scale": 1, "preload_g": 0})
    plain.reset(seed=4)
    for field in fields(MismatchDraw):
        np.testing.assert_array_equal(
            getattr(true_arm(one), field.name), getattr(true_arm(plain), field.name)
        )
    np.testing.assert_array_equal(one.step(shake(one))[0], plain.step(shake(plain))[0])


def test_a_larger_mismatch_holds_for_one_episode_of_every_arm(make_vector: MakeVector) -> None:
    env = make_vector(n_links=2, num_envs=2)
    scaled, plain = [], []
    for found, options in ((scaled, {"mismatch_scale": 3.0}), (plain, None)):
        env.reset(seed=7, options=options)
        found += [true_arm(env, slot).mass for slot in range(2)]
    for large, small in zip(scaled, plain, strict=True):
        np.testing.assert_allclose(large - 1, 3 * (small - 1), atol=1e-12)


@pytest.mark.parametrize("arm", [planar(4), vera(), six_axis(), scara()], ids=lambda a: a.name)
def test_drawn_faults_fit_the_step_even_with_three_times_the_mismatch(arm: Arm) -> None:
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    sampler = FaultSampler(LinearArm(arm), Difficulty(), KINDS)
    mismatch = DIFFICULTIES["default"].mismatch.scaled(3.0)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        for fault in (sampler.draw(rng), sampler.several(rng)):
            shop.build(fault, mismatch.draw(arm, rng))  # refuses what is too stiff for the step


# ---- a load on the seat


@pytest.mark.parametrize(
    "name", ["structural_looseness@link2", "backlash@joint1", "several_faults"]
)
@pytest.mark.parametrize("share", [1.0, -0.5])
def test_a_load_presses_the_drawn_seat_with_its_share_of_the_weight(
    make_env: MakeEnv, name: str, share: float
) -> None:
    env = make_env(n_links=3, unsure_after=1)
    env.reset(seed=2, options={"fault": name})
    free = env.batch.episode(0).fault  # type: ignore[union-attr]
    unloaded = env.step(shake(env))[0]
    env.reset(seed=2, options={"fault": name, "preload_g": share})
    pressed = env.batch.episode(0).fault  # type: ignore[union-attr]
    assert pressed == preloaded(env.arm, free, share)
    for before, after in zip(parts_of(free), parts_of(pressed), strict=True):
        assert isinstance(before, (StructuralLooseness, Backlash))
        assert after == replace(before, preload=share * seat_weight(env.arm, before))
    loaded, _, _, truncated, _ = env.step(shake(env))
    assert not truncated and not np.array_equal(loaded, unloaded)
    info = env.step(said(env, pressed.hypothesis if name != "several_faults" else UNSURE))[-1]
    # A pressed seat is loose all the same: its hypothesis is right.
    assert info["is_success"] == (name != "several_faults")
    assert info["fault_figures"] == pressed


def test_a_load_changes_nothing_where_nothing_is_loose(make_env: MakeEnv) -> None:
    env = make_env(n_links=2)
    seen = []
    for share in (0.0, 1.0):
        env.reset(seed=2, options={"fault": "healthy", "preload_g": share})
        assert env.batch.episode(0).fault == Healthy()  # type: ignore[union-attr]
        seen.append(env.step(shake(env))[0])
    np.testing.assert_array_equal(*seen)


# ---- what picture and timeline show


def test_the_words_call_being_unsure_neither_right_nor_wrong(make_env: MakeEnv) -> None:
    env = make_env(n_links=2, unsure_after=1)
    linear = env.batch.nominal
    for named, mark in (
        (UNSURE, "Verdict: unsure"),
        ("healthy", "Verdict: nothing is loose – wrong"),
    ):
        env.reset(seed=0, options={"fault": TWO})
        env.step(shake(env))
        env.step(said(env, named))
        episode = env.batch.episode(0)
        assert episode is not None
        lines = [line.text for line in header_lines(linear, episode, None, None, episode.verdict)]
        assert lines[0] == "Link 1 was loose (0.1 mm); joint 2 had play (0.011°)"
        assert mark in lines


@pytest.mark.parametrize("arm", [planar(2), six_axis()], ids=lambda a: a.name)
def test_a_picture_shows_every_one_of_several_faults(arm: Arm) -> None:
    env = DiagnosisEnv(arm, DiagnosisSettings(unsure_after=1), render_mode="rgb_array", threads=1)
    both = SeveralFaults(faults=(SLIDE, replace(PLAY, stiffness=(1e2, 1e2))))
    pictures = []
    for fault in (SLIDE, both):
        env.reset(seed=0, options={"fault": fault, "pose": np.full(arm.n, 0.4)})
        env.step(env.actions.encode())
        env.step(said(env, UNSURE))
        picture = env.render()
        pictures.append(np.isclose(picture, np.array(to_rgb(TRUTH)) * 255, atol=2).all(-1).sum())
    env.close()
    assert pictures[1] > pictures[0] > 0  # a ring round the joint beside the coloured link
