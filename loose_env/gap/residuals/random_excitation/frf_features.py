"""Means, and gain and phase of the response to a random command, as features of each channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft

from loose_env.gap.residuals.random_excitation.frequency_response import CommandResponse, Incoherent
from loose_env.statistics import resolution_of
from loose_env.typing import Array

_EDGE = 0.05
"""Share of the run that the weights fade in, and fade out."""
_SMOOTHED = 5
"""Pieces of the spectrum over which a density is averaged."""


@dataclass(frozen=True, eq=False)
class _Weighted:
    """Linear feature: a weighted sum over one channel."""

    name: str
    channel: int
    weights: Array
    """Weights (T,)."""
    rounding: float
    """Standard deviation due to the quantisation of the channel."""


class ResponseFeatures:
    """Features that are linear in the readings: means, gains and phases.

    Gain and phase of a channel are its products with a template, and with the template shifted by a
    quarter period, in bands that each hold the same share of the template's power over the noise.
    The template is the measured response, smoothed; each half of it is estimated from the other
    half of the run, so that a channel's noise does not bias its own gain. Channels without a clear
    response have the template of the channel with the clearest response, in one band.
    """

    def __init__(
        self,
        values: Array,
        names: Sequence[str],
        floors: Array,
        response: CommandResponse,
        rest: Incoherent,
        *,
        bands: int,
        clear: float,
        chaos: float,
    ) -> None:
        self._floors, self._response, self._rest = floors, response, rest
        self._channels, self._chaos = names, chaos
        self._steps = np.array([resolution_of(column) for column in values.T])
        self._share = _unsmeared(values, self._steps)
        self._features = [*self._means(), *self._gains(values, bands, clear)]
        self.names = tuple(feature.name for feature in self._features)
        self.variances = np.array(
            [self._variance(f.weights, f.channel) + f.rounding**2 for f in self._features]
        )
        """Of measured less simulated features of a right model (L,)."""
        self._grouped = [
            (c, members, np.stack([self._features[k].weights for k in members]))
            for c in range(values.shape[1])
            if (members := [k for k, f in enumerate(self._features) if f.channel == c])
        ]

    def of(self, values: Array) -> Array:
        """Compute the features of readings (T, C) -> (L,)."""
        found, rows = np.empty(len(self._features)), np.ascontiguousarray(values.T)
        for channel, members, weights in self._grouped:
            found[members] = weights @ rows[channel]
        return found

    @property
    def about(self) -> list[tuple[int, ...]]:
        """Indices of the channels of each feature."""
        return [(feature.channel,) for feature in self._features]

    def influences(self) -> Array:
        """Contribution of each sample of the incoherent part to each feature (T, L)."""
        loose = self._rest.series(np.ones(len(self._rest.density), dtype=bool))
        return np.stack([f.weights * loose[:, f.channel] for f in self._features], axis=1)

    @cached_property
    def _window(self) -> Array:
        count = len(self._response.commands)
        size = max(2, round(_EDGE * count))
        window = np.ones(count)
        window[:size] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(size) + 0.5) / size)
        window[-size:] = window[:size][::-1]
        return window

    def _means(self) -> list[_Weighted]:
        weights = self._window / self._window.sum()
        # An undithered reading has an error of up to (step / pi) times the share, at any value.
        off = self._share * self._steps / np.pi / np.sqrt(2)
        return [
            _Weighted(f"mean of {name}", c, weights, float(off[c]))
            for c, name in enumerate(self._channels)
        ]

    def _gains(self, values: Array, bands: int, clear: float) -> list[_Weighted]:
        found, window = [], self._window
        smooth = self._response.smooth(values)
        for i in range(smooth.shape[2]):
            clearness = self._clearness(values, smooth[:, :, i])
            leader = smooth[:, int(np.argmax(clearness)), i]
            if clearness.max() < clear:
                leader = self._response.centred[:, i]
            for c, name in enumerate(self._channels):
                responds = clearness[c] >= clear
                template = smooth[:, c, i] if responds else leader
                for b, waves in enumerate(self._split(template, c, bands if responds else 1)):
                    square = float(np.sum(waves[0] ** 2 * window))
                    for word, wave in zip(("gain", "phase"), waves, strict=True):
                        weights = (wave - wave @ window / window.sum()) * window / square
                        off = np.sqrt(2) * self._share[c] if responds else 0.0
                        label = f"{word} {b} of {name} to command {i}"
                        found.append(_Weighted(label, c, weights, float(off)))
        return found

    def _clearness(self, values: Array, smooth: Array) -> Array:
        """Significance (z) of each channel's correlation with its template (C,)."""
        found = np.zeros(values.shape[1])
        for c in range(len(found)):
            wave = smooth[:, c] - smooth[:, c].mean()
            spread = np.sqrt(self._variance(wave, c))
            if spread > 0:
                found[c] = float(wave @ values[:, c]) / spread
        return found

    def _split(self, template: Array, channel: int, bands: int) -> list[tuple[Array, Array]]:
        """Bands of a template, each with its quadrature component."""
        count = len(template)
        spectrum = fft.rfft(template - template.mean())
        share = np.cumsum(np.abs(spectrum) ** 2 / self._density(channel))
        part = np.minimum((share / share[-1] * bands).astype(int), bands - 1)
        banded = [np.where(part == b, spectrum, 0.0) for b in range(bands)]
        return [(fft.irfft(own, count), fft.irfft(-1j * own, count)) for own in banded]

    def _variance(self, weights: Array, channel: int) -> float:
        """Variance of a weighted sum over the random part of a channel's difference."""
        power = np.abs(fft.rfft(weights)) ** 2 * self._density(channel)
        twice = 2 * power.sum() - power[0] - (power[-1] if len(weights) % 2 == 0 else 0.0)
        return float(twice / len(weights))

    def _density(self, channel: int) -> Array:
        """Density of the random part of a channel's difference (T // 2 + 1,).

        At all frequencies. Noise is in the measurement alone, the chaotic part is independent in
        both, and the part that the simulation reproduces is in neither.
        """
        noise = float(self._floors[channel]) ** 2
        near = np.pad(self._rest.density[:, channel], _SMOOTHED // 2, mode="edge")
        density = np.convolve(near, np.full(_SMOOTHED, 1 / _SMOOTHED), mode="valid")
        density = density + (2 * self._chaos - 1) * np.maximum(density - noise, 0.0)
        response = self._response
        count = len(response.commands)
        frequencies = np.arange(count // 2 + 1) * response.rate / count
        level = np.maximum(density, 0.5 * noise)
        return np.asarray(np.interp(frequencies, response.frequencies, level))


def _unsmeared(values: Array, steps: Array) -> Array:
    """Share of a quantisation error not dithered by motion and noise (C,).

    Widrow and Kollar, Quantization Noise (2008), chapter 6.
    """
    variance = np.maximum(values.var(axis=0) - steps**2 / 12, 0.0)
    wide = np.where(steps > 0, steps, 1.0)
    return np.where(steps > 0, np.exp(-2 * np.pi**2 * variance / wide**2), 0.0)
