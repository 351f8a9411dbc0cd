"""From the lines of all runs to the probabilities of all hypotheses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.evidence import Evidence
from loose_env.instrument.lines import Lines, thinned
from loose_env.instrument.result import HEALTHY
from loose_env.instrument.uncertain import UncertainMachine
from loose_env.instrument.weighing import Fit, fit_hypothesis, seats_of

__all__ = ["Judged", "judge", "probabilities_of"]

Array = NDArray[np.float64]

_COARSE, _FINE = 32, 120
"""Lines of a run in the first look at all hypotheses, and in the last at the likely ones: errors of
a model are alike at neighbouring lines, so that more would cost time and say little."""
_BEHIND = 120.0
"""Log-evidence by which a hypothesis may be behind after the first look to be looked at again."""
_MOST = 4
_ELSE = 0.004
"""Probability that something is not as any hypothesis has it: then data say nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """What all runs together say."""

    posterior: Mapping[str, float]
    fits: Mapping[str, Fit]
    """Best fit of each hypothesis."""
    evidence: Evidence
    """Of the likely hypotheses."""
    coarse: Evidence
    """Of all."""
    lines: tuple[Lines, ...]
    """All lines of all runs."""

    @property
    def best(self) -> str:
        """The most probable hypothesis."""
        return max(self.posterior, key=lambda name: self.posterior[name])


def judge(
    machine: UncertainMachine, lines: Sequence[Lines], *, sound: float
) -> Judged:
    """Weigh all hypotheses.

    Parameters
    ----------
    machine : UncertainMachine
        The machine.
    lines : sequence of Lines
        All runs; none for what is known beforehand.
    sound : float
        Prior probability that nothing is loose.
    """
    hypotheses = machine.machine.hypotheses
    seats = seats_of(hypotheses, machine.machine.n)
    coarse = Evidence(machine=machine, lines=[thinned(one, _COARSE) for one in lines])
    fits = {name: fit_hypothesis(coarse, name, seat, steps=4) for name, seat in seats.items()}
    top = max(fit.evidence for fit in fits.values())
    order = sorted(fits, key=lambda name: -fits[name].evidence)
    likely = [name for name in order if fits[name].evidence > top - _BEHIND][:_MOST]
    fine = Evidence(machine=machine, lines=[thinned(one, _FINE) for one in lines])
    values = {name: fit.evidence for name, fit in fits.items()}
    if len(lines):
        again = {name: fit_hypothesis(fine, name, seats[name], start=fits[name]) for name in likely}
        # Hypotheses that were left out keep their distance from the best of those looked at.
        shift = max(fit.evidence for fit in again.values()) - top
        values = {name: value + shift for name, value in values.items()}
        values |= {name: fit.evidence for name, fit in again.items()}
        fits |= again
    return Judged(
        posterior=probabilities_of(values, sound=sound),
        fits=fits,
        evidence=fine,
        coarse=coarse,
        lines=tuple(lines),
    )


def probabilities_of(evidence: Mapping[str, float], *, sound: float) -> dict[str, float]:
    """Probabilities by log-evidence; faults are equally likely beforehand.

    Examples
    --------
    >>> found = probabilities_of({"healthy": 0.0, "backlash@a": 0.0, "backlash@b": 0.0}, sound=0.5)
    >>> found["healthy"], found["backlash@b"]
    (0.5, 0.25)
    """
    faults = len(evidence) - 1
    prior = {name: sound if name == HEALTHY else (1 - sound) / faults for name in evidence}
    log = {name: value + np.log(prior[name]) for name, value in evidence.items()}
    top = max(log.values())
    weight = {name: float(np.exp(value - top)) for name, value in log.items()}
    total = sum(weight.values())
    return {
        name: (1 - _ELSE) * weight[name] / total + _ELSE * prior[name] for name in evidence
    }
