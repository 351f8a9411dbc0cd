"""Force and static load across closed seats, and the probability that a run opens them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.inference.response.frequency_response import Response
from loose_env.instrument.settings.thresholds import OPENING_FORCE
from loose_env.typing import Array

_FRICTION = np.geomspace(0.3, 30.0, 9)
"""Prior grid of the friction of a slide's guide [N]."""
_LEVER = 0.03
"""Friction of play in a revolute joint over that of a slide [m]."""


def seat_forces(response: Response, seats: NDArray[np.intp], axes: Array) -> tuple[Array, Array]:
    """Rms force across a closed seat in a run and its static load, by axis (U,) each."""
    across, lines = response.across(seats, axes), response.lines
    # Lines that were left out between those that are there count too.
    power = 2 * np.sum(np.abs(across) ** 2, axis=1) * lines.spacing * lines.seconds
    drive = np.sqrt(power) * lines.period / lines.seconds
    load = np.abs(axes @ response.at.seat_load()[seats])
    return np.asarray(drive), np.asarray(load)


def open_probability(response: Response, seats: NDArray[np.intp], axes: Array) -> Array:
    """Probability that a seat opens in a run under unknown friction, by axis (U,)."""
    drive, load = seat_forces(response, seats, axes)
    friction = _FRICTION * (_LEVER if _turns(response, seats) else 1.0)
    held = OPENING_FORCE * (load[:, None] + friction)
    chance = 1 / (1 + (held / np.maximum(drive, 1e-12)[:, None]) ** 4)
    return np.asarray(np.clip(chance.mean(axis=1), 0.01, 0.99))


def _turns(response: Response, seats: NDArray[np.intp]) -> bool:
    """True for the play of a revolute joint."""
    arm = response.at.of.arm
    joint = int(seats[0]) - 3 * arm.n  # the slides of all links come first
    return joint >= 0 and not bool(arm.nominal.sliding[joint])
