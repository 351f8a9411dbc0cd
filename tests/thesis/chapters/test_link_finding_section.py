"""The search for the loose link: simulated arms, and the directions of VERA, paired and pooled."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.diagnosis import Order
from loose_env.thesis.ch4_diagnosis.link_finding import ESTIMATORS, search
from loose_env.thesis.ch4_diagnosis.vera_link_finding import (
    EXPERIMENTS,
    JOINTS,
    LINKS,
    chance_of,
    named,
    pair_count,
    printed_directions,
    scatter,
    simulated_directions,
)
from loose_env.thesis.ch6_experiments.shaken_vera.cases import Cases, measured_cases, poses

ARMS = 24


@pytest.mark.parametrize(("order", "most"), [("outward", 2), ("inward", 2), ("bisection", 2)])
def test_the_change_of_transmission_finds_most_links(order: Order, most: int) -> None:
    runs = search(planar(3), ESTIMATORS["change of transmission"], order, seed=3, arms=ARMS)
    assert [r.link for r in runs] == [1 + k % 3 for k in range(ARMS)]
    assert all(1 <= r.moves <= most for r in runs)
    # A blind guess names a third; half and more is beyond chance at 24 arms.
    assert np.mean([r.named == r.link for r in runs]) > 0.55


def test_going_outward_a_right_search_takes_as_many_moves_as_the_link_says() -> None:
    runs = search(planar(3), ESTIMATORS["change of transmission"], "outward", seed=3, arms=ARMS)
    for run in runs:
        if run.named == run.link:
            assert run.moves == min(run.link, 2)


def test_the_same_seed_gives_the_same_searches() -> None:
    one, other = (
        search(planar(3), ESTIMATORS["lowest correlation"], "inward", seed=4, arms=6)
        for _ in range(2)
    )
    assert one == other


@pytest.fixture(scope="module")
def cases() -> Cases:
    return measured_cases(7, ("high preload", "looseness", "backlash"), records=8)


@pytest.mark.parametrize(("experiment", "right"), [("five", 4), ("six", 5)])
def test_printed_directions_need_all_poses(experiment: str, right: int) -> None:
    told = printed_directions(experiment)
    found = pair_count(told)
    assert (found.right, found.asked) == (right, 9)  # 122 and 302 degrees are half a turn apart
    assert named(told) == LINKS[1]


def test_the_link_is_the_one_in_whose_frame_a_direction_is_fixed() -> None:
    theta2 = np.array(poses())
    assert named(0.4 - theta2) == LINKS[0]
    assert scatter(0.4 - theta2)[LINKS[0]] == pytest.approx(0.0, abs=1e-9)
    assert pair_count(0.4 - theta2).right == 0
    assert named([0.4] * 5) == LINKS[1]
    assert pair_count([0.4] * 5).right == 9


def test_play_shows_the_line_of_its_joint() -> None:
    # Link 2 turns about joint 2: the tool moves across it. The line of joint 1 through a tool at
    # the end of two equal links lies half of joint 2's angle from there.
    across = np.full(5, np.pi / 2)
    assert scatter(across)[JOINTS[1]] == pytest.approx(0.0, abs=1e-9)
    half = np.pi / 2 - np.array(poses()) / 2
    assert scatter(half)[JOINTS[0]] == pytest.approx(0.0, abs=1e-6)


def test_random_axes_scatter_widely() -> None:
    # Uniform axes deviate from a fixed line by 90 / sqrt(3) = 52 degrees; the mean takes some.
    assert chance_of(np.radians(60.0), 0) > 0.95
    assert chance_of(np.radians(10.0), 0) < 0.01


def test_simulated_directions_name_link_2_when_pooled(cases: Cases) -> None:
    for experiment in EXPERIMENTS:
        found = simulated_directions(cases, experiment)
        rows = found["lowest"]
        assert rows.shape == (8, 5)
        assert np.mean([named(row) == LINKS[1] for row in rows]) >= 0.75
        right = [pair_count(row).right / pair_count(row).asked for row in rows]
        assert np.mean(right) < 0.9  # pairs alone do not decide
