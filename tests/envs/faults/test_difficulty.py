"""Difficulties: the ranges from which hidden faults are drawn."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields
from functools import cache

import numpy as np
import pytest
from scipy import stats

from loose_env.arms import FASTEST_TURN, LinearArm, Mismatch, planar, vera
from loose_env.envs.faults import FaultSampler
from loose_env.envs.settings import DIFFICULTIES, Difficulty, difficulty_named
from loose_env.excitation import SeatDrive, at_levels
from loose_env.faults import Backlash, Healthy, StructuralLooseness, hypotheses
from loose_env.rig import PlantShop

ARMS = {arm.name: arm for arm in (planar(3), planar(4, vertical=True), vera())}
FRICTION = {
    "easy": (0.02, 0.2),
    "default": (0.02, 1.0),
    "hard": (0.1, 2.0),
    "reachable": (0.1, 0.7),
}
GAP = {"easy": (0.1e-3, 0.4e-3), "default": (0.02e-3, 0.4e-3), "hard": (0.02e-3, 0.4e-3)}
GAP["reachable"] = GAP["hard"]


@cache
def linear(arm: str) -> LinearArm:
    return LinearArm(ARMS[arm])


@cache
def sampler(arm: str, difficulty: str) -> FaultSampler:
    return FaultSampler(linear(arm), DIFFICULTIES[difficulty])


@cache
def figures(arm: str, difficulty: str) -> tuple[list[float], list[float]]:
    """Friction ratios and travels [m] of many draws."""
    over = DIFFICULTIES[difficulty].friction_over
    drive, reach = SeatDrive(linear(arm), over=over), ARMS[arm].reach
    rng = np.random.default_rng(0)
    frictions, travels = [], []
    for _ in range(600):
        fault = sampler(arm, difficulty).draw(rng)
        if isinstance(fault, StructuralLooseness):
            frictions.append(fault.friction / drive.slide(fault.link, fault.direction))
            travels.append(fault.gap)
        elif isinstance(fault, Backlash):
            frictions.append(fault.friction / drive.hinge(fault.joint))
            travels.append(fault.gap * reach)
    return frictions, travels


def test_four_difficulties_have_names() -> None:
    assert list(DIFFICULTIES) == ["easy", "default", "hard", "reachable"]
    for name, difficulty in DIFFICULTIES.items():
        assert difficulty_named(name) is difficulty
    assert DIFFICULTIES["default"] == Difficulty()


def test_a_difficulty_of_one_s_own_is_taken_as_it_is() -> None:
    own = Difficulty(friction=(0.3, 0.4))
    assert difficulty_named(own) is own


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
@pytest.mark.parametrize("arm", ARMS)
def test_friction_and_gap_lie_in_the_range_and_spread_evenly_over_it(
    arm: str, difficulty: str
) -> None:
    for values, (low, high) in zip(
        figures(arm, difficulty), (FRICTION[difficulty], GAP[difficulty]), strict=True
    ):
        assert low * (1 - 1e-9) <= min(values) and max(values) <= high * (1 + 1e-9)
        share = np.log(np.array(values) / low) / np.log(high / low)
        assert stats.kstest(share, "uniform").pvalue > 0.001


@pytest.mark.parametrize("arm", ARMS)
def test_each_difficulty_is_harder_than_the_one_before(arm: str) -> None:
    order = ("easy", "default", "hard")
    sticking = [np.median(figures(arm, difficulty)[0]) for difficulty in order]
    assert sticking == sorted(sticking)
    assert np.median(figures(arm, "easy")[1]) > np.median(figures(arm, "default")[1])
    off = [DIFFICULTIES[difficulty].mismatch for difficulty in order]
    for field in fields(Mismatch):
        deviations = [getattr(mismatch, field.name) for mismatch in off]
        assert deviations == sorted(set(deviations)), field.name


def test_a_ratio_of_one_is_the_force_that_the_top_level_drives_through_the_seat() -> None:
    # In the plane, shaken joint by joint at the top level, over random poses: the joint that
    # drives the seat best, and the middle pose.
    arm = ARMS["planar3"]
    at, rng = linear("planar3"), np.random.default_rng(5)
    direction = np.array([0.6, 0.8])
    forces, torques = [], []
    for _ in range(200):
        pose = at.at(arm.random_pose(rng))
        force, torque = [], []
        for joint in range(arm.n):
            levels = np.where(np.arange(arm.n) == joint, arm.levels[-1], 0.0)
            shake, _ = at_levels(pose, levels, duration=1.0)
            answer, rms = pose.response(shake.excited), shake.torque_rms[joint]
            force.append(rms * np.sqrt(np.mean(np.abs(answer.slide[:, 1, :, 0] @ direction) ** 2)))
            torque.append(rms * np.sqrt(np.mean(np.abs(answer.hinge[:, 1, 0]) ** 2)))
        forces.append(max(force))
        torques.append(max(torque))
    drive = SeatDrive(at)
    # The yardstick takes 48 poses of its own.
    assert drive.slide(2, (0.6, 0.8, 0.0)) == pytest.approx(np.median(forces), rel=0.15)
    assert drive.hinge(2) == pytest.approx(np.median(torques), rel=0.15)


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
@pytest.mark.parametrize("arm", ARMS)
def test_every_drawn_fault_can_be_simulated_in_every_drawn_arm(arm: str, difficulty: str) -> None:
    own = ARMS[arm]
    shop = PlantShop(own, timestep=own.timestep, link_accelerometers=False)
    rng = np.random.default_rng(1)
    for name in hypotheses(own):
        for _ in range(8):
            fault = sampler(arm, difficulty).draw(rng, hypothesis=name)
            shop.build(fault, DIFFICULTIES[difficulty].mismatch.draw(own, rng))


def seat_masses(arm: str, fault: StructuralLooseness | Backlash) -> tuple[float, float]:
    """Mass on a seat with the rest of the straight arm held, and the least with the rest free."""
    at = linear(arm)
    whole = at.at(np.zeros(ARMS[arm].n)).inertia
    seat = np.zeros(len(whole))
    if isinstance(fault, Backlash):
        seat[at.hinge_dofs[fault.joint - 1]] = 1.0
    else:
        seat[at.slide_dofs[fault.link - 1]] = fault.direction[:2]
    moving = np.vstack([np.eye(len(whole))[[*at.joint_dofs, *at.flexible_dofs]], seat])
    rng = np.random.default_rng(0)
    folded = [at.at(ARMS[arm].random_pose(rng)).inertia for _ in range(64)]
    free = [1 / np.linalg.inv(moving @ m @ moving.T)[-1, -1] for m in (whole, *folded)]
    return float(seat @ whole @ seat), float(min(free))


@pytest.mark.parametrize("arm", ARMS)
def test_stops_are_as_stiff_and_damped_as_stated_each_side_its_own(arm: str) -> None:
    rng = np.random.default_rng(2)
    fastest = 0.85 * FASTEST_TURN / ARMS[arm].timestep
    for name in hypotheses(ARMS[arm])[1:]:
        for _ in range(10):
            fault = sampler(arm, "default").draw(rng, hypothesis=name)
            assert isinstance(fault, (StructuralLooseness, Backlash))
            held, free = seat_masses(arm, fault)
            stiffness, damping = np.array(fault.stiffness), np.array(fault.damping)
            mode = np.sqrt(stiffness / held) / (2 * np.pi)
            local = np.sqrt(stiffness / free)
            assert ((mode < 360.001) & (local < fastest * 1.001)).all()
            # Below 300 Hz only where the local mode would be too fast for the step.
            assert ((mode > 299.999) | (local > fastest * 0.999)).all()
            ratio = damping / (2 * np.sqrt(stiffness * free))
            assert ((ratio > 0.0499) & (ratio < 0.3001)).all()
            assert damping[0] != damping[1]


def test_a_draw_by_name_is_of_that_hypothesis_and_a_draw_takes_the_same_variates() -> None:
    own = sampler("vera", "default")
    after = []
    for name in (None, *hypotheses(ARMS["vera"])):
        rng = np.random.default_rng(3)
        fault = own.draw(rng, hypothesis=name)
        if name is not None:
            assert fault.hypothesis == name
        after.append(rng.random())
    assert len(set(after)) == 1


def test_directions_of_looseness_are_uniform_in_the_plane() -> None:
    rng = np.random.default_rng(4)
    own = sampler("planar3", "default")
    faults = [own.draw(rng, hypothesis="structural_looseness@link1") for _ in range(500)]
    directions = np.array([fault.direction for fault in faults])  # type: ignore[union-attr]
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert not directions[:, 2].any()
    turn = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi) + 0.5
    assert stats.kstest(turn, "uniform").pvalue > 0.01


@pytest.mark.parametrize(
    "kinds",
    [
        {"healthy": 1.0},
        {"backlash": 1.0},
        {"healthy": 0.2, "structural_looseness": 0.8},
        {"healthy": 0.0, "structural_looseness": 0.25, "backlash": 0.75},
    ],
)
def test_kinds_come_with_the_probability_given(kinds: dict[str, float]) -> None:
    own = FaultSampler(linear("planar3"), Difficulty(kinds=kinds))
    rng = np.random.default_rng(6)
    found = Counter(own.draw(rng).kind for _ in range(400))
    possible = [kind for kind, share in kinds.items() if share > 0]
    assert set(found) == set(possible)
    expected = [400 * kinds[kind] for kind in possible]
    if len(possible) > 1:
        observed = [found[kind] for kind in possible]  # type: ignore[index]
        assert stats.chisquare(observed, expected).pvalue > 0.01


def test_a_range_of_one_value_is_that_value() -> None:
    own = FaultSampler(linear("planar3"), Difficulty(friction=(0.5, 0.5), gap=(2e-4, 2e-4)))
    rng = np.random.default_rng(7)
    play = own.draw(rng, hypothesis="backlash@joint3")
    assert isinstance(play, Backlash)
    assert play.gap == pytest.approx(2e-4 / 0.9)  # three links of 0.3 m
    assert play.friction == pytest.approx(0.5 * own.drive.hinge(3))
    assert own.draw(rng, hypothesis="healthy") == Healthy()
