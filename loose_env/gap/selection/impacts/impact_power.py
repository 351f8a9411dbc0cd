"""Residual model that compares runs by the power of their impacts, in bands and stretches.

When a part slides between stops, two simulations that differ in the last digit of its friction soon
have impacts at different times, and sample by sample the residual of the correct model exceeds that
of no model. The reproducible quantity is the power, in two bands and in short stretches of time, of
the readings beyond a model without play. Over 0.05 s it is nearly independent of the time of an
impact, and it follows the motion that excites the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.residuals.residual_model import ResidualModel, Rows
from loose_env.gap.settings import (
    IMPACT_WINDOW_S,
)
from loose_env.typing import Array

_FEWEST = 8
"""Samples of a stretch, at least."""
_READ = 0.5
"""Share of its samples that have to have been read."""
_SMOOTHED = 8
"""Samples of the moving mean that parts the lower band from the upper."""
_CHANCE = 0.7
"""Standard deviation of the logarithm of the power of impacts in a stretch, by chance."""
_BLOCK = 0.1
"""Block length [s]; residuals may be autocorrelated within a block."""


class ImpactPower(ResidualModel):
    """Compares forward runs by the power of their residual to a model without play.

    A hypothesis here is the set of effects added to that model. The residuals are logarithms of
    powers, measured less simulated, in standard deviations of the sampling error: about one where
    the model is correct. With nothing added the residual is `measured`.
    """

    def __init__(self, comparison: ResidualModel, known: Hypothesis) -> None:
        self.known = known
        self._own = _sensors(comparison)
        super().__init__(
            comparison.machine,
            [trial for trial in comparison.trials if _long_enough(comparison, trial)],
            comparison.channels,
            comparison.floors,
            threads=comparison.threads,
        )

    @staticmethod
    def worth_while(comparison: ResidualModel) -> bool:
        """Return whether any run can be compared by impact power."""
        read = _sensors(comparison)
        return any(
            _long_enough(comparison, trial) and np.isfinite(trial.measured[:, read]).any()
            for trial in comparison.trials
        )

    @property
    def stretch(self) -> float:
        """Length of the longest stretches [s]."""
        return max(self._stretch(t) / trial.rate for t, trial in enumerate(self.trials))

    def predict(self, hypotheses: Sequence[Hypothesis]) -> list[list[Array]]:
        """Predict all runs with effects added to the model without play."""
        return super().predict([self._whole(hypothesis) for hypothesis in hypotheses])

    def _whole(self, hypothesis: Hypothesis) -> Hypothesis:
        return replace(
            self.known,
            effects=(*self.known.effects, *hypothesis.effects),
            values=(*self.known.values, *hypothesis.values),
        )

    def _rows(self) -> tuple[Rows, Array]:
        """Build the rows: one per stretch, band, channel and run."""
        self._without = super().predict([self.known])[0]
        self._compared_with = [self._compared(t) for t in range(len(self.trials))]
        measured = [self._powers(t, values) for t, values in enumerate(self._compared_with)]
        shape = [power.shape for power in measured]
        count = [int(np.prod(s)) for s in shape]
        run = np.repeat(np.arange(len(shape)), count)
        parts = [np.indices(s).reshape(3, -1) for s in shape]
        channel, _, stretch = np.concatenate(parts, axis=1)
        flat = np.concatenate([power.ravel() for power in measured])
        read = np.isfinite(flat)
        self._read = read
        band = np.concatenate([p[1] for p in parts])
        self._scale = np.sqrt(
            2.0 / self._freedom(run, band) + (_CHANCE * (1.0 - 1.0 / np.maximum(flat, 1.0))) ** 2
        )[read]
        size = np.array([self._stretch(t) for t in range(len(shape))], dtype=np.intp)
        rates = np.array([trial.rate for trial in self.trials])
        together = np.maximum(1, np.round(_BLOCK * rates / size)).astype(np.intp)
        longest = max((s[2] for s in shape), default=0) + 1
        rows = Rows(
            trial=run[read],
            channel=np.array(self._own, dtype=np.intp)[channel[read]],
            sample=(stretch * size[run])[read],
            index=stretch[read],
            block=(run * longest + stretch // together[run])[read],
            is_feature=np.ones(int(read.sum()), dtype=bool),
            random_excitation=np.zeros(int(read.sum()), dtype=bool),
            inverse=np.zeros(int(read.sum()), dtype=bool),
        )
        # an encoder at rest shows a constant value, with variation far below its noise
        return rows, np.log(np.maximum(flat[read], 1.0)) / self._scale

    def flatten(self, predicted: Sequence[Array]) -> Array:
        """Convert readings to log powers with noise added, in standard deviations (N,)."""
        found = [
            self._powers(t, np.where(np.isfinite(measured), values, np.nan))
            for t, (measured, values) in enumerate(zip(self._compared_with, predicted, strict=True))
        ]
        power = np.concatenate([each.ravel() for each in found])[self._read]
        return np.asarray(np.log(power + 1.0) / self._scale)

    def _stretch(self, number: int) -> int:
        """Number of samples in a stretch of a run."""
        return max(_FEWEST, round(IMPACT_WINDOW_S * self.trials[number].rate))

    def _freedom(self, run: NDArray[np.intp], band: NDArray[np.intp]) -> Array:
        """Degrees of freedom of each power."""
        samples = np.array([self._stretch(t) for t in range(len(self.trials))], dtype=float)[run]
        return np.asarray(samples * np.where(band == 0, 1 / _SMOOTHED, 1 - 1 / _SMOOTHED))

    def _powers(self, number: int, values: Array) -> Array:
        """Power of the residual to the model without play, over the noise power (K, 2, W).

        By channel, band and stretch; NaN where nothing was read.
        """
        size = self._stretch(number)
        beyond = (values - self._without[number])[:, self._own].T
        beyond = beyond / np.asarray(self.floors, dtype=float)[self._own, None]
        read = np.isfinite(beyond)
        beyond = np.where(read, beyond, 0.0)
        mean = np.ones(_SMOOTHED) / _SMOOTHED
        known = np.array([np.convolve(row, mean, mode="same") for row in read.astype(float)])
        low = np.array([np.convolve(row, mean, mode="same") for row in beyond])
        low = np.where(read, low / np.maximum(known, 1 / _SMOOTHED), 0.0)
        bands = np.stack([low * np.sqrt(_SMOOTHED), (beyond - low) / np.sqrt(1 - 1 / _SMOOTHED)], 1)
        count = beyond.shape[1] // size
        cut = (bands[:, :, : count * size] ** 2).reshape(len(beyond), 2, count, size).sum(axis=-1)
        samples = read[:, : count * size].reshape(len(beyond), 1, count, size).sum(axis=-1)
        return np.where(samples >= _READ * size, cut / np.maximum(samples, 1), np.nan)


def _sensors(comparison: ResidualModel) -> list[int]:
    """Indices of the channels that are sensors."""
    return [c for c, one in enumerate(comparison.channels) if one.column.startswith("sensor.")]


def _long_enough(comparison: ResidualModel, trial: Trial) -> bool:
    """Return whether a run is simulated with its commands, for two stretches or more."""
    fewest = 2 * max(_FEWEST, IMPACT_WINDOW_S * trial.rate)
    return comparison.follows(trial) and len(trial.time) >= fewest
