"""Regressors of a residual (position, speed, load ...): bins, and the share each explains."""

from __future__ import annotations

import numpy as np

from loose_env.gap.output.evidence_schema import Dependence
from loose_env.typing import Array, IndexArray

REGRESSORS = ("position", "velocity", "direction", "acceleration", "load")
"""What residuals are held against."""


_BINS = 12
"""Bins of as many samples each; a regressor of fewer levels has a bin for each level."""


_STILL = 0.05
"""Share of the large speeds (95th percentile) below which a joint counts as standing."""


def direction_of(speed: Array) -> Array:
    """Direction of motion (T,): -1, 0 at rest, 1; NaN where the speed is NaN.

    Examples
    --------
    >>> direction_of(np.array([-2.0, 0.01, 2.0]))
    array([-1.,  0.,  1.])
    """
    good = np.isfinite(speed)
    if not good.any():
        return np.full_like(speed, np.nan)
    least = _STILL * float(np.percentile(np.abs(speed[good]), 95))
    return np.where(good, np.where(np.abs(speed) <= least, 0.0, np.sign(speed)), np.nan)


def binned(regressor: Array, *, bins: int = _BINS) -> tuple[IndexArray, Array]:
    """Bin a regressor into bins of about equal sample count.

    Returns
    -------
    labels : ndarray (N,)
        Bin of each sample.
    centres : ndarray (K,)
        Median of the regressor in each bin.

    Examples
    --------
    >>> labels, centres = binned(np.array([1.0, -1.0, 1.0, -1.0]))
    >>> labels, centres
    (array([1, 0, 1, 0]), array([-1.,  1.]))
    """
    ordered = np.sort(regressor)
    new = np.flatnonzero(np.diff(ordered) > 0) + 1
    if len(new) < bins:
        levels = ordered[np.concatenate([[0], new])]
        return np.searchsorted(levels, regressor).astype(np.intp), levels
    first = np.arange(1, bins) * len(ordered) // bins
    edges = ordered[first]
    edges = edges[np.concatenate([[True], np.diff(edges) > 0]) & (edges > ordered[0])]
    labels = np.searchsorted(edges, regressor, side="right").astype(np.intp)
    ends = np.concatenate([[0], np.searchsorted(ordered, edges), [len(ordered)]])
    return labels, ordered[(ends[:-1] + ends[1:]) // 2]


def dependence(
    residual: Array, regressor: Array, block: IndexArray, *, on: str = "", of: str = ""
) -> Dependence | None:
    """Measure the share of a residual that is a function of a regressor.

    The residual's mean in every bin of the regressor predicts it. Each block of time is predicted
    from the others, so that the expected share is zero without a dependence.

    Examples
    --------
    >>> rng = np.random.default_rng(2)
    >>> speed = np.sin(np.arange(3000) / 50)
    >>> friction = np.sign(speed) + rng.normal(0, 1, 3000)
    >>> found = dependence(friction, direction_of(speed), np.arange(3000) // 300)
    >>> bool(0.4 < found.share < 0.55), bool(found.z > 5)
    (True, True)
    """
    good = np.isfinite(residual) & np.isfinite(regressor)
    r, x = residual[good], regressor[good]
    if len(r) < 30:
        return None
    _, blocks = np.unique(block[good], return_inverse=True)
    labels, centres = binned(x)
    count, size = int(blocks.max()) + 1, len(centres)
    if count < 3 or size < 2:
        return None
    r = r - r.mean()
    power = float(r @ r)
    cell = blocks * size + labels
    sums = np.bincount(cell, r, minlength=count * size).reshape(count, size)
    counts = np.bincount(cell, minlength=count * size).reshape(count, size)
    others = counts.sum(axis=0) - counts
    mean = np.where(others > 0, (sums.sum(axis=0) - sums) / np.maximum(others, 1), 0.0)
    gains = np.sum(2 * sums * mean - counts * mean**2, axis=1)
    gained = float(gains.sum())
    share = float(np.clip(gained / power, 0.0, 1.0)) if power > 0 else 0.0
    scatter = float(np.sqrt(np.sum((gains - gains.mean()) ** 2)))
    return Dependence(
        regressor=on,
        joint=of,
        share=share,
        explained=float(np.sqrt(share * power / len(r))),
        z=gained / max(scatter, 1e-30 + 1e-12 * power),
    )
