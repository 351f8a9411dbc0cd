"""Frequencies of beams and rods, held against exact solutions and the printed figures."""

from __future__ import annotations

import math

import pytest
from scipy.optimize import brentq

from loose_env.errors import InvalidSetting
from loose_env.thesis.ch6_experiments.arm.structures import (
    SQUARE_INCH,
    beam_frequency,
    beam_modulus,
    rod_area,
    rod_stiffness,
    stinger_frequency,
)

TURN = 2 * math.pi


def exact_beam(end_over_beam: float) -> float:
    """Lowest root of 1 + cos x cosh x = (M/m) x (sin x cosh x - cos x sinh x), squared."""

    def equation(x: float) -> float:
        return (
            1
            + math.cos(x) * math.cosh(x)
            - end_over_beam * x * (math.sin(x) * math.cosh(x) - math.cos(x) * math.sinh(x))
        )

    return float(brentq(equation, 0.1, 2.0)) ** 2


@pytest.mark.parametrize(
    ("end", "high"), [(0.0, 0.0273), (0.2, 0.011), (1.0, 0.0029), (2.4, 0.0012)]
)
def test_the_beam_is_a_little_above_the_exact_solution(end: float, high: float) -> None:
    found = TURN * beam_frequency(
        modulus=1.0, second_moment=1.0, length=1.0, end_mass=end, beam_mass=1.0
    )
    excess = found / exact_beam(end) - 1
    assert excess == pytest.approx(high, rel=0.02)


def test_the_beam_scales_as_its_units_do() -> None:
    figures = {"modulus": 7e10, "second_moment": 3e-7, "end_mass": 2.0, "beam_mass": 1.0}
    long, short = (beam_frequency(length=x, **figures) for x in (0.8, 0.4))
    assert short == pytest.approx(2**1.5 * long)


def test_link_1_has_the_printed_mode_with_aluminium() -> None:
    figures = {"second_moment": 2.8e-7, "length": 0.40, "end_mass": 3.2, "beam_mass": 1.34}
    assert beam_modulus(frequency=519 / TURN, **figures) == pytest.approx(72e9, rel=2e-3)
    assert round(beam_frequency(modulus=72e9, **figures)) == 83


@pytest.mark.parametrize("ratio", [20.0, 5.0])
def test_the_stinger_is_near_the_exact_rod(ratio: float) -> None:
    """A rod with a mass at its end: x tan x = m / M with x = ω L √(ρ/E)."""
    modulus, length, area, density = 2.07e11, 0.17, 1e-5, 7850.0
    own = density * area * length
    x = brentq(lambda x: x * math.tan(x) - 1 / ratio, 1e-6, 1.5)
    exact = x / length * math.sqrt(modulus / density) / TURN
    stiffness = rod_stiffness(area=area, modulus=modulus, length=length)
    found = stinger_frequency(stiffness=stiffness, mass=ratio * own, rod_mass=own)
    assert found == pytest.approx(exact, rel=1.5e-3)


def test_the_printed_stinger_figures_do_not_give_the_printed_frequency() -> None:
    area, length, modulus = 0.0199 * SQUARE_INCH, 0.17, 2.07e11
    stiffness = rod_stiffness(area=area, modulus=modulus, length=length)
    rod = 7850.0 * area * length
    assert round(stinger_frequency(stiffness=stiffness, mass=0.5, rod_mass=rod)) == 885


def test_a_rod_of_the_area_found_has_the_frequency_asked_for() -> None:
    area = rod_area(frequency=710.0, modulus=2.07e11, length=0.17, mass=0.5, density=7850.0)
    # The exact rod of that area, not the formula that was inverted: x tan x = m / M.
    ratio = 7850.0 * area * 0.17 / 0.5
    x = brentq(lambda x: x * math.tan(x) - ratio, 1e-6, 1.5)
    assert x / 0.17 * math.sqrt(2.07e11 / 7850.0) / TURN == pytest.approx(710.0, rel=1.5e-3)
    with pytest.raises(InvalidSetting, match="shorter or stiffer"):
        rod_area(frequency=9000.0, modulus=2.07e11, length=0.17, mass=0.5, density=7850.0)
