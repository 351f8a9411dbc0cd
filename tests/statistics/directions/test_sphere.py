"""Axes in space: grid, angles, and the search on the hemisphere."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics import (
    axes_grid,
    axial_angle_between,
    covariances,
    hemisphere_search,
    lowest_coherence_direction,
    tangents,
)


def test_the_grid_leaves_no_hole() -> None:
    rng = np.random.default_rng(0)
    anywhere = rng.standard_normal((500, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    for count in (40, 400):
        nearest = np.arccos(np.abs(anywhere @ axes_grid(count).T).max(axis=1).clip(max=1.0))
        assert nearest.max() < 1.1 * np.sqrt(2 * np.pi / count)


def test_the_angle_between_axes_has_no_sign_and_no_rounding() -> None:
    u = np.array([0.3, -0.5, 0.8])
    assert axial_angle_between(u, -2 * u) < 1e-12
    assert axial_angle_between([1.0, 0.0, 0.0], [1.0, 1e-9, 0.0]) == pytest.approx(1e-9, rel=1e-6)
    with pytest.raises(InvalidData):
        axial_angle_between(u, [1.0, 0.0])


def test_tangents_are_across() -> None:
    for u in axes_grid(20):
        basis = tangents(u)
        np.testing.assert_allclose(basis @ basis.T, np.eye(2), atol=1e-12)
        np.testing.assert_allclose(basis @ u, 0.0, atol=1e-12)


def test_the_search_finds_what_the_closed_form_gives() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        x = rng.standard_normal((4, 600))
        a = rng.standard_normal((3, 4)) @ x + rng.standard_normal((3, 3)) @ rng.standard_normal(
            (3, 600)
        )
        cov = covariances(x, a)
        explained = cov.xa.T @ np.linalg.solve(cov.xx, cov.xa)

        def coherence(
            u: np.ndarray, explained: np.ndarray = explained, aa: np.ndarray = cov.aa
        ) -> np.ndarray:
            return np.asarray(
                np.einsum("ki,ij,kj->k", u, explained, u) / np.einsum("ki,ij,kj->k", u, aa, u)
            )

        found = hemisphere_search(coherence)
        closed = lowest_coherence_direction(x, a)
        assert found.value == pytest.approx(closed.coherence, abs=1e-4)
        assert np.degrees(axial_angle_between(found.direction, closed.direction)) < 0.5
        assert found.evaluations > 150  # the price of searching


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="count"):
        axes_grid(0)
    with pytest.raises(InvalidSetting, match="whole number"):
        axes_grid(2.5)  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match="dimension"):
        axes_grid(5, 4)
    with pytest.raises(InvalidSetting, match="tolerance"):
        hemisphere_search(lambda u: u[:, 0], spacing=0.1, tolerance=0.2)
