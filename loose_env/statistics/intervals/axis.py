"""Bootstrap confidence interval of an axis from one record.

An axis found from covariances errs, near the truth, by the mean of one series, its influence:
what each sample adds to the error. The memory of that series gives the standard deviation of the
axis and the length of bootstrap blocks. What a gap leaves in the motion varies in strength, and
the influence carries that too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.statistics._checks import require_rate
from loose_env.statistics.directions.angles import axial_difference, wrap_axial
from loose_env.statistics.sampling.autocorrelation import memory_of
from loose_env.statistics.sampling.block_bootstrap import resampled_covariances
from loose_env.typing import Array

METHODS = ("block", "hac")


@dataclass(frozen=True, slots=True)
class DirectionInterval:
    """Confidence interval of an axis in the plane; angles in rad from the tool's x axis."""

    direction: float
    """Estimate, in [0, pi)."""
    lower: float
    """Lower end, at most `direction`; it may lie below 0."""
    upper: float
    """Upper end, at least `direction`; it may lie above pi."""
    sd: float
    """Standard deviation of the estimate."""
    level: float
    """Confidence level."""

    def contains(self, angle: float) -> bool:
        """Return whether an axis lies in the interval."""
        turn = axial_difference(angle, self.direction)
        low, high = self.lower - self.direction, self.upper - self.direction
        # At +90 degrees from the estimate the same axis also lies at -90.
        return low <= turn <= high or low <= turn + math.pi <= high


@dataclass(frozen=True, slots=True)
class Resampling:
    """Resampling settings; the fields are those of `direction_interval`."""

    rate: float
    level: float
    rng: np.random.Generator | None
    method: str
    resamples: int
    block: float | None

    def __post_init__(self) -> None:
        """Check every setting."""
        require_rate(self.rate)
        if self.method not in METHODS:
            raise UnknownName(f"method is {self.method!r}; it must be one of {METHODS}")
        if not 0.0 < self.level < 1.0:
            raise InvalidSetting(f"level is {self.level}; it must lie above 0 and below 1")
        if self.resamples < 2:
            raise InvalidSetting(f"resamples is {self.resamples}; it must be at least 2")
        if self.method == "block" and self.rng is None:
            raise InvalidSetting('rng is None; the method "block" draws from a Generator')


def interval(
    first: Array,
    second: Array,
    influence: Array,
    axis: Callable[[Array], Array],
    how: Resampling,
) -> DirectionInterval:
    """Compute the confidence interval of an axis that is a function of cov(first, second).

    Parameters
    ----------
    first : array, shape (k, N)
        Signals, means removed.
    second : array, shape (l, N)
        Signals sampled with them, means removed.
    influence : array, shape (N,)
        What each sample adds to the error of the axis, rad; its mean is the error.
    axis : callable
        Angles, shape (R,), of the axes belonging to covariances of shape (R, k, l).
    how : Resampling
        Method and its settings.

    Returns
    -------
    DirectionInterval
        Interval about the estimate.
    """
    count = first.shape[1]
    if how.block is not None and not 1.0 <= how.block * how.rate <= count:
        raise InvalidSetting(
            f"block is {how.block} s; it must hold 1 to {count} samples at {how.rate} Hz"
        )
    covariance = np.einsum("in,jn->ij", first, second) / count
    estimate = float(axis(covariance[None])[0])
    memory = memory_of(influence, None if how.block is None else how.block * how.rate)
    tail = 0.5 + 0.5 * how.level
    student = float(stdtrit(memory.degrees, tail))
    if how.rng is None or how.method == "hac":
        sd = math.sqrt(memory.variance / count)
        below = above = student * sd
    else:
        length = round(memory.block)
        drawn = resampled_covariances(first, second, length, how.resamples, how.rng)
        # Blocks cut the memory between them; widen what they give by what they miss.
        spread = covariance + (drawn - covariance) / math.sqrt(memory.reach)
        turns = axial_difference(axis(spread), estimate)
        sd = math.sqrt(float(np.mean(turns**2)))
        low, high = np.quantile(turns, (1.0 - tail, tail)) * (student / float(ndtri(tail)))
        below, above = max(-float(low), 0.0), max(float(high), 0.0)
    direction = wrap_axial(estimate)
    return DirectionInterval(
        direction=direction,
        lower=direction - min(below, math.pi / 2),
        upper=direction + min(above, math.pi / 2),
        sd=sd,
        level=how.level,
    )
