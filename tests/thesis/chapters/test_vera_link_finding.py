"""Link finding on the directions of VERA: pairs of poses against all poses pooled."""

from __future__ import annotations

import numpy as np
import pytest

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
