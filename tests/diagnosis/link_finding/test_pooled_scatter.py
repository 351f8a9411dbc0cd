"""Scatter of changes about the directions of places, against changes made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loose_env.arms import LinearArm, Mismatch, planar
from loose_env.diagnosis import PlaceDirections, PooledScatter
from loose_env.diagnosis.learned.features import TransmissionChange
from loose_env.diagnosis.link_finding.pooled_scatter import scatter_of
from loose_env.sensors import SensorSuite


def change(direction: float, size: float) -> TransmissionChange:
    """Change along one direction [rad] with three joints shaken; places at 0, 30, ... degrees."""
    angles = np.radians(np.arange(0.0, 180.0, 30.0))
    lines = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    share = np.array([0.5, -1.0, 0.2])
    seen = size * np.outer([np.cos(direction), np.sin(direction)], share)
    # Unequal errors: what counts is the change in units of them.
    errors = np.diag([1.0, 4.0, 1.0, 9.0, 1.0, 4.0])
    return TransmissionChange(
        measured=seen.ravel(),
        open=np.einsum("pi,j->pij", lines, share).reshape(6, -1),
        nominal=np.zeros(6),
        covariance=errors,
    )


@pytest.mark.parametrize("k", range(6))
def test_a_change_along_a_places_line_is_all_gain_there(k: int) -> None:
    made = change(np.radians(30.0 * k), 8.0)
    found = scatter_of([made], 3)
    whole = made.measured @ np.linalg.solve(made.covariance, made.measured)
    assert found.gain[k] == pytest.approx(whole)
    assert (np.delete(found.gain, k) < 0.999 * whole).all()
    assert found.excess == pytest.approx(whole / 3)
    axis = np.array([np.cos(np.radians(30.0 * k)), np.sin(np.radians(30.0 * k))])
    assert abs(found.direction @ axis) == pytest.approx(1.0)


def test_an_outlying_record_counts_less_than_its_square() -> None:
    places = PlaceDirections(LinearArm(planar(2)), SensorSuite(), Mismatch())
    count = places.features.locations
    seen = scatter_of([change(0.0, 8.0)], 3)
    gain = np.full(count, 1.0)
    gain[0] = 1001.0
    wide = type(seen)(directions=np.ones((count, 2)), direction=seen.direction, gain=gain, joints=2)
    pool = PooledScatter.none(places, outlier=10.0).after(wide)
    assert pool.scatter[0] == 0.0
    assert pool.scatter[1] == pytest.approx(10.0 * np.log(101.0))
    assert pool.directions[0] @ places.axes[0] == pytest.approx(1.0)


def test_a_further_sensor_adds_its_gain_along_the_same_place() -> None:
    seen = change(np.radians(60.0), 8.0)
    np.testing.assert_allclose(scatter_of([seen] * 3, 3).gain, 3 * scatter_of([seen], 3).gain)


def test_sensors_do_not_outvote_an_error_that_they_share() -> None:
    made = change(0.0, 8.0)
    spring = made.measured[None]
    seen = replace(made, covariance=made.covariance + spring.T @ spring, springs=spring)
    # Known to be shared, it is no surer for being seen twice; taken as two errors it would be.
    shared = scatter_of([seen, seen], 3).gain[0]
    apart = scatter_of([replace(seen, springs=None)] * 2, 3).gain[0]
    assert shared < 1.1
    assert apart == pytest.approx(2 * scatter_of([seen], 3).gain[0])
