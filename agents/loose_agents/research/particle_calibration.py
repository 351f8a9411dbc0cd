"""Simulation-based calibration of the particle posterior under its own prior.

All cases share one record's pose and excitation, so that they share the particles too: these are
simulated once and weighed anew for every case, without a ladder. Hundreds of cases cost as much
as a few episodes. Fast posteriors can be asked about the same cases.

References
----------
S. Talts et al., "Validating Bayesian inference algorithms with simulation-based calibration",
arXiv:1804.06788, 2018.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from loose_agents.core.base import Problem
from loose_agents.research.particle_check import Played, probabilities_of
from loose_agents.research.particle_posterior import ParticlePosterior, SimulatedRecords
from loose_env.diagnosis import RecordStatistics, Repeated, SyntheticLikelihood, summaries_of
from loose_env.envs import FaultSampler
from loose_env.errors import InvalidData
from loose_env.typing import Array
from loose_env.wrappers import Posterior

__all__ = ["CalibrationCases", "calibration_cases"]

_FIRST_CASE = 10_000_000
"""Realisations of the cases begin here, far beyond those of the particles."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationCases:
    """Cases drawn from the prior, with their posteriors."""

    truth: NDArray[np.intp]
    """Index of what is true (M,)."""
    probabilities: Mapping[str, Array]
    """Probabilities of the hypotheses by posterior, "particles" first (M, H)."""

    def promised(self, posterior: str) -> float:
        """Mean probability of the truth expected of a calibrated posterior."""
        return float((self.probabilities[posterior] ** 2).sum(axis=1).mean())


def calibration_cases(
    problem: Problem,
    sampler: FaultSampler,
    record: RecordStatistics,
    others: Mapping[str, Posterior],
    *,
    seed: int,
    cases: int = 250,
    particles: int = 250,
    repeated: int = 40,
    repeats: int = 8,
) -> CalibrationCases:
    """Sample cases from the prior for one record, and compute their posteriors.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    sampler : FaultSampler
        Draws faults of a hypothesis.
    record : RecordStatistics
        Says pose and excitation; what was measured in it does not matter.
    others : mapping of str to Posterior
        Fast posteriors to ask about the same cases.
    seed : int
        Seed of all draws.
    cases : int
        Number of cases.
    particles, repeated, repeats : int
        Particles of each hypothesis, how many of them are repeated, and how often.

    Raises
    ------
    InvalidData
        If no case could be simulated.
    """
    rig = ParticlePosterior(problem, sampler=sampler).rig
    model = SimulatedRecords(problem, sampler, rig, [record], seed=seed)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_FIRST_CASE,)))
    drawn, measured = [], []
    for case, h in enumerate(rng.choice(len(model.prior), p=model.prior, size=cases)):
        variates = rng.standard_normal((1, model.variates[h]))
        [[shown]] = model.statistics(int(h), variates, np.array([_FIRST_CASE + case]))
        if shown is not None:
            drawn.append(int(h))
            measured.append(shown)
    if not measured:
        raise InvalidData(f"none of {cases} cases could be simulated; look at the excitation")
    common, anchors = {}, []
    first = 1
    for h in np.flatnonzero(model.prior > 0):
        alike = model.variates[h] == 0  # one stands for all
        variates = rng.standard_normal((1 if alike else particles, model.variates[h]))
        common[h] = model.simulate(int(h), variates, np.zeros(len(variates), dtype=np.intp))
        for k in range(repeated):
            k %= len(variates)
            numbers = np.arange(first, first + repeats)
            first += repeats
            again = model.simulate(int(h), np.tile(variates[k], (repeats, 1)), numbers)
            anchors.append(Repeated(common=common[h][k], again=again))
    likelihood = SyntheticLikelihood.by_repeats(model.measured, anchors, freedom=10.0)
    weighed = []
    for shown in measured:
        own = replace(likelihood, measured=summaries_of(shown))
        log = np.full(len(model.prior), -np.inf)
        for h, summaries in common.items():
            evidence = logsumexp(own.log(summaries)) - np.log(len(summaries))
            log[h] = np.log(model.prior[h]) + evidence
        weighed.append(np.exp(log - logsumexp(log)))
    probabilities = {"particles": np.array(weighed)}
    for name, posterior in others.items():
        asked = [Played(truth=0, records=(shown,)) for shown in measured]
        probabilities[name] = np.array([probabilities_of(problem, posterior, a) for a in asked])
    return CalibrationCases(truth=np.array(drawn, dtype=np.intp), probabilities=probabilities)
