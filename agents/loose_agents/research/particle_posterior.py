"""Particle posterior on the environment's records, with its own arm prior.

It is no agent's estimator, being slow, but the yardstick for those that are fast: it asks nothing
of the physics but the simulation itself (see `loose_env.diagnosis.research.particles.evidence`). A
particle is one fault; the mismatch belongs to a realisation, with excitation and noise. It has
some fifty numbers of which each does little, so that it is averaged over, and not searched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from loose_agents.core.base import Problem, hypothesis_prior
from loose_env.arms import MismatchDraw
from loose_env.diagnosis import (
    Evidence,
    ParticleSettings,
    RecordStatistics,
    evidence_by_particles,
    statistics_of,
    summaries_of,
)
from loose_env.envs import FaultSampler, difficulty_named
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation
from loose_env.faults import Fault, Healthy
from loose_env.rig import Job, Measurement, ReducedRig, SimulatedRig
from loose_env.typing import Array

__all__ = ["ParticleBelief", "ParticlePosterior", "SimulatedRecords"]

_BELOW_ONE = 1 - 2.0**-53
_SLOTS = 32
"""Arms at once on MuJoCo's batched engine."""


class _Given:
    """Random generator stand-in that returns given numbers.

    So the prior is the environment's own draw, as a function of standard normal variates.
    """

    def __init__(self, normals: Array | None = None) -> None:
        self.normals = normals
        self.taken = 0

    def standard_normal(self, size: Any) -> Array:
        start, count = self.taken, int(np.prod(size))
        self.taken += count
        if self.normals is None:
            return np.zeros(size)
        return self.normals[start : self.taken].reshape(size)

    def random(self, size: Any) -> Array:
        return np.minimum(ndtr(self.standard_normal(size)), _BELOW_ONE)  # type: ignore[no-any-return]


class SimulatedRecords:
    """Simulates particles in the poses and with the excitations of given records.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules; the engine of its settings simulates.
    sampler : FaultSampler
        Draws faults of a hypothesis.
    rig : ReducedRig or SimulatedRig
        Where particles are mounted, as many at once as it has slots.
    records : sequence of RecordStatistics
        What was measured.
    seed : int
        Seed of mismatch, excitations and noise.
    """

    def __init__(
        self,
        problem: Problem,
        sampler: FaultSampler,
        rig: ReducedRig | SimulatedRig,
        records: Sequence[RecordStatistics],
        *,
        seed: int,
    ) -> None:
        self.problem, self.sampler, self.rig, self.seed = problem, sampler, rig, seed
        self.records = tuple(records)
        self.mismatch = sampler.difficulty.mismatch
        self._nominal = MismatchDraw.none(problem.arm)
        self.prior = hypothesis_prior(problem.hypotheses, sampler.probabilities)
        self.variates = [self._variates_of(name) for name in problem.hypotheses]
        shown = [summaries_of(record) for record in self.records]
        self.measured = np.concatenate([np.zeros(0), *shown])
        self._blocks = np.repeat(np.arange(len(shown)), [len(s) for s in shown])
        self._excitations = [
            Excitation(
                torque_rms=tuple(float(t) for t in record.torque),
                duration=record.duration,
                band=problem.arm.band,
            )
            for record in self.records
        ]

    def _variates_of(self, hypothesis: str) -> int:
        counter = _Given()
        fault = self.sampler.draw(cast(np.random.Generator, counter), hypothesis=hypothesis)
        return 0 if isinstance(fault, Healthy) else counter.taken

    def fault(self, hypothesis: str, variates: Array) -> Fault:
        """Build the fault that standard normal variates (V,) map to."""
        if not len(variates):
            return Healthy()
        given = cast(np.random.Generator, _Given(variates))
        return self.sampler.draw(given, hypothesis=hypothesis)

    def true_arm(self, realisation: int) -> MismatchDraw:
        """Sample the arm of a realisation; realisation 0 is the nominal arm."""
        if realisation == 0:
            return self._nominal
        return self.mismatch.draw(self.problem.arm, self._generator(len(self.records), realisation))

    def _generator(self, stream: int, realisation: int) -> np.random.Generator:
        key = (stream, realisation)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def statistics(
        self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]
    ) -> list[list[RecordStatistics | None]]:
        """Simulate particles (N, V) with numbered realisations (N,).

        Returns the statistics of each one's records; None where a simulation failed.
        """
        name = self.problem.hypotheses[hypothesis]
        found: list[list[RecordStatistics | None]] = []
        for first in range(0, len(variates), self.rig.slots):
            chunk = range(first, min(first + self.rig.slots, len(variates)))
            for slot, k in enumerate(chunk):
                fault = self.fault(name, variates[k])
                self.rig.mount(slot, fault, self.true_arm(int(realisations[k])))
            shown: list[list[RecordStatistics | None]] = [[] for _ in chunk]
            for r, (record, excitation) in enumerate(
                zip(self.records, self._excitations, strict=True)
            ):
                jobs = [
                    Job(
                        slot=slot,
                        pose=record.pose,
                        excitation=excitation,
                        rng=self._generator(r, int(realisations[k])),
                    )
                    for slot, k in enumerate(chunk)
                ]
                for own, measurement in zip(shown, self.rig.measure_many(jobs), strict=True):
                    own.append(_statistics_if_any(measurement))
            found.extend(shown)
        return found

    def simulate(self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]) -> Array:
        """Simulate particles (N, V) with numbered realisations (N,); their summaries (N, D)."""
        summaries = np.full((len(variates), len(self.measured)), np.nan)
        for k, shown in enumerate(self.statistics(hypothesis, variates, realisations)):
            for r, statistics in enumerate(shown):
                if statistics is not None:
                    summaries[k, self._blocks == r] = summaries_of(statistics)
        return summaries


def _statistics_if_any(measurement: Measurement) -> RecordStatistics | None:
    """Statistics of a measurement; None if it failed or is degenerate."""
    if measurement.failure is not None:
        return None
    try:
        return statistics_of(measurement)
    except InvalidData:
        return None


@dataclass(frozen=True, kw_only=True, eq=False)
class ParticleBelief:
    """Particle posterior given the records so far, computed lazily."""

    posterior: ParticlePosterior
    """The posterior it belongs to."""
    records: tuple[RecordStatistics, ...] = ()
    """The records taken in."""

    @cached_property
    def evidence(self) -> Evidence:
        """Evidence of the hypotheses, with its Monte-Carlo error."""
        return self.posterior.evidence(self.records)

    @property
    def probabilities(self) -> Array:
        """Probability of each hypothesis (H,)."""
        return self.evidence.probabilities


class ParticlePosterior:
    """Bayes' rule over faults by simulating thousands of arms per set of records.

    Can stand where the other posteriors stand, as in `loose_agents.core.estimators.Tracker`,
    at seconds to minutes for each set of records. Direction, gap, friction, stops and mismatch are
    drawn as the environment draws them, and shared by the records of an arm. Records should be
    `statistics_of` measurements: what an observation shows is clipped where a ratio grows large.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules; the engine of its settings simulates.
    settings : ParticleSettings, optional
        How many particles, and how they climb.
    seed : int
        Seed of all draws: the same records give the same probabilities.
    sampler : FaultSampler, optional
        Draws faults; one for the problem by default. Give it to share it.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.envs import DiagnosisSettings
    >>> problem = Problem.of(planar(2), DiagnosisSettings(engine="reduced"))
    >>> ParticlePosterior(problem).start().probabilities.round(3).tolist()
    [0.333, 0.167, 0.167, 0.167, 0.167]
    """

    def __init__(
        self,
        problem: Problem,
        settings: ParticleSettings | None = None,
        *,
        seed: int = 0,
        sampler: FaultSampler | None = None,
    ) -> None:
        self.problem, self.seed = problem, seed
        self.settings = ParticleSettings() if settings is None else settings
        self.hypotheses = problem.hypotheses
        rules = problem.settings
        self.sampler = sampler or FaultSampler(
            problem.linear, difficulty_named(rules.difficulty), rules.kinds
        )
        self.rig: ReducedRig | SimulatedRig
        if rules.engine == "reduced":
            self.rig = ReducedRig(problem.arm, sensors=rules.sensors)
        else:
            self.rig = SimulatedRig(problem.arm, slots=_SLOTS, sensors=rules.sensors, threads=1)

    def start(self) -> ParticleBelief:
        """Return the prior."""
        return ParticleBelief(posterior=self)

    def update(self, belief: ParticleBelief, record: RecordStatistics) -> ParticleBelief:
        """Update with one record; simulation is deferred until probabilities are read."""
        return ParticleBelief(posterior=self, records=(*belief.records, record))

    def evidence(self, records: Sequence[RecordStatistics]) -> Evidence:
        """Compute the evidence of the hypotheses from all records of one arm."""
        model = SimulatedRecords(self.problem, self.sampler, self.rig, records, seed=self.seed)
        # A branch of its own beside those of the records' realisations.
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(len(records),)))
        return evidence_by_particles(model, self.settings, rng)  # type: ignore[arg-type]
