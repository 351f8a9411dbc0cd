"""Measured torques filtered as the motion, masked at reversals, with their noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.data.smoothing import SmoothedMotion, filled
from loose_env.statistics import noise_floor
from loose_env.typing import Array

_TURNING = 3.0
"""Speed below which the direction of motion is in doubt [standard deviations of its noise]."""
_MOVES = 10.0
"""Largest speed of a joint that counts as moving [standard deviations of its noise]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedTorques:
    """Measured torques of a run, as compared."""

    motion: SmoothedMotion
    measured: Array
    """Torques after the filter, NaN where they are not compared (T, C)."""
    floors: Array
    """Standard deviation of the residual (C,)."""
    torque: Array
    """Part of it due to the noise of the measured torque (C,)."""


def compared_torques(
    trial: Trial, motion: SmoothedMotion, torques: Mapping[int, int], propagated: Array
) -> ComparedTorques:
    """Filter the torques of a run, leave out what is in doubt, and find their noise."""
    measured = np.full(trial.measured.shape, np.nan)
    floors, own = np.full((2, trial.measured.shape[1]), np.nan)
    kept = motion.chosen
    edge = min(2.0 / motion.band.end, 0.1 * float(motion.time[-1]))
    inside = (motion.time[kept] >= edge) & (motion.time[kept] <= motion.time[-1] - edge)
    passed = _share_passed(motion)
    for channel, joint in torques.items():
        raw = trial.measured[:, channel]
        if not np.isfinite(raw).any():
            continue
        torque = filled(trial.time, raw, motion.time)
        good = inside & np.isfinite(raw[kept]) & _directed(motion, joint)[kept]
        measured[kept[good], channel] = motion.band.smooth(torque)[kept[good]]
        own[channel] = np.sqrt(passed) * noise_floor(torque)
        floors[channel] = np.hypot(own[channel], np.sqrt(propagated[joint]))
    return ComparedTorques(motion=motion, measured=measured, floors=floors, torque=own)


def _share_passed(motion: SmoothedMotion) -> float:
    """Share of white noise power that the filter passes."""
    impulse = np.zeros(min(len(motion.time), 4096))
    impulse[len(impulse) // 2] = 1.0
    return float(np.sum(motion.band.smooth(impulse) ** 2))


def _directed(motion: SmoothedMotion, joint: int) -> NDArray[np.bool_]:
    """Mask of known directions of a joint's motion (G,); all if it never moves."""
    speed, noise = np.abs(motion.speed[:, joint]), motion.noise[1, joint]
    if float(speed.max()) < _MOVES * noise:
        return np.ones(len(speed), dtype=bool)
    return np.asarray(speed > _TURNING * noise)
