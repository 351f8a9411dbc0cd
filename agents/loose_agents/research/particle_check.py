"""Comparison of fast posteriors with the particle posterior on random episodes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Situation
from loose_agents.core.seeds import CHECK_ACTIONS, CHECK_PARTICLES
from loose_agents.policies.policies import RandomPolicy
from loose_agents.research.particle_posterior import ParticlePosterior
from loose_env.diagnosis import (
    ParticleSettings,
    RecordStatistics,
    probabilities_from,
    statistics_of,
)
from loose_env.envs import EpisodeBatch, FaultSampler
from loose_env.evaluation import expected_calibration_error
from loose_env.report import FAINT, INK, MUTED, pyplot, save_figure
from loose_env.typing import Array
from loose_env.wrappers import Posterior, record_from

__all__ = [
    "FLOOR",
    "AtSize",
    "Comparison",
    "Played",
    "Weighed",
    "by_size",
    "compare",
    "distance",
    "draw_check",
    "particle_row",
    "play",
    "probabilities_of",
]


FLOOR = 1e-3
"""Probabilities below this count as this in the log score: the particles tell no less apart."""
_DRAWS = 400  # for the errors of calibration
_NOTHING = -99.0  # log evidence of what is out of the question


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """Measurements and ground truth of one episode."""

    truth: int
    """Index of the true hypothesis."""
    records: tuple[RecordStatistics, ...]
    """The records, as the environment shows them."""
    statistics: tuple[RecordStatistics, ...] = ()
    """The same before the observation clips and rounds them; for the particles."""


def play(problem: Problem, batch: EpisodeBatch, *, seed: int, number: int, most: int = 3) -> Played:
    """Play one episode of random actions, of 1 to ``most`` records by its number.

    Parameters
    ----------
    problem : Problem
        Arm and rules.
    batch : EpisodeBatch
        Episodes of the same; the first slot is used.
    seed, number : int
        Which episode.
    most : int
        Most records.
    """
    batch.start(0, seed=seed, number=number)
    policy = RandomPolicy(problem)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, CHECK_ACTIONS)))
    nothing = np.full(len(problem.hypotheses), 1 / len(problem.hypotheses))
    episode = batch.episode(0)
    statistics = []
    for taken in range(1 + number % most):
        if episode.ended:  # the simulation diverged
            break
        situation = Situation(
            observation=batch.observe(0),
            pose=episode.pose,
            records=taken,
            probabilities=nothing,
            memory=None,
            rng=rng,
        )
        batch.step([0], [policy.choose(situation)])
        if episode.last is not None and not episode.ended:
            statistics.append(statistics_of(episode.last))
    shown = batch.observe(0)
    found = [record_from(problem.layout, shown, k) for k in range(episode.records)]
    return Played(
        truth=problem.hypotheses.index(episode.fault.hypothesis),
        records=tuple(record for record in found if record is not None),
        statistics=tuple(statistics),
    )


def probabilities_of(problem: Problem, posterior: Posterior, played: Played) -> Array:
    """Probabilities of a problem's hypotheses by a fast posterior (H,)."""
    belief = posterior.start()
    for record in played.records:
        belief = posterior.update(belief, record)
    order = [posterior.hypotheses.index(name) for name in problem.hypotheses]
    return np.asarray(belief.probabilities)[order]


def particle_row(
    problem: Problem,
    settings: ParticleSettings,
    sampler: FaultSampler,
    played: Played,
    *,
    seed: int,
    number: int,
    runs: int = 2,
) -> dict[str, Any]:
    """Particle posteriors of one episode, over several runs, as a storable row.

    The evidence is that of every island, over the largest of its run.
    """
    found = []
    for run in range(runs):
        stream = np.random.SeedSequence(seed, spawn_key=(number, CHECK_PARTICLES, run))
        own = int(stream.generate_state(1)[0])
        posterior = ParticlePosterior(problem, settings, seed=own, sampler=sampler)
        started = time.process_time()
        evidence = posterior.evidence(played.statistics)
        log = evidence.log_evidence
        log = np.maximum(log - log[np.isfinite(log)].max(initial=-np.inf), _NOTHING)
        found.append(
            {
                "log_evidence": log.tolist(),
                "steps": evidence.steps.tolist(),
                "simulations": evidence.simulations,
                "accepted": evidence.accepted,
                "interaction": evidence.interaction,
                "cpu_seconds": time.process_time() - started,
            }
        )
    return {
        "episode": number,
        "truth": problem.hypotheses[played.truth],
        "records": len(played.records),
        "prior": evidence.prior.tolist(),
        "runs": found,
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class Weighed:
    """Particle posteriors of the stored episodes."""

    evidence: tuple[Array, ...]
    """Log evidence of each episode: runs, islands, hypotheses (R, B, H)."""
    prior: Array
    """Probability of each hypothesis beforehand (E, H)."""

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Any]]) -> Weighed:
        """Build from rows of `particle_row`."""
        evidence = tuple(
            np.array([run["log_evidence"] for run in row["runs"]], dtype=float) for row in rows
        )
        return cls(evidence=evidence, prior=np.array([row["prior"] for row in rows]))

    @property
    def islands(self) -> int:
        """Islands of a run."""
        return len(self.evidence[0][0])

    def by_run(self, run: int, islands: slice = slice(None)) -> Array:
        """Probabilities by run, or by a subset of its islands (E, H)."""
        return np.array(
            [
                probabilities_from(prior, log[run, islands])
                for prior, log in zip(self.prior, self.evidence, strict=True)
            ]
        )

    @property
    def probabilities(self) -> Array:
        """Mean of the runs (E, H)."""
        return np.mean([self.by_run(run) for run in range(len(self.evidence[0]))], axis=0)  # type: ignore[no-any-return]

    @property
    def standard_error(self) -> Array:
        """Standard error of that mean, from the variance between runs (E, H)."""
        runs = [self.by_run(run) for run in range(len(self.evidence[0]))]
        return np.asarray(np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs)))


def distance(one: Array, other: Array) -> Array:
    """Total variation distance between probabilities of each episode (E,).

    Examples
    --------
    >>> distance(np.array([[1.0, 0.0]]), np.array([[0.25, 0.75]])).tolist()
    [0.75]
    """
    return np.asarray(0.5 * np.abs(one - other).sum(axis=1))


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Distance of one posterior from the particle posterior over the same episodes."""

    log_score: float
    """Mean log probability of the truth, at least that of `FLOOR`."""
    success: float
    """Share of episodes in which the most probable hypothesis is true."""
    truth: float
    """Mean probability of the truth."""
    calibration: float
    """Expected calibration error of the most probable hypothesis."""
    calibration_error: float
    """Its standard error, by drawing the episodes again."""
    calibrated: float
    """Mean of that error for a calibrated posterior of the same confidences."""
    distance: float
    """Total variation from the particles' probabilities, mean over episodes."""
    agreement: float
    """Share of episodes in which the most probable hypothesis is the particles'."""
    score_gain: float
    """Log score less that of the particles, mean over episodes."""
    score_gain_error: float
    """Standard error of that mean."""


def compare(probabilities: Array, particles: Array, truth: NDArray[np.intp]) -> Comparison:
    """Compare a posterior's probabilities with those of the particle posterior.

    Parameters
    ----------
    probabilities, particles : ndarray (E, H)
        Probability of each hypothesis after each episode.
    truth : ndarray of int (E,)
        Index of what was true.

    Examples
    --------
    >>> p = np.array([[0.9, 0.1], [0.4, 0.6]])
    >>> same = compare(p, p, np.array([0, 0]))
    >>> same.success, same.truth, same.agreement, same.distance, same.score_gain
    (0.5, 0.65, 1.0, 0.0, 0.0)
    """
    rows = np.arange(len(truth))

    def scores(p: Array) -> Array:
        return np.asarray(np.log(np.maximum(p[rows, truth], FLOOR)))

    own, gain = scores(probabilities), scores(probabilities) - scores(particles)
    named = probabilities.argmax(axis=1)
    sure, right = np.minimum(probabilities.max(axis=1), 1.0), named == truth
    rng = np.random.default_rng(0)
    again = rng.integers(len(rows), size=(_DRAWS, len(rows)))
    drawn = [expected_calibration_error(sure[k], right[k]) for k in again]
    luck = rng.random((_DRAWS, len(rows))) < sure
    error = float(gain.std(ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else float("nan")
    return Comparison(
        log_score=float(own.mean()),
        success=float(np.mean(right)),
        truth=float(probabilities[rows, truth].mean()),
        calibration=expected_calibration_error(sure, right),
        calibration_error=float(np.std(drawn)),
        calibrated=float(np.mean([expected_calibration_error(sure, hit) for hit in luck])),
        distance=float(distance(probabilities, particles).mean()),
        agreement=float(np.mean(named == particles.argmax(axis=1))),
        score_gain=float(gain.mean()),
        score_gain_error=error,
    )


@dataclass(frozen=True, kw_only=True)
class AtSize:
    """Particle posterior from a fraction of the particles."""

    share: float
    """Share of a run's particles; above one, runs are put together."""
    log_score: float
    """Log score of that share, mean over the parts of the runs."""
    between: float
    """Total variation between parts of different runs; NaN where there are no two."""
    distance: Mapping[str, float]
    """Total variation of each other posterior from them."""


def by_size(
    weighed: Weighed, others: Mapping[str, Array], truth: NDArray[np.intp]
) -> tuple[AtSize, ...]:
    """Compute sampling error and distances against the number of particles.

    A share of a run is a group of its islands; the scatter of summaries is that of the whole run.
    """
    runs, islands = len(weighed.evidence[0]), weighed.islands
    rows = np.arange(len(truth))
    found = []
    size = 1
    groups: list[list[Array]]
    while size <= islands:
        starts = range(0, islands - size + 1, size)
        groups = [[weighed.by_run(r, slice(k, k + size)) for k in starts] for r in range(runs)]
        found.append((size / islands, groups))
        size *= 2
    found.append((float(runs), [[weighed.probabilities]]))
    sizes = []
    for share, groups in found:
        every = [p for group in groups for p in group]
        scores = [np.log(np.maximum(p[rows, truth], FLOOR)).mean() for p in every]
        pairs = [
            distance(p, q).mean()
            for i, group in enumerate(groups)
            for other in groups[i + 1 :]
            for p in group
            for q in other
        ]
        sizes.append(
            AtSize(
                share=share,
                log_score=float(np.mean(scores)),
                between=float(np.mean(pairs)) if pairs else float("nan"),
                distance={
                    name: float(np.mean([distance(p, q).mean() for p in every]))
                    for name, q in others.items()
                },
            )
        )
    return tuple(sizes)


def draw_check(
    others: Mapping[str, Array],
    particles: Array,
    errors: Array,
    truth: NDArray[np.intp],
    path: Path,
    *,
    caption: str,
) -> None:
    """Plot other posteriors against the particle posterior, one panel each.

    Parameters
    ----------
    others : mapping of str to ndarray (E, H)
        Probabilities by posterior.
    particles, errors : ndarray (E, H)
        Those by particles, with their Monte-Carlo standard error.
    truth : ndarray of int (E,)
        Index of what was true.
    path : Path
        The picture.
    caption : str
        What stands below it.
    """
    plt = pyplot()
    true = np.zeros(particles.shape, dtype=bool)
    true[np.arange(len(truth)), truth] = True
    names: Sequence[str] = list(others)
    figure, axes = plt.subplots(
        1, len(names), figsize=(0.6 + 4.0 * len(names), 4.9), sharey=True, squeeze=False
    )
    for panel, name in zip(axes[0], names, strict=True):
        panel.plot([0, 1], [0, 1], color=FAINT, lw=1, zorder=0)
        for mask, colour, label in ((~true, MUTED, "not true"), (true, "#d0451b", "true")):
            panel.errorbar(
                particles[mask],
                others[name][mask],
                xerr=errors[mask],
                fmt="o",
                ms=3.5,
                lw=0.6,
                alpha=0.65,
                color=colour,
                label=f"the hypothesis is {label}",
            )
        panel.set_xlim(-0.03, 1.03)
        panel.set_ylim(-0.03, 1.03)
        panel.set_aspect("equal")
        panel.set_xlabel("probability by particles")
        panel.set_title(f"{name} posterior", fontsize=9.5, color=INK, loc="left")
    axes[0, 0].set_ylabel("probability by the posterior checked")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=2, frameon=False, fontsize=8.5)
    figure.text(0.01, 0.015, caption, fontsize=8, color=MUTED)
    figure.tight_layout(rect=(0, 0.1, 1, 0.94))
    save_figure(plt, figure, path)
