"""Collects what accelerometers show beyond a hypothesis."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.accelerations import ResidualAccelerations
from loose_env.gap.comparison import Comparison
from loose_env.gap.hypothesis import Hypothesis

__all__ = ["residual_accelerations"]

Array = NDArray[np.float64]

_SAMPLES = 2000
"""Samples of all runs that are taken, about."""


def residual_accelerations(
    comparison: Comparison, hypothesis: Hypothesis
) -> ResidualAccelerations | None:
    """Collect what accelerometers of three axes show beyond a hypothesis in simulated runs.

    Parameters
    ----------
    comparison : Comparison
        The runs.
    hypothesis : Hypothesis
        What is known so far.

    Returns
    -------
    ResidualAccelerations or None
        None where there is no such accelerometer.
    """
    model, channels = comparison.machine.model, comparison.channels
    triads = []
    for column in dict.fromkeys(channel.column for channel in channels):
        own = [k for k, channel in enumerate(channels) if channel.column == column]
        kind, _, name = column.partition(".")
        if kind == "sensor" and len(own) == 3:
            sensor = model.sensor(name)
            if int(sensor.type[0]) == int(mujoco.mjtSensor.mjSENS_ACCELEROMETER):
                triads.append((model.site(int(sensor.objid[0])).name, own))
    runs = [t for t, trial in enumerate(comparison.trials) if trial.form == "forward"]
    if not triads or not runs:
        return None
    predicted = comparison.predict([hypothesis])[0]
    poses, sites, found = [], [], []
    for t in runs:
        trial = comparison.trials[t]
        apart = trial.measured - predicted[t]
        at = np.tile(trial.position, (len(trial.time), 1))
        for j, joint in enumerate(trial.joints):
            at[:, j] = trial.motion.get(joint, at[:, j])
        for site, own in triads:
            good = np.flatnonzero(np.isfinite(apart[:, own]).all(axis=1))
            taken = good[:: max(1, len(good) * len(runs) * len(triads) // _SAMPLES)]
            poses.append(at[taken])
            found.append(apart[taken][:, own])
            sites += [site] * len(taken)
    if not sites:
        return None
    return ResidualAccelerations(
        joints=comparison.trials[runs[0]].joints,
        poses=np.concatenate(poses),
        sites=tuple(sites),
        accelerations=np.concatenate(found),
    )
