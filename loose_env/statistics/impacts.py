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
    x, v = np.zeros(len(load)), np.zeros(len(load))
    samples = np.ascontiguousarray(-load.T)
    out = np.zeros_like(samples)
    for k in range(2 * len(samples)):
        force = samples[k % len(samples)]
        held = ((x <= 0) & (force < friction)) | ((x >= gap) & (force > -friction))
        drag = friction * np.sign(np.where(v != 0, v, force))
        v = np.where(held, 0.0, v + (force - drag) / mass * step)
        x = x + v * step
        arrived = ~held & ((x <= 0) | (x >= gap))
        if k >= len(samples):
            out[k - len(samples)] = np.where(arrived, v * v, 0.0)
        v[arrived] = 0.0
        np.clip(x, 0.0, gap, out=x)
    found: Array = out.T
    return found


def rung(energy: Array, decay_s: float, period: float) -> Array:
    """Energy (H, GRID) that rings down after each knock, around the period."""
    keep = np.exp(-period / energy.shape[-1] / decay_s)
    twice = lfilter([1.0], [1.0, -keep], np.concatenate([energy, energy], -1), axis=-1)
    found: Array = twice[..., energy.shape[-1] :]
    return found
