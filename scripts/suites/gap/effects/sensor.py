"""Effects of the sensors: they change readings, never the arm."""

from __future__ import annotations

import numpy as np

from scripts.suites.gap.effects.drive import LEAST_TIME
from scripts.suites.gap.effects.link import rotation
from scripts.suites.gap.effects.types import (
    FORWARD,
    FREE,
    INVERSE,
    RANDOM,
    Kind,
    Parameters,
    Place,
    Readings,
    either_sign,
    joints,
    nothing,
    scalar,
)
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.simulate import System

ACCELEROMETER = "tool_acc"
"""Name of the accelerometer at the tool."""


def _accelerometer(figures: Figures) -> list[Place]:
    return [Place(name=ACCELEROMETER, index=0)]


def _speeds(figures: Figures) -> list[Place]:
    return [Place(name=f"joint{i + 1}_vel", index=i) for i in range(figures.joints)]


def _speed_or_acceleration(figures: Figures) -> list[Place]:
    return _accelerometer(figures) * 2 + _speeds(figures)


def _any(figures: Figures) -> list[Place]:
    positions = [Place(name=f"joint{i + 1}_pos", index=i) for i in range(figures.joints)]
    return _accelerometer(figures) * 3 + _speeds(figures) + positions


def _draw_turn(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    axis = rng.normal(size=3)
    return {"direction": (axis / np.linalg.norm(axis)).tolist()}


def _size_turn(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    turn = size * np.array(drawn["direction"])
    return {"angle": size, **dict(zip("xyz", turn.tolist(), strict=True))}


def _turn(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # the sensor is turned by (x, y, z) in the tool's frame
    readings.rotation = rotation(np.array([p["x"], p["y"], p["z"]])).T @ readings.rotation


def _size_gain(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"gain": 1.0 + drawn["sign"] * size}


def _gain(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.gain[place.name] = p["gain"]


def _draw_bias(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    if place.name != ACCELEROMETER:
        return either_sign(rng, figures, place)
    return _draw_turn(rng, figures, place)


def _size_bias(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    if "sign" in drawn:
        return {"bias": drawn["sign"] * size}
    bias = size * np.array(drawn["direction"])
    return {"size": size, **dict(zip("xyz", bias.tolist(), strict=True))}


def _bias(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    value = [p["bias"]] if "bias" in p else [p["x"], p["y"], p["z"]]
    readings.bias[place.name] = np.array(value)


def _bias_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    return (1e-4, 1.5) if place.name == ACCELEROMETER else (1e-6, 0.05)


def _delay(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.delay[place.name] = p["delay"]


def _encoders(figures: Figures) -> list[Place]:
    return [Place(name=f"joint{i + 1}_pos", index=i) for i in range(figures.joints)]


def _round(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.step[place.name] = p["step"]


def _constant(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.torque[place.index] = p["factor"]


def _size_constant(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"factor": 1.0 + drawn["sign"] * size}


KINDS = (
    Kind(name="sensor_misalignment", places=_accelerometer, draw=_draw_turn,
         bounds=lambda figures, place: (1e-5, 0.35), size=_size_turn, apply=_turn,
         forms=(FORWARD, RANDOM)),
    Kind(name="sensor_gain", places=_speed_or_acceleration, draw=either_sign,
         bounds=lambda figures, place: (1e-4, 0.4), size=_size_gain, apply=_gain,
         forms=(FORWARD, RANDOM)),
    Kind(name="sensor_bias", places=_speed_or_acceleration, draw=_draw_bias, bounds=_bias_bounds,
         size=_size_bias, apply=_bias, forms=(FORWARD, FREE)),
    Kind(name="sensor_delay", places=_any, draw=nothing,
         bounds=lambda figures, place: (LEAST_TIME, 0.04), size=scalar("delay"), apply=_delay,
         forms=(FORWARD, RANDOM)),
    Kind(name="torque_constant", places=joints, draw=either_sign,
         bounds=lambda figures, place: (0.005, 0.5), size=_size_constant, apply=_constant,
         forms=(INVERSE,)),
    Kind(name="sensor_quantisation", places=_encoders, draw=nothing,
         bounds=lambda figures, place: (1e-4, 0.05), size=scalar("step"), apply=_round,
         forms=(FORWARD,)),
)  # fmt: skip
"""Kinds of this file."""
