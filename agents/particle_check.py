"""Check fast posteriors against the one by particles, on episodes of random actions."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.base import Problem
from agents.belief import Posterior, record_from
from agents.belief_agent import Situation
from agents.particles import ParticlePosterior
from agents.random_agent import RandomPolicy
from loose_env.diagnosis.particles import ParticleSettings
from loose_env.diagnosis.record import RecordStatistics
from loose_env.envs.difficulty import FaultSampler
from loose_env.envs.episode import EpisodeBatch
from loose_env.report.study_figure import FAINT, INK, MUTED, pyplot, save_figure

__all__ = [
    "CHECK_SEED",
    "FLOOR",
    "Comparison",
    "Played",
    "compare",
    "draw_check",
    "particle_row",
    "play",
    "probabilities_of",
]

Array = NDArray[np.float64]

CHECK_SEED = 19_960_000
"""Seed of the check's episodes; training, tuning and evaluation use others."""
FLOOR = 1e-3
"""Probabilities below this count as this in the log score: the particles tell no less apart."""
_ACTIONS, _PARTICLES = 17, 18  # streams of an episode beyond those of its own


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """What was measured in one episode, and what was true."""

    truth: int
    """Index of the true hypothesis."""
    records: tuple[RecordStatistics, ...]
    """The records, as the environment shows them."""


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
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, _ACTIONS)))
    nothing = np.full(len(problem.hypotheses), 1 / len(problem.hypotheses))
    episode = batch.episode(0)
    assert episode is not None
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
    shown = batch.observe(0)
    found = [record_from(problem.layout, shown, k) for k in range(episode.records)]
    return Played(
        truth=problem.hypotheses.index(episode.fault.hypothesis),
        records=tuple(record for record in found if record is not None),
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
) -> dict[str, Any]:
    """Weigh one episode by particles; a row that can be stored."""
    stream = np.random.SeedSequence(seed, spawn_key=(number, _PARTICLES))
    own = int(stream.generate_state(1)[0])
    posterior = ParticlePosterior(problem, settings, seed=own, sampler=sampler)
    started = time.process_time()
    evidence = posterior.evidence(played.records)
    return {
        "episode": number,
        "truth": problem.hypotheses[played.truth],
        "records": len(played.records),
        "probabilities": evidence.probabilities.tolist(),
        "standard_error": evidence.standard_error.tolist(),
        "steps": evidence.steps.tolist(),
        "simulations": evidence.simulations,
        "accepted": evidence.accepted,
        "interaction": evidence.interaction,
        "cpu_seconds": time.process_time() - started,
    }


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One posterior against the particles over the same episodes."""

    log_score: float
    """Mean log probability of the truth, at least that of `FLOOR`."""
    accuracy: float
    """Share of episodes in which the most probable hypothesis is true."""
    difference: float
    """Mean over episodes and hypotheses of the distance to the particles' probability."""
    agreement: float
    """Share of episodes in which the most probable hypothesis is the particles'."""
    score_gain: float
    """Log score less that of the particles, mean over episodes."""
    score_gain_error: float
    """Standard error of that mean."""


def compare(probabilities: Array, particles: Array, truth: NDArray[np.intp]) -> Comparison:
    """Compare a posterior's probabilities with the particles'.

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
    >>> same.accuracy, same.agreement, same.difference, same.score_gain
    (0.5, 1.0, 0.0, 0.0)
    """
    rows = np.arange(len(truth))

    def scores(p: Array) -> Array:
        return np.asarray(np.log(np.maximum(p[rows, truth], FLOOR)))

    own, gain = scores(probabilities), scores(probabilities) - scores(particles)
    named = probabilities.argmax(axis=1)
    error = float(gain.std(ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else float("nan")
    return Comparison(
        log_score=float(own.mean()),
        accuracy=float(np.mean(named == truth)),
        difference=float(np.abs(probabilities - particles).mean()),
        agreement=float(np.mean(named == particles.argmax(axis=1))),
        score_gain=float(gain.mean()),
        score_gain_error=error,
    )


def draw_check(
    others: Mapping[str, Array],
    particles: Array,
    errors: Array,
    truth: NDArray[np.intp],
    path: Path,
    *,
    caption: str,
) -> None:
    """Draw the probabilities of other posteriors against the particles', a panel for each.

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
