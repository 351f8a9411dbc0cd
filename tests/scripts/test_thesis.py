"""The thesis's equations against closed forms, derivatives, simulations and the source's tables."""

from __future__ import annotations

import inspect
import re
from importlib import import_module

import numpy as np
import pytest

from loose_env.arms import LinearArm
from scripts.thesis import planar_motion
from scripts.thesis.link_finding import (
    JOINTS,
    SLIDES,
    chance_of,
    named,
    pair_count,
    scatter,
)
from scripts.thesis.page import SECTIONS, text_of
from scripts.thesis.planar_motion import (
    LoosePlanarArm,
    tool_acceleration,
    tool_position,
    tool_velocity,
)
from scripts.thesis.rigs import cylindrical, slide_rig
from scripts.thesis.shaken_vera import poses


def cited(source: str) -> set[str]:
    """Numbers of equations in a text, ranges such as 3.15-3.17 spelt out."""
    found = re.findall(r"\b(\d)\.(\d+)\)?(?:(?:-| to )\(?(\d)\.(\d+))?", " ".join(source.split()))
    return {f"{c}.{k}" for c, a, _, b in found for k in range(int(a), int(b or a) + 1)}


@pytest.mark.parametrize("key", list(SECTIONS))
def test_every_equation_has_a_function_that_cites_it(key: str) -> None:
    assert callable(getattr(import_module(f"scripts.thesis.{SECTIONS[key]}"), key))
    for path, numbers in text_of(key).get("equations", {}).items():
        parts, found = path.split("."), None
        for k in range(len(parts) - 1, 0, -1):  # a method stands behind its class
            try:
                found = import_module(".".join(parts[:k]))
            except ModuleNotFoundError:
                continue
            for part in parts[k:]:
                found = getattr(found, part)
            break
        assert callable(found)
        assert set(numbers.split()) <= cited(inspect.getdoc(found) or ""), path


def test_tool_motion_is_the_derivative_of_the_one_before() -> None:
    arm, speed = LoosePlanarArm(length1=0.5, length2=0.3, beta=0.7), np.array([[1.3], [-0.8]])
    t, h = np.linspace(0.0, 2.0, 25), 1e-6

    def motion(t: np.ndarray) -> list[np.ndarray]:
        q, qd = np.sin(speed * t), speed * np.cos(speed * t)
        d, dd = 0.2 * np.sin(3 * t), 0.6 * np.cos(3 * t)
        return [q, qd, -(speed**2) * q, d, dd, -9 * d]

    q, qd, qdd, d, dd, ddd = motion(t)
    before, after = motion(t - h), motion(t + h)
    ends = [tool_position(arm, m[0], m[3]) for m in (before, after)]
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_velocity(arm, q, qd, d, dd), slope, atol=1e-8)  # (5.4)
    ends = [tool_velocity(arm, m[0], m[1], m[3], m[4]) for m in (before, after)]
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_acceleration(arm, q, qd, qdd, d, dd, ddd), slope, atol=1e-8)
    tight = tool_velocity(arm, q, qd, 0.0, 0.0)  # (3.71)
    ends = [tool_position(arm, m[0], 0.0) for m in (before, after)]
    np.testing.assert_allclose(tight, (ends[1] - ends[0]) / (2 * h), atol=1e-8)
    assert planar_motion.link_rate([0.7, -0.2]) == pytest.approx(0.5)
    reach = [0.5 * np.cos(0.3) + 0.3 * np.cos(1.4), 0.5 * np.sin(0.3) + 0.3 * np.sin(1.4)]
    np.testing.assert_allclose(tool_position(arm, [0.3, 1.1], 0.0), reach)  # (6.1)


def test_the_cylindrical_arm_moves_in_cylindrical_coordinates_and_carries_its_weight() -> None:
    arm = cylindrical()
    at = LinearArm(arm).at([0.4, 0.3, 0.7, 0.0, 0.0, 0.0])
    radius = 0.15 + 0.55 + 0.12 + 0.10 + 0.14 + 0.7
    expected = [[0, 0, 1], [radius, 0, 0], [0, 1, 0]]
    np.testing.assert_allclose(at.kinematic[:, :3], expected, atol=1e-12)
    carried = arm.model.body("flange2").subtreemass[0]
    assert at.gravity_torque[1] == pytest.approx(9.81 * carried)
    assert slide_rig(looseness_angle=1.0).shaker.stand == "bench"


def test_the_link_is_the_one_in_whose_frame_a_direction_is_fixed() -> None:
    theta2 = np.array(poses())
    assert named(0.4 - theta2) == SLIDES[0] and pair_count(0.4 - theta2)[0] == 0
    assert scatter(0.4 - theta2)[SLIDES[0]] == pytest.approx(0.0, abs=1e-9)
    assert named([0.4] * 5) == SLIDES[1] and pair_count([0.4] * 5)[0] == 9
    # Play in joint 2 moves the tool across link 2; the line of joint 1 lies half its angle on.
    assert scatter(np.full(5, np.pi / 2))[JOINTS[1]] == pytest.approx(0.0, abs=1e-9)
    assert scatter(np.pi / 2 - theta2 / 2)[JOINTS[0]] == pytest.approx(0.0, abs=1e-6)
    assert chance_of(np.radians(60.0), 0) > 0.95 and chance_of(np.radians(10.0), 0) < 0.01
