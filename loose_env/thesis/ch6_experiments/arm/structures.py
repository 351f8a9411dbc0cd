"""Frequencies of VERA's links and of the stinger, beside the printed ones (6.1.2, 6.3.2)."""

from __future__ import annotations

import math
from typing import Any

from loose_env.arms import BENDING_MODE_HZ, BLOCK_MASS, LINK2_MASS, LINK_LENGTH
from loose_env.errors import InvalidSetting
from loose_env.thesis.shared.sections import Table

STEEL = 7850.0
"""Density of the stinger's rod, which the thesis does not print [kg/m³]."""


def structures(told: dict[str, Any]) -> tuple[Table, list[str]]:
    """Table and text on the frequencies, from the printed data of the sizing."""
    one, rod = told["link_1"], told["stinger"]
    figures = {
        "second_moment": one["second_moment_m4"],
        "length": one["length_m"],
        "end_mass": one["end_mass_kg"],
        "beam_mass": one["beam_mass_kg"],
    }
    turn = 2 * math.pi
    modulus = beam_modulus(frequency=one["frequency_rad_per_s"] / turn, **figures)
    first = beam_frequency(modulus=modulus, **figures)
    other = beam_frequency(
        modulus=modulus,
        second_moment=one["second_moment_m4"],
        length=LINK_LENGTH,
        end_mass=BLOCK_MASS,
        beam_mass=LINK2_MASS,
    )

    def stinger(area: float) -> float:
        stiffness = rod_stiffness(area=area, modulus=rod["modulus_pa"], length=rod["length_m"])
        mass = STEEL * area * rod["length_m"]
        return stinger_frequency(stiffness=stiffness, mass=rod["slide_mass_kg"], rod_mass=mass)

    def area(frequency: float) -> float:
        found = rod_area(
            frequency=frequency,
            modulus=rod["modulus_pa"],
            length=rod["length_m"],
            mass=rod["slide_mass_kg"],
            density=STEEL,
        )
        return found / SQUARE_INCH

    inches = stinger(rod["area"] * SQUARE_INCH)
    above = told["link_2_frequency_above_hz"]
    rows = (
        ("link 1, first bending mode [Hz] (6.6)", f"{one['frequency_hz']:g}", f"{first:.1f}"),
        ("… as the simulated arm has it [Hz]", f"{one['frequency_hz']:g}", f"{BENDING_MODE_HZ:g}"),
        ("… Young's modulus that gives it [GPa]", "—", f"{modulus / 1e9:.1f}"),
        ("link 2, first bending mode [Hz] (6.6)", f"over {above:g}", f"{other:.0f}"),
        ("stinger [Hz] (6.11, 6.12), area in square inches", "—", f"{inches:.0f}"),
        (
            f"… area in {rod['area_unit']} as printed [Hz]",
            f"{rod['frequency_hz']:g} (slip)",
            f"{stinger(rod['area']):.0f}",
        ),
        (
            f"… area that gives the printed {rod['frequency_hz']:g} Hz [in²]",
            f"{rod['area']:g}",
            f"{area(rod['frequency_hz']):.4f}",
        ),
        (
            f"… area that gives the measured {rod['measured_hz']:g} Hz [in²]",
            "—",
            f"{area(rod['measured_hz']):.4f}",
        ),
    )
    table = Table(
        caption="Frequencies of links and stinger. The thesis prints no Young's modulus for the "
        "links and no mass of the rod; the rod is taken as steel, link 2 with link 1's section.",
        columns=("quantity", "printed", "here"),
        rows=rows,
    )
    agrees = round(first) == round(one["frequency_hz"])
    words = [
        f"Link 1's printed frequency {'follows' if agrees else 'does not follow'} from its "
        f"figures and (6.6) with a Young's modulus of {modulus / 1e9:.0f} GPa, which is that of "
        f"aluminium. Link 2 comes to {other:.0f} Hz, "
        + ("over" if other > above else "not over")
        + f" the printed {above:g} Hz. The stinger's area is in square inches, not in m²; even so "
        f"its printed figures give {inches:.0f} Hz, not {rod['frequency_hz']:g}. The measured "
        f"{rod['measured_hz']:g} Hz needs an effective area "
        f"{100 * (1 - area(rod['measured_hz']) / rod['area']):.0f} % smaller than printed, or "
        "another compliance in series, so the formula does not explain it as closely as the "
        "thesis says."
    ]
    return table, words


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
    mass = end_mass + 0.23 * beam_mass
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
    mass = end_mass + 0.23 * beam_mass
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
    return math.sqrt(stiffness / (mass + rod_mass / 3)) / (2 * math.pi)


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
    squared = (2 * math.pi * frequency) ** 2
    per_area = modulus / length - squared * density * length / 3
    if per_area <= 0:
        raise InvalidSetting(
            f"no section of a rod of {length:g} m has {frequency:g} Hz; take it shorter or stiffer"
        )
    return squared * mass / per_area
