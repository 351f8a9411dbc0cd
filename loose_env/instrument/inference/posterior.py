"""Posterior probabilities of all hypotheses from the spectral lines of all runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.instrument.data.spectral_lines import Lines, thinned
from loose_env.instrument.inference.evidence import Evidence, Seat
from loose_env.instrument.inference.laplace_fit import Fit, fit_hypothesis, seats_of
from loose_env.instrument.inference.uncertain_linear_arm import UncertainArm
from loose_env.instrument.result import HEALTHY
from loose_env.instrument.settings.thresholds import REFINED_WITHIN, UNEXPLAINED

__all__ = ["ModelComparison", "compare_hypotheses", "probabilities_of"]


_COARSE, _FINE = 32, 120
"""Lines of a run in the coarse fit of all hypotheses and in the fine fit of the likely ones: errors
of a model are correlated over neighbouring lines, so that more would add little."""
_MOST = 4
_PROBED = 2
"""Likely hypotheses by which the sampling of the sensors is identified."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelComparison:
    """Posterior over the hypotheses, given all runs."""

    posterior: Mapping[str, float]
    fits: Mapping[str, Fit]
    """Best fit of each hypothesis."""
    evidence: Evidence
    """Of the likely hypotheses, on more lines."""
    coarse: Evidence
    """Of all hypotheses, on few lines."""
    lines: tuple[Lines, ...]
    """All lines of all runs."""

    def as_sampled(self, lines: Lines) -> Lines:
        """Spectral lines of a run with the identified sampling of its sensors."""
        if not self.lines:
            return lines
        return replace(lines, sampled=self.lines[0].sampled, folded=self.lines[0].folded)

    @property
    def best(self) -> str:
        """The most probable hypothesis."""
        return max(self.posterior, key=lambda name: self.posterior[name])


def compare_hypotheses(
    uncertain: UncertainArm, lines: Sequence[Lines], *, healthy_prior: float
) -> ModelComparison:
    """Compute the posterior over all hypotheses.

    Parameters
    ----------
    uncertain : UncertainArm
        The arm and its nuisance parameters.
    lines : sequence of Lines
        All runs; none for what is known beforehand.
    healthy_prior : float
        Prior probability that nothing is loose.
    """
    hypotheses = uncertain.arm.hypotheses
    seats = seats_of(hypotheses, uncertain.arm.n)
    coarse, fits = _first_look(uncertain, lines, seats)
    top = max(fit.evidence for fit in fits.values())
    order = sorted(fits, key=lambda name: -fits[name].evidence)
    likely = [name for name in order if fits[name].evidence > top - REFINED_WITHIN][:_MOST]
    whole = [
        replace(one, sampled=few.sampled, folded=few.folded)
        for one, few in zip(lines, coarse.lines, strict=True)
    ]
    fine = Evidence(uncertain=uncertain, lines=[thinned(one, _FINE) for one in whole])
    values = {name: fit.evidence for name, fit in fits.items()}
    if len(lines):
        again = {name: fit_hypothesis(fine, name, seats[name], start=fits[name]) for name in likely}
        # Hypotheses that were left out keep their distance from the best of those looked at.
        shift = max(fit.evidence for fit in again.values()) - top
        values = {name: value + shift for name, value in values.items()}
        values |= {name: fit.evidence for name, fit in again.items()}
        fits |= again
    return ModelComparison(
        posterior=probabilities_of(values, healthy_prior=healthy_prior),
        fits=fits,
        evidence=fine,
        coarse=coarse,
        lines=tuple(whole),
    )


def _first_look(
    uncertain: UncertainArm, lines: Sequence[Lines], seats: Mapping[str, Seat | None]
) -> tuple[Evidence, dict[str, Fit]]:
    """Fit all hypotheses to few lines and identify the sensor sampling."""
    few = [thinned(one, _COARSE) for one in lines]

    def of(sampled: float, folded: float) -> Evidence:
        taken = [replace(one, sampled=sampled, folded=folded) for one in few]
        return Evidence(uncertain=uncertain, lines=taken)

    def fit(evidence: Evidence, name: str) -> Fit:
        return fit_hypothesis(evidence, name, seats[name], steps=4)

    filtered, stepped = of(0.0, 0.0), of(1.0, 1.0)
    if lines and any(np.any(one.command) for one in lines):
        fits = {name: fit(stepped, name) for name in seats}
        order = sorted(fits, key=lambda name: -fits[name].evidence)
        # Compared with the same allowance for errors, or the wider one would pay for it.
        alike = of(0.0, 1.0)
        other = max(fit(alike, name).evidence for name in {HEALTHY, *order[:_PROBED]})
        if fits[order[0]].evidence > other:
            return stepped, fits
    return filtered, {name: fit(filtered, name) for name in seats}


def probabilities_of(evidence: Mapping[str, float], *, healthy_prior: float) -> dict[str, float]:
    """Probabilities from log-evidences, with a uniform prior over the faults.

    Examples
    --------
    >>> evidence = {"healthy": 0.0, "backlash@a": 0.0, "backlash@b": 0.0}
    >>> found = probabilities_of(evidence, healthy_prior=0.5)
    >>> found["healthy"], found["backlash@b"]
    (0.5, 0.25)
    """
    faults = len(evidence) - 1
    prior = {
        name: healthy_prior if name == HEALTHY else (1 - healthy_prior) / faults
        for name in evidence
    }
    log = {name: value + np.log(prior[name]) for name, value in evidence.items()}
    top = max(log.values())
    weight = {name: float(np.exp(value - top)) for name, value in log.items()}
    total = sum(weight.values())
    return {
        name: (1 - UNEXPLAINED) * weight[name] / total + UNEXPLAINED * prior[name]
        for name in evidence
    }
