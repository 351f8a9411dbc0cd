"""What the sensors make of a trace: their effects, noise and steps."""

from __future__ import annotations

import dataclasses

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap.effects.sensor import ACCELEROMETER
from scripts.suites.gap.effects.types import Readings
from scripts.suites.gap.simulator.arms import GRAVITY, Figures
from scripts.suites.gap.simulator.simulate import SAMPLE, Trace

SLIDE_SCALE = 0.05
"""Metres of a slide that count like a radian of a hinge for the steps of its encoder."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Noise:
    """Noise of a recording's sensors; it is white."""

    step: Array
    """Steps of the encoders, of shape (n,) [rad or m]."""
    position: Array
    """Noise of the encoders before their steps, of shape (n,), standard deviation."""
    velocity: Array
    """Noise of the tachometers, of shape (n,) [rad/s or m/s]."""
    acceleration: float
    """Noise of the accelerometer, standard deviation of an axis [m/s²]."""
    torque: Array
    """Noise of the measured torques, of shape (n,) [N m or N]."""

    @classmethod
    def draw(cls, figures: Figures, rng: np.random.Generator) -> Noise:
        """Encoders of 14 to 17 bits, accelerometers of 150 to 300 µg/√Hz."""
        scale = np.array([SLIDE_SCALE if x.kind == "slide" else 1.0 for x in figures.links])
        step = 2 * np.pi / 2.0 ** rng.integers(14, 18) * scale
        density = rng.uniform(150e-6, 300e-6) * GRAVITY
        limits = np.array([link.limit for link in figures.links])
        return cls(
            step=step,
            position=step * rng.uniform(0.4, 0.8),
            velocity=rng.uniform(1e-3, 4e-3) * scale,
            acceleration=float(density * np.sqrt(0.5 / SAMPLE)),
            torque=rng.uniform(0.002, 0.006) * limits,
        )

    @property
    def reading(self) -> Array:
        """Standard deviation of a position as read, noise and steps, of shape (n,)."""
        return np.sqrt(self.position**2 + self.step**2 / 12)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Signals:
    """Readings at every sample, with or without noise."""

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array

    def normalised(self, noise: Noise) -> Array:
        """Positions, velocities and accelerations in standard deviations, of shape (T, 2n + 3)."""
        return np.hstack(
            (
                self.position / noise.reading,
                self.velocity / noise.velocity,
                self.acceleration / noise.acceleration,
            )
        )


def needs_fine(readings: Readings) -> bool:
    """Whether a sensor reads between the samples of the trace."""
    return bool(readings.delay)


def _late(values: Array, delay: float, inside: int) -> Array:
    """Values at every step inside the samples, as they were `delay` before every sample."""
    at = np.arange(0, len(values), inside) - delay / SAMPLE * inside
    grid = np.arange(len(values))
    return np.stack([np.interp(at, grid, column) for column in values.T], axis=1)


def read(trace: Trace, readings: Readings, *, inside: int = 1) -> Signals:
    """Readings without noise.

    Parameters
    ----------
    trace : Trace
        What happened; at every step inside the samples if `needs_fine`.
    readings : Readings
        What is wrong with the sensors.
    inside : int
        Rows of the trace in a sample.
    """
    joints = trace.position.shape[1]
    position = trace.position[::inside].copy()
    velocity = trace.velocity[::inside].copy()
    acceleration = trace.acceleration[::inside].copy()
    for sensor, delay in readings.delay.items():
        if sensor == ACCELEROMETER:
            acceleration = _late(trace.acceleration, delay, inside)
            continue
        j = int(sensor.removeprefix("joint").split("_")[0]) - 1
        if sensor.endswith("_pos"):
            position[:, j : j + 1] = _late(trace.position[:, j : j + 1], delay, inside)
        else:
            velocity[:, j : j + 1] = _late(trace.velocity[:, j : j + 1], delay, inside)
    acceleration = acceleration @ readings.rotation.T
    columns = {ACCELEROMETER: acceleration}
    for j in range(joints):
        columns[f"joint{j + 1}_pos"] = position[:, j : j + 1]
        columns[f"joint{j + 1}_vel"] = velocity[:, j : j + 1]
    for sensor, gain in readings.gain.items():
        columns[sensor] *= gain
    for sensor, bias in readings.bias.items():
        columns[sensor] += bias
    torque = trace.torque[::inside].copy()
    for j, factor in readings.torque.items():
        torque[:, j] *= factor
    return rounded(
        Signals(
            position=position,
            velocity=velocity,
            acceleration=columns[ACCELEROMETER],
            torque=torque,
        ),
        readings,
    )


def rounded(signals: Signals, readings: Readings) -> Signals:
    """Readings of coarse sensors at whole steps."""
    position, velocity = signals.position.copy(), signals.velocity.copy()
    for sensor, step in readings.step.items():
        j = int(sensor.removeprefix("joint").split("_")[0]) - 1
        column = position[:, j] if sensor.endswith("_pos") else velocity[:, j]
        column[:] = step * np.round(column / step)
    return dataclasses.replace(signals, position=position, velocity=velocity)


def add_noise(signals: Signals, noise: Noise, rng: np.random.Generator) -> Signals:
    """Readings with noise and steps."""
    draw = rng.normal
    position = signals.position + noise.position * draw(size=signals.position.shape)
    return Signals(
        position=noise.step * np.round(position / noise.step),
        velocity=signals.velocity + noise.velocity * draw(size=signals.velocity.shape),
        acceleration=signals.acceleration
        + noise.acceleration * draw(size=signals.acceleration.shape),
        torque=signals.torque + noise.torque * draw(size=signals.torque.shape),
    )
