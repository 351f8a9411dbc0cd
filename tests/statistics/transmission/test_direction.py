"""The direction of a change of transmission, its region and its rank."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics import (
    TransmissionEstimate,
    axes_grid,
    axial_angle_between,
    change_direction,
    change_rank,
    estimate_transmission,
    join_transmissions,
    pool_transmissions,
    transmission_change,
)


def alike(b: np.ndarray, sd: float) -> TransmissionEstimate:
    """A change whose entries all err alike and independently."""
    return TransmissionEstimate(b, sd**2 * np.eye(b.size).reshape(*b.shape, *b.shape))


def scattered(b: np.ndarray, root: np.ndarray, rng: np.random.Generator) -> TransmissionEstimate:
    """A change with errors drawn from a given covariance root (size, size)."""
    noise = (root @ rng.standard_normal(b.size)).reshape(b.shape)
    return TransmissionEstimate(b + noise, (root @ root.T).reshape(*b.shape, *b.shape))


@pytest.mark.parametrize("shape", [(2, 1), (2, 4), (3, 1), (3, 2), (3, 6)])
def test_with_equal_errors_it_is_the_leading_singular_vector(shape: tuple[int, int]) -> None:
    b = np.random.default_rng(0).standard_normal(shape)
    found = change_direction(alike(b, 0.05))
    expected = transmission_change(1.0 + b, np.ones(shape)).direction
    assert axial_angle_between(found.direction, expected) < 1e-4
    np.testing.assert_allclose(found.drive, found.direction @ b, atol=1e-6)


def test_a_bad_record_spoils_the_direction_less() -> None:
    rng = np.random.default_rng(1)
    u, v = np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.5, -0.3, 0.8])
    sd = np.array([0.6, 0.01, 0.01, 0.01])  # the first joint's record is bad
    errors: dict[str, list[float]] = {"weighed": [], "singular": []}
    for _ in range(30):
        change = scattered(np.outer(u, v), np.diag(np.tile(sd, 3)), rng)
        errors["weighed"].append(axial_angle_between(change_direction(change).direction, u))
        plain = transmission_change(1.0 + change.b, np.ones((3, 4))).direction
        errors["singular"].append(axial_angle_between(plain, u))
    assert np.median(errors["weighed"]) < 0.1 * np.median(errors["singular"])


def test_a_valley_narrower_than_any_grid_is_found() -> None:
    """Loose motion scatters along the seat a thousand times as far as across it."""
    rng = np.random.default_rng(9)
    for _ in range(20):
        u = rng.standard_normal(3)
        u /= np.linalg.norm(u)
        along = np.outer(u, u) * 0.05**2 + 1e-10 * np.eye(3)
        covariance = np.einsum("ij,mn->imjn", along, np.eye(6))
        noise = rng.multivariate_normal(np.zeros(18), covariance.reshape(18, 18)).reshape(3, 6)
        b = np.outer(u, 0.2 * rng.standard_normal(6)) + noise
        found = change_direction(TransmissionEstimate(b, covariance))
        assert axial_angle_between(found.direction, u) < 1e-3
        assert found.region.lowest <= found.region.misfit.at(u[None])[0] + 1e-6


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("size", [0.0, 0.05, 0.5])
def test_the_region_holds_the_truth_as_often_as_it_says(dimension: int, size: float) -> None:
    rng = np.random.default_rng(2)
    m = 3
    held = 0
    for _ in range(200):
        u = rng.standard_normal(dimension)
        u /= np.linalg.norm(u)
        mixed = 0.05 * rng.standard_normal((dimension * m, dimension * m))
        change = scattered(size * np.outer(u, rng.standard_normal(m)), mixed, rng)
        held += change_direction(change).contains(u)
    assert 0.91 <= held / 200 <= 0.985


def test_a_change_of_nothing_leaves_nearly_every_axis_inside() -> None:
    rng = np.random.default_rng(3)
    inside = []
    for _ in range(20):
        found = change_direction(scattered(np.zeros((3, 2)), 0.05 * np.eye(6), rng))
        inside.append(np.mean([found.contains(axis) for axis in axes_grid(50)]))
    assert np.mean(inside) > 0.8


def test_half_angle_and_sd_are_those_of_small_errors() -> None:
    b = np.outer([0.0, 0.0, 1.0], [0.6, 0.8])
    found = change_direction(alike(b, 0.01))
    # The sum over the columns is worth one observation of size one: sd = 0.01 rad each way.
    assert found.sd == pytest.approx(0.01, rel=0.02)
    assert found.half_angle == pytest.approx(0.01 * np.sqrt(5.991), rel=0.02)
    np.testing.assert_allclose(found.precision, np.diag([1e4, 1e4, 0.0]), rtol=0.01, atol=1.0)


def test_precision_knows_which_way_is_uncertain() -> None:
    b = np.outer([0.0, 0.0, 1.0], [0.6, 0.8])
    covariance = np.einsum("ij,mn->imjn", np.diag([1e-4, 9e-4, 1e-4]), np.eye(2))
    found = change_direction(TransmissionEstimate(b, covariance))
    np.testing.assert_allclose(np.diag(found.precision), [1e4, 1e4 / 9, 0.0], rtol=0.02, atol=1.0)
    assert 0.01 < found.sd < 0.03


def test_rank_counts_directions() -> None:
    rng = np.random.default_rng(4)
    one = np.outer([0.0, 1.0, 0.0], rng.standard_normal(6))
    two = one + np.outer([1.0, 0.0, 0.0], rng.standard_normal(6))
    three = two + np.outer([0.0, 0.0, 1.0], rng.standard_normal(6))
    for rank, b in enumerate((0 * one, one, two, three)):
        found = [change_rank(scattered(b, 0.02 * np.eye(18), rng)).rank for _ in range(40)]
        assert np.mean(np.array(found) == rank) >= 0.95


def test_rank_tests_have_their_significance() -> None:
    rng = np.random.default_rng(5)
    b = np.outer([0.0, 0.6, 0.8], rng.standard_normal(4))
    p = [change_rank(scattered(b, 0.01 * np.eye(12), rng)).p_values[1] for _ in range(150)]
    assert 0.01 <= np.mean(np.array(p) < 0.05) <= 0.1


def test_known_errors_widen_the_region() -> None:
    b = np.outer([0.0, 0.0, 1.0], [1.0, 0.5])
    lean = np.zeros((1, 3, 2))
    lean[0, 0] = 0.1 * b[2]
    narrow, wide = alike(b, 0.01), alike(b, 0.01).with_errors(lean)
    assert change_direction(wide).half_angle > 2 * change_direction(narrow).half_angle
    assert change_direction(wide).contains([0.1, 0.0, 1.0])
    assert not change_direction(narrow).contains([0.1, 0.0, 1.0])
    assert not change_direction(wide).contains([0.0, 0.1, 1.0])


def record(rng: np.random.Generator, count: int = 1200) -> tuple[np.ndarray, ...]:
    """Two coloured excitations and a tool whose looseness is as strong as the first of them."""
    white = rng.standard_normal((3, count + 8))
    x = np.array([np.convolve(w, np.ones(5) / 5, mode="same") for w in white[:2]])[:, :count]
    loose = np.convolve(white[2], np.ones(4) / 4, mode="same")[:count] * np.abs(x[0]) * 2
    b = np.array([[0.5, 0.1], [0.2, -0.3], [0.0, 0.4]])
    tool = b @ x + np.outer([0.6, 0.0, 0.8], loose) + 0.01 * rng.standard_normal((3, count))
    return x, tool, b


def test_estimated_scatter_is_that_of_many_records() -> None:
    rng = np.random.default_rng(6)
    found = []
    for _ in range(200):
        x, tool, b = record(rng)
        found.append((estimate_transmission(x, tool, 1000.0), b))
    errors = np.array([(e.b - b).ravel() for e, b in found])
    claimed = np.mean([e.covariance.reshape(6, 6) for e, _ in found], axis=0)
    true = errors.T @ errors / len(errors)
    np.testing.assert_allclose(np.sqrt(np.diag(claimed)), np.sqrt(np.diag(true)), rtol=0.2)
    assert abs(claimed[0, 4] / np.sqrt(claimed[0, 0] * claimed[4, 4])) > 0.8  # they err together


def test_the_command_frees_the_estimate_of_encoder_noise() -> None:
    rng = np.random.default_rng(7)
    command = rng.standard_normal(4000)
    tool = np.stack((command, 0.5 * command, 0 * command)) + 0.1 * rng.standard_normal((3, 4000))
    seen = command + rng.standard_normal(4000)
    shrunk = estimate_transmission(seen, tool, 1000.0)
    free = estimate_transmission(seen, tool, 1000.0, command=command)
    assert shrunk.b[0, 0] < 0.6
    assert abs(free.b[0, 0] - 1.0) < 4 * np.sqrt(free.covariance[0, 0, 0, 0]) < 0.2


def test_scatter_is_right_where_one_command_moves_several_joints() -> None:
    """Brakes give a little: cov(command, x) is then not symmetric."""
    rng = np.random.default_rng(9)
    b = np.array([[0.5, 0.1], [0.2, -0.3], [0.0, 0.4]])
    mixed = np.array([[1.0, 0.8], [0.0, 0.5]])
    found = []
    for _ in range(200):
        command = rng.standard_normal((2, 1200))
        x = mixed @ command
        tool = b @ x + np.array([[0.3], [0.1], [0.2]]) * rng.standard_normal((3, 1200))
        found.append(estimate_transmission(x, tool, 1000.0, command=command))
    true = np.sqrt(np.mean([(e.b - b).ravel() ** 2 for e in found], axis=0))
    claimed = np.sqrt(np.mean([np.diag(e.covariance.reshape(6, 6)) for e in found], axis=0))
    np.testing.assert_allclose(claimed, true, rtol=0.2)


@pytest.mark.parametrize(("dimension", "joints"), [(2, 4), (3, 6)])
def test_regions_allow_for_errors_that_differ_much_where_little_changes(
    dimension: int, joints: int
) -> None:
    rng = np.random.default_rng(10)
    held, cases, size = 0, 150, dimension * joints
    for _ in range(cases):
        u = rng.standard_normal(dimension)
        u /= np.linalg.norm(u)
        root = 0.05 * rng.standard_normal((size, size))
        change = scattered(0.1 * np.outer(u, rng.standard_normal(joints)), root, rng)
        held += change_direction(change).contains(u)
    assert 0.9 <= held / cases <= 0.995


def test_joined_and_pooled_estimates() -> None:
    rng = np.random.default_rng(8)
    parts = [estimate_transmission(*record(rng)[:2], 1000.0) for _ in range(4)]
    joined = join_transmissions(parts[:2])
    np.testing.assert_array_equal(joined.b[:, 2:], parts[1].b)
    np.testing.assert_array_equal(joined.covariance[:, 2:, :, 2:], parts[1].covariance)
    assert not joined.covariance[:, :2, :, 2:].any()
    pooled = pool_transmissions(parts)
    alone = np.mean([np.sqrt(p.covariance[0, 0, 0, 0]) for p in parts])
    assert 0.3 < np.sqrt(pooled.covariance[0, 0, 0, 0]) / alone < 0.6


def test_what_cannot_be_used_is_refused() -> None:
    b = np.ones((3, 2))
    with pytest.raises(InvalidData, match="two or three"):
        change_direction(alike(np.ones((4, 2)), 0.1))
    with pytest.raises(InvalidData, match="positive"):
        change_direction(TransmissionEstimate(b, np.zeros((3, 2, 3, 2))))
    with pytest.raises(InvalidData, match="NaN"):
        change_direction(alike(np.full((3, 2), np.nan), 0.1))
    with pytest.raises(InvalidSetting, match="level"):
        change_direction(alike(b, 0.1), level=1.0)
    with pytest.raises(InvalidSetting, match="significance"):
        change_rank(alike(b, 0.1), significance=0.0)
    with pytest.raises(InvalidData, match="reference"):
        alike(b, 0.1).minus(np.ones((3, 3)))
    with pytest.raises(InvalidData, match="errors"):
        alike(b, 0.1).with_errors(np.ones((2, 3)))
    with pytest.raises(InvalidData, match="same number of rows"):
        join_transmissions([])
    with pytest.raises(InvalidData, match="one shape"):
        pool_transmissions([alike(b, 0.1), alike(np.ones((3, 1)), 0.1)])
