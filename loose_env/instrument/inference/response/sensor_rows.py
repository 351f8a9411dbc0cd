"""Sensor matrices of a linear arm: readings per displacement, sensors' own gains, command steps."""

from __future__ import annotations

import numpy as np

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.response.uncertain_linear_arm import PoseModel
from loose_env.typing import Array, ComplexArray


def rows_of(
    at: PoseModel, lines: Lines, jacobian: Array, s: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Channels per displacement (K, c, m), feedthrough of the seats (K, c, s)."""
    n, m = at.of.arm.n, at.size
    seats = at.nominal.inertia.shape[0] - m
    rows = np.zeros((len(s), len(lines.row), m), dtype=complex)
    own = np.zeros((len(s), len(lines.row), seats), dtype=complex)
    for k, (reading, axis) in enumerate(lines.row):
        if reading.kind == "acceleration":
            turned = at.turned[reading.at, axis]
            rows[:, k] = (s**2)[:, None] * jacobian[reading.at, axis, :m] + turned
            own[:, k] = jacobian[reading.at, axis, m:]
            # play turns the tool against gravity as the joint itself does
            own[:, k, at.of.plays] += turned[:n] / (s**2)[:, None]
        elif reading.kind == "turning":
            rows[:, k] = s[:, None] * at.nominal.turning[reading.at, axis, :m]
            own[:, k] = at.nominal.turning[reading.at, axis, m:] / s[:, None]
        elif reading.kind == "position":
            rows[:, k, reading.at] = 1.0
        else:
            rows[:, k, reading.at] = s
    return rows, own


def sensing_of(at: PoseModel, lines: Lines, errors: Array) -> dict[str, Array]:
    """Gain matrix (3, 3) of every sensor on a site, by the sensor's name."""
    of, t = at.of, at.of.tolerances
    found = {}
    rows = [r.sensor for r, _ in lines.row]
    for at_sensor, k in enumerate(of.sensors):
        sensor = of.arm.readings[k].sensor
        if rows.count(sensor) != 3:
            continue
        start = of.sensing.start + 9 * at_sensor
        size = np.full((3, 3), t.cross_axis)
        np.fill_diagonal(size, t.sensor_gain)
        found[sensor] = np.eye(3) + size * errors[start : start + 9].reshape(3, 3)
    return found


def stepped_of(
    at: PoseModel, lines: Lines, jacobian: Array, jump: ComplexArray, moved: ComplexArray
) -> ComplexArray:
    """Channels just after a command step, less their zero-order-hold mean (K, c).

    ``jump`` is the sudden acceleration of the moving coordinates, ``moved`` their motion (K, m).
    """
    step = np.zeros_like(lines.readings)
    half = np.pi * lines.frequency * lines.period
    for k, (reading, axis) in enumerate(lines.row):
        if reading.kind == "acceleration":
            step[:, k] = jump @ jacobian[reading.at, axis, : at.size]
        elif reading.kind == "velocity":
            # Of a path of parabolas from sample to sample, as a held force makes it.
            step[:, k] = 2j * half / lines.period * (np.tan(half) / half - 1) * moved[:, reading.at]
    return step
