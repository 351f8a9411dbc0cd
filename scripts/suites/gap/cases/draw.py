"""Any case of the suite by its number, and how well its nominal figures are known."""

from __future__ import annotations

import dataclasses

import numpy as np

from scripts.suites.gap.cases import whole_machines
from scripts.suites.gap.cases.cases import SEED, Case, draw_few, role_of
from scripts.suites.gap.simulator.build import TOLERANCE

__all__ = ["draw_case", "tolerance_of"]


def draw_case(number: int, *, seed: int = SEED) -> Case:
    """Draw a case by its number.

    Parameters
    ----------
    number : int
        From 0; thousands say the group, one of `ROLES`.
    seed : int
        Seed of the suite, not negative; that of the published one by default. With another one
        neither names nor lengths of runs tell the group.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0, number]))
    if role_of(number) == "machine":
        case = whole_machines.draw_machine(number, rng)
    else:
        case = draw_few(number, rng, even_lengths=seed != SEED)
    return dataclasses.replace(case, seed=seed)


def tolerance_of(number: int) -> float:
    """Largest relative error of the nominal figures of a case, which the tool is told."""
    return whole_machines.TOLERANCE if role_of(number) == "machine" else TOLERANCE
