"""Delay between two signals of one motion, from the phases of their cross-spectrum.

Where y(t) = s x(t - d), the cross-spectrum of x and y has the phase -2 pi f d, turned by pi for s
below zero. d maximises |sum w cos(phase + 2 pi f d)|, the generalised cross-correlation (Knapp and
Carter, IEEE Trans. Acoust. Speech Signal Process. 24, 1976) of lines whose weights w are the
inverse variances of their phases.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loose_env.typing import Array, ComplexArray

__all__ = ["PhaseDelay", "phase_delay"]

_PER_PERIOD = 24
"""Delays tried per period of the highest line."""
_REFINEMENTS = 3


class PhaseDelay(NamedTuple):
    """Delay of one signal behind another."""

    seconds: float
    """Positive where it is late [s]."""
    sd: float
    """Standard deviation by the scatter of the phases, as if lines were independent [s]."""
    sign: int
    """-1 where one is the negative of the other."""
    fit: float
    """Mean resultant length of the phases without the delay: 1 where they are the delay's alone."""
    rival: float
    """Fit of the best other delay over this one's; 0 where there is no other peak."""


def phase_delay(
    frequency: Array, cross: ComplexArray, weight: Array, *, largest: float, either_sign: bool
) -> PhaseDelay | None:
    """Delay by the phases of a cross-spectrum.

    Parameters
    ----------
    frequency : ndarray of shape (K,)
        Frequencies of the lines [Hz].
    cross : ndarray of shape (K,)
        Cross-spectrum conj(X) Y; only its phase counts.
    weight : ndarray of shape (K,)
        Weight of each line, not negative.
    largest : float
        Largest delay searched, either way [s].
    either_sign : bool
        True if one signal may be the negative of the other.

    Returns
    -------
    PhaseDelay or None
        None where no line has a weight, or the fit rises up to the largest delay.

    Examples
    --------
    >>> frequency = np.linspace(5.0, 100.0, 60)
    >>> late = -np.exp(-2j * np.pi * frequency * 0.0042)
    >>> found = phase_delay(frequency, late, np.ones(60), largest=0.05, either_sign=True)
    >>> round(found.seconds, 6), found.sign, round(found.fit, 6)
    (0.0042, -1, 1.0)
    """
    size = np.abs(cross)
    used = (size > 0) & (weight > 0)
    if not used.any():
        return None
    at, turn = frequency[used], cross[used] / size[used]
    share = weight[used] / weight[used].sum()
    step = 1 / (_PER_PERIOD * float(at.max()))
    tried = np.linspace(-largest, largest, 2 * int(np.ceil(largest / step)) + 1)
    fits = (np.exp(2j * np.pi * np.outer(tried, at)) @ (share * turn)).real
    heights = np.abs(fits) if either_sign else fits
    best = int(np.argmax(heights))
    if best in (0, len(tried) - 1) or not heights[best] > 0:
        return None
    sign = 1 if fits[best] > 0 else -1
    seconds = float(tried[best])
    for _ in range(_REFINEMENTS):  # Newton: outlying phases count by their sine alone
        left = np.angle(sign * turn * np.exp(2j * np.pi * at * seconds))
        bend = 2 * np.pi * float(share @ (at**2 * np.cos(left)))
        if not bend > 0:
            break
        move = -float(share @ (at * np.sin(left))) / bend
        seconds += float(np.clip(move, -step, step))
    left = np.angle(sign * turn * np.exp(2j * np.pi * at * seconds))
    normal = float(share @ at**2)
    lines = 1 / float(np.sum(share**2))
    sd = float(np.sqrt(share @ left**2)) / (2 * np.pi * np.sqrt(normal * lines))
    return PhaseDelay(
        seconds, sd, sign, float(share @ np.cos(left)), _rival(heights, best) / float(heights[best])
    )


def _rival(heights: Array, best: int) -> float:
    """Height of the highest point beyond the peak's own slopes."""
    left = right = best
    while left > 0 and heights[left - 1] < heights[left]:
        left -= 1
    while right < len(heights) - 1 and heights[right + 1] < heights[right]:
        right += 1
    return float(max(heights[:left].max(initial=0.0), heights[right + 1 :].max(initial=0.0)))
