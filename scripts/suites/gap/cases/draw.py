"""Any case of the suite by its number, and how well its nominal figures are known."""

from __future__ import annotations

import numpy as np

from scripts.suites.gap.cases import whole_machines
from scripts.suites.gap.cases.cases import SEED, Case, draw_few, role_of
from scripts.suites.gap.simulator.build import TOLERANCE

__all__ = ["draw_case", "tolerance_of"]


def draw_case(number: int) -> Case:
    """Draw a case by its number.

    Parameters
    ----------
    number : int
        From 0; thousands say the group, one of `ROLES`.
    """
    rng = np.random.default_rng(np.random.SeedSequence([SEED, 0, number]))
    if role_of(number) == "machine":
        return whole_machines.draw_machine(number, rng)
    return draw_few(number, rng)


def tolerance_of(number: int) -> float:
    """Largest relative error of the nominal figures of a case, which the tool is told."""
    return whole_machines.TOLERANCE if role_of(number) == "machine" else TOLERANCE
