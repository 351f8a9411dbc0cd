"""The size of a signal: its mean removed, and its rms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["centred", "rms"]

Array = NDArray[np.float64]


def centred(signal: Array) -> Array:
    """Remove the mean along the last axis, time; the shape stays.

    Examples
    --------
    >>> centred(np.array([1.0, 3.0]))
    array([-1.,  1.])
    """
    return np.asarray(signal - signal.mean(axis=-1, keepdims=True))


def rms(signal: Array) -> float:
    """Root mean square of all values, in the unit of the signal.

    Examples
    --------
    >>> rms(np.array([3.0, -3.0]))
    3.0
    """
    return float(np.sqrt(np.mean(signal**2)))
