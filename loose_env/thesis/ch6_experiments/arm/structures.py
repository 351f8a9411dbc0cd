"""Frequencies of VERA's links and of the stinger, beside the printed ones (6.1.2, 6.3.2)."""

from __future__ import annotations

import math
from typing import Any

from loose_env.arms import BENDING_MODE_HZ, BLOCK_MASS, LINK2_MASS, LINK_LENGTH
from loose_env.thesis.rigs.beams import (
    SQUARE_INCH,
    beam_frequency,
    beam_modulus,
    rod_area,
    rod_stiffness,
    stinger_frequency,
)
from loose_env.thesis.shared.section import Table

__all__ = ["structures"]

STEEL = 7850.0
"""Density of the stinger's rod, which the thesis does not print [kg/m³]."""


def structures(told: dict[str, Any]) -> tuple[Table, list[str]]:
    """Table and words on the frequencies, from the printed figures of the sizing."""
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
        "thesis says.",
    ]
    return table, words
