"""Effects of the drives and of the encoders that close their loops."""

from __future__ import annotations

import numpy as np

from scripts.suites.gap.effects.types import (
    FORWARD,
    FREE,
    INVERSE,
    RANDOM,
    Kind,
    Parameters,
    Place,
    Readings,
    actuators,
    either_sign,
    hinges,
    joints,
    log_uniform,
    nothing,
    scalar,
)
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.laws import (
    BACK_EMF,
    DEAD,
    DELAY,
    ECCENTRIC_COSINE,
    ECCENTRIC_SINE,
    GAIN,
    LAG,
    LIMIT,
    LOADED,
    LOADED_BUMP,
    LOADED_EXTERNAL,
    LOADED_SMOOTH,
    LOADED_SPEED,
    OFFSET,
)
from scripts.suites.gap.simulator.simulate import System

LEAST_TIME = 3e-4
"""Shortest lag or delay [s]: shorter ones only say on which side of a command's step a sample
was taken."""


def _size_gain(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"gain": 1.0 + drawn["sign"] * size}


def _gain(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.drives[place.index, GAIN] *= p["gain"]


def _lag(system: System, readings: Readings, figures: Figures, place: Place, p: Parameters) -> None:
    system.drives[place.index, LAG] = p["time"]


def _all_or_one(figures: Figures) -> list[Place]:
    # a bus delays all drives alike: as likely as one of them
    one = actuators(figures)
    return one + [Place(name="all", index=-1)] * len(one)


def _delay(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    rows = slice(None) if place.index < 0 else place.index
    system.drives[rows, DELAY] += p["delay"]


def _offset(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # the servo closes on the shifted reading too
    system.drives[place.index, OFFSET] += p["offset"]


def _offset_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    return 1e-5, 0.25 * figures.links[place.index].reach


def _offset_places(figures: Figures) -> list[Place]:
    # the zero of a first joint about the vertical, or of a slide, changes nothing that is measured
    up = np.array([0.0, 0.0, 1.0])
    first_upright = abs(np.array(figures.links[0].axis) @ up) > 0.99
    return [
        place
        for place in joints(figures)
        if figures.links[place.index].kind == "hinge" and not (place.index == 0 and first_upright)
    ]


def _draw_loaded(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    unit = 0.2 if figures.links[place.index].kind == "slide" else 1.0
    return {
        "static_ratio": rng.uniform(1.0, 1.6),
        "speed": log_uniform(rng, 0.03, 0.25) * unit,
        "smooth_speed": log_uniform(rng, 1e-3, 4e-3) * unit,
        "load_ratio": float(rng.choice([0.0, rng.uniform(0.2, 0.8)])),
    }


def _loaded(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    row = system.drives[place.index]
    row[LOADED], row[LOADED_BUMP] = p["share"], p["static_ratio"] - 1.0
    row[LOADED_SPEED], row[LOADED_SMOOTH] = p["speed"], p["smooth_speed"]
    row[LOADED_EXTERNAL] = p["load_ratio"] * p["share"]


def _size_limit(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"limit": figures.links[place.index].limit / size, **drawn}


def _limit(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.drives[place.index, LIMIT] = p["limit"]


def _draw_voltage(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    # of the velocity gain this much is back-EMF
    return {"back_emf": rng.uniform(0.3, 1.0) * figures.links[place.index].kv}


def _size_voltage(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    stall = figures.links[place.index].limit / size
    return {"stall_torque": stall, "no_load_speed": stall / drawn["back_emf"], **drawn}


def _voltage(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    row = system.drives[place.index]
    row[LIMIT], row[BACK_EMF] = p["stall_torque"], p["back_emf"]


def _dead(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.drives[place.index, DEAD] = p["width"]


def _dead_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    link = figures.links[place.index]
    return 1e-6 * link.limit / link.kp, 0.3 * link.limit / link.kp


def _draw_eccentric(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"phase": rng.uniform(-np.pi, np.pi)}


def _size_eccentric(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    phase = drawn["phase"]
    return {
        "amplitude": size,
        "sine": float(size * np.cos(phase)),
        "cosine": float(size * np.sin(phase)),
    }


def _eccentric(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    row = system.drives[place.index]
    row[ECCENTRIC_SINE], row[ECCENTRIC_COSINE] = p["sine"], p["cosine"]


KINDS = (
    Kind(name="actuator_gain", places=actuators, draw=either_sign,
         bounds=lambda figures, place: (0.01, 0.6), size=_size_gain, apply=_gain,
         forms=(FORWARD, INVERSE)),
    Kind(name="actuator_lag", places=actuators, draw=nothing,
         bounds=lambda figures, place: (LEAST_TIME, 0.1), size=scalar("time"), apply=_lag,
         forms=(FORWARD, RANDOM)),
    Kind(name="command_delay", places=_all_or_one, draw=nothing,
         bounds=lambda figures, place: (LEAST_TIME, 0.06), size=scalar("delay"), apply=_delay,
         forms=(FORWARD, RANDOM)),
    Kind(name="encoder_offset", places=_offset_places, draw=either_sign, bounds=_offset_bounds,
         size=scalar("offset"), apply=_offset, forms=(FORWARD, INVERSE, FREE)),
    Kind(name="load_friction", places=joints, draw=_draw_loaded,
         bounds=lambda figures, place: (0.005, 0.7), size=scalar("share"), apply=_loaded,
         forms=(FORWARD, INVERSE), rivals=("coulomb_friction",)),
    Kind(name="torque_limit", places=actuators, draw=nothing,
         bounds=lambda figures, place: (1.05, 20.0), size=_size_limit, apply=_limit,
         forms=(FORWARD,)),
    Kind(name="voltage_limit", places=actuators, draw=_draw_voltage,
         bounds=lambda figures, place: (1.05, 20.0), size=_size_voltage, apply=_voltage,
         forms=(FORWARD,), rivals=("torque_limit",)),
    Kind(name="dead_zone", places=actuators, draw=nothing, bounds=_dead_bounds,
         size=scalar("width"), apply=_dead, forms=(FORWARD,)),
    Kind(name="gear_eccentricity", places=hinges, draw=_draw_eccentric,
         bounds=lambda figures, place: (1e-5, 0.03), size=_size_eccentric, apply=_eccentric,
         forms=(FORWARD,), rivals=("encoder_offset",)),
)  # fmt: skip
"""Kinds of this file."""
