"""Runs are cut where the recorder paused, and never where it was only slow."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap.data.measured_runs import measured_runs, pieces_of
from loose_env.recording import Run

MODEL = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>'
    '<sensor><jointpos name="q" joint="turn"/></sensor></mujoco>'
)


def run(time: np.ndarray) -> Run:
    return Run(name="a.csv", time=time, sensors={"q": np.sin(time)})


def test_a_clock_that_jumps_parts_the_run() -> None:
    time = np.arange(300) / 100
    time[150:] += 1.7e9
    pieces, words = measured_runs([run(time)], MODEL)
    assert [piece.samples for piece in pieces[0]] == [150, 150]
    assert all(np.ptp(piece.time) < 2 for piece in pieces[0])
    assert "compared as 2 pieces" in words[0] and "1.7e+09 s" in words[0]


def test_slow_uneven_and_briefly_lost_rows_stay_one_run() -> None:
    rng = np.random.default_rng(0)
    lost = np.arange(500) / 100
    for time in (
        np.arange(50) / 5.0,
        np.cumsum(rng.uniform(0.01, 1.2, 100)),
        np.delete(lost, slice(100, 180)),
    ):
        assert pieces_of(run(time))[0].samples == len(time)


def test_pieces_that_are_too_short_are_left_out_or_refused() -> None:
    time = np.arange(60) / 100
    time[5:] += 100
    (piece,) = pieces_of(run(time))
    assert piece.samples == 55
    with pytest.raises(InvalidData, match="no piece of 10 samples"):
        pieces_of(run(np.arange(20) * 0.01 + 1000 * (np.arange(20) // 8)))
