"""Posterior probabilities of all fault hypotheses, from the spectral lines of all runs."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.instrument.data.spectral_lines import Lines, thinned
from loose_env.instrument.inference.evidence import Evidence, KnownArm
from loose_env.instrument.inference.laplace_fit import Fit, fit_hypothesis, seats_of
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.inference.seat_motion import Seat
from loose_env.instrument.result import HEALTHY
from loose_env.instrument.settings.thresholds import (
    COARSENED_RUNS,
    REFINED_WITHIN,
    UNEXPLAINED,
)
from loose_env.typing import Array

_LINES = 32
"""Lines of a run that are fitted: errors of a model are correlated over neighbouring lines, so that
more would add little."""
_WIDTHS = (10.0, 3.0)
"""Widths of the model error with which fits start (`fit_hypothesis`): modes that the model has
elsewhere make local optima, and neither of the widths leads past all of them."""
_SOFT_HZ = (30.0, 60.0, 120.0)
"""Modes that gears, base or links have where a further fit starts: in usual bands and above, an
octave apart. From a stiff arm a search seldom finds modes in the band."""
_PROBED = 4
"""Steps after which the best of these fits goes on."""
_ROUNDS = 3
"""Rounds in which all likely hypotheses begin with the arm of the best one."""
_BETTER = 1.0
"""Gain of the best fit below which a search ends [nats]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelComparison:
    """Posterior over the hypotheses, given all runs."""

    posterior: Mapping[str, float]
    fits: Mapping[str, Fit]
    """Best fit of each hypothesis."""
    evidence: Evidence
    """Of all hypotheses, on the lines that were fitted."""
    lines: tuple[Lines, ...]
    """All lines of all runs."""
    healthy_prior: float
    """Prior probability that nothing is loose."""

    def as_sampled(self, lines: Lines) -> Lines:
        """Spectral lines of a run with the identified sampling of its sensors."""
        if not self.lines:
            return lines
        return _as_sampled(lines, self.lines[0].sampled, self.lines[0].folded)

    @property
    def best(self) -> str:
        """The most probable hypothesis."""
        return max(self.posterior, key=lambda name: self.posterior[name])

    @property
    def nothing_opened(self) -> float:
        """Probability that no seat opened in any run: tight ones do not, nor do shut ones."""
        return sum(
            p * math.prod(term.shut for term in self.fits[name].runs.values())
            for name, p in self.posterior.items()
        )

    @property
    def tested(self) -> float:
        """Share of all faults whose seats the runs would have opened [1]."""
        shut = [
            math.prod(term.held for term in fit.runs.values())
            for name, fit in self.fits.items()
            if name != HEALTHY
        ]
        return 1 - sum(shut) / max(len(shut), 1)

    @property
    def misfit(self) -> float:
        """Share of a suspect run's accelerations that the best fit leaves unexplained [1].

        That of the worst run: an arm of which the model cannot explain one run is not its own.
        """
        best = _best(self.fits.values())
        suspect = [one.number for one in self.lines if not one.healthy]
        return max((best.runs[run].misfit for run in suspect if run in best.runs), default=0.0)

    def after(self, runs: Collection[int]) -> dict[str, float]:
        """Probabilities by some of the runs, at the parameters that all runs together have."""
        counted = {one.number for one in self.lines if one.healthy} | set(runs)
        return posterior_of(
            self.fits,
            [one for one in self.lines if one.number in counted],
            healthy_prior=self.healthy_prior,
        )


def compare_hypotheses(
    uncertain: UncertainArm, lines: Sequence[Lines], *, healthy_prior: float
) -> ModelComparison:
    """Compute the posterior over all hypotheses."""
    seats = seats_of(uncertain.arm.hypotheses, uncertain.arm.n)
    few = [thinned(one, _LINES) for one in lines]
    sampling = _sampling_of(uncertain, few)
    evidence = _evidence_of(uncertain, [_as_sampled(one, *sampling) for one in few])
    fits = _fitted(evidence, seats)
    whole = tuple(_as_sampled(one, *sampling) for one in lines)
    return ModelComparison(
        posterior=posterior_of(fits, whole, healthy_prior=healthy_prior),
        fits=fits,
        evidence=evidence,
        lines=whole,
        healthy_prior=healthy_prior,
    )


def _evidence_of(uncertain: UncertainArm, lines: Sequence[Lines]) -> Evidence:
    """Evidence of the suspect runs, after what the healthy arm's own runs say.

    These say the same under all hypotheses. They know the arm without any fault that would spoil
    it, and count as `power_of` has it.
    """
    every = Evidence(uncertain=uncertain, lines=lines)
    references = [one for one in lines if one.healthy]
    if not references:
        return every
    alone = Evidence(uncertain=uncertain, lines=references, known_runs=every.runs)
    fit = _fitted(alone, {HEALTHY: None})[HEALTHY]
    power = power_of(len(references))
    known = KnownArm(
        errors=fit.errors,
        precision=power * fit.normal + (1 - power) * np.eye(len(fit.errors)),
        variances=fit.variances,
    )
    suspect = [one for one in lines if not one.healthy]
    return Evidence(uncertain=uncertain, lines=suspect, known_runs=every.runs, known=known)


def _sampling_of(uncertain: UncertainArm, lines: Sequence[Lines]) -> tuple[float, float]:
    """Steps and folding of the sensors (`Lines.sampled`, `Lines.folded`), by the healthy arm.

    How sensors sample is the same under all hypotheses.
    """
    if not any(np.any(one.command) for one in lines):
        return 0.0, 0.0
    # Compared with the same allowance for errors, or the wider one would pay for it.
    without = fit_hypothesis(
        Evidence(uncertain=uncertain, lines=[_as_sampled(one, 0.0, 1.0) for one in lines]),
        HEALTHY,
        None,
        width=_WIDTHS[0],
    )
    with_steps = fit_hypothesis(
        Evidence(uncertain=uncertain, lines=[_as_sampled(one, 1.0, 1.0) for one in lines]),
        HEALTHY,
        None,
        start=without,
    )
    return (1.0, 1.0) if with_steps.evidence > without.evidence else (0.0, 0.0)


def _fitted(evidence: Evidence, seats: Mapping[str, Seat | None]) -> dict[str, Fit]:
    """Best fits of all hypotheses.

    All hypotheses are about the same arm. One whose search ended early must not count for less: all
    are fitted from the healthy arm's best parameters too, and the likely ones from those of the
    best hypothesis, until that gets no better.
    """
    fits = {
        name: fit_hypothesis(evidence, name, seat, width=_WIDTHS[0]) for name, seat in seats.items()
    }
    softer = _softer(evidence, fits[HEALTHY])
    if softer.evidence > fits[HEALTHY].evidence + _BETTER:
        for name, seat in seats.items():
            start = replace(softer, hypothesis=name)
            found = fit_hypothesis(evidence, name, seat, start=start, width=_WIDTHS[0])
            fits[name] = _better(fits[name], found)
        fits[HEALTHY] = _better(fits[HEALTHY], softer)
    for name in _likely(fits):
        for width in _WIDTHS[1:]:
            found = fit_hypothesis(evidence, name, seats[name], width=width)
            fits[name] = _better(fits[name], found)
    last = -math.inf
    for _ in range(_ROUNDS):
        best = _best(fits.values())
        if best.evidence < last + _BETTER:
            break
        last = best.evidence
        for name in _likely(fits):
            start = best if name == best.hypothesis else replace(best, hypothesis=name, axis=None)
            for again in (None, _WIDTHS[-1]):
                found = fit_hypothesis(evidence, name, seats[name], start=start, width=again)
                fits[name] = _better(fits[name], found)
    return fits


def _softer(evidence: Evidence, healthy: Fit) -> Fit:
    """Best fit of the healthy arm from starts with modes in the band.

    Of each kind of elastic part one start goes on after some steps.
    """
    if not evidence.lines or evidence.known is not None:  # what is known has its modes
        return healthy
    found = [healthy]
    for kind in evidence.uncertain.softer(evidence.expected, _SOFT_HZ):
        starts = [replace(healthy, errors=errors) for errors in kind]
        probes = [
            fit_hypothesis(evidence, HEALTHY, None, start=start, width=_WIDTHS[0], steps=_PROBED)
            for start in starts
        ]
        found.append(fit_hypothesis(evidence, HEALTHY, None, start=_best(probes), width=_WIDTHS[0]))
    return _best(found)


def _best(fits: Iterable[Fit]) -> Fit:
    return max(fits, key=lambda fit: fit.evidence)


def _better(one: Fit, other: Fit) -> Fit:
    return other if other.evidence > one.evidence else one


def _likely(fits: Mapping[str, Fit]) -> list[str]:
    """The healthy arm, and all hypotheses not too far behind the best."""
    least = _best(fits.values()).evidence - REFINED_WITHIN
    return [name for name, fit in fits.items() if name == HEALTHY or fit.evidence >= least]


def _as_sampled(lines: Lines, sampled: float, folded: float) -> Lines:
    beside = lines.beside
    if beside is not None:
        beside = replace(beside, sampled=sampled, folded=folded)
    return replace(lines, sampled=sampled, folded=folded, beside=beside)


def posterior_of(
    fits: Mapping[str, Fit], lines: Sequence[Lines], *, healthy_prior: float
) -> dict[str, float]:
    """Probabilities of all hypotheses from their fits, for models that are not exact.

    Errors outside the model are alike in all runs and do not average out: n runs count as
    n / (1 + n / COARSENED_RUNS) (coarsened posterior).
    """
    numbers = [one.number for one in lines]
    suspect = sum(not one.healthy for one in lines)
    power = power_of(suspect)
    evidence = {name: power * float(_by_run(fit, numbers).sum()) for name, fit in fits.items()}
    return probabilities_of(evidence, healthy_prior=healthy_prior)


def power_of(runs: int) -> float:
    """Weight of each of n runs [1]: together they count as n / (1 + n / COARSENED_RUNS)."""
    return 1 / (1 + runs / COARSENED_RUNS)


def _by_run(fit: Fit, numbers: Sequence[int]) -> Array:
    """Log evidence of a hypothesis by run; the cost of its parameters is spread over all runs."""
    known = [number for number in numbers if number in fit.runs]
    cost = fit.evidence - sum(term.log_likelihood for term in fit.runs.values())
    share = cost / max(len(fit.runs), 1)
    found = np.zeros(len(numbers))
    for k, number in enumerate(numbers):
        if number in known:
            found[k] = fit.runs[number].log_likelihood + share
    return found


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
