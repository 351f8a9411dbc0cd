"""Halve the simulation step and test a record's statistics for changes, by arm and step.

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

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import OmitArgPrefixes

from loose_env.arms import Arm, LinearArm
from loose_env.cli.command import command, one_of
from loose_env.diagnosis import RecordStatistics, statistics_of
from loose_env.envs import DIFFICULTIES, FaultSampler
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Fault, hypotheses
from loose_env.io import Count
from loose_env.report import INK, MUTED
from loose_env.rig import Job, SimulatedRig
from loose_env.statistics import axial_difference, axial_mean, wrap_axial
from loose_env.typing import Array
from scripts.charts import Panel, chart, curve, save
from scripts.study import ROOT, Row, arm_named, study_rows

ARMS = ("vera", "planar2", "planar4", "planar6", "planar4v")
STEPS = (5e-4, 2.5e-4, 2e-4, 1e-4)
"""Candidate steps [s]; each must divide the 1 ms between two readings, and so must its half."""
SURVEY_DURATION = 0.3
"""Length of a surveyed record [s]; a simulation that diverges does so within milliseconds."""
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
QUANTILES = (0.5, 0.9, 0.95, 1.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arms: tuple[Annotated[str, one_of(ARMS)], ...] = ARMS
    """Arms under test."""
    steps: tuple[float, ...] = STEPS
    """Candidate steps [s]."""
    cases: Count = 18
    """Faults and poses per arm, 1 or more; the locations of the arm take turns."""
    records: Count = 6
    """Draws of the excitation per case, 3 or more."""
    duration: float = 1.2
    """Length of a record [s]."""
    surveyed: Count = 120
    """Faults and poses per arm of the survey for divergence, at the top level."""
    difficulty: str = "default"
    """Ranges of the faults."""
    seed: int = 0
    """Seed of faults, poses and excitations."""

    def __post_init__(self) -> None:
        if self.records < 3:
            raise InvalidSetting(f"records must be 3 or more, got {self.records}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """Run of the study; no row depends on it."""

    settings: OmitArgPrefixes[Settings] = dataclasses.field(default_factory=Settings)
    quick: bool = False
    """A rough look with few cases."""
    out: Path | None = None
    """File of the rows, the figure beside it; docs/figures/step_halving.json by default, of a quick
    run out/step_halving.json."""
    afresh: bool = False
    """Work out again what is stored."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One fault in one pose, shaken."""

    fault: Fault
    pose: Array
    excitation: Excitation
    seed: int
    softened: bool
    """Whether the stops were made softer than drawn, for the step."""


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
    angles = [
        wrap_axial(np.array([np.arctan2(*r.lowest_direction[::-1]) for r in records]))
        for records in ladder
    ]
    means = [axial_mean(a) for a in angles]
    squares = [
        np.sum(axial_difference(a, m) ** 2) / (len(a) - 1)
        for a, m in zip(angles, means, strict=True)
    ]
    turned = abs(axial_difference(means[rung], means[rung + 1]))
    found["direction"] = np.array([turned / (TWO_SIDED * np.sqrt(np.mean(squares)))])
    return found


def work(case: tuple[str, float], *, settings: Settings) -> list[Row]:
    """Compare one candidate step of an arm with its halves; a row for each rung."""
    name, candidate = case
    arm = arm_named(name)
    cases = cases_of(arm, candidate, settings, count=settings.cases, duration=settings.duration)
    survey: dict[str, Any] = {"count": settings.surveyed, "duration": SURVEY_DURATION}
    many = cases_of(arm, candidate, settings, hardest=True, **survey)
    surveyed = [one[0] for one in measure(arm, many, candidate, settings, draws=1)]
    steps = [candidate / 2**k for k in range(HALVINGS + 1)]
    steps = [step for step in steps if step > 0.99 * FINEST]
    ladder = []
    for step in steps:
        ladder.append(measure(arm, cases, step, settings, draws=settings.records))
    rows = []
    for rung in range(len(steps) - 1):
        z: dict[str, list[float]] = {s: [] for s in STATISTICS}
        for k in range(len(cases)):
            draws = list(zip(*(found[k] for found in ladder), strict=True))
            whole = [draw for draw in draws if None not in draw]
            if len(whole) < 3:
                continue
            for statistic, values in changes(list(zip(*whole, strict=True)), rung).items():
                z[statistic] += values.tolist()
        records = [r for found in ladder[rung] for r in found]
        rows.append(
            {
                "arm": name,
                "candidate": candidate,
                "step": steps[rung],
                "records": len(records),
                "lost": sum(r is None for r in records),
                "softened": float(np.mean([one.softened for one in many])),
                "diverged": float(np.mean([r is None for r in surveyed])),
                "z": {statistic: summary(values) for statistic, values in z.items()},
            }
        )
    return rows


def summary(values: Sequence[float]) -> dict[str, float]:
    """Count, share below 1 and quantiles of z; infinite where nothing could be compared."""
    return {
        "count": len(values),
        "below_1": float(np.mean(np.array(values) < 1)) if values else 0.0,
        **{
            f"{100 * q:g} %": float(np.quantile(values, q)) if values else float("inf")
            for q in QUANTILES
        },
    }


def chance(settings: Settings) -> float:
    """Value of z that scatter alone exceeds once in twenty, no two records being alike."""
    return float(np.sqrt(2 / settings.records))


def show(rows: list[Row]) -> None:
    """Print quantiles of z by arm, step and statistic."""
    print(
        f"{'arm':<9} {'faults for':>10} {'step':>8} {'statistic':<27}"
        f" {'50 %':>6} {'90 %':>6} {'95 %':>6} {'max':>6} {'z < 1':>7}"
        f" {'diverged':>9} {'softened':>9}"
    )
    for row in rows:
        for statistic, label in STATISTICS.items():
            z = row["z"][statistic]
            quantiles = " ".join(f"{z[f'{100 * q:g} %']:6.2f}" for q in QUANTILES)
            print(
                f"{row['arm']:<9} {row['candidate'] * 1e6:7.4g} µs {row['step'] * 1e6:5.4g} µs"
                f" {label:<27} {quantiles} {100 * z['below_1']:5.0f} %"
                f" {100 * row['diverged']:7.1f} % {100 * row['softened']:7.0f} %"
            )


COLOURS = dict(zip(STATISTICS, ("#0072b2", "#d0451b", "#f0a30a", "#4a8f5c"), strict=True))


def draw(rows: list[Row], settings: Settings, path: Path) -> None:
    """Draw z against the step, a panel for every arm; its own step dashed."""
    panels = []
    for name in settings.arms:
        own = [r for r in rows if r["arm"] == name and r["step"] == r["candidate"]]
        own.sort(key=lambda r: r["step"])
        steps = [1e6 * r["step"] for r in own]
        curves = [curve(steps, [level] * len(steps), words, color=colour, linestyle=":")
                  for level, words, colour in ((1.0, "it shows in a record", INK),
                                               (chance(settings), "by chance", MUTED))]  # fmt: skip
        for statistic, colour in COLOURS.items():
            most, half = ([r["z"][statistic][q] for r in own] for q in ("95 %", "50 %"))
            look: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 4}
            curves.append(curve(steps, most, STATISTICS[statistic], **look))
            curves.append(curve(steps, half, **look | {"linestyle": ":", "marker": ""}))
        ticks = {"xticks": steps, "xticklabels": [f"{s:.4g}" for s in steps]}
        look = {"xscale": "log", "yscale": "log", "ylim": (1.5e-3, 12), **ticks}
        marks = [1e6 * arm_named(name).timestep]
        panels.append(Panel(title=name, curves=curves, marks=marks, look=look))
    across = "step h [µs]; vertical: change from h to h/2 over the interval of one record, z"
    size = {"columns": len(panels), "width": 1.2 + 2.4 * len(panels), "height": 3.4}
    save(chart(panels, across=across, sharey="all", **size), path, dpi=150)  # type: ignore[arg-type]


QUICK: dict[str, Any] = {"cases": 4, "records": 3, "surveyed": 40, "steps": (5e-4, 2e-4)}
"""Settings of a quick run."""


def halve(options: Options) -> None:
    """Work out what is missing, print the table and draw the figure."""
    settings = options.settings
    if options.quick:
        settings = dataclasses.replace(settings, **QUICK)
    path = options.out or ROOT / ("out" if options.quick else "docs/figures") / "step_halving.json"
    rows = study_rows(
        path,
        [(arm, step) for arm in settings.arms for step in settings.steps],
        work,
        lambda row: (row["arm"], row["candidate"]),
        script="scripts/studies/step_halving.py",
        settings=settings,
        unit="steps",
        afresh=options.afresh,
    )
    show(rows)
    draw(rows, settings, path.with_suffix(".png"))


if __name__ == "__main__":
    command("step_halving", __doc__, Options, halve, interrupted="the same command goes on")
