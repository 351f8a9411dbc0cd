"""Features of random-excitation runs: means, response to the command, incoherent power; whitened.

After an impact two simulations diverge within milliseconds, so an impact-dominated run is compared
by reproducible statistics: means, the linear response to the command (gain and phase in bands), and
power, covariance and higher cumulants of the incoherent part. Measurement and simulation are driven
by the same command, so the linear response differs by noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.random_excitation.frequency_response import CommandResponse
from loose_env.gap.residuals.random_excitation.frf_features import ResponseFeatures
from loose_env.gap.residuals.random_excitation.incoherent_features import IncoherentFeatures
from loose_env.typing import Array

_BLOCK = 0.2
"""Length of the blocks from which the features' correlation is estimated [s]."""


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """Settings of the features."""

    bands: int = 2
    """Bands of gain and phase, of channels that clearly respond."""
    clear: float = 8.0
    """Response of a channel that clearly responds [standard deviations]."""
    floor_error: float = 0.04
    """Standard deviation of a noise floor, as a share of it."""
    chaos: float = 1.0
    """Share of the incoherent part, less the noise, that a right simulation draws anew: 1 where
    impacts are chaotic, 0 where it repeats all of it. Measured by `RandomFeatures.chaotic_share`.
    """

    def __post_init__(self) -> None:
        """Check the values."""
        if self.bands < 1 or self.clear <= 0 or self.floor_error < 0 or not 0 <= self.chaos <= 1:
            raise InvalidSetting(
                "bands must be at least 1, clear above 0, floor_error at least 0 and chaos "
                f"between 0 and 1; got {self}"
            )


class RandomFeatures:
    """Features of a run with random excitation.

    They are the same for every hypothesis: templates, bands and units come from the measured run. A
    template of the linear response in one half of the run is made from the other half, so that a
    channel's noise does not bias its own gain.

    Examples
    --------
    >>> rng = np.random.default_rng(3)
    >>> command = rng.normal(size=(4000, 1))
    >>> response = np.convolve(command[:, 0], 0.8 ** np.arange(30))[:4000, None]
    >>> read = response + rng.normal(size=response.shape)
    >>> features = RandomFeatures(read, rate=1000.0, commands=command, floors=np.array([1.0]))
    >>> apart = (features.measured - features.of(response)) / features.scales
    >>> bool(np.max(np.abs(apart)) < 4)
    True
    >>> apart = (features.measured - features.of(1.1 * response)) / features.scales
    >>> features.names[int(np.argmax(np.abs(apart)))].startswith("gain")
    True
    """

    def __init__(
        self,
        values: Array,
        *,
        rate: float,
        commands: Array,
        floors: Array,
        channels: Sequence[Channel] | None = None,
        settings: FeatureSettings | None = None,
    ) -> None:
        values, floors = np.asarray(values, dtype=float), np.asarray(floors, dtype=float)
        self.settings = settings or FeatureSettings()
        if values.ndim != 2 or floors.shape != values.shape[1:] or len(commands) != len(values):
            raise InvalidData(
                f"values {values.shape}, floors {floors.shape} and commands {np.shape(commands)} "
                "do not fit; they must be (T, C), (C,) and (T, m)"
            )
        if channels is None:
            channels = [Channel(f"channel{c}") for c in range(values.shape[1])]
        varies = np.nanmax(values, axis=0, initial=-np.inf) > np.nanmin(
            values, axis=0, initial=np.inf
        )  # a braked joint's encoder may stay on one of its steps
        read = varies & (np.isfinite(values).mean(axis=0) >= 0.5)
        self.used = np.flatnonzero(read & np.isfinite(floors) & (floors > 0))
        if not len(self.used):
            raise InvalidData(
                "no channel varies and was read in half of the samples; nothing can be compared"
            )
        self._missing = ~np.isfinite(values[:, self.used])
        self._channels = [channels[int(c)] for c in self.used]
        self._floors = floors[self.used]
        self.response = CommandResponse(np.asarray(commands, dtype=float), rate)
        own, chosen = self._own(values), self.settings
        rest = self.response.incoherent(own)
        self._linear = ResponseFeatures(
            own, [channel.name for channel in self._channels], self._floors, self.response, rest,
            bands=chosen.bands, clear=chosen.clear, chaos=chosen.chaos,
        )  # fmt: skip
        self._rest_density = rest.density
        self._rest = IncoherentFeatures(
            rest, self._channels, self._floors, self.response,
            floor_error=chosen.floor_error, chaos=chosen.chaos,
        )  # fmt: skip
        self.names = (*self._linear.names, *self._rest.names)
        """What each feature is (K,)."""
        self.measured = np.concatenate([self._linear.of(own), self._rest.measured])
        """Features of the measured run (K,)."""
        self.scales = np.sqrt(np.concatenate([self._linear.variances, self._rest.variances]))
        """Standard deviation of measured less simulated features of a right model (K,)."""

    @classmethod
    def of_trial(
        cls,
        trial: Trial,
        machine: NominalModel,
        channels: Sequence[Channel],
        floors: Array,
    ) -> RandomFeatures:
        """Features of a measured run whose recording lists excited joints."""
        driven = [
            k
            for k, name in enumerate(machine.actuators)
            if machine.actuated_joint.get(name) in trial.excited
        ]
        if not driven:
            raise InvalidData(
                f"run {trial.name} excites {list(trial.excited)}, but no actuator of the model "
                "drives such a joint"
            )
        at = np.minimum((trial.time / trial.step + 1e-6).astype(int), trial.steps - 1)
        return cls(
            trial.measured,
            rate=trial.rate,
            commands=trial.controls[at][:, driven],
            floors=floors,
            channels=channels,
        )

    @cached_property
    def about(self) -> NDArray[np.bool_]:
        """Mask of the `used` channels that each feature depends on (K, U)."""
        found = np.zeros((len(self.names), len(self.used)), dtype=bool)
        for k, own in enumerate([*self._linear.about, *self._rest.about]):
            found[k, list(own)] = True
        return found

    def of(self, values: Array, *, noisy: bool = False) -> Array:
        """Compute the features of readings (T, C) -> (K,)."""
        own = np.asarray(values, dtype=float)[:, self.used]
        if self._missing.any():
            own = self._own(values)
        if not np.isfinite(own).all():
            return np.full(len(self.names), np.nan)
        rest = self._rest.of(self.response.incoherent(own), noisy=noisy)
        return np.concatenate([self._linear.of(own), rest])

    def differences(self, values: Array) -> Array:
        """Measured less simulated features, over the deviation of a correct model (K,)."""
        return np.asarray((self.measured - self.of(values)) / self.scales)

    def incoherence(self, values: Array) -> float:
        """Incoherent power of the measured run, over that of simulated readings (T, C).

        The noise is in both. Of the channel where the ratio is largest.
        """
        simulated = self.response.incoherent(self._own(values)).density.mean(axis=0)
        measured = self._rest_density.mean(axis=0)
        return float(np.max(measured / (simulated + self._floors**2)))

    def chaotic_share(self, first: Array, second: Array) -> float:
        """Share of the incoherent part that is chaotic, from two simulations of a model."""
        one, two = (self.response.incoherent(self._own(values)) for values in (first, second))
        apart = np.mean(np.abs(one.spectra - two.spectra) ** 2, axis=(0, 1))
        both = one.density.mean(axis=0) + two.density.mean(axis=0)
        loud = both > 2 * self._floors**2
        share = apart[loud] / np.maximum(both[loud], 1e-300)
        return float(np.clip(share.max(initial=0.0), 0.0, 1.0))

    def whitened(self, differences: Array) -> Array:
        """Whitened differences, in standard deviations (..., K)."""
        return np.asarray(differences @ self._whitener)

    def _own(self, values: Array) -> Array:
        """Used channels (T, C), with gaps of the measured run interpolated linearly."""
        own = np.array(np.asarray(values, dtype=float)[:, self.used])
        at = np.arange(len(own))
        for c in np.flatnonzero(self._missing.any(axis=0)):
            good = ~self._missing[:, c]
            own[:, c] = np.interp(at, at[good], own[good, c])
        return own

    @cached_property
    def correlation(self) -> Array:
        """Correlation of the features' differences (K, K), shrunk towards the identity.

        From sums over blocks; the shrinkage is Ledoit and Wolf's, Journal of Multivariate Analysis
        88 (2004).
        """
        parts = np.concatenate([self._linear.influences(), self._rest.influences()], axis=1)
        size = max(1, round(_BLOCK * self.response.rate))
        blocks = len(parts) // size
        sums = parts[: blocks * size].reshape(blocks, size, -1).sum(axis=1)
        sums = sums - sums.mean(axis=0)
        sums /= np.maximum(np.sqrt(np.mean(sums**2, axis=0)), 1e-300)
        found = sums.T @ sums / blocks
        apart = float(np.sum((found - np.eye(len(found))) ** 2))
        scatter = float(np.sum((sums**2).sum(axis=1) ** 2) / blocks - np.sum(found**2)) / blocks
        kept = 1.0 - min(1.0, max(0.0, scatter / max(apart, 1e-300)))
        return np.asarray(kept * found + (1 - kept) * np.eye(len(found)))

    @cached_property
    def _whitener(self) -> Array:
        values, vectors = np.linalg.eigh(self.correlation)
        return np.asarray(vectors / np.sqrt(np.maximum(values, 1e-6)) @ vectors.T)


GROUP = 4
"""Numbers in a block."""


@dataclass(frozen=True, eq=False)
class RandomRun:
    """One run of random excitation, as independent numbers of unit variance.

    The whitened differences of all features are multiplied by a fixed random rotation, so that an
    error in any hypothesis, in however few features, shows in every block of them.
    """

    features: RandomFeatures

    @classmethod
    def of_trial(
        cls, trial: Trial, machine: NominalModel, channels: Sequence[Channel], floors: Array
    ) -> RandomRun:
        """Features of a measured run."""
        return cls(RandomFeatures.of_trial(trial, machine, channels, floors))

    def __len__(self) -> int:
        """Number of features."""
        return len(self.features.names)

    @property
    def channel(self) -> NDArray[np.intp]:
        """Channel index for each of the numbers: the channels in turn (K,)."""
        return self.features.used[np.arange(len(self)) % len(self.features.used)]

    @cached_property
    def rotation(self) -> Array:
        """Orthogonal matrix, the same for every run with as many features (K, K)."""
        normal = np.random.default_rng(len(self)).standard_normal((len(self), len(self)))
        return np.asarray(np.linalg.qr(normal)[0])

    def residual(self, predicted: Array) -> Array:
        """Measured less predicted (T, C) -> (K,), over the deviation of a correct model."""
        return np.asarray(
            self.features.whitened(self.features.differences(predicted)) @ self.rotation
        )
