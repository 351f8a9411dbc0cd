"""Axes in space: grid, angles, and the search on the hemisphere."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.statistics import (
    axes_grid,
    tangents,
)


def test_the_grid_leaves_no_hole() -> None:
    rng = np.random.default_rng(0)
    anywhere = rng.standard_normal((500, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    for count in (40, 400):
        nearest = np.arccos(np.abs(anywhere @ axes_grid(count).T).max(axis=1).clip(max=1.0))
        assert nearest.max() < 1.1 * np.sqrt(2 * np.pi / count)


def test_tangents_are_across() -> None:
    for u in axes_grid(20):
        basis = tangents(u)
        np.testing.assert_allclose(basis @ basis.T, np.eye(2), atol=1e-12)
        np.testing.assert_allclose(basis @ u, 0.0, atol=1e-12)


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="count"):
        axes_grid(0)
    with pytest.raises(InvalidSetting, match="whole number"):
        axes_grid(2.5)  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match="dimension"):
        axes_grid(5, 4)
