"""Thesis's comparative index between a nominal state and a suspected fault."""

import math
from typing import NamedTuple

from loose_env.errors import InvalidData


class ComparativeIndex(NamedTuple):
    """Magnitudes of the two cross products of correlation vectors."""

    mag_e: float
    """|C* sin(phi_n - phi_f)| (6.17)."""
    mag_d: float
    """|(1 - C*) sin(phi_n - phi_f)| (6.18): the index; near zero without a fault."""


def comparative_index(c_n: float, phi_n: float, c_f: float, phi_f: float) -> ComparativeIndex:
    """Compare a correlation vector with the nominal one (6.15 to 6.18).

    C* = c_f / c_n is the maximum correlation relative to the nominal one. The printed tables use
    the magnitude |1 - C*|, since C* exceeds one in some poses, and |sin|, since directions are
    axes. The index stays near zero when the direction does not change, fault or not.

    Parameters
    ----------
    c_n, c_f : float
        Maximum correlation in the nominal and in the compared state, 0 to 1; c_n above zero.
    phi_n, phi_f : float
        Direction of lowest correlation in either state, rad, from the same axis.

    Returns
    -------
    ComparativeIndex
        Magnitudes of E and D.

    Raises
    ------
    InvalidData
        If a correlation lies outside 0 to 1, c_n is zero or an angle is not finite.

    Examples
    --------
    The looseness case at 56 degrees, from table 6.4 and the angle of table 6.5:

    >>> round(comparative_index(0.60, math.radians(70.0), 0.30, 0.0).mag_d, 2)
    0.47
    """
    if not (0.0 < c_n <= 1.0 and 0.0 <= c_f <= 1.0):
        raise InvalidData(
            f"c_n is {c_n} and c_f is {c_f}; correlations lie between 0 and 1, c_n above 0"
        )
    if not (math.isfinite(phi_n) and math.isfinite(phi_f)):
        raise InvalidData(f"phi_n is {phi_n} and phi_f is {phi_f}; angles must be finite")
    relative = c_f / c_n
    turn = abs(math.sin(phi_n - phi_f))
    return ComparativeIndex(relative * turn, abs(1.0 - relative) * turn)
