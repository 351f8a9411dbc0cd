"""Ratio of two signals of one quantity by least squares, and the wrong unit that it means."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from loose_env.doctor.thresholds import UNIT_MATCH
from loose_env.typing import Array

ANGLE: Mapping[str, float] = {"degrees instead of radians": 180 / np.pi}
"""Wrong units of an angle or of its rate, and what they multiply it by."""
LENGTH: Mapping[str, float] = {"millimetres instead of metres": 1e3}
"""The same of a length."""
ACCELERATION: Mapping[str, float] = {
    "g instead of m/s²": 1 / 9.80665,
    "mg instead of m/s²": 1e3 / 9.80665,
    "mm/s² instead of m/s²": 1e3,
}
"""The same of an acceleration."""
FORCE: Mapping[str, float] = {
    "N·mm instead of N·m": 1e3,
    "kN·m instead of N·m": 1e-3,
    "kgf·m instead of N·m": 1 / 9.80665,
}
"""The same of a torque."""


class Ratio(NamedTuple):
    """Ratio of a measured to an expected signal, and their correlation about zero."""

    ratio: float
    correlation: float


def ratio_of(measured: Array, expected: Array) -> Ratio | None:
    """Ratio of two signals by least squares through the origin; None where one is zero."""
    power, own = float(expected @ expected), float(measured @ measured)
    if power == 0.0 or own == 0.0:
        return None
    product = float(measured @ expected)
    # The geometric mean of both regressions: noise in either does not pull it to zero.
    ratio = float(np.copysign(np.sqrt(own / power), product))
    return Ratio(ratio, product / np.sqrt(power * own))


def inverse(ratio: float) -> float:
    """One over a ratio; not finite for zero."""
    return float("inf") if ratio == 0.0 else 1 / ratio


def named_unit(ratio: float, units: Mapping[str, float]) -> str | None:
    """Wrong unit that a ratio stands for; None where none fits."""
    if not np.isfinite(ratio):
        return None
    for words, factor in units.items():
        if abs(abs(ratio) / factor - 1) <= UNIT_MATCH:
            return words
    return None
