"""Identify the parameters of VERA on its shaker that the thesis does not print.

One set of parameters must explain the directions of lowest correlation and the maximum correlations
that were printed for the healthy arm in five poses (ten numbers). The arm's closed-form answer to
white force is compared with them; differential evolution searches within stated bounds. The result
goes by hand into `ShakenVeraParameters`. Twelve parameters are fitted to ten numbers: a good fit is
no evidence for any one of them. ``--stiff-pin`` holds the pin at twenty times the identified
stiffness and fits the other ten. What was not fitted is the check: the pin half released, which the
thesis saw turn no direction.

Usage: python scripts/thesis/identify_vera.py --generations 40 --stiff-pin
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import differential_evolution

from loose_env.cli.command import command
from loose_env.io import Count
from loose_env.statistics import axial_difference
from loose_env.typing import Array
from scripts.thesis.plots import rms
from scripts.thesis.rigs import PROXIMAL, STIFF_PIN_FACTOR, Pin, ShakenVeraParameters, shaken_vera
from scripts.thesis.shaken_arm import ShakenArm
from scripts.thesis.shaken_vera import from_y, printed_healthy

# Parameter, lowest and highest value, and whether to search on a logarithmic scale.
BOUNDS: tuple[tuple[str, float, float, bool], ...] = (
    ("pin_stiffness", 5e3, 5e5, True),
    ("pin_damping", 3.0, 60.0, True),
    ("link2_mode", 205.0, 320.0, False),
    ("link2_damping", 0.01, 0.10, True),
    ("link1_damping", 0.01, 0.10, True),
    ("seat_mass", 0.4, 1.0, False),
    ("joint_damping", 0.5, 5.0, True),
    ("hitch", 0.14, 0.30, False),
    ("accelerometer", 0.14, 0.30, False),
    ("coil_mass", 0.2, 4.0, True),
    ("suspension_stiffness", 2e4, 3e5, True),
    ("suspension_damping", 20.0, 400.0, True),
)
DIRECTION, MAGNITUDE = np.radians(15.0), 0.15
"""Differences of a direction [rad] and of a correlation that count as much as each other."""
APART = 0.03
"""Hitch and accelerometer sit side by side on link 1: their distance counts from here [m]."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the search."""

    seed: int = 0
    """Seed of the search."""
    generations: Count = 40
    """Generations of differential evolution."""
    stiff_pin: bool = False
    """Hold the pin nearly rigid and fit the other parameters."""


def healthy_cases(
    parameters: ShakenVeraParameters, points: int = 200, pin: Pin = "engaged"
) -> Array:
    """Direction of lowest correlation [rad from x] and maximum correlation, by pose (poses, 2)."""
    shaken, found = ShakenArm(shaken_vera(pin=pin, parameters=parameters), points=points), []
    for theta2, _, _ in printed_healthy():
        variance, c, s = shaken.at([0.0, theta2]).covariances(PROXIMAL, 1)
        direction = np.arctan2(c[1], c[0]) + np.pi / 2
        found.append((direction, np.sqrt(c @ np.linalg.solve(s, c) / variance)))
    return np.array(found)


def misfit(parameters: ShakenVeraParameters) -> float:
    """Mean square difference from the printed values, in the units above."""
    found, told = healthy_cases(parameters), np.array(printed_healthy())
    turns = axial_difference(found[:, 0], told[:, 1]) / DIRECTION
    sizes = (found[:, 1] - told[:, 2]) / MAGNITUDE
    apart = (parameters.hitch - parameters.accelerometer) / APART
    return float((np.sum(turns**2) + np.sum(sizes**2) + apart**2) / len(found))


def identify(settings: Settings) -> None:
    """Search, and print the parameters with the cases they give."""
    start, bounds = ShakenVeraParameters(), BOUNDS
    if settings.stiff_pin:
        start = replace(
            start,
            pin_stiffness=start.pin_stiffness * STIFF_PIN_FACTOR,
            pin_damping=start.pin_damping * STIFF_PIN_FACTOR**0.5,
        )
        bounds = tuple(b for b in BOUNDS if not b[0].startswith("pin_"))

    def parameters_of(x: Array) -> ShakenVeraParameters:
        named = zip(bounds, x, strict=True)
        values = {b[0]: float(np.exp(v)) if b[3] else float(v) for b, v in named}
        return replace(start, **values)

    result = differential_evolution(
        lambda x: misfit(parameters_of(x)),
        [(np.log(a), np.log(b)) if log else (a, b) for _, a, b, log in bounds],
        maxiter=settings.generations,
        popsize=8,
        rng=np.random.default_rng(settings.seed),
        polish=False,
    )
    parameters, searched = parameters_of(result.x), {b[0] for b in bounds}
    for name, *_ in BOUNDS:
        held = "" if name in searched else "  (held)"
        print(f"{name:22s} {getattr(parameters, name):.3g}{held}")
    print(f"misfit {result.fun:.3f}: {len(bounds)} parameters, 10 numbers\n")
    print_cases(parameters)


def print_cases(parameters: ShakenVeraParameters) -> None:
    """Print the healthy cases beside the printed ones, and the turn with the pin half released."""
    engaged = healthy_cases(parameters, 400)
    released = healthy_cases(parameters, 400, "half_released")
    turns = np.degrees(axial_difference(released[:, 0], engaged[:, 0]))
    off = np.degrees(axial_difference(engaged[:, 0], np.array(printed_healthy())[:, 1]))
    print("pose   direction printed, found [deg]   magnitude printed, found   half released, turn")
    for (theta2, phi, c), (direction, magnitude), turn in zip(
        printed_healthy(), engaged, turns, strict=True
    ):
        print(
            f"{np.degrees(theta2):4.0f}   {from_y(phi):12.0f} {from_y(direction):12.0f}   {c:20.2f}"
            f" {magnitude:6.2f}   {turn:+17.0f}"
        )
    print(f"rms of the directions' differences {rms(off):.1f} deg")
    print(f"rms of the half-released turns {rms(turns):.1f} deg")


def main(arguments: Sequence[str] | None = None) -> None:
    """Identify, with errors in one line."""
    command("identify_vera", __doc__, Settings, identify, arguments)


if __name__ == "__main__":
    main()
