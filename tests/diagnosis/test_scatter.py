"""Scatter of changes of motion about the directions of places, pooled over records."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import LinearArm, Mismatch, planar
from loose_env.diagnosis import PlaceDirections, PooledScatter, RecordScatter
from loose_env.sensors import SensorSuite


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
