"""The torque that a rigid arm needs for a motion, against the torque that was measured."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import signal

from loose_env.typing import Array
from scripts.suites.gap.cases.sensing import Signals
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.build import Factors, build
from scripts.suites.gap.simulator.dynamics import forward, mass_and_bias
from scripts.suites.gap.simulator.laws import DAMPING
from scripts.suites.gap.simulator.simulate import SAMPLE

BAND = 20.0
"""Band in which torques are compared [Hz]."""
THINNED = round(0.5 / BAND / SAMPLE)
"""One sample in this many is independent of the others in the band."""


@njit(cache=True)
def _needed(bodies, damping, gravity, q, v, a):  # type: ignore[no-untyped-def]
    samples, n = q.shape
    out = np.zeros((samples, n))
    work = np.zeros((n, 40))
    mass, bias = np.zeros((n, n)), np.zeros(n)
    for i in range(samples):
        forward(bodies, q[i], v[i], gravity, work)
        mass_and_bias(bodies, work, mass, bias)
        for j in range(n):
            out[i, j] = bias[j] + damping[j] * v[i, j]
            for k in range(n):
                out[i, j] += mass[j, k] * a[i, k]
    return out


def _smooth(values: Array) -> Array:
    low = signal.butter(4, BAND, fs=1 / SAMPLE, output="sos")
    return signal.sosfiltfilt(low, values, axis=0)  # type: ignore[no-any-return]


def torque_residual(signals: Signals, figures: Figures, factors: Factors) -> Array:
    """Measured torque less the torque that the rigid arm needs, in a low band.

    Parameters
    ----------
    signals : Signals
        Readings.
    figures, factors : Figures, Factors
        The rigid arm.

    Returns
    -------
    Array
        Independent samples, of shape (K, n) [N m or N].
    """
    system = build(figures, factors)
    q, v = _smooth(signals.position), _smooth(signals.velocity)
    a = np.gradient(v, SAMPLE, axis=0)
    needed = _needed(system.bodies, system.laws[:, DAMPING].copy(), system.gravity, q, v, a)
    residual = _smooth(signals.torque) - needed
    edge = 2 * THINNED
    return residual[edge:-edge:THINNED]  # type: ignore[no-any-return]
