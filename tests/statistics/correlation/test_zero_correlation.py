"""What one, two and more excitations leave uncorrelated in space."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.statistics import (
    axial_angle_between,
    covariances,
    lowest_coherence_direction,
    lowest_coherence_of_records,
    tangents,
    uncorrelated_axis,
    uncorrelated_plane,
)


def record(joints: int, *, seed: int = 0, count: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((joints, count))
    a = rng.standard_normal((3, joints)) @ x + 0.7 * rng.standard_normal((3, count))
    return x, a


def test_one_joint_leaves_a_plane() -> None:
    x, a = record(1)
    normal = uncorrelated_plane(x, a)
    for inside in tangents(normal):
        assert abs(np.corrcoef(x[0], inside @ a)[0, 1]) < 1e-12
    assert abs(np.corrcoef(x[0], normal @ a)[0, 1]) > 0.3


def test_two_joints_leave_an_axis() -> None:
    x, a = record(2)
    axis = uncorrelated_axis(x, a)
    for joint in x:
        assert abs(np.corrcoef(joint, axis @ a)[0, 1]) < 1e-12
    lowest = lowest_coherence_direction(x, a)
    assert lowest.coherence < 1e-12
    assert axial_angle_between(axis, lowest.direction) < 1e-6


def test_records_in_turn_show_what_one_record_shows() -> None:
    rng = np.random.default_rng(3)
    b = rng.standard_normal((3, 3))
    loose = np.array([0.0, 0.6, 0.8])
    covs = []
    for j in range(3):
        x = rng.standard_normal(6000)
        noise = 0.05 * rng.standard_normal((3, 6000))
        # Along the loose direction the tool follows nothing.
        follows = np.eye(3) - np.outer(loose, loose)
        a = follows @ np.outer(b[:, j], x) + np.outer(loose, rng.standard_normal(6000)) + noise
        covs.append(covariances(x, a))
    found = lowest_coherence_of_records(covs)
    assert np.degrees(axial_angle_between(found.direction, loose)) < 3.0
    assert found.coherence < 0.01 < found.coherences[1]
    same = lowest_coherence_of_records(covs[:1])
    assert same.coherence == pytest.approx(0.0, abs=1e-12)


def test_what_cannot_be_used_is_refused() -> None:
    x, a = record(2)
    with pytest.raises(InvalidData, match="three"):
        uncorrelated_plane(x[0], a[:2])
    with pytest.raises(InvalidData, match="two excited joints"):
        uncorrelated_axis(x[0], a)
    with pytest.raises(InvalidData, match="one line"):
        uncorrelated_axis(x, np.outer([1.0, 2.0, 3.0], x[0] + x[1]))
    with pytest.raises(InvalidData, match="same tool axes"):
        lowest_coherence_of_records([])
