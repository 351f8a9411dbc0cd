"""Settings of the plan beside a recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from loose_env.errors import InvalidData
from loose_env.instrument import (
    ModelSettings,
    MotionSettings,
    NextSettings,
    PlanFiles,
    plan,
    read_recorded_arm,
    session_beside,
    write_plan,
)
from loose_env.instrument.model.motion_limits import motion_limits
from tests.instrument.arms.plan_arms import URDF, written

SLOW = MotionSettings(max_jerk_rad_s3=(4000.0,), command_bandwidth_hz=90.0)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Folder of a plan for a URDF that states speeds, with a limit of jerk given."""
    model = written(tmp_path, URDF, "arm.urdf")
    chosen = NextSettings(poses=2, seconds=1.0)
    made = plan(model, arm=ModelSettings(), choice=chosen, motion=SLOW)
    write_plan(PlanFiles(tmp_path / "session", made.arm.recording_model.xml), made)
    return tmp_path / "session"


def test_the_limits_of_a_plan_hold_for_the_recording_beside_it(session: Path) -> None:
    before = session_beside(session / "recording")
    assert before.motion == SLOW
    assert before.limits is not None
    arm = read_recorded_arm(session / "recording" / "model.xml")
    limits = motion_limits(arm, before.limits)
    # The recording's MJCF does not state the speeds of the URDF; the plan does.
    assert [limits.limit("speed", j) for j in range(2)] == [2.0, 2.0]
    assert [limits.limit("jerk", j) for j in range(2)] == [4000.0, 4000.0]
    assert limits.limit("acceleration", 0) == float("inf")
    assert limits.bandwidth_hz == 90.0


def test_without_a_plan_no_limits_are_known(session: Path, tmp_path: Path) -> None:
    assert session_beside(tmp_path / "elsewhere").limits is None


def test_the_limits_hold_for_every_recording_of_the_session(session: Path) -> None:
    corrected = session_beside(session / "corrected")
    assert corrected.limits is not None and corrected == session_beside(session / "recording")


@pytest.mark.parametrize("damage", [lambda raw: raw[: len(raw) // 2], lambda raw: b"\xff" + raw])
def test_a_damaged_plan_is_refused_in_one_line(
    session: Path, damage: Callable[[bytes], bytes]
) -> None:
    path = session / "plan.json"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InvalidData, match=r"plan\.json: the plan is damaged") as error:
        session_beside(session / "recording")
    assert "\n" not in str(error.value)


def test_a_plan_that_cannot_be_read_is_refused(session: Path) -> None:
    (session / "plan.json").unlink()
    (session / "plan.json").mkdir()
    with pytest.raises(InvalidData, match="cannot be read"):
        session_beside(session / "recording")


def test_a_plan_of_another_program_is_no_plan(session: Path) -> None:
    (session / "plan.json").write_text('{"format": "another"}', "utf-8")
    assert session_beside(session / "recording").limits is None


@pytest.mark.parametrize(
    "stated", [3, [], {"speed": 3}, {"speed": {"j1": 2}}, {"speed": {"j1": {"limit": -1.0}}}]
)
def test_limits_that_make_no_sense_are_refused_in_one_line(session: Path, stated: Any) -> None:
    path = session / "plan.json"
    whole = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps({**whole, "limits": stated}), "utf-8")
    with pytest.raises(InvalidData, match=r"plan\.json: limits: ") as error:
        session_beside(session / "recording")
    assert "\n" not in str(error.value)


def test_a_plan_of_an_earlier_version_states_no_limits(session: Path) -> None:
    path = session / "plan.json"
    whole = json.loads(path.read_text("utf-8"))
    del whole["limits"]
    path.write_text(json.dumps(whole), "utf-8")
    assert session_beside(session / "recording").limits == SLOW
