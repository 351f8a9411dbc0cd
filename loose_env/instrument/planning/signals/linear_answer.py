"""Response of the linear arm to one period of noise torque at one joint."""

from __future__ import annotations

import numpy as np
from scipy import fft

from loose_env.arms import LinearArm
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.typing import Array, ComplexArray

OVERSAMPLED = 4
"""Samples at which peaks are looked for, per sample of the signal."""


class LinearAnswer:
    """Response of the linear arm to one period of noise torque at one joint."""

    def __init__(
        self,
        arm: InstrumentedArm,
        linear: LinearArm,
        pose: Array,
        j: int,
        period: Array,
        rate: float,
    ) -> None:
        nominal = arm.nominal
        self.count = len(period)
        spectrum = np.asarray(fft.rfft(period))
        self._lines = np.flatnonzero(np.abs(spectrum) > 1e-9 * np.abs(spectrum).max())
        frequency = self._lines * rate / self.count
        fine = linear.variant(linear.arm)
        fine.frequency = frequency
        excited = np.arange(nominal.n) == j
        answer = fine.at(pose).response(excited)
        self.s = 2j * np.pi * frequency
        self.torque = spectrum[self._lines]
        self.joints = (answer.joint[:, :, 0] * self.torque[:, None]).T  # (n, K)
        self.tool = (answer.tool[:, :, 0] * self.torque[:, None]).T  # (d, K)
        self.moved = self.joints / self.s**2
        self.positions = self.in_time(self.moved, OVERSAMPLED)
        spring = np.array([0.0 if d is None else d.stiffness for d in arm.drives])
        damper = np.array([0.0 if d is None else d.damping for d in arm.drives])
        self.drive = -(spring[:, None] + damper[:, None] * self.s) * self.moved
        self.drive[j] += self.torque
        self.drive_torques = self.in_time(self.drive, OVERSAMPLED)

    def in_time(self, lines: ComplexArray, finer: int = 1) -> Array:
        """One period of a signal of given lines (..., count)."""
        whole = np.zeros((*lines.shape[:-1], finer * self.count // 2 + 1), dtype=complex)
        whole[..., self._lines] = lines
        return np.asarray(fft.irfft(whole, n=finer * self.count) * finer)

    def peak(self, lines: ComplexArray, derivative: int = 0) -> Array:
        """Largest magnitude of a derivative of signals of given lines (...,)."""
        found = self.in_time(lines * self.s**derivative, OVERSAMPLED)
        return np.asarray(np.abs(found).max(axis=-1))

    def rms(self, lines: ComplexArray) -> float:
        """Root of the sum of the mean squares of all rows."""
        return float(np.sqrt(2 * np.sum(np.abs(lines) ** 2)) / self.count)
