"""Halve the simulation step and see whether a record's statistics notice.

After an impact two simulations part ways, so single records cannot be compared. What must not
depend on the step is what a diagnosis reads off a record: the transmission, the covariance of
the tool's acceleration, the highest correlation and the direction of lowest coherence. For
random faults at every place of an arm, random poses and every joint excited, this study measures
each with a step h, with h/2 and with h/4, under the same torque, the same noise and the same
start. The change of the mean over several draws of the excitation is divided by the half-width
of the 95 % interval of a single record: z below 1 says that the step changes a statistic by
less than the record leaves open anyway.

A larger survey counts how often the simulation diverges with each candidate, and how often stops
are made softer than drawn because their mode would outrun the step.

Usage: python scripts/studies/step_halving.py [--quick] [--arms vera planar4] [--out
docs/figures/...]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np

import loose_env
from loose_env.arms import Arm, LinearArm, planar, vera
from loose_env.diagnosis import RecordStatistics, statistics_of
from loose_env.envs import DIFFICULTIES, FaultSampler
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Fault, hypotheses
from loose_env.rig import Job, SimulatedRig
from loose_env.statistics import axial_angle, axial_difference, axial_mean
from loose_env.typing import Array

ROOT = Path(__file__).resolve().parents[2]
ARMS: dict[str, Callable[[], Arm]] = {
    "vera": vera,
    "planar2": lambda: planar(2),
    "planar4": lambda: planar(4),
    "planar6": lambda: planar(6),
    "planar4v": lambda: planar(4, vertical=True),
}
STEPS = (5e-4, 2.5e-4, 2e-4, 1e-4)
"""Candidate steps [s]; each must divide the 1 ms between two readings, and so must its half."""
SURVEY_DURATION = 0.3
"""Length of a surveyed record [s]; a simulation that diverges does so within milliseconds."""
QUICK_STEPS = (5e-4, 2e-4)
HALVINGS = 2
FINEST = 5e-5
"""No step below this one is taken [s]: it would cost as much as all others together."""
STATISTICS = {
    "transmission": "transmission b",
    "covariance": "tool covariance",
    "correlation": "highest correlation",
    "direction": "lowest-coherence direction",
}
TWO_SIDED = 1.96  # standard deviations of a 95 % interval


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is studied."""

    arms: tuple[str, ...] = tuple(ARMS)
    """Names of the arms."""
    steps: tuple[float, ...] = STEPS
    """Candidate steps [s]."""
    cases: int = 18
    """Faults and poses per arm; the places of the arm take turns."""
    records: int = 6
    """Draws of the excitation per case."""
    duration: float = 1.2
    """Length of a record [s]."""
    surveyed: int = 120
    """Faults and poses per arm that are looked at for divergence alone, shaken hardest."""
    difficulty: str = "default"
    """Ranges of the faults."""
    seed: int = 0
    """Seed of faults, poses and excitations."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One fault in one pose, shaken."""

    fault: Fault
    pose: Array
    excitation: Excitation
    seed: int
    softened: bool
    """Whether the stops were made softer than drawn, for the step."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """A step against its half, over all cases of an arm."""

    arm: str
    candidate: float
    """Step for which the faults were drawn [s]."""
    step: float
    """Step compared with its half [s]."""
    z: dict[str, list[float]]
    """Changes over intervals, by statistic: all components of all cases."""
    records: int
    """Records taken with this step."""
    lost: int
    """Records of these in which the simulation diverged."""
    softened: float
    """Share of the surveyed faults whose stops had to be made softer for the candidate."""
    diverged: float
    """Share of the surveyed faults with which the simulation diverged at the candidate."""

    def quantile(self, statistic: str, share: float) -> float:
        """Quantile of z; infinite where nothing could be compared."""
        values = self.z[statistic]
        return float(np.quantile(values, share)) if values else float("inf")

    def below_one(self, statistic: str) -> float:
        """Share of z below 1."""
        return float(np.mean(np.array(self.z[statistic]) < 1)) if self.z[statistic] else 0.0


def cases_of(
    arm: Arm, step: float, settings: Settings, *, count: int, duration: float, hardest: bool = False
) -> list[Case]:
    """Draw cases of an arm that is simulated with a step.

    The draws are the same for every step but for stops that would be too fast for it: the
    sampler softens these, as it would for an arm with this step.
    """
    difficulty = DIFFICULTIES[settings.difficulty]
    linear = LinearArm(dataclasses.replace(arm, timestep=step))
    sampler = FaultSampler(linear, difficulty)
    as_drawn = FaultSampler(LinearArm(dataclasses.replace(arm, timestep=1e-6)), difficulty)
    places = [h for h in hypotheses(arm) if h != "healthy"]
    order = np.random.default_rng([settings.seed, arm.n]).permutation(len(places))
    cases = []
    for k in range(count):
        seeds = [settings.seed, arm.n, k]
        place = places[order[k % len(places)]]
        fault, wanted = (
            s.draw(np.random.default_rng(seeds), hypothesis=place) for s in (sampler, as_drawn)
        )
        rng = np.random.default_rng([*seeds, 1])
        level = np.full(arm.n, arm.levels[-1] if hardest else rng.choice(arm.levels))
        for _ in range(1000):
            pose = arm.random_pose(rng)
            excitation, _ = at_levels(linear.at(pose), level, duration=duration)
            if all(excitation.excited):  # gravity leaves torque to spare at every joint
                break
        softened = min(np.divide(fault.stiffness, wanted.stiffness)) < 1 - 1e-9  # type: ignore[union-attr]
        cases.append(
            Case(fault=fault, pose=pose, excitation=excitation, seed=k, softened=bool(softened))
        )
    return cases


def measure(
    arm: Arm, cases: Sequence[Case], step: float, settings: Settings, *, draws: int
) -> list[list[RecordStatistics | None]]:
    """Statistics of every case and draw; None where the simulation diverged."""
    # The brakes' own inertance follows the step: a finer step stands for a finer arm.
    rig = SimulatedRig(dataclasses.replace(arm, timestep=step), slots=len(cases))
    for slot, case in enumerate(cases):
        rig.mount(slot, case.fault)
    found: list[list[RecordStatistics | None]] = [[] for _ in cases]
    for draw in range(draws):
        jobs = [
            Job(
                slot=slot,
                pose=case.pose,
                excitation=case.excitation,
                rng=np.random.default_rng([settings.seed, case.seed, draw]),
            )
            for slot, case in enumerate(cases)
        ]
        for slot, record in enumerate(rig.measure_many(jobs)):
            found[slot].append(statistics_of(record) if record.failure is None else None)
    return found


def components(record: RecordStatistics) -> dict[str, Array]:
    """Numbers of a record that are compared, by statistic; the direction apart."""
    covariance = record.tool_covariance
    return {
        "transmission": record.transmission[:, record.excited].ravel(),
        "covariance": covariance[np.triu_indices(len(covariance))],
        "correlation": np.array([record.maximum_correlation]),
    }


def changes(ladder: Sequence[Sequence[RecordStatistics]], rung: int) -> dict[str, Array]:
    """Return z of one case between a rung of the ladder of steps and the next.

    The ladder holds, for every step, the records of the same draws. The interval of a single
    record comes from the scatter between draws, averaged over the steps.
    """
    found = {}
    numbers = [[components(r) for r in records] for records in ladder]
    for statistic in numbers[0][0]:
        values = np.array([[n[statistic] for n in rows] for rows in numbers])
        scatter = np.sqrt(np.mean(np.var(values, axis=1, ddof=1), axis=0))
        change = np.abs(values[rung].mean(axis=0) - values[rung + 1].mean(axis=0))
        found[statistic] = change / (TWO_SIDED * scatter)
    angles = [np.array([axial_angle(r.lowest_direction) for r in records]) for records in ladder]
    means = [axial_mean(a) for a in angles]
    squares = [
        np.sum(axial_difference(a, m) ** 2) / (len(a) - 1)
        for a, m in zip(angles, means, strict=True)
    ]
    turned = abs(axial_difference(means[rung], means[rung + 1]))
    found["direction"] = np.array([turned / (TWO_SIDED * np.sqrt(np.mean(squares)))])
    return found


def study(settings: Settings, report: Callable[[str], None]) -> Iterator[Comparison]:
    """Compare every candidate step of every arm with its halves."""
    for name in settings.arms:
        arm = ARMS[name]()
        for candidate in settings.steps:
            report(f"{name}, step {candidate * 1e6:g} µs: survey")
            many = cases_of(
                arm,
                candidate,
                settings,
                count=settings.surveyed,
                duration=SURVEY_DURATION,
                hardest=True,
            )
            surveyed = [found[0] for found in measure(arm, many, candidate, settings, draws=1)]
            cases = cases_of(
                arm, candidate, settings, count=settings.cases, duration=settings.duration
            )
            steps = [candidate / 2**k for k in range(HALVINGS + 1)]
            steps = [step for step in steps if step > 0.99 * FINEST]
            ladder = []
            for step in steps:
                report(f"{name}, step {candidate * 1e6:g} µs: records at {step * 1e6:g} µs")
                ladder.append(measure(arm, cases, step, settings, draws=settings.records))
            for rung in range(len(steps) - 1):
                z: dict[str, list[float]] = {s: [] for s in STATISTICS}
                for k in range(len(cases)):
                    rows = list(zip(*(found[k] for found in ladder), strict=True))
                    whole = [row for row in rows if None not in row]
                    if len(whole) < 3:
                        continue
                    for statistic, values in changes(list(zip(*whole, strict=True)), rung).items():
                        z[statistic] += values.tolist()
                records = [r for found in ladder[rung] for r in found]
                yield Comparison(
                    arm=name,
                    candidate=candidate,
                    step=steps[rung],
                    z=z,
                    records=len(records),
                    lost=sum(r is None for r in records),
                    softened=float(np.mean([case.softened for case in many])),
                    diverged=float(np.mean([r is None for r in surveyed])),
                )


def chance(settings: Settings) -> float:
    """Value of z that scatter alone exceeds once in twenty, no two records being alike."""
    return float(np.sqrt(2 / settings.records))


def print_table(found: Sequence[Comparison]) -> None:
    """Print quantiles of z, by arm, step and statistic."""
    print(
        f"{'arm':<9} {'faults for':>10} {'step':>8} {'statistic':<27}"
        f" {'50 %':>6} {'90 %':>6} {'95 %':>6} {'max':>6} {'z < 1':>7}"
        f" {'diverged':>9} {'softened':>9}"
    )
    for c in found:
        for statistic, label in STATISTICS.items():
            quantiles = " ".join(f"{c.quantile(statistic, q):6.2f}" for q in (0.5, 0.9, 0.95, 1))
            print(
                f"{c.arm:<9} {c.candidate * 1e6:7.4g} µs {c.step * 1e6:5.4g} µs {label:<27}"
                f" {quantiles} {100 * c.below_one(statistic):5.0f} % {100 * c.diverged:7.1f} %"
                f" {100 * c.softened:7.0f} %"
            )


def draw_figure(found: Sequence[Comparison], settings: Settings, path: Path) -> None:
    """Draw z against the step, a panel for every arm."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    colours = {
        "transmission": "#0072b2",
        "covariance": "#d0451b",
        "correlation": "#f0a30a",
        "direction": "#4a8f5c",
    }
    ink, muted, faint = "#1b2128", "#66717d", "#c9d0d7"
    plt.rcParams.update(
        {
            "font.size": 9,
            "text.color": ink,
            "axes.edgecolor": faint,
            "axes.labelcolor": ink,
            "xtick.color": muted,
            "ytick.color": muted,
        }
    )
    count = len(settings.arms)
    figure, axes = plt.subplots(
        1, count, figsize=(1.2 + 2.4 * count, 4.4), sharey=True, squeeze=False
    )
    for panel, name in zip(axes[0], settings.arms, strict=True):
        arm = ARMS[name]()
        own = [c for c in found if c.arm == name and c.step == c.candidate]
        own.sort(key=lambda c: c.step)
        x = list(range(len(own)))
        labels = [f"{c.step * 1e6:.4g}" for c in own]
        present = np.interp(
            np.log(arm.timestep), np.log([c.step for c in own]), x, left=-0.4, right=len(own) - 0.6
        )
        panel.axhspan(1e-4, chance(settings), color="#eef1f4", lw=0, zorder=0)
        panel.axhline(1.0, color=ink, lw=0.9, zorder=1)
        panel.axvline(present, color="#dbe1e7", lw=12, zorder=0.5)
        for statistic, colour in colours.items():
            for share, style in ((0.95, "-"), (0.5, ":")):
                y = [c.quantile(statistic, share) for c in own]
                panel.plot(
                    x,
                    y,
                    style,
                    color=colour,
                    lw=1.6 if share == 0.95 else 1.1,
                    marker="o" if share == 0.95 else None,
                    ms=4,
                    label=STATISTICS[statistic] if share == 0.95 else None,
                )
        for place, c in zip(x, own, strict=True):
            for height, share in ((0.075, c.softened), (0.015, c.diverged)):
                panel.text(
                    place,
                    height,
                    f"{100 * share:.0f} %",
                    transform=panel.get_xaxis_transform(),
                    ha="center",
                    fontsize=7.5,
                    color=ink if share else muted,
                )
        panel.set_yscale("log")
        panel.set_xlim(-0.5, len(own) - 0.5)
        panel.set_ylim(1.5e-3, 12)
        panel.set_xticks(x, labels)
        panel.minorticks_off()
        panel.set_title(name, fontsize=10, color=ink, loc="left")
        panel.set_xlabel("step h [µs]")
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    for height, label in ((0.075, "softened"), (0.015, "diverged")):
        axes[0, 0].text(
            -0.03,
            height,
            label,
            transform=axes[0, 0].transAxes,
            ha="right",
            fontsize=7.5,
            color=muted,
        )
    axes[0, 0].set_ylabel("change from h to h/2\nover interval of one record, z")
    axes[0, 0].set_yticks([0.01, 0.1, 1, 10], ["0.01", "0.1", "1", "10"])
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", ncols=4, frameon=False, bbox_to_anchor=(0, 1))
    figure.text(
        0.008,
        0.012,
        "Solid: 95 % of all components of all cases lie below; dotted: half of them. "
        "Above the line at 1 the step shows in a record. "
        "Shaded: within chance. Grey bar: the step the arm has.\n"
        "Softened: share of the faults whose stops would be too fast for the step. "
        "Diverged: share with which the simulation ran away.",
        fontsize=8,
        color=muted,
    )
    figure.tight_layout(rect=(0, 0.085, 1, 0.93))
    beside = path.with_suffix(".part.png")
    figure.savefig(beside, dpi=150)
    plt.close(figure)
    os.replace(beside, path)


def write_json(found: Sequence[Comparison], settings: Settings, path: Path) -> None:
    """Write the results with everything needed to get them again."""
    document = {
        "settings": dataclasses.asdict(settings),
        "difficulty": {
            key: str(value)
            for key, value in vars(DIFFICULTIES[settings.difficulty]).items()
            if key != "kinds"
        },
        "versions": {
            "loose_env": loose_env.__version__,
            "mujoco": mujoco.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "chance": chance(settings),
        "comparisons": [
            {
                **{
                    field.name: getattr(c, field.name)
                    for field in dataclasses.fields(c)
                    if field.name != "z"
                },
                "z": {
                    statistic: {
                        "count": len(values),
                        "below_1": c.below_one(statistic),
                        **{
                            f"{100 * q:g} %": c.quantile(statistic, q)
                            for q in (0.5, 0.9, 0.95, 1.0)
                        },
                    }
                    for statistic, values in c.z.items()
                },
            }
            for c in found
        ],
    }
    beside = path.with_suffix(".part.json")
    beside.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    os.replace(beside, path)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, print its table, write its picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS), metavar="ARM")
    parser.add_argument("--cases", type=int, help="faults and poses per arm")
    parser.add_argument("--records", type=int, help="draws of the excitation per case, 3 or more")
    parser.add_argument("--steps", type=float, nargs="+", help="candidate steps [µs]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="a rough look in half a minute")
    parser.add_argument(
        "--out", type=Path, help="picture; default docs/figures/step_halving.png, quick: out/"
    )
    chosen = parser.parse_args(arguments)
    cases = chosen.cases or (4 if chosen.quick else Settings.cases)
    records = chosen.records or (3 if chosen.quick else Settings.records)
    if cases < 1 or records < 3:
        parser.error(f"cases must be 1 or more and records 3 or more, got {cases} and {records}")
    steps = tuple(s * 1e-6 for s in chosen.steps) if chosen.steps else Settings.steps
    if chosen.quick and not chosen.steps:
        steps = QUICK_STEPS
    surveyed = 40 if chosen.quick else Settings.surveyed
    settings = Settings(
        arms=tuple(chosen.arms),
        steps=steps,
        cases=cases,
        records=records,
        surveyed=surveyed,
        seed=chosen.seed,
    )
    folder = ROOT / ("out" if chosen.quick else "docs/figures")
    picture: Path = chosen.out or folder / "step_halving.png"
    picture.parent.mkdir(parents=True, exist_ok=True)

    started = time.perf_counter()

    def report(line: str) -> None:
        print(f"[{time.perf_counter() - started:4.0f} s] {line}", file=sys.stderr, flush=True)

    found = list(study(settings, report))
    report("done")
    print_table(found)
    draw_figure(found, settings, picture)
    write_json(found, settings, picture.with_suffix(".json"))
    print(f"\npicture: {picture}\nfigures: {picture.with_suffix('.json')}")


if __name__ == "__main__":
    main()
