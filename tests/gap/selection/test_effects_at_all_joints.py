"""Machines whose model is wrong at several places at once, with something else left over."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.model.effects.friction import make_it_stick
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import GapSolution, find_gap
from tests.gap.workflow.test_pipeline import STEP, record

SERVOS = ("servo1", "servo2", "servo3")


def find_gains(
    folder: Path, *, softer: float, servos: Sequence[str], friction: float
) -> GapSolution:
    """Search for gains alone where servos are softer and a joint has a friction as well [N·m]."""

    def edit(spec: mujoco.MjSpec) -> None:
        for name in servos:
            servo = spec.actuator(name)
            servo.gainprm = np.asarray(servo.gainprm) * np.array([softer] + [1.0] * 9)
            servo.biasprm = np.asarray(servo.biasprm) * np.array([1, softer, softer] + [1.0] * 7)
        spec.joint("joint2").frictionloss = friction
        make_it_stick(spec.joint("joint2"), STEP / 2)

    recording = record(folder / "r", edit, seed=7, runs=4)
    return find_gap(recording, GapSettings(threads=1, kinds=("actuator_gain",)))


def test_large_effects_stay_where_something_else_is_left(tmp_path: Path) -> None:
    """Thirty standard deviations are left of 260: the intervals must not run off to nothing."""
    found = find_gains(tmp_path, softer=0.5, servos=SERVOS, friction=4.0)
    assert found.verdict == "named"
    assert [e.where for e in found.effects] == list(SERVOS)
    for effect in found.effects:
        low, high = effect.interval_95["gain"]
        assert 0.3 < low < effect.parameters["gain"] < high < 0.7
    assert found.best.held_out_rms > 20


def explained(found: GapSolution) -> float:
    """Share of what hung together in time that the best hypothesis explains."""
    return 1 - found.best.autocorrelated / found.base.autocorrelated


@pytest.mark.parametrize(
    ("softer", "friction", "servos"), [(0.8, 12.0, SERVOS), (0.7, 8.0, SERVOS[2:])]
)
def test_what_explains_its_own_joint_is_named_whatever_is_wrong_at_another(
    tmp_path: Path, softer: float, friction: float, servos: Sequence[str]
) -> None:
    """Friction at joint2 is no candidate; a gain there may stand in for it."""
    found = find_gains(tmp_path, softer=softer, servos=servos, friction=friction)
    assert 0.6 < explained(found) < 0.8
    assert found.verdict == "named"
    assert [e.where for e in found.effects] == [servo for servo in servos if servo != "servo2"]
    assert {e.where for e in found.doubtful} <= {"servo2"}
    for effect in found.effects:
        assert effect.deletion is not None
        assert max(effect.deletion.share_without, effect.deletion.share_in_channel) > 0.85
