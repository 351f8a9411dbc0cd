"""A mass between two stops: when it arrives under a load, and how that rings down."""

from __future__ import annotations

import numpy as np

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
    step, share = period / load.shape[1], period / load.shape[1] / mass
    x, v = np.zeros(len(load)), np.zeros(len(load))
    low, high = np.ones(len(load), bool), np.zeros(len(load), bool)
    samples = np.ascontiguousarray(-load.T)
    at_low, at_high = samples < friction, samples > -friction
    out = np.zeros_like(samples)
    for k in range(2 * len(samples)):
        now = k % len(samples)
        # most are held at a stop most of the time
        free = np.flatnonzero(~(low & at_low[now] | high & at_high[now]))
        force, speed, most = samples[now, free], v[free], gap[free]
        drag = np.copysign(friction[free], np.where(speed != 0, speed, force))
        speed = speed + (force - drag) * share[free]
        way = x[free] + speed * step
        low[free], high[free] = below, beyond = way <= 0, way >= most
        stopped = below | beyond
        if k >= len(samples):
            out[now, free] = np.where(stopped, speed * speed, 0.0)
        v[free] = np.where(stopped, 0.0, speed)
        x[free] = np.minimum(np.maximum(way, 0.0), most)
    found: Array = out.T
    return found


def rung(energy: Array, decay_s: float, period: float) -> Array:
    """Energy (H, GRID) that rings down after each knock, around the period."""
    keep = np.exp(-period / energy.shape[-1] / decay_s)
    found = np.array(np.moveaxis(energy, -1, 0), order="C")  # time first: a step is one row
    last = np.zeros(energy.shape[:-1])
    for each in found:
        last = keep * last + each
    last = last / (1 - keep ** len(found))  # of all periods before
    for each in found:
        each += keep * last
        last = each
    return np.moveaxis(found, 0, -1)
