"""How near to nothing an effect may be that is nothing only in a limit: what the runs refute.

The bootstrap of an interval draws steps of a linear fit. Where stops are struck the sum of squares
is no parabola, and such an interval may reach a limit that the runs have plainly refuted, such as a
seat that sticks for ever.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Comparison
from loose_env.gap.effect import Effect
from loose_env.gap.fit import Fit, hypothesis_of, slice_of
from loose_env.gap.intervals import Intervals
from loose_env.gap.judgement import sureness_of
from loose_env.gap.naming_settings import NamingSettings
from loose_env.gap.parameter import free_of, values_of

__all__ = ["short_of_limit"]

Array = NDArray[np.float64]

_SURE = NamingSettings.sureness
"""Lead over the limit itself from which on it is refuted [standard deviations over blocks]."""
_REFUTED = 2.0
"""Lead over a value from which on it lies outside a 95 % interval."""
_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9)
"""Values that are looked at: shares of the way to the limit, in free numbers."""


def short_of_limit(
    comparison: Comparison, fitted: Fit, intervals: Intervals, effect: Effect
) -> Intervals:
    """Take back the ends of an interval that lie beyond what the runs refute.

    Parameters
    ----------
    comparison : Comparison
        What was fitted to.
    fitted : Fit
        The fit.
    intervals : Intervals
        Of all its parameters.
    effect : Effect
        One of its effects; nothing is changed if it has no limit, or if that is not refuted.
    """
    if not effect.limit:
        return intervals
    own = slice_of(fitted.effects, effect)
    here = fitted.free[own]
    limit = free_of(effect.parameters, effect.at_limit(values_of(effect.parameters, here)))
    tried = []
    for share in (*_SHARES, 1.0):
        free = fitted.free.copy()
        free[own] = here + share * (limit - here)
        tried.append(free)
    residuals = comparison.residuals([hypothesis_of(fitted.effects, free) for free in tried])
    blocks = comparison.by_block(fitted.residual**2)
    leads = [sureness_of(comparison.by_block(r**2), blocks) for r in residuals]
    if not leads[-1] >= _SURE:
        return intervals
    first = next(k for k, lead in enumerate(leads) if lead >= _REFUTED)
    ends = values_of(effect.parameters, tried[first][own])
    low, high = intervals.low.copy(), intervals.high.copy()
    to_low = [dict(effect.limit).get(p.name) == "low" for p in effect.parameters]
    to_high = [dict(effect.limit).get(p.name) == "high" for p in effect.parameters]
    low[own] = np.where(to_low, np.maximum(low[own], ends), low[own])
    high[own] = np.where(to_high, np.minimum(high[own], ends), high[own])
    return replace(intervals, low=low, high=high)
