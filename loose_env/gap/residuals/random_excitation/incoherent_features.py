"""Power, covariance and cumulants of the incoherent part of readings, as features of a run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Channel
from loose_env.gap.residuals.random_excitation.frequency_response import CommandResponse, Incoherent
from loose_env.statistics import long_run_variance
from loose_env.typing import Array

_POWER = 0.99
"""Share of the command's power that lies in its band."""
_ROOM = 1.2
"""Upper end of the band, as a multiple of where that share is reached."""
_ABOVE = 4.0
"""Upper end of what is looked at above the band, as a multiple of the band's."""
_LINEAR = 2.0
"""Cumulants up to about this count as they are, larger ones by their logarithm."""


class IncoherentFeatures:
    """Features of the incoherent part of the readings.

    Logarithms of its variance in the command's band and above it, with the noise floor in both
    measurement and simulation; covariances of the axes of one sensor; third and fourth cumulants,
    which are zero for Gaussian noise. Units come from the measured run. Cumulants and the power
    above the band are computed for vector sensors, and for all channels if there are none.
    """

    def __init__(
        self,
        rest: Incoherent,
        channels: Sequence[Channel],
        floors: Array,
        response: CommandResponse,
        *,
        floor_error: float,
        chaos: float,
    ) -> None:
        self._rest, self._channels, self._noise = rest, channels, floors**2
        self._response, self._floor_error, self._chaos = response, floor_error, chaos
        self._variance = np.maximum(_level(rest, self._whole), 1e-300)
        self.measured = self.of(rest, noisy=True)
        """Features of the measured run (R,)."""
        self.variances, self._series_of = self._spread()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features (R,)."""
        own = [channel.name for channel in self._channels]
        return (
            *(f"rest in band of {name}" for name in own),
            *(f"rest above band of {own[c]}" for c in self._shaped),
            *(f"covariance of {own[a]} and {own[b]}" for a, b in self._pairs),
            *(f"skewness of {own[c]}" for c in self._shaped),
            *(f"kurtosis of {own[c]}" for c in self._shaped),
        )

    @property
    def about(self) -> list[tuple[int, ...]]:
        """Indices of the channels of each feature, in the order of `names`."""
        shaped = [(c,) for c in self._shaped]
        return [
            *((c,) for c in range(len(self._channels))),
            *shaped,
            *self._pairs,
            *shaped,
            *shaped,
        ]

    def of(self, rest: Incoherent, *, noisy: bool) -> Array:
        """Compute the features (R,); the noise floor is added to noise-free input."""
        noise = np.zeros_like(self._noise) if noisy else self._noise
        inside = np.maximum(_level(rest, self._inside) + noise, 1e-300)
        above = np.maximum(_level(rest, self._above) + noise, 1e-300)[self._shaped]
        pairs = np.zeros(0)
        if self._pairs:
            a, b = np.array(self._pairs).T
            inner = rest.spectra[self._inside]
            pairs = np.mean((inner[..., a] * inner[..., b].conj()).real, axis=(0, 1))
            pairs /= np.sqrt(self._variance[a] * self._variance[b])
        shaped = self._in_units(rest, self._whole)
        square = shaped * shaped
        third = np.einsum("ts,ts->s", square, shaped) / len(square)
        fourth = np.einsum("ts,ts->s", square, square) / len(square)
        fourth = fourth - 3 * square.mean(axis=0) ** 2
        cumulants = np.concatenate([pairs, third, fourth])
        return np.concatenate([np.log(inside), np.log(above), np.arcsinh(cumulants / _LINEAR)])

    def influences(self) -> Array:
        """Contribution of each measured incoherent sample to each feature (T, R)."""
        return np.stack(self._series_of, axis=1)

    @cached_property
    def _edge(self) -> float:
        """Upper end of the command's band [Hz]."""
        commands, rate = self._response.centred, self._response.rate
        power = np.abs(np.fft.rfft(commands, axis=0)) ** 2
        share = np.cumsum((power / power.sum(axis=0)).mean(axis=1))
        return _ROOM * float(np.searchsorted(share, _POWER)) * rate / len(commands)

    @cached_property
    def _inside(self) -> NDArray[np.bool_]:
        pieces = self._response.frequencies
        return np.asarray(pieces <= max(self._edge, float(pieces[0])))

    @cached_property
    def _above(self) -> NDArray[np.bool_]:
        found = ~self._inside & (self._response.frequencies <= _ABOVE * self._edge)
        return np.asarray(found if found.any() else self._inside)

    @cached_property
    def _whole(self) -> NDArray[np.bool_]:
        return np.asarray(self._inside | self._above)

    @cached_property
    def _shaped(self) -> list[int]:
        """Indices of the channels with cumulant features."""
        vectors = [c for c, channel in enumerate(self._channels) if channel.axis is not None]
        return vectors or list(range(len(self._channels)))

    @cached_property
    def _pairs(self) -> list[tuple[int, int]]:
        """Pairs of channels that are axes of one sensor."""
        column = [channel.column for channel in self._channels]
        own = self._shaped
        return [(a, b) for a in own for b in own if a < b and column[a] == column[b]]

    @cached_property
    def _even(self) -> slice:
        """Mask of samples outside the taper."""
        full = np.flatnonzero(self._response.window == 1)
        return slice(int(full[0]), int(full[-1]) + 1)

    def _in_units(self, rest: Incoherent, kept: NDArray[np.bool_]) -> Array:
        """Band-filtered channels, standardised, outside the taper (t, S)."""
        own = Incoherent(rest.spectra[:, :, self._shaped], rest.pieces, rest.samples)
        share = 2 * float(np.mean(kept)) * rest.pieces.size / rest.samples
        faded = float(np.mean(self._response.window**2))  # the spectra are scaled by the taper
        scale = np.sqrt(faded / (self._variance[self._shaped] * share))
        return np.asarray(own.series(kept)[self._even] * scale)

    def _spread(self) -> tuple[Array, list[Array]]:
        """Variances of the feature differences (R,), and influences of the samples."""
        rest, variances, series = self._rest, [], []
        count = rest.samples
        fade = self._response.window**2 / np.mean(self._response.window**2)
        every = list(range(len(self._channels)))
        for kept, members in ((self._inside, every), (self._above, self._shaped)):
            level, squares = _level(rest, kept), rest.series(kept) ** 2
            for c in members:
                # The taper does not correlate the series.
                influence = squares[:, c] / squares[:, c].mean() - fade
                floor = 2 * self._floor_error * self._noise[c] / level[c]
                again = self._random(self._excess(level[c], c) ** 2)
                variances.append(_of_mean(influence) * again + floor**2)
                series.append(influence / count)
        shaped, banded = self._in_units(rest, self._whole), self._in_units(rest, self._inside)
        shares = [self._excess(self._variance[c], c) for c in self._shaped]
        at = {c: k for k, c in enumerate(self._shaped)}
        parts = [
            *((banded[:, at[a]] * banded[:, at[b]], shares[at[a]] * shares[at[b]])
              for a, b in self._pairs),
            *((z**3 - 3 * z, shares[k] ** 3) for k, z in enumerate(shaped.T)),
            *((z**4 - 6 * z**2, shares[k] ** 4) for k, z in enumerate(shaped.T)),
        ]  # fmt: skip
        slopes = 1.0 / (_LINEAR * np.cosh(self.measured[-len(parts) :]))
        for (influence, share), slope in zip(parts, slopes, strict=True):
            variances.append(_of_mean(influence) * self._random(share) * slope**2)
            whole = np.zeros(count)
            whole[self._even] = (influence - influence.mean()) * slope / len(influence)
            series.append(whole)
        return np.array(variances), series

    def _excess(self, level: float, channel: int) -> float:
        """Share of a variance above the noise."""
        return max(0.0, 1.0 - float(self._noise[channel]) / max(float(level), 1e-300))

    def _random(self, share: float) -> float:
        """Variance of a difference, as a multiple of that of the measured feature.

        Part of the measured feature is free of noise; measurement and simulation draw that part
        independently, or share it.
        """
        return 1.0 + (2.0 * self._chaos - 1.0) * share


def _level(rest: Incoherent, kept: NDArray[np.bool_]) -> Array:
    """Mean density in a band (C,)."""
    return np.asarray(rest.density[kept].mean(axis=0))


def _of_mean(series: Array) -> float:
    """Variance of the mean of an autocorrelated series."""
    return long_run_variance(series - series.mean()) / len(series)
