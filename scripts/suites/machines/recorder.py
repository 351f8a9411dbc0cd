"""Recorders of a machine: filters, clocks, quantisation and noise make columns of motion."""

from __future__ import annotations

import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from scripts.suites.machines.arms import GRAVITY, STEP, Array
from scripts.suites.machines.disturbances import Disturbances
from scripts.suites.machines.machine import Played

USUAL_NOISE = 20.0
"""Noise density of an accelerometer where it is not drawn [µg/√Hz]."""


class Recorder:
    """Recorder and sensors of a machine.

    Parameters
    ----------
    rate : float
        Sampling rate [Hz].
    disturbances : Disturbances
        What the sensors have.
    speeds : bool
        True if joint speeds are recorded too.
    seed : sequence of int
        Of what belongs to the sensors.
    """

    def __init__(
        self, rate: float, disturbances: Disturbances, *, speeds: bool, seed: list[int]
    ) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        self.rate, self.speeds, self.disturbances = rate, speeds, disturbances
        size = disturbances.size
        axis = rng.normal(size=3)
        angle = np.radians(size("accelerometer_rotation", "angle"))
        turned = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        leaks = size("cross_axis", "share") * rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
        self.mixing: Array = (np.eye(3) + leaks) @ turned
        self.offset = float(rng.choice([-1, 1])) * size("clock_offset", "offset")
        self.drift = float(rng.choice([-1, 1])) * size("clock_drift", "drift") * 1e-6
        self.bits = round(size("encoder_quantisation", "bits"))

    def columns(
        self, played: Played, commands: Array, begin: float, seconds: float,
        rng: np.random.Generator,
    ) -> dict[str, Array]:  # fmt: skip
        """Columns of the recording format.

        Parameters
        ----------
        played : Played
            True motion.
        commands : (T, n) array
            Commands in the unit of the model's actuators, by integration step.
        begin, seconds : float
            Beginning and length of the record [s].
        rng : Generator
            Of the noise.
        """
        count = round(seconds * self.rate)
        time: Array = np.arange(count, dtype=np.float64) / self.rate
        steps: Array = np.arange(len(played.position), dtype=np.float64) * STEP
        size = self.disturbances.size
        late = float(size("accelerometer_delay", "delay") + self.offset)
        asked: Array = begin + time * (1 + self.drift) - late
        analogue = self._filtered(played.acceleration)
        density = size("accelerometer_noise", "density", USUAL_NOISE) * 1e-6 * GRAVITY
        noise = density * np.sqrt(self.rate / 2) * rng.normal(size=(count, 3))
        reading = _at(asked, steps, analogue) @ self.mixing.T + noise
        now = np.minimum(np.round((begin + time) / STEP).astype(int), len(steps) - 1)
        angles, speeds = played.position[now], played.velocity[now]
        if self.bits:
            step = 2 * np.pi / 2**self.bits
            angles = np.round(angles / step) * step
        columns: dict[str, Array] = {"time": time}
        for j in range(angles.shape[1]):
            columns[f"ctrl.servo{j + 1}"] = commands[now, j]
            columns[f"sensor.joint{j + 1}_pos"] = angles[:, j]
            if self.speeds:
                columns[f"sensor.joint{j + 1}_vel"] = speeds[:, j]
        for k, axis in enumerate("xyz"):
            columns[f"sensor.tool_acc.{axis}"] = reading[:, k]
        return columns

    def _filtered(self, acceleration: Array) -> Array:
        """Analogue low-pass of the sensor, then decimation of linear phase."""
        bandwidth = self.disturbances.size("accelerometer_filter", "bandwidth")
        found: Array = acceleration
        if bandwidth:
            sos = signal.butter(2, bandwidth, fs=1 / STEP, output="sos")
            start = signal.sosfilt_zi(sos)[:, :, None] * found[0]
            found, _ = signal.sosfilt(sos, found, axis=0, zi=start)
        if 0.4 * self.rate < 0.45 / STEP:
            sos = signal.butter(4, 0.4 * self.rate, fs=1 / STEP, output="sos")
            found = signal.sosfiltfilt(sos, found, axis=0)
        return np.asarray(found, dtype=np.float64)


def _at(asked: Array, time: Array, values: Array) -> Array:
    return np.stack([np.interp(asked, time, column) for column in values.T], axis=1)
