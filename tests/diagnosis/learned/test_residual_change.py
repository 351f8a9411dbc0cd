"""What a seat leaves unexplained of a change, with room for errors beyond the first order."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.diagnosis.learned.residual_change import MODEL_SHARE, SEAT_SHARE, residual_change
from loose_env.diagnosis.learned.transmission_change import TransmissionChange

SIZE, PLACES = 8, 6


def change(
    rng: np.random.Generator,
    openings: dict[int, float],
    *,
    error: float = 0.0,
    thin: float = 1e-2,
) -> TransmissionChange:
    """Make a change by some seats, in an arm with a direction along which errors are thin."""
    opened = rng.normal(size=(PLACES, SIZE))
    axes = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0]
    sd = np.full(SIZE, 0.05)
    sd[0] = thin
    nominal = 3.0 * rng.normal(size=SIZE)
    measured = axes @ (sd * rng.normal(size=SIZE)) + error * nominal
    for place, opening in openings.items():
        measured = measured + opening * opened[place]
    return TransmissionChange(
        measured=measured,
        open=opened,
        nominal=nominal,
        covariance=axes @ np.diag(sd**2) @ axes.T,
    )


def test_the_seat_that_moved_leaves_little_and_opens_as_it_did() -> None:
    rng = np.random.default_rng(1)
    left, opening = [], []
    for _ in range(200):
        found = residual_change(change(rng, {2: 0.6}))
        left.append(found.residual)
        opening.append(found.opening[2])
        assert found.healthy > found.residual[2]
    mean = np.mean(left, axis=0)
    assert mean[2] < SIZE < 3 * SIZE < np.delete(mean, 2).min()
    assert np.mean(opening) == pytest.approx(0.6, abs=0.01)


def test_a_sound_arm_is_a_sound_arm_however_thin_the_errors() -> None:
    rng = np.random.default_rng(2)
    for thin in (1e-2, 1e-6):  # errors of second order are a share of the motion
        error = 0.5 * MODEL_SHARE
        found = [residual_change(change(rng, {}, thin=thin, error=error)) for _ in range(200)]
        assert np.mean([each.healthy for each in found]) < SIZE
    far = [residual_change(change(rng, {}, error=0.15)) for _ in range(50)]
    assert min(each.healthy for each in far) > 3 * SIZE


def test_a_seat_off_the_directions_tried_has_room() -> None:
    rng = np.random.default_rng(3)
    one = change(rng, {2: 1.0})
    found = residual_change(one)
    room = found.variance[2] - found.variance[2].min()
    assert (found.variance[2] > (SEAT_SHARE * 0.9) ** 2 * (one.open[2] ** 2).mean()).all()
    assert room.max() == pytest.approx(0.05**2 - 0.01**2, rel=0.01)


def test_the_second_seat_takes_off_what_the_first_leaves() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        found = residual_change(change(rng, {1: 0.8, 4: 0.5}))
        second = found.second(1)
        assert int(np.argmax(second)) == 4
        assert second[1] == pytest.approx(0.0, abs=1e-9)
        assert (second >= 0).all()


def test_the_unit_does_not_matter() -> None:
    one = change(np.random.default_rng(5), {0: 0.4})
    factor = 1e3
    other = TransmissionChange(
        measured=factor * one.measured,
        open=factor * one.open,
        nominal=factor * one.nominal,
        covariance=factor**2 * one.covariance,
    )
    for name in ("healthy", "residual", "explained", "opening"):
        assert getattr(residual_change(other), name) == pytest.approx(
            getattr(residual_change(one), name)
        )
    assert residual_change(other).second(0) == pytest.approx(residual_change(one).second(0))
