"""How much the direction by rms depends on the pair of accelerometers that measures it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.statistics.signals import rms_motion
from loose_env.statistics.spectra import bandpass
from loose_env.thesis.slide_records import slide_records

__all__ = ["shares_within"]


def shares_within(
    seed: int,
    pairs: int,
    *,
    band: tuple[float, float],
    angles: tuple[float, float],
    percent: float,
) -> NDArray[np.float64]:
    """Share of the cube's angles that come out right by rms (6.8), for several pairs.

    The motion is the same for all; gains, cross-axis sensitivities, protractor and tape
    are drawn for each. Pair 0 is that of `slide_records` by default.

    Parameters
    ----------
    seed : int
        Seed of the records.
    pairs : int
        Number of pairs.
    band : tuple of float
        Band of the rms [Hz].
    angles : tuple of float
        Lowest and highest angle of the cube that count [deg].
    percent : float
        Error allowed, in percent of the angle.

    Returns
    -------
    ndarray (pairs,)
        Shares [%].

    Raises
    ------
    InvalidSetting
        If there is no pair, or no angle in the range.

    Examples
    --------
    >>> shares_within(0, 0, band=(2.0, 200.0), angles=(10.0, 80.0), percent=2.0)
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidSetting: shares need one pair or more, got 0
    """
    if pairs < 1:
        raise InvalidSetting(f"shares need one pair or more, got {pairs!r}")
    found = []
    for pair in range(pairs):
        records = slide_records(seed, pair=pair)
        x, y = (
            bandpass(s - s.mean(axis=-1, keepdims=True), records.rate, band)
            for s in (records.x, records.y)
        )
        alpha = np.degrees(records.alpha)
        inside = (alpha >= angles[0]) & (alpha <= angles[1])
        if not inside.any():
            raise InvalidSetting(f"no angle of the cube lies in {angles} deg; it takes 0 to 90")
        off = np.abs(np.degrees(rms_motion(x, y).direction) - alpha)[inside]
        found.append(100 * np.mean(off <= percent / 100 * alpha[inside]))
    return np.array(found)
