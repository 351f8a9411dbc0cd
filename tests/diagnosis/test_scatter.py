"""Scatter of changes of motion about the directions of places, pooled over records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loose_env.arms import LinearArm, Mismatch, planar
from loose_env.diagnosis import PlaceDirections, PooledScatter, RecordScatter
from loose_env.diagnosis.features import (
    TransmissionChange,
)
from loose_env.diagnosis.scatter import (
    scatter_of,
)
from loose_env.sensors import SensorSuite
from loose_env.typing import Array


def change(direction: float, size: float) -> TransmissionChange:
    """Change along one direction [rad] with three joints shaken; places at 0, 30, ... degrees."""
    angles = np.radians(np.arange(0.0, 180.0, 30.0))
    lines = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    share = np.array([0.5, -1.0, 0.2])
    seen = size * np.outer([np.cos(direction), np.sin(direction)], share)
    return TransmissionChange(
        measured=seen.ravel(),
        open=np.einsum("pi,j->pij", lines, share).reshape(6, -1),
        nominal=np.full(6, 1e6),  # so large that no error counts to second order
    )


# Unequal errors: what counts is the change in units of them.
ERRORS = np.diag([1.0, 4.0, 1.0, 9.0, 1.0, 4.0])


def gain_of(*changes: TransmissionChange, errors: Array = ERRORS) -> Array:
    """Gain of every place, the errors of all sensors alike and independent."""
    sampling = np.kron(np.eye(len(changes)), errors)
    return scatter_of(changes, 3, sampling=sampling).gain


@pytest.mark.parametrize("k", range(6))
def test_a_change_along_a_places_line_is_all_gain_there(k: int) -> None:
    made = change(np.radians(30.0 * k), 8.0)
    found = scatter_of([made], 3, sampling=ERRORS)
    whole = made.measured @ np.linalg.solve(ERRORS, made.measured)
    assert found.gain[k] == pytest.approx(whole)
    assert (np.delete(found.gain, k) < 0.999 * whole).all()
    axis = np.array([np.cos(np.radians(30.0 * k)), np.sin(np.radians(30.0 * k))])
    assert abs(found.direction @ axis) == pytest.approx(1.0)


def on_axes(measured: list[float], *, shared: list[float] | None = None) -> RecordScatter:
    """Record of two axes and one joint: places along the first axis, then along the second."""
    places = PlaceDirections(LinearArm(planar(2)), SensorSuite(), Mismatch())
    lines = np.tile([[0.0, 1.0]], (places.features.locations, 1))
    lines[0] = [1.0, 0.0]
    return RecordScatter(
        lines=lines,
        directions=lines,
        direction=lines[0],
        measured=np.array(measured),
        precision=np.eye(2),
        shared=np.zeros((0, 2)) if shared is None else np.array([shared]),
        joints=1,
    )


def pooled(*records: RecordScatter) -> PooledScatter:
    """Pool of some records."""
    places = PlaceDirections(LinearArm(planar(2)), SensorSuite(), Mismatch())
    pool = PooledScatter.none(places, outlier=10.0)
    for record in records:
        pool = pool.after(record)
    return pool


def test_an_outlying_record_counts_less_than_its_square() -> None:
    pool = pooled(on_axes([np.sqrt(1000.0), 0.0]))
    assert pool.scatter[0] == 0.0
    assert pool.scatter[1] == pytest.approx(10.0 * np.log(101.0))
    assert pool.gain == pytest.approx(1000.0)


def test_an_error_that_all_records_share_counts_once() -> None:
    apart = pooled(*[on_axes([2.0, 0.0])] * 10)
    shared = pooled(*[on_axes([2.0, 0.0], shared=[2.0, 0.0])] * 10)
    assert apart.gain == pytest.approx(40.0)
    # One standard deviation of that error explains it all: chi-square 1 in place of 40.
    assert shared.gain == pytest.approx(40.0 / 41.0)


def test_changes_that_a_shared_error_cannot_make_together_add_up() -> None:
    # The second record contradicts the first: a fault, not the sensor's error.
    pool = pooled(*[on_axes([x, 0.0], shared=[2.0, 0.0]) for x in (2.0, -2.0)])
    assert pool.gain == pytest.approx(8.0)


@pytest.mark.parametrize("records", [1, 4])
@pytest.mark.parametrize("joints", [1, 3])
def test_errors_alone_stand_out_as_rarely_as_asked(records: int, joints: int) -> None:
    # Many places vie for each change, and more joints and records leave more to be explained.
    places = PlaceDirections(LinearArm(planar(2)), SensorSuite(), Mismatch())
    rng = np.random.default_rng(0)
    angles = rng.uniform(0.0, np.pi, (records, places.features.locations))
    shared = rng.standard_normal((2, 2 * joints))
    found = []
    for _ in range(200):
        theta, pool = rng.standard_normal(2), PooledScatter.none(places, outlier=10.0)
        for angle in angles:
            lines = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            pool = pool.after(
                RecordScatter(
                    lines=lines,
                    directions=lines,
                    direction=lines[0],
                    measured=rng.standard_normal(2 * joints) + theta @ shared,
                    precision=np.eye(2 * joints),
                    shared=shared,
                    joints=joints,
                )
            )
        found.append(pool.stands_out(0.1, rng))
    assert 0.04 < np.mean(found) < 0.18


def test_a_change_beyond_all_errors_stands_out_and_none_does_not() -> None:
    rng = np.random.default_rng(0)
    assert pooled(on_axes([8.0, 0.0])).stands_out(0.001, rng)
    assert not pooled(on_axes([0.5, 0.0])).stands_out(0.1, rng)
    assert not pooled().stands_out(0.5, rng)


def test_sensors_do_not_outvote_an_error_that_they_share() -> None:
    made = change(0.0, 8.0)
    spring = made.measured[None]
    seen = replace(made, arm_errors=spring)
    # Known to be shared, it is no surer for being seen twice; taken as two errors it would be.
    assert gain_of(seen, seen)[0] < 1.1
    errors = ERRORS + spring.T @ spring
    assert gain_of(made, made, errors=errors)[0] == pytest.approx(2 * gain_of(seen)[0])
