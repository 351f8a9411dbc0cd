"""Check the learned and the analytic posterior against one by particles.

Episodes of random actions, 1 to 3 records each, are played on simulated arms with hidden faults.
Hundreds of arms drawn from the same ranges are then simulated in the same poses under the same
excitation; those that show what was measured say how probable each hypothesis is (see
`loose_env.diagnosis.research.particles.evidence`), twice over with other draws: how far the two
runs are apart is the noise of the particles. The probabilities of the fast posteriors are set
against theirs.

The episodes come from the ranges that the particles are drawn from, so the particles' own
probabilities must be calibrated, and on average nobody's log score can be better than that of
the exact posterior given what was measured.

The particles' probabilities are stored after every episode; a check that asks for more episodes
adds them. The fast posteriors are evaluated anew.

With --cases, hundreds of cases are drawn from the prior in one record's pose and excitation, and
scored with the same particles: whether the particles' own probabilities are calibrated.

Usage: python scripts/studies/checks/posterior.py --episodes 60 --particles 200
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from loose_agents.base import CHECK_SEED, Problem, check_training_seed
from loose_agents.belief import WEIGHTS, setting_name
from loose_agents.execution.command import option
from loose_agents.execution.study import Row, Study, StudyRun
from loose_agents.research.particle_calibration import CalibrationCases, calibration_cases
from loose_agents.research.particle_check import (
    Played,
    Weighed,
    by_size,
    compare,
    draw_check,
    particle_row,
    play,
    probabilities_of,
)

from loose_env.diagnosis import AmortisedPosterior, ParticleSettings, RecordStatistics
from loose_env.envs import DiagnosisSettings, EpisodeBatch, difficulty_named
from loose_env.io import Count, NonNegativeCount
from loose_env.wrappers import Posterior, analytic_posterior
from scripts.study_parts.arms import arm_named

ARMS = ("vera", "planar2", "planar3", "six_axis")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the check."""

    arm: str = option("vera", "arm under test", choices=ARMS)
    difficulty: str = option("default", "ranges of the faults")
    particles: Count = option(240, "particles of a run")
    moves: Count = option(1, "moves after a step of the ladder")
    share: float = option(0.3, "share of the particles that a step leaves")
    repeated: Count = option(40, "particles repeated to see how their summaries scatter")
    most_records: Count = option(3, "most records of an episode", "--records")
    seed: int = option(CHECK_SEED, "seed of the episodes")

    def __post_init__(self) -> None:
        """Check the seed."""
        check_training_seed(self.seed)

    @property
    def rules(self) -> DiagnosisSettings:
        """Rules of the episodes."""
        return DiagnosisSettings(difficulty=self.difficulty, engine="reduced")

    @property
    def sampling(self) -> ParticleSettings:
        """Settings of the particles."""
        return ParticleSettings(
            particles=self.particles, moves=self.moves, share=self.share, repeated=self.repeated
        )


@dataclass(frozen=True, kw_only=True)
class Run(StudyRun):
    """Run of the check."""

    episodes: Count = option(100, "episodes of random actions")
    cases: NonNegativeCount = option(
        0, "instead: this many cases drawn from the prior, in the first record of --episode"
    )
    episode: NonNegativeCount = option(0, "see --cases")
    learned: Path | None = option(None, "folder of the trained posterior")


@cache
def bench(settings: Settings) -> tuple[Problem, EpisodeBatch]:
    """Problem and episodes of the check."""
    problem = Problem.of(arm_named(settings.arm), settings.rules)
    return problem, EpisodeBatch(problem.arm, settings.rules, num=1, threads=1)


@cache
def played(settings: Settings, number: int, most: int) -> Played:
    """One episode."""
    return play(*bench(settings), seed=settings.seed, number=number, most=most)


def learned_posterior(problem: Problem, folder: Path) -> AmortisedPosterior:
    """Load the learned posterior for a problem."""
    difficulty = difficulty_named(problem.settings.difficulty)
    return AmortisedPosterior.load(
        folder,
        problem.linear,
        problem.settings.sensors,
        difficulty.mismatch,
        kinds=difficulty.probabilities(problem.settings.kinds),
    )


def print_table(
    rows: Sequence[dict[str, Any]],
    others: dict[str, np.ndarray],
    truth: np.ndarray,
    particles: int,
) -> None:
    """Print the scores of each posterior, by number of records and over all."""
    weighed = Weighed.of(rows)
    mean = weighed.probabilities
    count = np.array([row["records"] for row in rows])
    print(
        f"\n{'records':>7} {'episodes':>8}  {'posterior':<9} {'log score':>9} {'success':>7} "
        f"{'P(truth)':>8} {'calibration error':>20} {'distance':>8} {'agrees':>6}  "
        "log score less the particles'"
    )
    for name in (*sorted(set(count.tolist())), "all"):
        chosen = np.ones(len(rows), dtype=bool) if name == "all" else count == name
        for label, values in {"particles": mean, **others}.items():
            c = compare(values[chosen], mean[chosen], truth[chosen])
            line = (
                f"{name!s:>7} {chosen.sum():>8}  {label:<9} {c.log_score:>9.3f} "
                f"{c.success:>7.1%} {c.truth:>8.3f} "
                f"{c.calibration:>6.3f} ± {c.calibration_error:.3f} ({c.calibrated:.3f})"
            )
            if label != "particles":
                line += f" {c.distance:>8.3f} {c.agreement:>6.1%}  "
                line += f"{c.score_gain:+.3f} ± {c.score_gain_error:.3f}"
            print(line)
    print(
        "calibration error: of the most probable hypothesis, with its standard error; in brackets "
        "what\nchance alone shows in as many episodes. distance: total variation from the "
        "particles' probabilities,\nmean of two runs."
    )
    names = "".join(f"{'to ' + name:>12}" for name in others)
    print(f"\n{'particles':>9} {'log score':>9} {'between runs':>13}{names}   (total variation)")
    for at in by_size(weighed, others, truth):
        line = f"{round(at.share * particles):>9} {at.log_score:>9.3f} {at.between:>13.3f}"
        print(line + "".join(f"{at.distance[name]:>12.3f}" for name in others))
    runs = [run for row in rows for run in row["runs"]]
    measured = [run["simulations"] * row["records"] for row in rows for run in row["runs"]]
    seconds = np.array([run["cpu_seconds"] for run in runs])
    print(
        f"\nprocessor time: {seconds.mean():.1f} s a run, "
        f"{1e3 * seconds.sum() / np.sum(measured):.2f} ms a record of a particle; "
        f"{np.mean([run['simulations'] for run in runs]):.0f} arms simulated a run"
    )


def print_calibration(found: CalibrationCases, record: RecordStatistics) -> None:
    """Print the scores of posteriors on cases drawn from the particles' own prior."""
    torque = ", ".join(f"{t:.3g}" for t in record.torque)
    print(
        f"\n{len(found.truth)} cases from the prior, one record of {record.duration:.1f} s with "
        f"torques {torque}\n{'posterior':<9} {'log score':>9} {'success':>7} {'P(truth)':>8} "
        f"{'expected':>8} {'calibration error':>20} {'distance':>8}  log score less the particles'"
    )
    particles = found.probabilities["particles"]
    for label, values in found.probabilities.items():
        c = compare(values, particles, found.truth)
        print(
            f"{label:<9} {c.log_score:>9.3f} {c.success:>7.1%} {c.truth:>8.3f} "
            f"{found.promised(label):>8.3f} "
            f"{c.calibration:>6.3f} ± {c.calibration_error:.3f} ({c.calibrated:.3f}) "
            f"{c.distance:>8.3f}  {c.score_gain:+.3f} ± {c.score_gain_error:.3f}"
        )


def posteriors_of(problem: Problem, given: Path | None) -> dict[str, Posterior]:
    """The analytic posterior, and the learned one where it has been trained."""
    posteriors: dict[str, Posterior] = {
        "analytic": analytic_posterior(problem.linear, problem.settings)
    }
    folder = given or WEIGHTS / f"posterior-{setting_name(problem)}"
    if given is not None or folder.is_dir():
        posteriors["learned"] = learned_posterior(problem, folder)
    else:
        print(f"no trained posterior in {folder}: checking the analytic one alone")
    return posteriors


def work(number: int, *, settings: Settings, run: Run, say: Callable[[str], None]) -> list[Row]:
    """Weigh the particles of one episode."""
    problem, batch = bench(settings)
    one = played(settings, number, settings.most_records)
    sampled = settings.sampling
    seed = settings.seed
    return [particle_row(problem, sampled, batch.sampler, one, seed=seed, number=number)]


def head(settings: Settings) -> Mapping[str, Any]:
    """What the rows rest on."""
    named = ("arm", "difficulty", "seed", "most_records")
    return {"settings": settings.sampling, **{name: getattr(settings, name) for name in named}}


def show(rows: list[Row], settings: Settings, path: Path, run: Run) -> None:
    """Ask the fast posteriors, print the table, draw the picture beside the rows."""
    if run.cases:
        calibrate(settings, run)
        return
    problem, _ = bench(settings)
    found = [played(settings, row["episode"], settings.most_records) for row in rows]
    # An episode whose first records were lost says nothing of anybody.
    kept = [(row, one) for row, one in zip(rows, found, strict=True) if one.records]
    truth = np.array([one.truth for _, one in kept], dtype=np.intp)
    others = {
        name: np.array([probabilities_of(problem, posterior, one) for _, one in kept])
        for name, posterior in posteriors_of(problem, run.learned).items()
    }
    weighed = Weighed.of([row for row, _ in kept])
    draw_check(
        others,
        weighed.probabilities,
        weighed.standard_error,
        truth,
        path.with_suffix(".png"),
        caption=f"Arm {settings.arm}, {len(kept)} episodes of random actions, 1 to "
        f"{settings.most_records} records; {settings.particles} particles, mean of two runs.\n"
        "Bars: standard error by the two runs.",
    )
    print_table([row for row, _ in kept], others, truth, settings.particles)


def calibrate(settings: Settings, run: Run) -> None:
    """Print the calibration on cases from the prior."""
    problem, batch = bench(settings)
    record = played(settings, run.episode, 1).statistics[0]
    posteriors = posteriors_of(problem, run.learned)
    found = calibration_cases(
        problem, batch.sampler, record, posteriors, seed=settings.seed, cases=run.cases
    )
    print_calibration(found, record)


STUDY = Study(
    script=__file__,
    about=__doc__,
    settings=Settings,
    run=Run,
    quick={"particles": 120},
    file="particle_check.json",
    unit="episodes",
    cases=lambda settings, run: range(0 if run.cases else run.episodes),
    work=work,
    case_of=lambda row: row["episode"],
    head=head,
    show=show,
)
main = STUDY.main

if __name__ == "__main__":
    main()
