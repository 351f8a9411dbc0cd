"""Band-limited Gaussian excitation of the joints.

Signals are synthesised in the frequency domain: every Fourier line of the record inside the
band gets an independent complex Gaussian amplitude (a Gaussian process, periodic in the
record length). The run-in before the record is the end of the same period, so the linear
answer is periodic too and nothing leaks out of the band.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from loose_env.errors import InvalidSetting

__all__ = ["CREST_FACTOR", "Excitation", "Shaping", "compensation", "torque_signals"]

Array = NDArray[np.float64]
Shaping = Callable[[Array], Array]
"""Relative amplitude of the excitation at given frequencies [Hz]."""

CREST_FACTOR = 3.0
"""Peak over rms that the drive has to deliver; rarer peaks are clipped at the limit."""


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """Random torque for one record. Joints with zero rms are held."""

    torque_rms: tuple[float, ...]
    """Rms torque of each joint, base first [N·m]; 0 holds the joint."""
    duration: float
    """Length of the record [s]."""
    band: tuple[float, float]
    """Band of the excitation [Hz]."""
    shaping: tuple[Shaping | None, ...] | None = field(default=None, compare=False)
    """Spectrum of each joint's torque, from `compensation`; None for a flat one."""

    def __post_init__(self) -> None:
        if any(not np.isfinite(t) or t < 0 for t in self.torque_rms):
            raise InvalidSetting(
                f"torque_rms must be finite, zero or more N·m, got {self.torque_rms}"
            )
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise InvalidSetting(f"duration must be positive seconds, got {self.duration!r}")
        if not 0 < self.band[0] < self.band[1]:
            raise InvalidSetting(f"band must be 0 < low < high in Hz, got {self.band}")
        if self.duration * (self.band[1] - self.band[0]) < 4:
            raise InvalidSetting(
                f"a record of {self.duration} s holds fewer than 4 independent lines of the band "
                f"{self.band} Hz; lengthen it or widen the band"
            )
        if self.shaping is not None and len(self.shaping) != len(self.torque_rms):
            raise InvalidSetting(
                f"shaping needs one entry for each of {len(self.torque_rms)} joints, "
                f"got {len(self.shaping)}"
            )

    @property
    def excited(self) -> tuple[bool, ...]:
        """Whether each joint is excited."""
        return tuple(t > 0 for t in self.torque_rms)


def torque_signals(
    excitation: Excitation,
    *,
    timestep: float,
    before: int,
    after: int,
    rng: np.random.Generator,
) -> Array:
    """Draw the torque of every joint.

    Parameters
    ----------
    excitation : Excitation
        What to play.
    timestep : float
        Sampling step [s].
    before, after : int
        Samples of run-in and run-out around the record; they continue its period.
    rng : numpy.random.Generator
        Source of the draw. Joints draw in order, whether excited or not, so that the signal
        of a joint does not depend on which others are on.

    Returns
    -------
    ndarray (n, before + duration / timestep + after)
        Torques [N·m].

    Examples
    --------
    >>> import numpy as np
    >>> e = Excitation(torque_rms=(2.0, 0.0), duration=1.2, band=(30.0, 150.0))
    >>> u = torque_signals(e, timestep=1e-3, before=0, after=0, rng=np.random.default_rng(0))
    >>> u.shape, bool(abs(u[0].std() - 2.0) < 0.3), float(u[1].std())
    ((2, 1200), True, 0.0)
    """
    count = round(excitation.duration / timestep)
    frequency = np.arange(count // 2 + 1) / (count * timestep)
    low, high = excitation.band
    inside = np.flatnonzero((frequency >= low - 1e-9) & (frequency <= high + 1e-9))
    if high >= 0.5 / timestep:
        raise InvalidSetting(
            f"band {excitation.band} Hz reaches half the sampling rate, {0.5 / timestep:g} Hz"
        )
    n = len(excitation.torque_rms)
    draws = rng.standard_normal((n, len(inside), 2))
    lines = draws[..., 0] + 1j * draws[..., 1]
    torque = np.zeros((n, before + count + after))
    index = np.arange(-before, count + after) % count
    for j, rms in enumerate(excitation.torque_rms):
        if rms == 0:
            continue
        shape = excitation.shaping[j] if excitation.shaping is not None else None
        weight = np.ones(len(inside)) if shape is None else shape(frequency[inside])
        weight = weight / np.sqrt(np.mean(weight**2))
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        # E|line|² = 2; the expected rms of the sum of all lines is the one asked for.
        spectrum[inside] = weight * lines[j] * (rms * count / (2 * np.sqrt(len(inside))))
        torque[j] = fft.irfft(spectrum, n=count)[index]
    return torque


def compensation(frequency: Array, transfer: NDArray[np.complex128]) -> Shaping:
    """Shape of the torque that makes the joint motion white instead of the torque (8.2.2).

    Parameters
    ----------
    frequency : ndarray (K,)
        Frequencies of the measured transfer function, increasing [Hz].
    transfer : ndarray (K,)
        Measured joint acceleration per torque, for example from
        `loose_env.statistics.transfer_function`.

    Returns
    -------
    Shaping
        Amplitude 1 / abs(transfer), limited to a tenfold range about its median so that a
        deep antiresonance does not take all the power.

    Raises
    ------
    InvalidSetting
        If the two arrays do not match or hold no usable value.
    """
    f, h = np.asarray(frequency, dtype=float), np.abs(np.asarray(transfer))
    if f.ndim != 1 or f.shape != h.shape or len(f) < 2 or np.any(np.diff(f) <= 0):
        raise InvalidSetting(
            "compensation needs increasing frequencies and one transfer value for each, got "
            f"shapes {f.shape} and {h.shape}"
        )
    if not np.isfinite(h).all() or not np.any(h > 0):
        raise InvalidSetting("the transfer function must be finite and not zero everywhere")
    inverse = 1 / np.maximum(h, 1e-12 * h.max())
    middle = np.median(inverse)
    inverse = np.clip(inverse, middle / np.sqrt(10), middle * np.sqrt(10))

    def shape(at: Array) -> Array:
        result: Array = np.interp(at, f, inverse)
        return result

    return shape
