"""Check the learned and the analytic posterior against one by particles.

Episodes of random actions, 1 to 3 records each, are played on simulated arms with hidden faults.
Thousands of arms drawn from the same ranges are then simulated in the same poses under the same
excitation; those that show what was measured say how probable each hypothesis is (see
`loose_env.diagnosis.particles`). The probabilities of the fast posteriors are set against theirs.

What the particles say is stored after every episode; a check that was interrupted goes on where
it stopped, and one that asks for more episodes adds them. The fast posteriors are asked anew.

Usage: nice python scripts/check_posterior.py --episodes 100 --particles 4000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import loose_env
from agents.base import Problem
from agents.belief import Posterior, analytic_posterior
from agents.evaluation import check_training_seed
from agents.particle_check import (
    CHECK_SEED,
    Played,
    compare,
    draw_check,
    particle_row,
    play,
    probabilities_of,
)
from agents.policies import WEIGHTS, setting_name
from agents.progress_line import ProgressLine
from loose_env.arms import planar, six_axis, vera
from loose_env.diagnosis.amortised import AmortisedPosterior
from loose_env.diagnosis.particles import ParticleSettings
from loose_env.envs.difficulty import difficulty_named
from loose_env.envs.episode import EpisodeBatch
from loose_env.envs.settings import DiagnosisSettings
from loose_env.report.stored_study import rounded, stored_rows, study_head, write_study

ROOT = Path(__file__).resolve().parents[1]
ARMS = {"vera": vera, "planar2": lambda: planar(2), "planar3": lambda: planar(3)}
ARMS |= {"six_axis": six_axis}


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
    rows: Sequence[dict[str, Any]], others: dict[str, np.ndarray], truth: np.ndarray
) -> None:
    """Print how each posterior does, by number of records and over all."""
    particles = np.array([row["probabilities"] for row in rows])
    error = np.array([row["standard_error"] for row in rows])
    count = np.array([row["records"] for row in rows])
    print(
        f"\n{'records':>8} {'episodes':>9}  {'posterior':<10} {'log score':>9} {'right':>6} "
        f"{'difference':>11} {'agrees':>7}  log score less the particles'"
    )
    for name in (*sorted(set(count.tolist())), "all"):
        chosen = np.ones(len(rows), dtype=bool) if name == "all" else count == name
        for label, values in {"particles": particles, **others}.items():
            c = compare(values[chosen], particles[chosen], truth[chosen])
            line = (
                f"{name!s:>8} {chosen.sum():>9}  {label:<10} {c.log_score:>9.3f} "
                f"{c.accuracy:>6.1%} "
            )
            if label == "particles":
                line += f"{'':>11} {'':>7}  Monte-Carlo error {error[chosen].mean():.4f}"
            else:
                line += f"{c.difference:>11.4f} {c.agreement:>7.1%}  "
                line += f"{c.score_gain:+.3f} ± {c.score_gain_error:.3f}"
            print(line)
    seconds = np.array([row["cpu_seconds"] for row in rows])
    measured = np.array([row["simulations"] * row["records"] for row in rows])
    print(
        f"\nprocessor time: {seconds.mean():.0f} s an episode, "
        f"{1e3 * seconds.sum() / measured.sum():.2f} ms a record of a particle; "
        f"{np.mean([row['simulations'] for row in rows]):.0f} particles simulated an episode"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the check, print its table, write its picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arm", choices=list(ARMS), default="vera")
    parser.add_argument("--difficulty", default="default")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--particles", type=int, default=4000)
    parser.add_argument("--moves", type=int, default=ParticleSettings().moves)
    parser.add_argument(
        "--repeated",
        type=int,
        default=ParticleSettings().repeated,
        help="particles repeated for the sampling covariance",
    )
    parser.add_argument("--records", type=int, default=3, help="most records of an episode")
    parser.add_argument("--seed", type=int, default=CHECK_SEED)
    parser.add_argument("--learned", type=Path, help="folder of the trained posterior")
    parser.add_argument("--afresh", action="store_true", help="weigh again what is stored")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "figures")
    chosen = parser.parse_args(arguments)
    check_training_seed(chosen.seed)
    rules = DiagnosisSettings(difficulty=chosen.difficulty, engine="reduced")
    problem = Problem.of(ARMS[chosen.arm](), rules)
    settings = ParticleSettings(
        particles=chosen.particles, moves=chosen.moves, repeated=chosen.repeated
    )
    batch = EpisodeBatch(problem.arm, rules, num=1, threads=1)
    posteriors: dict[str, Posterior] = {"analytic": analytic_posterior(problem)}
    folder = chosen.learned or WEIGHTS / f"posterior-{setting_name(problem)}"
    if chosen.learned is not None or folder.is_dir():
        posteriors["learned"] = learned_posterior(problem, folder)
    else:
        print(f"no trained posterior in {folder}: checking the analytic one alone")

    chosen.out.mkdir(parents=True, exist_ok=True)
    path = chosen.out / "particle_check.json"
    head = study_head(
        "scripts/check_posterior.py",
        settings,
        version=loose_env.__version__,
        arm=chosen.arm,
        difficulty=chosen.difficulty,
        seed=chosen.seed,
        most_records=chosen.records,
    )
    rows = [] if chosen.afresh else stored_rows(path, head)
    known = {row["episode"]: row for row in rows}
    played: list[Played] = []
    with ProgressLine(chosen.episodes, done=0, unit="episodes") as line:
        for number in range(chosen.episodes):
            one = play(problem, batch, seed=chosen.seed, number=number, most=chosen.records)
            played.append(one)
            if number not in known:
                known[number] = rounded(
                    particle_row(
                        problem, settings, batch.sampler, one, seed=chosen.seed, number=number
                    )
                )
                write_study(path, head, [known[k] for k in sorted(known)])
            line.advance(1)
    # An episode whose first records were lost says nothing of anybody.
    kept = [k for k in range(chosen.episodes) if played[k].records]
    truth = np.array([played[k].truth for k in kept], dtype=np.intp)
    rows = [known[k] for k in kept]
    others = {
        name: np.array([probabilities_of(problem, posterior, played[k]) for k in kept])
        for name, posterior in posteriors.items()
    }
    picture = path.with_suffix(".png")
    draw_check(
        others,
        np.array([row["probabilities"] for row in rows]),
        np.array([row["standard_error"] for row in rows]),
        truth,
        picture,
        caption=f"Arm {chosen.arm}, {len(kept)} episodes of random actions, 1 to {chosen.records} "
        f"records; {chosen.particles} particles.\nBars: Monte-Carlo standard error.",
    )
    print_table(rows, others, truth)
    print(f"\npicture: {picture}")


if __name__ == "__main__":
    main()
