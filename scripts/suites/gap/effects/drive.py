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
    joints,
    nothing,
    scalar,
)
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.laws import DELAY, GAIN, LAG, OFFSET
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
)  # fmt: skip
"""Kinds of this file."""
