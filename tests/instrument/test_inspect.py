"""Preview of a model: levels, modes, and which faults a diagnosis of its arm would find."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.instrument import ModelSettings, NextSettings, inspect_model, screen
from tests.instrument.arms import MOTORS, SERVOED, written

FEW = NextSettings(poses=6)


@pytest.fixture(scope="module")
def servoed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("servoed"), SERVOED)


@pytest.fixture(scope="module")
def seen(servoed: Path) -> Any:
    return inspect_model(servoed, FEW)


def test_the_band_is_the_one_that_is_asked_for(servoed: Path) -> None:
    found = inspect_model(servoed, NextSettings(poses=2, band_low=20.0, band_high=80.0))
    assert found.band_hz == (20.0, 80.0)
    with pytest.raises(InvalidSetting, match="is none"):
        inspect_model(servoed, NextSettings(poses=2, band_low=500.0))


def test_gravity_keeps_a_seat_under_a_vertical_axis_shut_along_it(servoed: Path) -> None:
    seen = inspect_model(servoed, NextSettings(poses=4, torque_share=0.15))
    post = next(f for f in seen.faults if f.hypothesis == "structural_looseness@post")
    assert post.directions < 1
    assert post.shut_along is not None
    assert abs(post.shut_along[2]) > 0.9  # the whole arm weighs on it in every pose
    fore = next(f for f in seen.faults if f.hypothesis == "structural_looseness@fore")
    assert fore.directions > post.directions


def test_play_in_a_joint_whose_axis_meets_the_tool_is_not_found(tmp_path: Path) -> None:
    text = SERVOED.replace(
        '<site name="tool" pos=".35 .03 0"/>', '<site name="tool" pos="0 .03 0"/>'
    )
    found = inspect_model(written(tmp_path, text), FEW)
    play = found.faults[-1]
    assert play.hypothesis == "backlash@elbow"
    assert play.verdict in ("hardly", "no")
    assert "axis" in play.why


def test_a_smaller_gap_shows_with_a_healthy_reference_than_without(seen: Any) -> None:
    for fault in seen.faults:
        if fault.smallest_gap is not None and fault.smallest_gap_model is not None:
            assert fault.smallest_gap <= fault.smallest_gap_model


def test_more_noise_hides_larger_gaps(servoed: Path) -> None:
    quiet, loud = (
        inspect_model(servoed, NextSettings(poses=2, noise_ug=noise)).faults
        for noise in (20.0, 20000.0)
    )
    found = [(q.smallest_gap, n.smallest_gap) for q, n in zip(quiet, loud, strict=True)]
    assert any(q is not None for q, _ in found)
    assert all(q is not None and q <= n for q, n in found if n is not None)


def test_levels_and_modes_are_those_of_the_servos(seen: Any) -> None:
    assert seen.arm.held_by == "the model's position servos"
    inertia = seen.arm.linear.at(np.zeros(3)).inertia
    slowest = np.sqrt(800 / inertia[0, 0]) / (2 * np.pi)
    assert 0.3 * slowest < seen.modes_hz[0] < 3 * slowest
    for joint, limit in zip(seen.joints, (80.0, 90.0, 50.0), strict=True):
        assert joint.torque_limit == limit
        assert 0 < 3 * joint.torque_rms <= 0.8 * limit


def test_the_models_own_accelerometer_says_where_the_tool_is(tmp_path: Path) -> None:
    found = inspect_model(written(tmp_path, MOTORS), NextSettings(poses=2))
    made = found.arm.recording_model
    assert (made.site, made.accelerometer) == ("tip", "vibration")
    assert made.positions == ("lift_position", "q2")
    assert "torque alone" in found.arm.held_by


def test_screen_and_file_hold_joints_tool_band_and_every_fault(seen: Any) -> None:
    assert tuple(f.hypothesis for f in seen.faults) == seen.arm.hypotheses[1:]
    assert {f.verdict for f in seen.faults} <= {"yes", "mostly", "hardly", "no"}
    text = screen(seen)
    for word in ("pan_servo", "80 N·m", "accelerometer: at tool", "Hz", "backlash@elbow", "mm"):
        assert word in text
    assert max(map(len, text.splitlines())) < 200
    whole = json.loads(seen.to_json())
    assert whole["format"] == "loose-inspection/1"
    assert [f["hypothesis"] for f in whole["faults"]] == list(seen.arm.hypotheses[1:])
    assert whole["settings"]["poses"] == 6


def test_a_tool_can_be_named(servoed: Path) -> None:
    found = inspect_model(servoed, NextSettings(poses=2), ModelSettings(tool="fore"))
    assert (found.arm.report.tool, found.joints[-1].name) == ("fore", "elbow")
    assert found.joints[-1].level_tool == 0  # it turns about the tool
