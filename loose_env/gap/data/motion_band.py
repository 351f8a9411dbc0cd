"""Zero-phase low-pass filter (Band), and the frequency up to which a motion exceeds noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.signal import butter, sosfiltfilt, welch
from scipy.stats import chi2

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.statistics import noise_floor
from loose_env.typing import Array

ORDER = 4
"""Order of the low-pass filter, which acts twice."""
HIGHEST = 0.4
"""Highest end of a band, as a share of the sample rate: below half of it."""
_STANDS_OUT = 4.0
"""Power of a motion over that of the noise that makes it visible, in a long run."""
_BULK = 0.99
"""Share of the mean square speed that is the bulk of a motion."""
_CHANCE = 1e-3
"""Chance that noise stands out anywhere in a reading."""
_LOWEST = 2.0
"""Lowest end of a band [Hz]."""
_ROOM = 2.0
"""End of the band over the highest frequency of the motion: nearly all of that passes."""


@lru_cache(maxsize=256)
def low_pass(order: int, end: float, rate: float) -> Array:
    """Second-order sections of a Butterworth low-pass, shared by all hypotheses."""
    return np.asarray(butter(order, end, fs=rate, output="sos"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """Zero-phase low-pass filter on a uniform grid."""

    rate: float
    """Sample rate of the grid [1/s]."""
    end: float
    """Cut-off frequency, at which half of an amplitude passes [Hz]."""

    def smooth(self, values: Array) -> Array:
        """Filter values (T, ...) forwards and backwards."""
        low = low_pass(ORDER, self.end, self.rate)
        pad = min(len(values) - 1, int(2 * self.rate / self.end))
        return np.asarray(sosfiltfilt(low, values, axis=0, padlen=pad))


def motion_band(columns: Sequence[Array], rate: float) -> float:
    """Highest frequency at which any of some readings exceeds its noise [Hz].

    Examples
    --------
    >>> time = np.arange(4000) / 500
    >>> noisy = np.sin(2 * np.pi * 3 * time) + np.random.default_rng(1).normal(0, 0.01, 4000)
    >>> 2.9 < motion_band([noisy], 500.0) < 5.0
    True
    """
    return min(max((_ends(v, rate)[1] for v in columns), default=_LOWEST), HIGHEST * rate)


def _ends(values: Array, rate: float) -> tuple[float, float]:
    """Upper frequencies of most of a reading's motion, and of all above noise [Hz].

    Most of the motion is 99 % of the mean square speed above the noise.
    """
    floor = noise_floor(values)
    change = np.diff(values, 2)
    size = min(len(change), max(64, int(2 * rate)))
    frequency, power = welch(change, fs=rate, window="blackmanharris", nperseg=size, detrend=False)
    # Second differences amplify high frequencies, of signal and noise alike.
    raised = (2 - 2 * np.cos(2 * np.pi * frequency / rate)) ** 2
    segments = max(1, (len(change) - size // 2) // (size - size // 2))
    by_chance = chi2.isf(_CHANCE / len(frequency), 2 * segments) / (2 * segments)
    stands_out = max(_STANDS_OUT * (1 + 2 / np.sqrt(segments)), by_chance)
    visible = power > stands_out * raised * floor**2 * 2 / rate
    # One line alone may be interference: its neighbour has to exceed the noise too.
    sure = np.flatnonzero(visible[1:-1] & (visible[:-2] | visible[2:])) + 1
    if not len(sure):
        return _LOWEST, _LOWEST
    speeds = np.cumsum(power[sure] / np.sqrt(raised[sure]))
    bulk = sure[int(np.searchsorted(speeds, _BULK * speeds[-1]))]
    return max(_LOWEST, float(frequency[bulk])), max(_LOWEST, float(frequency[sure[-1]]))


def band_end(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    positions: dict[int, Array],
    speeds: dict[int, Array],
) -> float:
    """End of the band of a run [Hz].

    The end of the motion; or lower, where noise of the acceleration exceeds that of the torque, but
    not so low that it cuts most of the motion: the model is not linear in that.
    """
    rate = trial.rate
    ends = [_ends(values, rate) for values in positions.values()]
    bulk = max((low for low, _ in ends), default=_LOWEST)
    highest = motion_band([*positions.values(), *speeds.values()], rate)
    balanced = _balance(trial, machine, channels, positions, speeds)
    end = max(balanced, _ROOM * bulk) if balanced > 0 else np.inf
    return float(min(_ROOM * highest, end, HIGHEST * rate))


def _balance(
    trial: Trial,
    machine: NominalModel,
    channels: Sequence[Channel],
    positions: dict[int, Array],
    speeds: dict[int, Array],
) -> float:
    """Frequency where torque noise equals inertia times acceleration noise [Hz].

    Geometric mean over the joints whose torque was measured; 0 if there are none.
    """
    frequency = np.geomspace(_LOWEST, HIGHEST * trial.rate, 200)
    turn = 2 * np.pi * frequency
    found = []
    for k, channel in enumerate(channels):
        prefix, _, name = channel.column.partition(".")
        if prefix != "torque" or not np.isfinite(trial.measured[:, k]).any():
            continue
        joint = machine.joint_number(name)
        if joint not in positions:
            continue
        known = 1 / (turn**2 * noise_floor(positions[joint])) ** 2
        if joint in speeds:
            known = known + 1 / (turn * noise_floor(speeds[joint])) ** 2
        ratio = machine.inertias[joint] / np.sqrt(known) / noise_floor(trial.measured[:, k])
        found.append(frequency[min(int(np.searchsorted(ratio, 1.0)), len(frequency) - 1)])
    return float(np.exp(np.mean(np.log(found)))) if found else 0.0
