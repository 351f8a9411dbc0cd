"""Which kinds of fault are hypotheses: names, draws, and episodes on every arm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from loose_env.arms import Arm, LinearArm, arm_from_file, planar, scara, six_axis, vera
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.faults import PIVOT, FaultSampler
from loose_env.envs.settings import DIFFICULTIES, DiagnosisSettings, Difficulty
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults import (
    DEFAULT_KINDS,
    KINDS,
    Backlash,
    CompoundLooseness,
    RotationalLooseness,
    StructuralLooseness,
    hypotheses,
    parts_of,
    twist_of,
)
from loose_env.rig import PlantShop

UR5E = Path(__file__).parents[4] / "shared" / "models" / "ur5e_bare.xml"
ARMS: dict[str, Callable[[], Arm]] = {
    "vera": vera,
    "planar3": lambda: planar(3),
    "six_axis": six_axis,
    "scara": scara,
    "scara-compliant": lambda: scara(hold="compliant"),
}
if UR5E.exists():
    ARMS["ur5e"] = lambda: arm_from_file(UR5E)
FURTHER = ("healthy", "rotational_looseness", "compound_looseness")


@cache
def arm_of(name: str) -> Arm:
    return ARMS[name]()


@cache
def sampler(name: str, difficulty: str = "default") -> FaultSampler:
    return FaultSampler(LinearArm(arm_of(name)), DIFFICULTIES[difficulty], KINDS)


def draws(name: str, kind: str, count: int, difficulty: str = "default") -> list[Any]:
    """Faults of one kind, as many at every link."""
    rng, own = np.random.default_rng(8), sampler(name, difficulty)
    places = hypotheses(arm_of(name), ("healthy", kind))[1:]
    return [own.draw(rng, hypothesis=place) for place in places for _ in range(count)]


# --- names


def test_hypotheses_are_ordered_by_kind_then_by_place() -> None:
    arm = planar(2)
    assert hypotheses(arm) == hypotheses(arm, DEFAULT_KINDS)
    every = hypotheses(arm, KINDS)
    assert every == hypotheses(arm, KINDS[::-1])
    assert every[: 1 + 2 * arm.n] == hypotheses(arm)
    assert every[5:] == (
        "rotational_looseness@link1",
        "rotational_looseness@link2",
        "compound_looseness@link1",
        "compound_looseness@link2",
    )
    assert hypotheses(arm, ("healthy",)) == ("healthy",)


@pytest.mark.parametrize(
    ("kinds", "error", "message"),
    [
        (("healthy", "rust"), UnknownName, r"\['rust'\]; kinds are .*'compound_looseness'"),
        (("healthy", "backlash", "backlash"), InvalidSetting, "named once"),
        (("backlash",), InvalidSetting, "add it to the kinds, got .*backlash"),
        ((), InvalidSetting, '"healthy" is always a hypothesis'),
        ("healthy", InvalidSetting, "several names out of"),
        (None, InvalidSetting, "several names out of"),
    ],
)
def test_kinds_that_cannot_be_are_refused(kinds: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        hypotheses(planar(2), kinds)
    with pytest.raises(error, match=message):
        DiagnosisSettings(kinds=kinds)


def test_a_difficulty_shares_out_what_are_hypotheses() -> None:
    equal = Difficulty().probabilities
    assert dict(equal()) == dict.fromkeys(DEFAULT_KINDS, 1 / 3)
    assert dict(equal(KINDS)) == dict.fromkeys(KINDS, 1 / 5)
    own = Difficulty(kinds={"backlash": 0.25, "compound_looseness": 0.75, "healthy": 0.0})
    settings = DiagnosisSettings(difficulty=own, kinds=(*DEFAULT_KINDS, "compound_looseness"))
    assert own.probabilities(settings.kinds) == own.kinds
    with pytest.raises(InvalidSetting, match=r"hides \['compound_looseness'\], but only .*add"):
        DiagnosisSettings(difficulty=own)
    with pytest.raises(InvalidSetting, match="hides"):
        FaultSampler(LinearArm(planar(2)), own)
    # No probability is as good as no mention.
    DiagnosisSettings(difficulty=Difficulty(kinds={"healthy": 1.0, "compound_looseness": 0.0}))


# --- draws


@pytest.mark.parametrize("name", ["planar3", "six_axis"])
def test_more_hypotheses_change_no_draw_of_the_default_ones(name: str) -> None:
    arm = arm_of(name)
    plain = FaultSampler(LinearArm(arm), Difficulty())
    for hypothesis in hypotheses(arm):
        one, other = np.random.default_rng(3), np.random.default_rng(3)
        assert plain.draw(one, hypothesis=hypothesis) == sampler(name).draw(
            other, hypothesis=hypothesis
        )
        assert one.random() == other.random()


def test_all_kinds_come_up_alike_at_every_place() -> None:
    own, rng = sampler("planar3"), np.random.default_rng(6)
    found = Counter(own.draw(rng).hypothesis for _ in range(600))
    kinds = Counter({k: sum(c for h, c in found.items() if h.startswith(k)) for k in KINDS})
    assert stats.chisquare([kinds[k] for k in KINDS]).pvalue > 0.01
    assert set(found) == set(hypotheses(arm_of("planar3"), KINDS))


def levers(arm: Arm) -> Any:
    """Largest distance of the tool from each link's frame over the sampler's own poses."""
    import mujoco

    rng, most = np.random.default_rng(0), np.zeros(arm.n)
    for pose in [np.zeros(arm.n), *(arm.random_pose(rng) for _ in range(64))]:
        data = mujoco.MjData(arm.model)
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_forward(arm.model, data)
        away = [data.site(arm.tool).xpos - data.body(b).xpos for b in arm.seat_bodies]
        most = np.maximum(most, np.linalg.norm(away, axis=1))
    return np.maximum(most, 0.1 * arm.reach)


@pytest.mark.parametrize("name", ARMS)
def test_a_rocking_link_has_its_travel_at_the_tool_and_its_axis_off_the_joint(name: str) -> None:
    arm, own = arm_of(name), sampler(name)
    lever = levers(arm)
    travels, ratios, axes = [], [], []
    for fault in draws(name, "rotational_looseness", 40):
        assert isinstance(fault, RotationalLooseness)
        travels.append(fault.gap * lever[fault.link - 1])
        drive = own.further.drive.twist(fault.link, twist_of(arm, fault))
        ratios.append(fault.friction / drive)
        axes.append(fault.axis)
        anchor = arm.model.joint(arm.joints[fault.link - 1]).pos
        away = np.linalg.norm(np.array(fault.pivot) - anchor) / arm.reach
        assert PIVOT[0] - 1e-9 < away < PIVOT[1] + 1e-9
    for values, (low, high) in ((travels, (0.02e-3, 0.4e-3)), (ratios, (0.02, 1.0))):
        share = np.log(np.array(values) / low) / np.log(high / low)
        assert stats.kstest(share, "uniform").pvalue > 0.001
    if len(arm.axes) == 2:
        assert set(axes) == {(0.0, 0.0, 1.0)}
    else:
        for component in np.transpose(axes):  # uniform on the sphere
            assert stats.kstest((component + 1) / 2, "uniform").pvalue > 0.001


@pytest.mark.parametrize("name", ARMS)
def test_a_compound_seat_has_two_slides_across_or_a_slide_and_a_rotation(name: str) -> None:
    arm = arm_of(name)
    slides = 0
    faults = draws(name, "compound_looseness", 40)
    for fault in faults:
        assert isinstance(fault, CompoundLooseness)
        first, second = fault.parts
        assert isinstance(first, StructuralLooseness)
        if isinstance(second, StructuralLooseness):
            slides += 1
            assert abs(np.dot(first.direction, second.direction)) < 1e-12
            assert second.gap != first.gap
        for part in fault.parts:
            twist = twist_of(arm, part)
            drive = sampler(name).further.drive.twist(fault.link, twist)
            assert 0.02 * 0.999 < part.friction / drive < 1.001
    assert stats.binomtest(slides, len(faults)).pvalue > 0.001


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
@pytest.mark.parametrize("name", ARMS)
def test_every_further_fault_can_be_simulated_in_every_drawn_arm(
    name: str, difficulty: str
) -> None:
    arm = arm_of(name)
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    rng = np.random.default_rng(1)
    for kind in FURTHER[1:]:
        for fault in draws(name, kind, 10, difficulty):
            mismatch = DIFFICULTIES[difficulty].mismatch.draw(arm, rng)
            plant = shop.build(fault, mismatch)
            assert plant.parts == len(parts_of(fault))


def test_play_of_a_sliding_joint_is_drawn_in_metres() -> None:
    arm, own = arm_of("scara"), sampler("scara")
    rng = np.random.default_rng(2)
    for joint, least, most in ((3, 2e-5, 4e-4), (2, 2e-5 / arm.reach, 4e-4 / arm.reach)):
        gaps = []
        for _ in range(60):
            play = own.draw(rng, hypothesis=f"backlash@joint{joint}")
            assert isinstance(play, Backlash)
            assert 0.02 * 0.999 < play.friction / own.drive.hinge(joint) < 1.001
            gaps.append(play.gap)
        share = np.log(np.array(gaps) / least) / np.log(most / least)
        assert stats.kstest(share, "uniform").pvalue > 0.001


# --- episodes


def run(env: Any, fault: str, seed: int) -> tuple[Any, ...]:
    """One record in which everything is shaken, then the right verdict."""
    n = env.arm.n
    first, _ = env.reset(seed=seed, options={"fault": fault})
    seen = env.step(env.actions.encode(levels=np.full(n, 3), duration=0))
    verdict = env.actions.encode(verdict=1 + env.hypotheses.index(fault))
    return first, seen, env.step(verdict)


@pytest.mark.parametrize("name", ARMS)
def test_episodes_with_all_kinds_run_on_every_arm(name: str) -> None:
    env = DiagnosisEnv(arm_of(name), DiagnosisSettings(kinds=KINDS, max_records=2), threads=1)
    assert env.hypotheses == hypotheses(env.arm, KINDS)
    assert env.action_space.nvec[-1] == 1 + len(env.verdicts)
    for k, fault in enumerate(env.hypotheses):
        first, (seen, _, terminated, truncated, info), last = run(env, fault, k)
        assert first.shape == seen.shape
        assert np.isfinite(seen).all() and env.observation_space.contains(seen)
        assert not terminated and not truncated
        assert info["action_mask"].shape == (int(env.action_space.nvec.sum()),)
        _, reward, terminated, _, info = last
        assert terminated and reward == 1.0
        assert info["is_success"] and info["link_success"] and info["fault"] == fault
        assert info["fault_figures"].hypothesis == fault


def test_a_vector_of_arms_with_all_kinds_gives_what_single_ones_give() -> None:
    settings = DiagnosisSettings(kinds=KINDS, max_records=2)
    for name in ("planar3", "six_axis"):
        arm = arm_of(name)
        number = 10
        vector = DiagnosisVectorEnv(arm, settings, num_envs=number, threads=2)
        starts, _ = vector.reset(seed=list(range(number)))
        single = DiagnosisEnv(arm, settings, threads=1)
        shake = single.actions.encode(levels=np.full(arm.n, 2), duration=0)
        seen = vector.step(np.tile(shake, (number, 1)))[0]
        kinds = set()
        for k in range(number):
            first, _ = single.reset(seed=k)
            np.testing.assert_array_equal(first, starts[k])
            np.testing.assert_array_equal(single.step(shake)[0], seen[k])
            episode = single.batch.episode(0)
            assert episode is not None
            kinds.add(episode.fault.kind)
        assert len(kinds) >= 4


def test_a_given_fault_need_not_be_a_hypothesis() -> None:
    arm = planar(2)
    env = DiagnosisEnv(arm, DiagnosisSettings(max_records=2), threads=1)
    rocking = RotationalLooseness(link=1, axis=(0, 0, 1), gap=1e-4, stiffness=(1e4, 1e4))
    env.reset(seed=0, options={"fault": rocking})
    env.step(env.actions.encode(levels=np.full(2, 3), duration=0))
    *_, info = env.step(env.actions.encode(verdict=2))
    assert info["fault"] == "rotational_looseness@link1"
    assert not info["is_success"] and info["link_success"]
    env.reset(seed=0, options={"fault": "rotational_looseness@link1"})
    drawn = env.batch.episode(0).fault  # type: ignore[union-attr]
    assert isinstance(drawn, RotationalLooseness) and drawn != rocking
    with pytest.raises(UnknownName, match="rotational_looseness@link3"):
        env.reset(seed=0, options={"fault": "rotational_looseness@link3"})
