"""Change of the tool's motion per command against the nominal arm, with its errors by source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.typing import Array, ComplexArray

__all__ = ["TransmissionChange", "sampling_covariance"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TransmissionChange:
    """Change of the tool's in-step motion per command, as far as the transmission makes it."""

    measured: Array
    """As measured [m/s²] (d m,)."""
    open: Array
    """As each seat would make it by floating [m/s²] (P, d m)."""
    nominal: Array
    """The motion itself in the nominal arm [m/s²] (d m,)."""
    covariance: Array | None = None
    """Covariance by model errors, to first order, and sampling as the record shows it [m²/s⁴]
    (d m, d m); None where only the errors by source were asked for."""
    arm_errors: Array | None = None
    """What errors of joint zeros and springs make of it, one standard deviation each: the same at
    every sensor and in every record of an arm [m/s²] (K, d m); None where none is known."""
    sensor_errors: Array | None = None
    """What errors of the sensor and its levers make of it: the same in every record (L, d m)."""


def sampling_covariance(rest: ComplexArray, noise: Array, samples: float) -> Array:
    """Covariance of the motion in step with Gaussian commands, as a record of finite length has it.

    Where the motion R of an axis per command varies over the band, so that its mean in step is
    zero, a record still shows some: with N samples

    ``cov(E_ij, E_kl) = mean over f of Re(δ_jl (R Rᴴ)_ik + R_il R_kj) / N``

    for axes i, k and commands j, l. On an arm that bends, these errors are far from even, and far
    from independent.

    Parameters
    ----------
    rest : ndarray (K, D, m)
        Motion of D axes per unit-rms command out of step with the joints, at K frequencies that
        are spread evenly over the band [m/s²].
    noise : ndarray (D, D)
        Covariance of the sensors' noise in the band [m²/s⁴].
    samples : float
        Independent samples in the record, N.

    Returns
    -------
    ndarray (D m, D m)
        Covariance [m²/s⁴].

    Examples
    --------
    >>> rest = np.array([[[2.0 + 0j]], [[-2.0 + 0j]]])  # one axis, one command, two frequencies
    >>> sampling_covariance(rest, np.zeros((1, 1)), 4.0).tolist()
    [[2.0]]
    """
    count, axes, commands = rest.shape
    power = np.einsum("fim,fkm->ik", rest, rest.conj()).real / count + noise
    crossed = np.einsum("fil,fkj->ijkl", rest, rest).real / count
    size = axes * commands
    covariance = np.kron(power, np.eye(commands)) + crossed.reshape(size, size)
    return np.asarray(covariance / samples)
