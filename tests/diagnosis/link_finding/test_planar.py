"""The thesis's link finding on directions that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import LinearArm, planar
from loose_env.diagnosis.link_finding.planar import (
    LinkFindingSettings,
    Sighting,
    backlash_joint,
    judge_turn,
    looks_healthy,
    next_joint,
)
from loose_env.errors import InvalidSetting


def sighting(
    pose: list[float],
    direction: float,
    *,
    kurtosis: float = 0.0,
    correlation: float = 0.5,
    nominal_direction: float = 0.0,
) -> Sighting:
    return Sighting(
        pose=np.array(pose),
        direction=direction,
        correlation=correlation,
        kurtosis=kurtosis,
        nominal_direction=nominal_direction,
        nominal_correlation=1.0,
    )


def seen_in_tool_frame(link: int, angle: float, pose: list[float]) -> float:
    """Direction of looseness at a link: it turns back by the joints distal to the link."""
    return angle - float(np.sum(pose[link:]))


@pytest.mark.parametrize("link", [1, 2, 3, 4])
@pytest.mark.parametrize("joint", [2, 3, 4])
@pytest.mark.parametrize("move", [np.pi / 2, -np.pi / 4])
def test_a_direction_turns_when_a_joint_beyond_the_loose_link_moves(
    link: int, joint: int, move: float
) -> None:
    before, after = [0.1, -0.4, 0.9, 0.3], [0.1, -0.4, 0.9, 0.3]
    after[joint - 1] += move
    finding = judge_turn(
        sighting(before, seen_in_tool_frame(link, 0.7, before)),
        sighting(after, seen_in_tool_frame(link, 0.7, after)),
        joint,
        LinkFindingSettings(),
    )
    assert finding == ("turned" if joint > link else "still")


def test_a_turn_between_the_thresholds_is_unclear() -> None:
    settings = LinkFindingSettings(still=0.2, turned=0.2)
    before = sighting([0.0, 0.0], 0.0)
    after = sighting([0.0, np.pi / 2], np.radians(30))  # |z*| = 0.5
    assert judge_turn(before, after, 2, settings) == "unclear"


def test_a_joint_that_did_not_move_says_nothing() -> None:
    same = sighting([0.0, 0.0], 0.3)
    assert judge_turn(same, same, 2, LinkFindingSettings()) == "unclear"


@pytest.mark.parametrize("order", ["outward", "inward", "bisection"])
@pytest.mark.parametrize("links", [2, 3, 4, 7])
def test_every_order_narrows_down_to_the_loose_link(order: str, links: int) -> None:
    for loose in range(1, links + 1):
        low, high, moves = 1, links, 0
        while low < high:
            joint = next_joint(order, low, high)  # type: ignore[arg-type]
            assert low < joint <= high
            low, high = (low, joint - 1) if joint > loose else (joint, high)
            moves += 1
        assert low == loose
        if order == "bisection":
            assert moves <= np.ceil(np.log2(links))


def test_healthy_asks_for_a_small_index_in_every_pose() -> None:
    settings = LinkFindingSettings(healthy_index=0.05)
    alike = sighting([0.0, 0.0], 0.0, correlation=0.99)
    unlike = sighting([0.0, 0.0], 1.2, correlation=0.4)
    assert looks_healthy([alike, alike], settings)
    assert not looks_healthy([alike, unlike], settings)


def test_index_e_sees_a_turn_that_leaves_the_correlation_as_it_was() -> None:
    turned = sighting([0.0, 0.0], 1.0, correlation=1.0)
    assert looks_healthy([turned], LinkFindingSettings(index="d"))
    assert not looks_healthy([turned], LinkFindingSettings(index="e"))


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_backlash_is_motion_along_a_joints_own_line_that_is_not_normal(joint: int) -> None:
    linear = LinearArm(planar(3))
    poses = [[0.0, 0.6, -1.1], [0.0, -0.9, 0.7]]

    def seen(pose: list[float], kurtosis: float) -> Sighting:
        line = linear.at(pose).kinematic[:, joint - 1]
        return sighting(pose, float(np.arctan2(line[1], line[0])), kurtosis=kurtosis)

    settings = LinkFindingSettings(backlash_angle=5.0, backlash_kurtosis=1.0)
    assert backlash_joint(linear, [seen(p, 3.0) for p in poses], settings) == joint
    assert backlash_joint(linear, [seen(p, 0.0) for p in poses], settings) is None


@pytest.mark.parametrize(
    "wrong", [{"order": "sideways"}, {"joint": 0}, {"still": -0.1}, {"turned": float("nan")}]
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidSetting):
        LinkFindingSettings(**wrong)  # type: ignore[arg-type]
