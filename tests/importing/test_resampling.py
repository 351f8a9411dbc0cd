"""What one time base does to channels of other rates, and what it does not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loose_env.importing.timing.clock_alignment import shift_between
from loose_env.importing.timing.resampling import bridged, held, is_even, resampled, rows_of


def band(time: np.ndarray, low: float, high: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(low, high, 40), rng.uniform(0, 2 * np.pi, 40)
    return np.asarray(np.sin(2 * np.pi * np.outer(time, frequency) + phase).sum(1) / np.sqrt(20))


@pytest.mark.parametrize("offset", [0.0, 0.37e-2, 1.234e-3])
def test_a_slower_channel_keeps_its_band_and_its_phase(offset: float) -> None:
    slow = np.arange(500) / 100 + offset
    rows = np.arange(1000, 4000) / 1000
    found = resampled(slow, band(slow, 1, 42), rows, 0.015)
    assert np.abs(found.values - band(rows, 1, 42)).max() < 1e-3
    assert found.how == "band-limited from 100 Hz"


def test_a_faster_channel_brings_nothing_from_above_half_the_rate() -> None:
    fast = np.arange(20000) / 2000
    rows = np.arange(100, 900) / 100
    below = resampled(fast, band(fast, 1, 40), rows, 1e-3)
    above = resampled(fast, band(fast, 60, 900), rows, 1e-3)
    assert np.abs(below.values - band(rows, 1, 40)).max() < 1e-3
    # Picking every twentieth sample would fold all of it, rms 1, into the rows.
    assert np.abs(above.values).max() < 1e-3
    assert below.how.startswith("low-passed at 45.5 Hz")


def test_uneven_samples_are_joined_by_a_spline() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(1000) / 200 + rng.uniform(-1e-3, 1e-3, 1000)
    rows = np.arange(500, 4500) / 1000
    found = resampled(time, band(time, 1, 15), rows, bridged(time, None))
    assert np.abs(found.values - band(rows, 1, 15)).max() < 1e-2
    assert found.how.startswith("spline")


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    ratio=st.sampled_from([0.1, 0.5, 1.0, 1.7, 10.0]),
    lost=st.floats(0, 0.5),
)
def test_values_are_bounded_and_missing_where_there_are_none(
    seed: int, ratio: float, lost: float
) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(300) / 100
    kept = rng.uniform(size=300) >= lost
    kept[[0, 150, 299]] = True
    time, values = time[kept], rng.uniform(-1, 1, 300)[kept]
    rows = np.arange(-20, int(340 * ratio)) / (100 * ratio)
    longest = 0.015
    found = resampled(time, values, rows, longest).values
    outside = (rows < time[0] - 1e-5) | (rows > time[-1] + 1e-5)
    assert np.isnan(found[outside]).all()
    after = np.clip(np.searchsorted(time, rows), 1, len(time) - 1)
    between = (rows > time[after - 1] + 1e-4) & (rows < time[after] - 1e-4)
    in_gap = between & (time[after] - time[after - 1] > longest)
    assert np.isnan(found[in_gap & ~outside]).all()
    assert np.nanmax(np.abs(found)) < 6
    there = ~outside & ~in_gap & between
    assert np.isfinite(found[there]).all()


def test_a_constant_stays_what_it_is() -> None:
    time = np.arange(40) / 50
    for rate in (13.0, 50.0, 77.0, 1000.0):
        rows = np.arange(1, int(0.75 * rate)) / rate
        np.testing.assert_allclose(resampled(time, np.full(40, 2.5), rows, 0.1).values, 2.5)


def test_commands_are_held_and_no_longer_than_the_gap() -> None:
    time, values = np.array([0.0, 0.1, 0.2, 0.6]), np.array([1.0, 2.0, 3.0, 4.0])
    rows = np.array([-0.05, 0.0, 0.09, 0.1, 0.29, 0.36, 0.6, 0.7, 0.8])
    found = held(time, values, rows, 0.15)
    np.testing.assert_array_equal(found, [np.nan, 1, 1, 2, 3, np.nan, 4, 4, np.nan])


def test_rows_run_on_through_a_gap() -> None:
    time = np.concatenate([np.arange(50), np.arange(60, 100)]) / 100
    assert is_even(time)
    rows = rows_of(time, 0.1, 0.9, bridged(time, None), 1000)
    assert rows is not None
    np.testing.assert_allclose(rows, np.arange(10, 91) / 100, atol=1e-12)
    assert rows_of(np.concatenate([time, [1e9]]), 0.0, 1e9, 0.015, 10**6) is None


@pytest.mark.parametrize("shift", [-0.4, 0.0, 0.0123, 0.31])
@pytest.mark.parametrize("rate", [250.0, 1000.0])
def test_a_shift_is_found_below_the_sample(shift: float, rate: float) -> None:
    rng = np.random.default_rng(5)
    own, other = np.arange(int(4 * rate)) / rate, np.arange(3000) / 500
    noise = 0.1 * rng.normal(size=len(own))
    found = shift_between(
        "here",
        (own - shift, -3 * band(own, 2, 60) + noise),
        (other, band(other, 2, 60)),
        most_s=0.5,
        sign=-1,
    )
    assert abs(found.seconds - shift) < 1e-4
    assert found.correlation > 0.95
