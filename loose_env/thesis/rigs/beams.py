"""First frequencies of links and drive rods, from their figures (thesis 6.1.2, 6.3.2)."""

from __future__ import annotations

import math

from loose_env.errors import InvalidSetting

__all__ = [
    "SQUARE_INCH",
    "beam_frequency",
    "beam_modulus",
    "rod_area",
    "rod_stiffness",
    "stinger_frequency",
]

SQUARE_INCH = 0.0254**2
"""One square inch [m²]."""


def beam_frequency(
    *, modulus: float, second_moment: float, length: float, end_mass: float, beam_mass: float
) -> float:
    """First bending frequency of a clamped beam with a mass at its free end [Hz] (6.6).

    Rayleigh's estimate, a little too high: by 2.7 % without an end mass, by 0.3 % where the end
    mass is that of the beam, by 0.12 % for link 1 of VERA.

    ``modulus``: Young's modulus E [Pa]. ``second_moment``: second moment of area I of the section
    [m⁴]. ``length``: length of the beam L [m]. ``end_mass``: mass at the free end M [kg]; may be
    zero. ``beam_mass``: mass of the beam [kg]; may be zero if there is an end mass.

    Examples
    --------
    >>> round(
    ...     beam_frequency(
    ...         modulus=72e9, second_moment=2.8e-7, length=0.4, end_mass=3.2, beam_mass=1.34
    ...     ),
    ...     1,
    ... )
    82.6
    """
    _above_zero(modulus=modulus, second_moment=second_moment, length=length)
    mass = _moving(end_mass, beam_mass, 0.23)
    return math.sqrt(3 * modulus * second_moment / (length**3 * mass)) / (2 * math.pi)


def beam_modulus(
    *, frequency: float, second_moment: float, length: float, end_mass: float, beam_mass: float
) -> float:
    """Young's modulus with which (6.6) gives a frequency [Pa]; arguments as `beam_frequency`.

    Examples
    --------
    >>> figures = dict(second_moment=2.8e-7, length=0.4, end_mass=3.2, beam_mass=1.34)
    >>> round(beam_modulus(frequency=519 / (2 * math.pi), **figures) / 1e9)
    72
    """
    _above_zero(frequency=frequency, second_moment=second_moment, length=length)
    mass = _moving(end_mass, beam_mass, 0.23)
    return (2 * math.pi * frequency) ** 2 * length**3 * mass / (3 * second_moment)


def rod_stiffness(*, area: float, modulus: float, length: float) -> float:
    """Stiffness of a rod pulled along its axis [N/m] (6.12).

    ``area``: section A [m²]; of a thread, what carries load. ``modulus``: Young's modulus E [Pa].
    ``length``: free length L [m].

    Examples
    --------
    >>> rod_stiffness(area=1e-5, modulus=2e11, length=0.2)
    10000000.0
    """
    _above_zero(area=area, modulus=modulus, length=length)
    return area * modulus / length


def stinger_frequency(*, stiffness: float, mass: float, rod_mass: float) -> float:
    """First longitudinal frequency of a mass on a rod held at its other end [Hz] (6.11).

    ``stiffness``: of the rod, from `rod_stiffness` [N/m]. ``mass``: mass at the rod's end M [kg].
    ``rod_mass``: mass of the rod [kg].

    Examples
    --------
    >>> round(stinger_frequency(stiffness=1e7, mass=0.5, rod_mass=0.0), 1)
    711.8
    """
    _above_zero(stiffness=stiffness)
    return math.sqrt(stiffness / _moving(mass, rod_mass, 1 / 3)) / (2 * math.pi)


def rod_area(
    *, frequency: float, modulus: float, length: float, mass: float, density: float
) -> float:
    """Section of the rod with which (6.11) and (6.12) give a frequency [m²].

    ``frequency``: first longitudinal frequency [Hz]. ``modulus``, ``length``, ``mass``: as
    `rod_stiffness` and `stinger_frequency` [Pa, m, kg]. ``density``: of the rod [kg/m³].

    Examples
    --------
    >>> area = rod_area(frequency=720.0, modulus=2.07e11, length=0.17, mass=0.5, density=7850.0)
    >>> round(area / SQUARE_INCH, 4)
    0.0132
    """
    _above_zero(frequency=frequency, modulus=modulus, length=length, density=density)
    squared = (2 * math.pi * frequency) ** 2
    per_area = modulus / length - squared * density * length / 3
    if per_area <= 0:
        raise InvalidSetting(
            f"no section of a rod of {length:g} m has {frequency:g} Hz; take it shorter or stiffer"
        )
    return squared * _moving(mass, 0.0, 0.0) / per_area


def _above_zero(**figures: float) -> None:
    for name, value in figures.items():
        if not (math.isfinite(value) and value > 0):
            raise InvalidSetting(f"{name} must be finite and above zero, in SI units; got {value}")


def _moving(mass: float, own: float, share: float) -> float:
    for value in (mass, own):
        if not (math.isfinite(value) and value >= 0):
            raise InvalidSetting(f"masses must be finite and zero or more [kg], got {value}")
    moving = mass + share * own
    if not moving > 0:
        raise InvalidSetting("give a mass above zero [kg]: without one nothing vibrates")
    return moving
