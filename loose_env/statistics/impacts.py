"""A mass between two stops: when it arrives under a load, and how that rings down."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from loose_env.typing import Array


def knocks(load: Array, mass: Array, gap: Array, friction: Array, period: float) -> Array:
    """Squared speed of each arrival of a mass between two stops, in the second of two periods.

    Parameters
    ----------
    load : ndarray
        Load that the stops carry (H, GRID) [N, N·m].
    mass, gap, friction : ndarray
        Of each hypothesis (H,) [kg, m, N; kg·m², rad, N·m].

    Examples
    --------
    >>> swing = 10 * np.sin(2 * np.pi * 3 * np.arange(1000) / 1000)[None]
    >>> one = np.ones(1)
    >>> int((knocks(swing, one, 1e-4 * one, 0.1 * one, 1.0) > 0).sum())
    6
    """
    step = period / load.shape[1]
    force = np.ascontiguousarray(-load.T)
    slips = 1e-200 * force  # at rest, it slips the way it is pushed
    rests, hangs = force < friction, force > -friction  # what holds it at 0, and at the gap
    x, v = np.zeros(len(load)), np.zeros(len(load))
    low, high = x <= 0, x >= gap
    arrived = np.zeros_like(force)
    for k in [*range(len(force))] * 2:
        drag = np.copysign(friction, v + slips[k])
        v += (force[k] - drag) / mass * step
        np.putmask(v, low & rests[k] | high & hangs[k], 0.0)
        x += v * step
        low, high = x <= 0, x >= gap
        v -= np.multiply(v, low | high, out=arrived[k])
        np.minimum(np.maximum(x, 0.0, out=x), gap, out=x)
    found: Array = arrived.T**2
    return found


def rung(energy: Array, decay_s: float, period: float) -> Array:
    """Energy (H, GRID) that rings down after each knock, around the period."""
    keep = np.exp(-period / energy.shape[-1] / decay_s)
    twice = lfilter([1.0], [1.0, -keep], np.concatenate([energy, energy], -1), axis=-1)
    found: Array = twice[..., energy.shape[-1] :]
    return found
