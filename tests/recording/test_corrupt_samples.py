"""Corrupt samples are told from motion, impacts and commands, and set aside as missing."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.recording import Run, corrupt_mask, set_aside, without_corrupt

MODEL = mujoco.MjModel.from_xml_string(
    """<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/><site name="tip"/></body>
    </worldbody><actuator><motor name="m" joint="turn"/></actuator>
    <sensor><jointpos name="q" joint="turn"/><accelerometer name="acc" site="tip"/></sensor>
    </mujoco>"""
)
TIME = np.arange(2000) / 500
SWING = 0.8 * np.sin(3 * TIME) + np.random.default_rng(0).normal(0, 1e-3, len(TIME))


def run(**columns: np.ndarray) -> Run:
    given = {"q": SWING} | columns
    torque = {"turn": given.pop("torque")} if "torque" in given else {}
    control = {"m": given.pop("m")} if "m" in given else {}
    return Run(name="a.csv", time=TIME, sensors=given, torques=torque, controls=control)


@pytest.mark.parametrize("value", [1e282, -1e30, 3e9, 5e4, 100.0])
@pytest.mark.parametrize("rows", [[700], [0, 1999], [300, 301, 302]])
def test_absurd_positions_are_found_and_nothing_else(value: float, rows: list[int]) -> None:
    wrong = SWING.copy()
    wrong[rows] = value
    clean, (found,) = without_corrupt(run(q=wrong), MODEL)
    assert (found.column, found.count) == ("sensor.q", len(rows))
    assert found.largest == abs(value)
    assert np.flatnonzero(np.isnan(clean.sensors["q"])).tolist() == rows
    np.testing.assert_array_equal(np.delete(clean.sensors["q"], rows), np.delete(wrong, rows))


def test_real_readings_are_not_corrupt() -> None:
    rng = np.random.default_rng(1)
    impacts = rng.normal(0, 0.5, (len(TIME), 3))
    impacts[::400] += 400.0
    move = np.where(TIME < 3.9, 0.0, 2 * (TIME - 3.9))  # at rest, then away
    pulse = np.zeros(len(TIME))
    pulse[500] = 40.0
    steps = np.where(TIME < 2, 0.0, 90.0)
    slip = np.zeros(len(TIME))  # at rest, but for a slip of a few samples
    slip[500:503] = [2e-3, 1e-3, 5e-4]
    slip[503:] = 1e-20 * 0.9 ** np.arange(len(TIME) - 503)
    for given in (
        run(acc=impacts),
        run(q=np.round(SWING, 2)),
        run(q=move),
        run(m=pulse),
        run(torque=steps),
        run(torque=slip),
        run(q=np.full(len(TIME), 0.3)),
        run(q=np.degrees(SWING)),
    ):
        same, found = without_corrupt(given, MODEL)
        assert found == () and same is given


def test_a_run_that_is_mostly_corrupt_is_refused_with_its_column_and_share() -> None:
    wrong = SWING.copy()
    wrong[::2] = 1e30
    with pytest.raises(InvalidData, match=r"'sensor\.q': 1000 of 2000 samples are corrupt.*50%"):
        set_aside(run(q=wrong), MODEL)


def test_missing_samples_and_short_columns_are_no_obstacle() -> None:
    wrong = SWING.copy()
    wrong[:200] = np.nan
    wrong[900] = -1e12
    assert np.flatnonzero(corrupt_mask(wrong)).tolist() == [900]
    assert corrupt_mask(np.array([1.0, 1e300])).tolist() == [False, True]
    assert not corrupt_mask(np.full(20, np.nan)).any()
