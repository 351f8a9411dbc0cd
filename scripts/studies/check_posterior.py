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

What the particles say is stored after every episode; a check that was interrupted goes on where
it stopped, and one that asks for more episodes adds them. The fast posteriors are asked anew.

With --cases, hundreds of cases are drawn from the prior in one record's pose and excitation, and
weighed with the same particles: whether the particles' own probabilities are right.

Usage: python scripts/studies/check_posterior.py --episodes 60 --particles 200
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from loose_agents.core.base import Problem
from loose_agents.core.belief_tracker import Posterior, analytic_posterior
from loose_agents.core.shipped_weights import WEIGHTS, setting_name
from loose_agents.evaluation.evaluate import check_training_seed
from loose_agents.execution.progress import ProgressLine
from loose_agents.research.particle_calibration import CalibrationCases, calibration_cases
from loose_agents.research.particle_check import (
    CHECK_SEED,
    Played,
    Weighed,
    by_size,
    compare,
    draw_check,
    particle_row,
    play,
    probabilities_of,
)

import loose_env
from loose_env.arms import planar, six_axis, vera
from loose_env.diagnosis import AmortisedPosterior, ParticleSettings, RecordStatistics
from loose_env.envs import DiagnosisSettings, EpisodeBatch, difficulty_named
from loose_env.report import rounded, stored_rows, study_head, write_study

ROOT = Path(__file__).resolve().parents[2]
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
    rows: Sequence[dict[str, Any]],
    others: dict[str, np.ndarray],
    truth: np.ndarray,
    particles: int,
) -> None:
    """Print how each posterior does, by number of records and over all."""
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
    """Print how posteriors do on cases drawn from the particles' own prior."""
    torque = ", ".join(f"{t:.3g}" for t in record.torque)
    print(
        f"\n{len(found.truth)} cases from the prior, one record of {record.duration:.1f} s with "
        f"torques {torque}\n{'posterior':<9} {'log score':>9} {'success':>7} {'P(truth)':>8} "
        f"{'promised':>8} {'calibration error':>20} {'distance':>8}  log score less the particles'"
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the check, print its table, write its picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arm", choices=list(ARMS), default="vera")
    parser.add_argument("--difficulty", default="default")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--particles", type=int, default=240)
    parser.add_argument("--moves", type=int, default=1, help="moves after a step of the ladder")
    parser.add_argument("--share", type=float, default=0.3, help="share of them that it leaves")
    parser.add_argument(
        "--repeated",
        type=int,
        default=40,
        help="particles repeated to see how their summaries scatter",
    )
    parser.add_argument("--records", type=int, default=3, help="most records of an episode")
    parser.add_argument(
        "--cases",
        type=int,
        default=0,
        help="instead: this many cases drawn from the prior, in the first record of --episode",
    )
    parser.add_argument("--episode", type=int, default=0, help="see --cases")
    parser.add_argument("--seed", type=int, default=CHECK_SEED)
    parser.add_argument("--learned", type=Path, help="folder of the trained posterior")
    parser.add_argument("--afresh", action="store_true", help="weigh again what is stored")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "figures")
    chosen = parser.parse_args(arguments)
    check_training_seed(chosen.seed)
    rules = DiagnosisSettings(difficulty=chosen.difficulty, engine="reduced")
    problem = Problem.of(ARMS[chosen.arm](), rules)  # type: ignore[no-untyped-call]
    settings = ParticleSettings(
        particles=chosen.particles,
        moves=chosen.moves,
        share=chosen.share,
        repeated=chosen.repeated,
    )
    batch = EpisodeBatch(problem.arm, rules, num=1, threads=1)
    posteriors: dict[str, Posterior] = {"analytic": analytic_posterior(problem)}
    folder = chosen.learned or WEIGHTS / f"posterior-{setting_name(problem)}"
    if chosen.learned is not None or folder.is_dir():
        posteriors["learned"] = learned_posterior(problem, folder)
    else:
        print(f"no trained posterior in {folder}: checking the analytic one alone")

    if chosen.cases:
        one = play(problem, batch, seed=chosen.seed, number=chosen.episode, most=1)
        found = calibration_cases(
            problem,
            batch.sampler,
            one.statistics[0],
            posteriors,
            seed=chosen.seed,
            cases=chosen.cases,
        )
        print_calibration(found, one.statistics[0])
        return
    chosen.out.mkdir(parents=True, exist_ok=True)
    path = chosen.out / "particle_check.json"
    head = study_head(
        "scripts/studies/check_posterior.py",
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
    weighed = Weighed.of(rows)
    picture = path.with_suffix(".png")
    draw_check(
        others,
        weighed.probabilities,
        weighed.standard_error,
        truth,
        picture,
        caption=f"Arm {chosen.arm}, {len(kept)} episodes of random actions, 1 to {chosen.records} "
        f"records; {chosen.particles} particles, mean of two runs.\n"
        "Bars: standard error by the two runs.",
    )
    print_table(rows, others, truth, settings.particles)
    print(f"\npicture: {picture}")


if __name__ == "__main__":
    main()
