"""Rank of a transmission change: zero, one or more directions."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtrc, fdtrc

from loose_env.errors import InvalidSetting
from loose_env.statistics.tool_transmission.axis_misfit import Misfit, lowest_axis
from loose_env.statistics.tool_transmission.estimate import TransmissionEstimate
from loose_env.typing import Array

_DRAWS = 10000


@dataclass(frozen=True, slots=True)
class ChangeRank:
    """Rank of a transmission change with its test results."""

    rank: int
    """0: no change; 1: one direction; 2 or more: several."""
    p_values: tuple[float, ...]
    """Chance of so large a misfit if the rank were 0, 1, ..., for each rank that is tested."""
    misfits: tuple[float, ...]
    """Squared misfit of the best change of rank 0, 1, ..."""
    significance: float
    """A rank is refused below this chance."""


def change_rank(change: TransmissionEstimate, significance: float = 0.01) -> ChangeRank:
    """Test the rank of a transmission change.

    Ranks are tried from zero up; the first that the change's errors can explain is the answer. No
    change is tested against one direction, by what that direction explains; one against several, by
    the misfit of the best matrix of rank one: chi-square with (d - 1)(m - 1) degrees of freedom,
    or F where the errors' covariance is itself an estimate; and so on.

    Parameters
    ----------
    change : TransmissionEstimate
        As in `change_direction`.
    significance : float
        Chance below which a rank is refused, above 0 and below 1.

    Returns
    -------
    ChangeRank
        The rank, and every test on the way to min(d, m).

    Raises
    ------
    InvalidData
        If the change or its covariance cannot be used.
    InvalidSetting
        If the significance is out of range.

    References
    ----------
    Cragg and Donald, J. Econometrics 76 (1997), minimum distance of a matrix to one of lower rank.

    Examples
    --------
    >>> small = 1e-4 * np.eye(9).reshape(3, 3, 3, 3)
    >>> turned = np.outer([0.0, 0.6, 0.8], [0.3, -0.2, 0.5])
    >>> [change_rank(TransmissionEstimate(b, small)).rank for b in (0 * turned, turned, np.eye(3))]
    [0, 1, 3]
    """
    if not 0.0 < significance < 1.0:
        raise InvalidSetting(f"significance is {significance}; it must lie above 0 and below 1")
    misfit = Misfit(change)
    d, m = change.b.shape
    most = min(d, m)
    likely = misfit.likely()
    one = max(lowest_axis(misfit.at, likely)[1], 0.0)
    p_values = [_chance_of_evidence(misfit.total - one, d, m, change.degrees)]
    misfits = [misfit.total]
    if most > 1:
        misfits.append(one)
    if most > 2:
        misfits.append(max(lowest_axis(misfit.without, likely)[1], 0.0))
    for r in range(1, most):
        p_values.append(_chance(misfits[r], (d - r) * (m - r), change.degrees))
    rank = next((r for r, p in enumerate(p_values) if p >= significance), most)
    return ChangeRank(rank, tuple(p_values), tuple(misfits), significance)


def _chance(misfit: float, constraints: int, degrees: float) -> float:
    """p-value of a misfit: chi-square, or F if the covariance is estimated."""
    if not math.isfinite(degrees):
        return float(chdtrc(constraints, misfit))
    return float(fdtrc(constraints, max(degrees, 1.0), misfit / constraints))


@lru_cache(maxsize=64)
def _evidence_of_errors(d: int, m: int) -> Array:
    """Null distribution of the evidence for one direction (K,)."""
    z = np.random.default_rng(0).standard_normal((_DRAWS, d, m))
    return np.asarray(np.linalg.svd(z, compute_uv=False)[:, 0] ** 2)


def _chance_of_evidence(evidence: float, d: int, m: int, degrees: float) -> float:
    """p-value of the evidence for one direction under errors alone.

    A sharper test against one direction than asking whether all entries together are too large.
    Never below that of the draws it rests on.
    """
    made = _evidence_of_errors(d, m)
    if math.isfinite(degrees):
        freedom = max(degrees, 1.0)
        made = made * freedom / np.random.default_rng(1).chisquare(freedom, len(made))
    return float((1 + np.sum(made >= evidence)) / (1 + len(made)))
