"""Self-starting CUSUM and Shewhart charts of one series, and limits for a false-alarm rate.

Mean and scatter of a healthy machine are not known beforehand; they are estimated from the earlier
sessions. The standardised difference of a value from the m before it is Student's t with m - 1
degrees of freedom, and its normal score is standard normal, independently of those before
(Quesenberry 1991, "SPC Q charts for start-up processes"). A CUSUM of these scores finds slow
changes (Hawkins 1987, "Self-starting CUSUM charts"), a limit on the single score sudden ones (Lucas
1982, "Combined Shewhart-CUSUM quality control schemes").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from loose_env.errors import InvalidSetting
from loose_env.typing import Array

_OVERSHOOT = 1.166
"""Mean excess of a random walk over a limit, by which Siegmund's formula widens it [standard
deviations]."""
_HIGHEST_SCORE = 8.0
"""Largest normal score: the tail of Student's t beyond is below the precision of its values."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of one control chart."""

    cusum: float
    """Limit of the cumulative sum [standard deviations]."""
    single: float
    """Limit of a single score [standard deviations]."""
    allowance: float
    """Part of every score that the cumulative sum leaves out [standard deviations]."""
    two_sided: bool
    """True if a decrease counts as a change too."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """Control chart of one series over n sessions."""

    scores: Array
    """Normal score of each value (n,); NaN where the baseline is too short."""
    statistic: Array
    """Larger of cumulative sum and single score, each over its limit (n,); above 1 is an alarm."""
    change: Array
    """Value less the mean of its baseline (n,)."""
    scatter: Array
    """Standard deviation expected of ``change`` on a healthy machine (n,)."""
    alarm: int | None
    """Index of the first alarm since the last restart; None where there is none."""
    alarms: tuple[int, ...]
    """Indices of the first alarm between each two restarts."""


def normal_score(value: float, baseline: Array, *, least_scatter: float) -> tuple[float, float]:
    """Standard normal score of a value against earlier values of the same process.

    Examples
    --------
    >>> score, scatter = normal_score(3.0, np.array([0.0, 1.0, 2.0]), least_scatter=0.1)
    >>> round(score, 3), round(scatter, 3)  # t = 2 / 1.155, with two degrees of freedom
    (1.212, 1.155)
    """
    m = len(baseline)
    scatter = max(float(baseline.std(ddof=1)), least_scatter) * np.sqrt(1 + 1 / m)
    t = (value - float(baseline.mean())) / scatter
    score = min(-float(special.ndtri(special.stdtr(m - 1, -abs(t)))), _HIGHEST_SCORE)
    return float(np.copysign(score, t)), float(scatter)


def limits_for(rate: float, *, allowance: float, two_sided: bool) -> Limits:
    """Limits that a healthy machine exceeds at a given rate.

    Half of the rate goes to the cumulative sum, half to the single score. The limit of the sum is
    that of Siegmund's formula for the average run length, ARL = (exp(2 k b) - 2 k b - 1) / (2 k²)
    with b = h + 1.166, k the allowance and h the limit.

    Examples
    --------
    >>> found = limits_for(0.01, allowance=0.5, two_sided=True)
    >>> round(found.cusum, 2), round(found.single, 2)
    (4.16, 2.81)
    """
    if not 0 < rate <= 0.5:
        raise InvalidSetting(f"a false-alarm rate is above 0 and at most 0.5, got {rate!r}")
    if not allowance > 0:
        raise InvalidSetting(f"the allowance is above 0 standard deviations, got {allowance!r}")
    sides = 2 if two_sided else 1
    wanted = 2 * sides / rate

    def excess(limit: float) -> float:
        b = 2 * allowance * (limit + _OVERSHOOT)
        return float(np.log((np.expm1(b) - b) / (2 * allowance**2)) - np.log(wanted))

    highest = (np.log(wanted * 2 * allowance**2 + 1) + 10) / (2 * allowance) + 10
    cusum = 0.0 if excess(0.0) > 0 else float(optimize.brentq(excess, 0.0, highest))
    single = -float(special.ndtri(rate / (2 * sides)))
    return Limits(cusum=cusum, single=single, allowance=allowance, two_sided=two_sided)


def control_chart(
    values: Array,
    limits: Limits,
    *,
    least_scatter: float,
    least_baseline: int = 2,
    restarts: tuple[int, ...] = (),
) -> Chart:
    """Chart of a series whose mean and scatter are estimated on the way.

    Examples
    --------
    >>> limits = limits_for(0.01, allowance=0.5, two_sided=True)
    >>> level = np.array([0.0, 0.1, -0.1, 0.05, -0.05, 0.08, 2.0, 2.1])
    >>> control_chart(level, limits, least_scatter=0.01).alarm
    6
    >>> control_chart(level, limits, least_scatter=0.01, restarts=(6,)).alarm is None
    True
    """
    n = len(values)
    scores, statistic, change, scatter = (np.full(n, np.nan) for _ in range(4))
    baseline: list[float] = []
    up = down = 0.0
    alarm: int | None = None
    alarms: list[int] = []
    for k, value in enumerate(values):
        if k in restarts:
            baseline, up, down, alarm = [], 0.0, 0.0, None
        if not np.isfinite(value):
            continue
        if len(baseline) >= least_baseline:
            known = np.array(baseline)
            score, scatter[k] = normal_score(float(value), known, least_scatter=least_scatter)
            scores[k], change[k] = score, value - known.mean()
            up = max(0.0, up + score - limits.allowance)
            down = max(0.0, down - score - limits.allowance)
            summed, single = (
                (max(up, down), abs(score)) if limits.two_sided else (up, max(score, 0.0))
            )
            statistic[k] = max(summed / max(limits.cusum, 1e-12), single / limits.single)
            if statistic[k] > 1 and alarm is None:
                alarm = k
                alarms.append(k)
        if alarm is None:
            baseline.append(float(value))
    return Chart(
        scores=scores,
        statistic=statistic,
        change=change,
        scatter=scatter,
        alarm=alarm,
        alarms=tuple(alarms),
    )
