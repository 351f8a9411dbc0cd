"""Pairs of accelerometers differ on one motion; the gear's play holds the resolver back."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.thesis.ch6_experiments.slide.directions import shares_within
from loose_env.thesis.ch6_experiments.slide.records import play, slide_records


def test_pairs_measure_one_motion_with_their_own_gains():
    one, other = slide_records(1), slide_records(1, pair=1)
    np.testing.assert_array_equal(one.velocity, other.velocity)
    # At 0 degrees the first accelerometer reads the motion: gains differ by a percent or so.
    first, second = one.x[0] - one.x[0].mean(), other.x[0] - other.x[0].mean()
    ratio = float(first @ second / (first @ first))
    assert 0.0005 < abs(ratio - 1) < 0.04
    assert np.corrcoef(first, second)[0, 1] > 0.999


def test_the_velocity_is_the_integral_of_the_acceleration():
    records = slide_records(1)
    middle = slice(1, -1)
    slope = (records.velocity[0][2:] - records.velocity[0][:-2]) * records.rate / 2
    # Two central differences weaken 710 Hz by (sin w / w)^2 = 0.935.
    x = records.x[0][middle]
    gain = float(slope @ (x - x.mean()) / np.sum((x - x.mean()) ** 2))
    assert gain == pytest.approx(0.935, abs=0.03)


def test_shares_differ_from_pair_to_pair():
    found = shares_within(1, 4, band=(2.0, 200.0), angles=(10.0, 80.0), percent=2.0)
    assert found.shape == (4,)
    assert ((found >= 0) & (found <= 100)).all()
    assert np.ptp(found) > 0
    wide = shares_within(1, 1, band=(2.0, 200.0), angles=(20.0, 70.0), percent=20.0)
    assert wide[0] == 100.0


def test_play_takes_its_width_off_the_stroke():
    turn = np.sin(np.linspace(0, 6 * np.pi, 3001))
    found = play(turn, 0.4)
    assert np.abs(found - turn).max() == pytest.approx(0.2)
    assert np.ptp(found) == pytest.approx(2.0 - 0.4, abs=1e-4)
    np.testing.assert_array_equal(play(turn, 0.0), turn)
    assert np.ptp(play(turn, 3.0)) == 0.0
