"""The comparative index against the thesis's tables."""

import math

import pytest

from loose_env.errors import InvalidData
from loose_env.statistics import comparative_index

# Case (degrees), maximum correlations of table 6.4 in the nominal and in the fault state, printed
# difference of angles (degrees) and printed mag(D) of tables 6.5 (looseness) and 6.7 (backlash).
PRINTED = [
    (122, 0.40, 0.25, 100, 0.37),
    (98, 0.40, 0.60, 80, 0.49),
    (28, 0.75, 0.50, 20, 0.11),
    (302, 0.50, 0.20, 120, 0.52),
    (122, 0.40, 0.13, 50, 0.52),
    (98, 0.40, 0.55, 5, 0.03),
    (56, 0.60, 0.65, 20, 0.03),
    (28, 0.75, 0.20, -60, 0.63),
    (302, 0.50, 0.55, 0, 0.00),
]


@pytest.mark.parametrize(("case", "c_n", "c_f", "turn", "printed"), PRINTED)
def test_the_printed_index_follows_from_the_printed_correlations(case, c_n, c_f, turn, printed):
    found = comparative_index(c_n, math.radians(turn), c_f, 0.0).mag_d
    # Two decimals are printed, of factors that were themselves rounded.
    assert found == pytest.approx(printed, abs=0.0075)


def test_the_looseness_case_at_56_degrees_was_misprinted():
    # Printed 0.80 and 0.75; table 6.4 gives 1 - 0.30/0.60 = 0.50.
    found = comparative_index(0.60, math.radians(70), 0.30, 0.0).mag_d
    assert found == pytest.approx(0.47, abs=0.005)


def test_the_backlash_case_at_302_degrees_was_misprinted():
    # Printed 0.18; table 6.4 gives |1 - 0.55/0.50| = 0.10, seen in full at a right angle.
    assert comparative_index(0.50, math.pi / 2, 0.55, 0.0).mag_d == pytest.approx(0.10)


def test_e_and_d_are_cross_products_of_correlation_vectors():
    c_n, phi_n, c_f, phi_f = 0.6, 1.1, 0.3, 0.2
    relative = c_f / c_n
    # (6.16) with C_n* = 1, and the same with the difference of magnitudes.
    cross = math.cos(phi_f) * math.sin(phi_n) - math.sin(phi_f) * math.cos(phi_n)
    found = comparative_index(c_n, phi_n, c_f, phi_f)
    assert found.mag_e == pytest.approx(abs(relative * cross))
    assert found.mag_d == pytest.approx(abs((1 - relative) * cross))


def test_the_index_is_blind_where_the_direction_does_not_change():
    assert comparative_index(0.5, 0.7, 0.1, 0.7) == (0.0, 0.0)


def test_opposite_ends_of_an_axis_count_as_one():
    assert comparative_index(0.5, 0.7, 0.1, 0.2) == pytest.approx(
        comparative_index(0.5, 0.7 + math.pi, 0.1, 0.2)
    )


@pytest.mark.parametrize(
    "arguments",
    [
        (0.0, 0.0, 0.5, 0.0),
        (1.1, 0.0, 0.5, 0.0),
        (0.5, 0.0, -0.1, 0.0),
        (math.nan, 0.0, 0.5, 0.0),
        (0.5, math.inf, 0.5, 0.0),
    ],
)
def test_impossible_correlation_vectors_are_refused(arguments):
    with pytest.raises(InvalidData):
        comparative_index(*arguments)
