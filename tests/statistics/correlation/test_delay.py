"""Delay between two signals from the phases of their cross-spectrum."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.statistics import phase_delay

LINES = np.linspace(5.0, 100.0, 80)


def turned(seconds: float, sign: int = 1) -> np.ndarray:
    """Cross-spectrum of a signal and the same one late, of uneven size."""
    size = np.linspace(0.1, 3.0, len(LINES))
    return np.asarray(sign * size * np.exp(-2j * np.pi * LINES * seconds))


@pytest.mark.parametrize("seconds", [-0.0199, -3e-4, 0.0, 1e-5, 4.2e-3])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_delay_and_a_sign_are_found_exactly(seconds: float, sign: int) -> None:
    found = phase_delay(
        LINES, turned(seconds, sign), np.ones(len(LINES)), largest=0.03, either_sign=True
    )
    assert found is not None
    assert found.seconds == pytest.approx(seconds, abs=1e-9)
    assert found.sign == sign and found.fit == pytest.approx(1.0)
    assert found.rival < 0.8


def test_the_standard_deviation_is_that_of_repeated_estimates() -> None:
    rng = np.random.default_rng(0)
    errors, sds = [], []
    for _ in range(200):
        phases = np.exp(1j * rng.normal(0.0, 0.3, len(LINES)))
        found = phase_delay(
            LINES, turned(2e-3) * phases, np.ones(len(LINES)), largest=0.03, either_sign=False
        )
        assert found is not None
        errors.append(found.seconds - 2e-3)
        sds.append(found.sd)
    assert np.mean(sds) == pytest.approx(np.std(errors), rel=0.2)


def test_lines_of_another_phase_hardly_move_the_delay() -> None:
    cross = turned(2e-3)
    cross[10:16] *= 1j  # a resonance between the two
    found = phase_delay(LINES, cross, np.ones(len(LINES)), largest=0.03, either_sign=False)
    assert found is not None and found.seconds == pytest.approx(2e-3, abs=1e-4)


def test_without_lines_or_beyond_the_search_there_is_no_delay() -> None:
    ones = np.ones(len(LINES))
    nothing = np.zeros(len(LINES), dtype=complex)
    assert phase_delay(LINES, nothing, ones, largest=0.03, either_sign=True) is None
    assert phase_delay(LINES, turned(1e-3), 0 * ones, largest=0.03, either_sign=True) is None
    assert phase_delay(LINES, turned(6e-3), ones, largest=5e-3, either_sign=False) is None


def test_a_single_line_leaves_the_delay_open() -> None:
    found = phase_delay(
        np.array([50.0]), np.array([1j]), np.ones(1), largest=0.05, either_sign=True
    )
    assert found is not None and found.rival > 0.95
