"""What rings above the shaking's lines: bands, and what repeats in them from period to period."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, sosfiltfilt

from loose_env.typing import Array, ComplexArray

GRID = 1000
"""Samples of a period on which loads and ringing are compared."""
TOP_BAND = (0.6, 0.9)
"""The highest band, as shares of the highest frequency that the sensor passes [1]."""
_BANDS = 3
"""Bands: the highest and octaves below it, above the signal's own harmonics. A knock is heard in
all of them, a mode of a link or a servo's steps in one."""
_CLEAR_OF_LINES = 2.0
"""Frequency over the highest line from which a band counts [1]."""
_SMOOTH_S = 0.004
"""Time over which energy is smoothed [s]: a seat's knock rings about as long."""
_SMOOTH_HZ = 8.0
"""Frequency to either side over which the spectrum is smoothed [Hz]: wider than a link's mode,
which 1 to 3 % of damping make 2 to 6 Hz wide at 100 Hz."""
_HEARD = 0.2
"""Share of the energy that counts as repeating at least [1]: what repeats less is friction and gear
mesh that differ from day to day by more than a decibel."""
_STRIKES = 2.0
"""Mean energy over that of the median period from which single strikes make it [1]."""
REPEATS = 0.60
"""Correlation of the energy between periods from which the shaking causes it [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ringing:
    """Acceleration of the tool above the signal's lines over P periods, at F samples each."""

    waves: Array
    """Sensor frame (P, F, 3) [m/s²]."""
    period_s: float
    bands_hz: tuple[tuple[float, float], ...]
    """Lowest and highest frequency of each band, the highest band first [Hz]."""
    spectrum: Array
    """Power of each line of a period, smoothed, sensor frame (F // 2 + 1, 3) [m²/s⁴]."""

    def repeating(self, band: int, *, spectrum: Array | None = None) -> Array:
        """Energy that repeats in a band over a period (GRID,): products of unlike periods.

        What a gear's roughness, a cable or a hand does has no part in it beside its scatter, which
        is of either sign.

        Parameters
        ----------
        spectrum : ndarray, optional
            By which every frequency is divided first: modes of the links, in which all that happens
            rings on, hide when it happened.
        """
        h = self._banded(band, spectrum)
        pairs = len(h) * (len(h) - 1)
        energy = (h.sum(0) ** 2 - (h**2).sum(0)).sum(-1) / pairs
        n = max(1, round(_SMOOTH_S / self.period_s * len(energy)))
        around = np.concatenate([energy[-n:], energy, energy[:n]])
        smooth = np.convolve(around, np.ones(n) / n, "same")[n:-n]
        found: Array = smooth[:: len(energy) // GRID]
        return found

    @property
    def levels(self) -> Array:
        """Energy that repeats in each band, as far as it can be told from noise (B,) [m²/s⁴]."""
        total = [(self._banded(b, None) ** 2).sum(-1).mean() for b in range(len(self.bands_hz))]
        own = [self.repeating(b).mean() for b in range(len(self.bands_hz))]
        return np.maximum(own, _HEARD * np.array(total))

    @property
    def covariance(self) -> Array:
        """Covariance of what repeats in the highest band, sensor frame (3, 3) [m²/s⁴]."""
        h = self._banded(0, None)
        whole = h.sum(0)
        pairs = len(h) * (len(h) - 1) * h.shape[1]
        found: Array = (whole.T @ whole - np.einsum("pia,pib->ab", h, h)) / pairs
        return found

    def struck(self) -> tuple[float, bool]:
        """Correlation of the highest band's energy between periods, and if strikes make it."""
        energy = (self._banded(0, None) ** 2).sum(-1)
        each = energy.reshape(len(energy), GRID // 10, -1).mean(-1)
        alike = np.corrcoef(np.sqrt(each))[np.triu_indices(len(each), 1)]
        repeats = float(np.median(alike))
        strikes = float(each.mean()) > _STRIKES * float(np.median(each, 0).mean())
        return repeats, repeats < REPEATS and strikes

    @cached_property
    def _lines(self) -> ComplexArray:
        return np.asarray(np.fft.rfft(self.waves, axis=1))

    def _banded(self, band: int, spectrum: Array | None) -> Array:
        low, high = self.bands_hz[band]
        hertz = np.arange(self.waves.shape[1] // 2 + 1) / self.period_s
        share = ((hertz >= low) & (hertz <= high)).astype(float)
        if spectrum is not None:
            power = spectrum.sum(-1)
            share /= np.sqrt(np.maximum(power, 1e-9 * power.max()))
        lines = self._lines * share[None, :, None]
        found: Array = np.fft.irfft(lines, self.waves.shape[1], axis=1)
        return found


def ringing(
    t: Array,
    tool: Array,
    first: float,
    periods: int,
    period_s: float,
    *,
    top: float,
    highest: float,
) -> Ringing:
    """Take the ringing from an accelerometer's samples.

    Parameters
    ----------
    first : float
        Time of the first whole period [s].
    top, highest : float
        Highest frequency that the sensor passes, and highest line of the signal [Hz].
    """
    rate = float(1 / np.median(np.diff(t)))
    bands = [(TOP_BAND[0] * top, min(TOP_BAND[1] * top, 0.45 * rate))]
    while len(bands) < _BANDS and bands[-1][0] / 2 >= _CLEAR_OF_LINES * highest:
        bands.append((bands[-1][0] / 2, bands[-1][0]))
    sos = butter(4, min(_CLEAR_OF_LINES * highest, bands[-1][0]), "highpass", fs=rate, output="sos")
    h = sosfiltfilt(sos, tool - tool.mean(0), axis=0)
    samples = GRID * max(1, int(np.ceil(4 * bands[0][1] * period_s / GRID)))
    at = first + (np.arange(periods)[:, None] + np.arange(samples) / samples) * period_s
    waves = CubicSpline(t, h)(at)
    power = (np.abs(np.fft.rfft(waves, axis=1) / samples) ** 2).mean(0)
    wide = 2 * max(1, round(_SMOOTH_HZ * period_s)) + 1
    return Ringing(
        waves=waves,
        period_s=period_s,
        bands_hz=tuple(bands),
        spectrum=uniform_filter1d(power, wide, axis=0, mode="nearest"),
    )


def amplitude(energy: Array) -> Array:
    """Amplitude of an energy, with its sign: noise is of either."""
    found: Array = np.sign(energy) * np.sqrt(np.abs(energy))
    return found
