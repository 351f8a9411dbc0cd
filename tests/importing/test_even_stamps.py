"""Evenly spaced samples whose stamps jitter, and some of which are missing."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.importing.timing.even_stamps import straightened

STEP = 1e-3


def stamps(
    missing: tuple[int, ...], jitter: float, *, count: int = 4000, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """True times, and stamps off by a share of a step (standard deviation), some left out."""
    rng = np.random.default_rng(seed)
    kept = np.setdiff1d(np.arange(count), missing)
    true = STEP * kept
    noted = true + jitter * STEP * rng.normal(size=len(true))
    return true, np.sort(noted)


@pytest.mark.parametrize("jitter", [0.0, 0.05, 0.2, 0.5])
@pytest.mark.parametrize("missing", [(), (2000,), (700, 701, 2500), (100, 900, 1700, 3300)])
def test_missing_samples_do_not_bend_the_clock(missing: tuple[int, ...], jitter: float) -> None:
    true, noted = stamps(missing, jitter)
    found = straightened("here", noted)
    # Near a gap that jitter hides it cannot be told between which two samples it lies.
    near = np.zeros(len(true), dtype=bool)
    for gap in missing:
        near |= np.abs(true - STEP * gap) < 8 * STEP
    assert np.abs(found - true)[~near].max() < 0.1 * STEP
    assert np.abs(found - true).max() < 1.2 * len(missing or (1,)) * STEP


def test_many_missing_samples_are_no_matter_where_stamps_are_clear() -> None:
    rng = np.random.default_rng(3)
    missing = tuple(int(k) for k in rng.choice(np.arange(1, 3999), 400, replace=False))
    true, noted = stamps(missing, 0.05)
    assert np.abs(straightened("here", noted) - true).max() < 0.05 * STEP


def test_coarse_stamps_are_put_right() -> None:
    true = np.arange(3000) / 300.0
    found = straightened("here", np.floor(true * 1e3) / 1e3)
    assert np.ptp(found - true) < 1e-4


def test_single_late_stamps_are_no_missing_samples() -> None:
    true, noted = stamps((), 0.1)
    noted[1000] += 0.8 * STEP
    noted[2000:2006] += np.linspace(1.6, 0.1, 6) * STEP
    assert np.abs(straightened("here", np.sort(noted)) - true).max() < 0.1 * STEP


@pytest.mark.parametrize("steps", [0.6, 1.5, -0.7])
def test_a_move_that_is_no_whole_step_is_refused(steps: float) -> None:
    _, noted = stamps((), 0.02)
    late = noted + np.where(np.arange(len(noted)) >= 2000, steps * STEP, 0.0)
    late[2000:] = np.maximum(late[2000:], late[1999] + 1e-6)
    with pytest.raises(InvalidData, match="cannot be told"):
        straightened("here", np.maximum.accumulate(late) + 1e-9 * np.arange(len(late)))


def test_stamps_that_are_late_for_long_and_come_back_are_refused() -> None:
    """A logger that stalls and catches up looks like missing samples, and then like too many."""
    _, noted = stamps((), 0.05)
    noted[2000:2200] += 1.0 * STEP
    noted[2200] = noted[2199] + 1e-6
    with pytest.raises(InvalidData, match="cannot be told"):
        straightened("here", np.maximum.accumulate(noted) + 1e-9 * np.arange(len(noted)))


def test_stamps_far_off_the_line_are_refused() -> None:
    true = STEP * np.arange(20_000.0)
    with pytest.raises(InvalidData, match=r"off the straight line.*leave even out"):
        straightened("here", true + 0.01 * np.sin(0.1 * np.pi * true))
