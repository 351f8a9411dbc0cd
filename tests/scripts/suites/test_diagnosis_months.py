"""Months of simulated sessions: what they scatter by, and what the table counts."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.instrument import TrendSettings, change_since
from scripts.suites.diagnosis.months import PLAY, alarms_of, as_found, machine, table
from tests.instrument.arms import named, session

pytestmark = pytest.mark.slow


def test_months_scatter_and_wear_grows_from_its_onset() -> None:
    case = machine(0, 1)
    first, second = (as_found(case, month, "healthy", 0) for month in (0, 1))
    assert not first.arm.effects
    change = second.arm.factors.kp / first.arm.factors.kp - 1
    assert 0 < np.abs(change).max() < 0.03
    play = as_found(case, 9, "play", 3).arm.effects[0]
    assert play.kind == "backlash" and play.parameters["gap"] == pytest.approx(3 * PLAY)
    softer = as_found(case, 9, "softer drive", 20).arm.factors.kp
    assert softer[1] < 0.95 * as_found(case, 9, "healthy", 0).arm.factors.kp[1]


def test_the_table_counts_false_alarms_before_wear_and_delays_after_it() -> None:
    settings = TrendSettings()
    healthy = change_since(session(9), named(9))
    worn = change_since(session(9, factor={"elbow": 1.4}), named(9))
    assert alarms_of(worn) == [9]
    words = table({"healthy": [healthy], "play": [worn]}, 9, settings)
    assert "false alarms: 0 in 15 sessions" in words
    assert "play: found on 1 of 1 machines, after 1 worn sessions" in words
