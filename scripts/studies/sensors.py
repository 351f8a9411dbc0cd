"""Study how many accelerometers a diagnosis needs, and where (thesis 8.3.3, 8.3.4).

Faults slide in a link's seat along a random direction, with little friction; every joint is
excited in turn in one random pose, on the same arm healthy and then with gaps from 0.003 to
0.4 mm. All sets of sensors are read from the same records: the tool's accelerometer alone, with
accelerometers on one link after the other, and with a single axis on each link along the tangent
of its own joint's motion. Each set says how surely a fault is there, which link has it and along
what it slides, against the same arm's healthy records and against the nominal arm.

The smallest detectable gap is where half (or 90 %) of the faults pass a threshold that 5 % of the
healthy arms pass. A healthy arm has the same seat with the same stops and the same friction, and
no gap: nothing but the gap can then be found. The nominal arm knows no such seat and takes the
give of its stops for a fault; so its threshold is also taken from arms whose seats are rigid.
Then it is the give that is found, whatever the gap.

Detection depends on friction and on the weight on a seat more than on the gap: friction is small
here, and the level is the arm's top one. Of several levels the one that finds most counts for
each gap. Gaps below a micrometre are there to show where detection ends: real surfaces are
rougher.

Usage: python scripts/studies/sensors.py [--quick] [--arms vera planar4] [--levels 1 2]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logsumexp

import loose_env
from loose_env.arms import Arm, LinearArm, planar, scara, six_axis, vera
from loose_env.diagnosis import (
    SensedArm,
    SensorRows,
    SensorVerdict,
    StackedRecord,
    rows_of,
    splitting_order,
    stack,
    weigh_links,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import at_levels
from loose_env.faults import Fault, Healthy, StructuralLooseness
from loose_env.report import study_head, write_study
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.statistics import axial_angle_between
from loose_env.typing import Array

Records = Sequence[StackedRecord] | None
Score = tuple[float, bool, float, bool, float]
"""Log odds of a fault, whether the link is right, error of the direction [deg], whether that is
within two standard deviations, probability stated for the link named."""

ROOT = Path(__file__).resolve().parents[2]
ARMS: dict[str, Callable[[], Arm]] = {
    "vera": vera,
    "planar4": lambda: planar(4),
    "planar4v": lambda: planar(4, vertical=True),
    "six_axis": six_axis,
    "scara": scara,
}
GAPS = np.geomspace(0.0001e-3, 0.4e-3, 9)
"""Gaps that are tried [m]."""
KNOWN_FROM = 0.02e-3
"""Smallest gap of which directions and links are scored [m]: the least that arms are said to have.
"""
FALSE_ALARMS = 0.05
REFERENCES = ("healthy", "nominal", "nominal, rigid")
"""What records are compared with: those of the same arm when it was healthy, or the nominal arm;
and the nominal arm again where healthy arms have rigid seats."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What a study depends on."""

    arms: tuple[str, ...]
    cases: int = 24
    """True arms, each with a fault of its own; links take turns."""
    levels: tuple[int, ...] = (3,)
    """Levels of the arm, from 1, each simulated."""
    friction: tuple[float, float] = (0.02, 0.1)
    """Guide friction over the seat drive of the top level, log-uniform [1]."""
    duration: float = 0.6
    """Length of a record [s]; there is one for each joint."""
    seed: int = 0


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class SensorSet:
    """One way to instrument an arm."""

    name: str
    family: str
    """"growing": the tool and some links; "tangential" and "links only" as they say."""
    rows: SensorRows
    sensors: int


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One true arm in one pose."""

    number: int
    link: int
    fault: StructuralLooseness
    pose: Array
    truth: Array
    """Sliding direction in the world of the nominal arm (3,)."""

    def with_gap(self, gap: float) -> StructuralLooseness:
        """Return the case's fault with another gap [m]; the arm is healthy with none."""
        return dataclasses.replace(self.fault, gap=gap)


def sensor_sets(arm: Arm) -> list[SensorSet]:
    """List the sets of sensors of an arm, few channels first within each family."""
    order = splitting_order(arm.n)
    every, tangents = LinkAccelerometers(), LinkAccelerometers(tangential=True)
    sets = [SensorSet(name="tool", family="growing", rows=rows_of(arm, None), sensors=1)]
    for count in range(1, arm.n + 1):
        links = tuple(sorted(order[:count]))
        sets.append(
            SensorSet(
                name=f"tool + link{'s' if count > 1 else ''} {', '.join(map(str, links))}",
                family="growing",
                rows=rows_of(arm, dataclasses.replace(every, links=links)),
                sensors=1 + count,
            )
        )
    for name, family, tool in (
        ("tool + all links, tangential", "tangential", True),
        ("all links, tangential, no tool", "links only", False),
    ):
        rows = rows_of(arm, tangents, tool=tool)
        sets.append(SensorSet(name=name, family=family, rows=rows, sensors=arm.n + tool))
    return sets


class Study:
    """Simulates one arm and weighs its records with every set of sensors."""

    def __init__(self, name: str, settings: Settings, tell: Callable[[str], None]) -> None:
        self.name, self.settings, self.tell = name, settings, tell
        self.arm = arm = ARMS[name]()
        self.linear = LinearArm(arm)
        self.difficulty = Difficulty(friction=settings.friction)
        every = LinkAccelerometers()
        self.sensed = SensedArm(arm, links=every.on(arm), mismatch=self.difficulty.mismatch)
        self.full = rows_of(arm, every)
        self.sets = sensor_sets(arm)
        self.parts = [self.full.projection(s.rows) for s in self.sets]
        self.rig = SimulatedRig(
            arm, slots=settings.cases, sensors=SensorSuite(link_accelerometers=every)
        )
        self.index = list(ARMS).index(name)
        self.cases = self._draw()

    def _rng(self, *where: int) -> np.random.Generator:
        return np.random.default_rng(
            np.random.SeedSequence([self.settings.seed, self.index, *where])
        )

    def _draw(self) -> list[Case]:
        sampler = FaultSampler(self.linear, self.difficulty)
        cases = []
        for k in range(self.settings.cases):
            rng = self._rng(k)
            link = 1 + k % self.arm.n
            fault = sampler.draw(rng, hypothesis=f"structural_looseness@link{link}")
            assert isinstance(fault, StructuralLooseness)
            pose = self.arm.random_pose(rng)
            turn = self.sensed.at(pose, [True] + [False] * (self.arm.n - 1)).orientation[link - 1]
            cases.append(
                Case(
                    number=k,
                    link=link,
                    fault=fault,
                    pose=pose,
                    truth=turn @ np.array(fault.direction),
                )
            )
        return cases

    def measure(self, level: int, kind: int, faults: Sequence[Fault]) -> list[Records]:
        """Records of all cases with these faults: a list of one for each joint, or None."""
        found: list[list[StackedRecord] | None] = [[] for _ in self.cases]
        for case, fault in zip(self.cases, faults, strict=True):
            self.rig.mount(
                case.number,
                fault,
                self.difficulty.mismatch.draw(self.arm, self._rng(case.number, 1)),
            )
        for joint in range(self.arm.n):
            jobs = []
            for case in self.cases:
                levels = np.zeros(self.arm.n)
                levels[joint] = self.arm.levels[level - 1]
                shake, _ = at_levels(
                    self.linear.at(case.pose), levels, duration=self.settings.duration
                )
                if shake.torque_rms[joint] > 0:  # else the joint's weight takes all its torque
                    rng = self._rng(case.number, 2, level, kind, joint)
                    jobs.append(Job(slot=case.number, pose=case.pose, excitation=shake, rng=rng))
            for k, measurement in self.rig.measure_each(jobs):
                slot = jobs[k].slot
                so_far = found[slot]
                if measurement.failure is not None:
                    found[slot] = None
                elif so_far is not None:
                    so_far.append(stack(measurement, self.full))
        return list(found)

    def weigh(self, records: Records, reference: Records) -> list[list[SensorVerdict]]:
        """Verdicts of every set of sensors with either reference; empty if a record failed."""
        if not records or not reference:
            return []
        verdicts = []
        for sensors, part in zip(self.sets, self.parts, strict=True):
            now = [r.projected(part) for r in records]
            before = [r.projected(part) for r in reference]
            verdicts.append(
                [
                    weigh_links(
                        self.sensed, sensors.rows, now, against, mismatch=self.difficulty.mismatch
                    )
                    for against in (before, None)
                ]
            )
        return verdicts

    def run(self) -> list[dict[str, Any]]:
        """Simulate and weigh; give a row for each set of sensors and reference."""
        shape = (len(self.settings.levels), len(self.sets), len(REFERENCES))
        healthy: dict[tuple[int, ...], list[float]] = {i: [] for i in np.ndindex(shape)}
        faulty: dict[tuple[int, ...], list[list[Score]]] = {
            i: [[] for _ in GAPS] for i in np.ndindex(shape)
        }
        for a, level in enumerate(self.settings.levels):
            shut = [case.with_gap(0.0) for case in self.cases]
            reference = self.measure(level, 0, shut)
            for kind in (1, 2):  # two sets of healthy records, for a steadier threshold
                for before, now in zip(reference, self.measure(level, kind, shut), strict=True):
                    for s, pair in enumerate(self.weigh(now, before)):
                        for r, verdict in enumerate(pair):
                            healthy[a, s, r].append(verdict.odds)
            # Arms whose seats are rigid, for the nominal arm alone.
            for now in self.measure(level, 9, [Healthy()] * len(self.cases)):
                for s, pair in enumerate(self.weigh(now, now)):
                    healthy[a, s, 2].append(pair[1].odds)
            self.tell(f"{self.name}: level {level}, healthy")
            for g, gap in enumerate(GAPS):
                faults = [case.with_gap(float(gap)) for case in self.cases]
                measured = self.measure(level, 10 + g, faults)
                for case, before, now in zip(self.cases, reference, measured, strict=True):
                    for s, pair in enumerate(self.weigh(now, before)):
                        for r, verdict in enumerate([*pair, pair[1]]):
                            faulty[a, s, r][g].append(score(verdict, case))
                self.tell(f"{self.name}: level {level}, gap {g + 1} of {len(GAPS)}")
        rows = []
        for s, sensors in enumerate(self.sets):
            for r, reference_name in enumerate(REFERENCES):
                levels = range(len(self.settings.levels))
                rows.append(
                    {
                        "arm": self.name,
                        "sensors": sensors.name,
                        "family": sensors.family,
                        "count": sensors.sensors,
                        "channels": len(sensors.rows),
                        "reference": reference_name,
                    }
                    | figures_of(
                        [healthy[a, s, r] for a in levels], [faulty[a, s, r] for a in levels]
                    )
                )
        return rows


def score(verdict: SensorVerdict, case: Case) -> Score:
    """Compare a verdict with the truth; see `Score`."""
    k = verdict.link - 1
    angle = axial_angle_between(verdict.world[k], case.truth)
    said = float(np.exp(verdict.evidence[k] - logsumexp(verdict.evidence)))
    right, inside = verdict.link == case.link, angle <= 2 * float(verdict.spread[k])
    return verdict.odds, right, float(np.degrees(angle)), inside, said


def figures_of(
    healthy: Sequence[Sequence[float]],
    faulty: Sequence[Sequence[Sequence[Score]]],
) -> dict[str, Any]:
    """Accuracy and detection from the odds of healthy arms and the scores of faulty ones.

    Both are given for each level, faulty arms for each gap too. The best level of a gap is that
    which detects most.
    """
    detected, threshold = np.zeros((len(healthy), len(GAPS))), []
    for a, (sound, found) in enumerate(zip(healthy, faulty, strict=True)):
        threshold.append(float(np.quantile(sound, 1 - FALSE_ALARMS, method="higher")))
        for g, scores in enumerate(found):
            detected[a, g] = np.mean([s[0] > threshold[a] for s in scores])
    best = np.argmax(detected, axis=0)
    share = detected.max(axis=0)
    named = [s for g, a in enumerate(best) if GAPS[g] >= KNOWN_FROM for s in faulty[a][g]]
    caught = [
        s
        for g, a in enumerate(best)
        if GAPS[g] >= KNOWN_FROM
        for s in faulty[a][g]
        if s[0] > threshold[a]
    ]
    return {
        "healthy_cases": len(healthy[0]),
        "threshold": threshold,
        "detected": share.tolist(),
        "best_level": best.tolist(),
        "gap_half_mm": smallest_gap(share, 0.5),
        "gap_most_mm": smallest_gap(share, 0.9),
        "cases": len(named),
        "found": len(caught) / len(named),
        "link_right": float(np.mean([s[1] for s in named])),
        "link_right_found": float(np.mean([s[1] for s in caught])) if caught else None,
        "direction_error": float(np.median([s[2] for s in named])),
        "direction_error_found": float(np.median([s[2] for s in caught])) if caught else None,
        "link_said_found": float(np.mean([s[4] for s in caught])) if caught else None,
        "within_two_sd": float(np.mean([s[3] for s in caught])) if caught else None,
    }


def smallest_gap(share: Array, wanted: float) -> float | None:
    """Gap at which a rising share of detections reaches what is wanted [mm].

    Shares are made to rise with the gap (isotonic regression) and joined by lines in its
    logarithm. The smallest gap tried stands for anything below it; None: not reached.
    """
    rising = np.array(
        [
            max(
                min(float(np.mean(share[i : j + 1])) for j in range(k, len(share)))
                for i in range(k + 1)
            )
            for k in range(len(share))
        ]
    )
    reached = np.flatnonzero(rising >= wanted)
    if len(reached) == 0:
        return None
    k = int(reached[0])
    if k == 0:
        return float(1e3 * GAPS[0])
    part = (wanted - rising[k - 1]) / (rising[k] - rising[k - 1])
    return float(1e3 * np.exp((1 - part) * np.log(GAPS[k - 1]) + part * np.log(GAPS[k])))


def print_table(rows: Sequence[dict[str, Any]]) -> None:
    """Print a line for each arm and set: healthy reference / nominal / with rigid seats.

    Of the faults that were found: how probable the link named was said to be beside how often it
    was right, and how often the true direction lay within two standard deviations.
    """
    print(
        f"{'arm':9} {'sensors':34} {'axes':>4}  {'direction [deg]':>15}  {'link right [%]':>14}  "
        f"{'found: right [%]':>16}  {'said [%]':>9}  {'in 2 sd [%]':>11}  "
        f"{'half found from [mm]':>27}  {'90 % from [mm]':>27}"
    )
    for group in zip(rows[::3], rows[1::3], rows[2::3], strict=True):
        head = group[0]
        error, right, found, said, inside, half, most = (
            " / ".join(form(row[key]) for row in group[:count])
            for key, form, count in (
                ("direction_error", "{:.1f}".format, 2),
                ("link_right", percent, 2),
                ("link_right_found", percent, 2),
                ("link_said_found", percent, 2),
                ("within_two_sd", percent, 2),
                ("gap_half_mm", gap_text, 3),
                ("gap_most_mm", gap_text, 3),
            )
        )
        print(
            f"{head['arm']:9} {head['sensors']:34} {head['channels']:4d}  "
            f"{error:>15}  {right:>14}  {found:>16}  {said:>9}  {inside:>11}  "
            f"{half:>27}  {most:>27}"
        )


def percent(share: float | None) -> str:
    """Spell out a share [%]; a dash where there was nothing to count."""
    return "-" if share is None else f"{100 * share:.0f}"


def gap_text(gap: float | None) -> str:
    """Spell out a smallest gap [mm]."""
    if gap is None:
        return f"> {1e3 * GAPS[-1]:.2g}"
    return f"< {gap:.2g}" if gap <= 1.001e3 * GAPS[0] else f"{gap:.2g}"


def draw_figure(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw links named right, direction error and smallest gap against the number of axes."""
    from matplotlib.figure import Figure

    families = {
        "growing": ("tool, then links one by one", "#0072b2", "o", "-"),
        "tangential": ("tool and all links, tangential only", "#d0451b", "s", "none"),
        "links only": ("all links tangential, no tool", "#5b8c5a", "D", "none"),
    }
    ink, muted, faint = "#1b2128", "#66717d", "#c9d0d7"
    arms = list(dict.fromkeys(row["arm"] for row in rows))
    figures: tuple[tuple[str, Callable[[dict[str, Any]], float]], ...] = (
        ("link named right [%]", lambda r: 100 * r["link_right"]),
        ("direction error [deg]", lambda r: r["direction_error"]),
        (
            "half found from gap [mm]",
            lambda r: 1e3 * GAPS[-1] * 1.5 if r["gap_half_mm"] is None else r["gap_half_mm"],
        ),
    )
    wide = len(arms) >= 3
    height, head = (7.0, 0.75) if wide else (7.6, 1.3)
    picture = Figure(figsize=(1.1 + 2.0 * len(arms), height))
    axes = picture.subplots(3, len(arms), sharey="row", squeeze=False)
    errors = [row["direction_error"] for row in rows]
    plain = "{x:g}"  # numbers on logarithmic axes
    for column, arm in enumerate(arms):
        for line, (label, figure) in enumerate(figures):
            panel = axes[line, column]
            for reference, fill in (("healthy", 1.0), ("nominal", 0.35)):
                for family, (name, colour, marker, style) in families.items():
                    own = [
                        r
                        for r in rows
                        if (r["arm"], r["family"], r["reference"]) == (arm, family, reference)
                    ]
                    panel.plot(
                        [r["channels"] for r in own],
                        [figure(r) for r in own],
                        linestyle=style,
                        color=colour,
                        alpha=fill,
                        marker=marker,
                        markersize=5,
                        markerfacecolor=colour if fill == 1 else "none",
                        linewidth=1.4,
                        label=f"{name}; {'healthy' if fill == 1 else 'nominal'} reference",
                    )
            if line == 0:
                panel.set_title(arm, fontsize=10, color=ink, loc="left")
                panel.set_ylim(0, 104)
            elif line == 1:
                panel.set_yscale("log")
                panel.set_ylim(0.8 * min(errors), 1.25 * max(errors))
                panel.yaxis.set_major_formatter(plain)
            else:
                panel.set_yscale("log")
                panel.set_ylim(0.7e3 * GAPS[0], 1e3 * GAPS[-1] * 2)
                panel.yaxis.set_major_formatter(plain)
                panel.axhline(1e3 * GAPS[-1], color=faint, linewidth=0.9, zorder=0)
                panel.set_xlabel("axes", color=muted)
            if column == 0:
                panel.set_ylabel(label, color=ink, fontsize=9)
            panel.tick_params(colors=muted, labelsize=8)
            panel.grid(color="#eef1f4", zorder=0)
            for side in ("top", "right"):
                panel.spines[side].set_visible(False)
            for side in ("left", "bottom"):
                panel.spines[side].set_color(faint)
    handles, names = axes[0, 0].get_legend_handles_labels()
    picture.legend(
        handles, names, loc="upper left", ncols=2 if wide else 1, frameon=False, fontsize=8
    )
    picture.tight_layout(rect=(0, 0, 1, 1 - head / height))
    beside = path.with_suffix(f".part{path.suffix}")
    picture.savefig(beside, dpi=150)
    os.replace(beside, path)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, print its table, write its picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS), metavar="ARM")
    parser.add_argument("--cases", type=int, help="true arms and faults for each arm, 2 or more")
    parser.add_argument("--levels", type=int, nargs="+", default=[3], help="from 1; default 3")
    parser.add_argument("--duration", type=float, default=Settings.duration, help="of a record [s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="a rough look in a minute")
    parser.add_argument(
        "--out", type=Path, help="picture; default docs/figures/sensors_number.png, quick: out/"
    )
    parser.add_argument("--show", type=Path, help="print the table of a stored study and end")
    chosen = parser.parse_args(arguments)
    if chosen.show is not None:
        print_table(json.loads(chosen.show.read_text(encoding="utf-8"))["rows"])
        return
    cases = chosen.cases or (4 if chosen.quick else Settings.cases)
    if cases < 2:
        parser.error(f"cases must be 2 or more, got {cases}")
    for name in chosen.arms:
        most = len(ARMS[name]().levels)
        if any(not 1 <= level <= most for level in chosen.levels):
            parser.error(f"levels of {name} are 1 to {most}, got {chosen.levels}")
    settings = Settings(
        arms=tuple(chosen.arms),
        cases=cases,
        levels=tuple(chosen.levels),
        duration=chosen.duration,
        seed=chosen.seed,
    )
    folder = ROOT / ("out" if chosen.quick else "docs/figures")
    path: Path = chosen.out or folder / "sensors_number.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()

    def report(line: str) -> None:
        print(f"[{time.perf_counter() - started:4.0f} s] {line}", file=sys.stderr, flush=True)

    rows: list[dict[str, Any]] = []
    head = study_head(
        "scripts/studies/sensors.py",
        settings,
        version=loose_env.__version__,
        gaps_mm=(1e3 * GAPS).tolist(),
        scored_from_mm=1e3 * KNOWN_FROM,
        false_alarms=FALSE_ALARMS,
    )
    for name in settings.arms:
        rows += Study(name, settings, report).run()
        write_study(path.with_suffix(".json"), head, rows)
    report("done")
    print_table(rows)
    draw_figure(rows, path)
    print(f"\npicture: {path}\nfigures: {path.with_suffix('.json')}")


if __name__ == "__main__":
    main()
