"""Experiment Four: the looseness joint on the slide rig at four angles (6.3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from loose_env.excitation import Excitation
from loose_env.faults import Fault, Healthy
from loose_env.report import FigureCard
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.sensors import Accelerometer, SensorSuite
from loose_env.statistics import (
    axial_difference,
    kurtosis,
    lowest_correlation_direction,
    maximum_correlation,
    skewness,
)
from loose_env.thesis.ch6_experiments.shaken_vera.cases import RATE, Spread, from_y
from loose_env.thesis.ch6_experiments.shaken_vera.tables import axis_words, percent, spread_words
from loose_env.thesis.printed import printed
from loose_env.thesis.rigs.shaken_vera import SHAKEN_BAND
from loose_env.thesis.rigs.slide import BENCH, SLIDE, Mount, finger_tight, loosened, slide_rig
from loose_env.thesis.shared.plots import LoopPanel, Points, by_category, loop_panels
from loose_env.thesis.shared.sections import Section, Table
from loose_env.typing import Array

EQUATIONS: dict[str, str] = {
    "4.10": "loose_env.statistics.correlation.correlation_loop",
    "4.19": "loose_env.statistics.moments.skewness",
    "4.20": "loose_env.statistics.moments.kurtosis",
}
"""Function of each equation."""


RECORDS = 12
FORCE = 3.0
"""Rms force of the shaker [N]: the slide then moves with about 3 m/s²."""
GAIN_ERROR = 0.05
"""Error of the gain of one accelerometer against the other [1], a large one for a calibrated pair:
tried as an explanation of what the thesis saw of relative acceleration."""
_ALONG = (1.0, 0.0, 0.0)
TIGHT, FINGER, LOOSE = "high preload", "low preload", "looseness"
STATES: dict[str, Fault] = {
    TIGHT: Healthy(),
    FINGER: finger_tight(link=1, direction=_ALONG),
    LOOSE: loosened(link=1, direction=_ALONG),
}
"""States of the joint, the same figures at every angle."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One angle of the joint in one state, over all its records."""

    angle: float
    """Angle of the looseness joint from the slide's motion [rad] (β)."""
    records: tuple[Measurement, ...]
    """The records."""

    def pairs(self, *, relative: bool = False, gain: float = 1.0) -> list[tuple[Array, Array]]:
        """Acceleration of the slide (N,) and of the distal link in its own frame (2, N).

        With ``relative``, that of the slide is taken off the distal link's (4.1.4), read with
        ``gain`` [1].
        """
        c, s = np.cos(self.angle), np.sin(self.angle)
        turn = gain * np.array([[c, s], [-s, c]])
        return [
            (m.probes[SLIDE][0], m.tool - turn @ m.probes[SLIDE][:2] if relative else m.tool)
            for m in self.records
        ]

    def lowest(self, *, relative: bool = False, gain: float = 1.0) -> Spread:
        """Direction of lowest correlation from the link's x axis [rad]."""
        pairs = self.pairs(relative=relative, gain=gain)
        return Spread.of_axes([lowest_correlation_direction(x, a) for x, a in pairs])

    def maximum(self) -> Spread:
        """Maximum correlation over directions."""
        return Spread.of([maximum_correlation(x, a).value for x, a in self.pairs()])


def section(seed: int) -> Section:
    """Shake the rig at the four angles, bolted down and with the mounting screw loose."""
    bolted = {state: trials(seed, state, "bolted") for state in STATES}
    loose = {state: trials(seed, state, "loose") for state in (TIGHT, LOOSE)}
    return Section(
        key="experiment_four",
        title="Looseness motions on the slide rig (Experiment Four, 6.3.3)",
        finding=(
            "When preload is lost the direction of lowest correlation turns from across the motion "
            f"to the joint, {_along_joint(bolted[LOOSE]):.0f}° off (RMS of four angles; printed: "
            "at it)."
        ),
        words=_words(bolted, loose),
        tables=[_direction_table(bolted), _screw_table(loose)],
        cards=_cards(bolted),
        equations=EQUATIONS,
        left_out=[
            "Experiment Four: the drop of the maximum correlation with looseness. Across the "
            "joint the simulated guide is rigid, so that motion is passed on perfectly there.",
            "Experiment Four: skewness and kurtosis at 230° while tight, which the thesis puts "
            "down to a preload that was not high.",
        ],
    )


@lru_cache(maxsize=8)
def trials(seed: int, state: str, mount: Mount, *, records: int = RECORDS) -> tuple[Trial, ...]:
    """Measure one state of the joint at the four angles.

    ``state``: key of `STATES`. ``records``: records of each trial; the first ones are the same for
    any number.
    """
    found = []
    shake = Excitation(torque_rms=(0.0,), duration=1.2, band=SHAKEN_BAND, shaker_rms=FORCE)
    sensors = SensorSuite(rate=RATE, accelerometer=Accelerometer(bandwidth=0.45 * RATE))
    for k, degrees in enumerate(printed("experiment_four")["looseness_angle_deg"]):
        angle = float(np.radians(degrees))
        arm = slide_rig(looseness_angle=angle, mount=mount)
        rig = SimulatedRig(arm, slots=records, sensors=sensors)
        jobs = []
        for slot in range(records):
            rig.mount(slot, STATES[state])
            key = [seed, 4, list(STATES).index(state), mount == "loose", k, slot]
            rng = np.random.default_rng(key)
            jobs.append(Job(slot=slot, pose=np.zeros(1), excitation=shake, rng=rng))
        good = tuple(m for m in rig.measure_many(jobs) if m.failure is None)
        found.append(Trial(angle=angle, records=good))
    return tuple(found)


Trials = dict[str, tuple[Trial, ...]]


def _along_joint(trials: Sequence[Trial]) -> float:
    """RMS angle between the direction found and the joint's, the link's x axis [deg]."""
    turns = [axial_difference(t.lowest().mean, 0.0) for t in trials]
    return float(np.degrees(np.sqrt(np.mean(np.square(turns)))))


def _across_motion(trials: Sequence[Trial]) -> float:
    """RMS angle between the direction found and the perpendicular of the slide's motion [deg]."""
    turns = [axial_difference(t.lowest().mean, np.pi / 2 - t.angle) for t in trials]
    return float(np.degrees(np.sqrt(np.mean(np.square(turns)))))


def _kurtoses(trial: Trial) -> Spread:
    return Spread.of([float(kurtosis(a, _ALONG[:2])) for _, a in trial.pairs()])


def _words(bolted: Trials, loose: Trials) -> list[str]:
    figures = printed("experiment_four")
    tight, slack = bolted[TIGHT], bolted[LOOSE]
    risen = [
        f"{np.degrees(a.angle):.0f}°"
        for a, b in zip(slack, tight, strict=True)
        if _kurtoses(b).mean < figures["kurtosis_factor_without_looseness"] * _kurtoses(a).mean
    ]
    relative = [abs(np.degrees(axial_difference(a.lowest(relative=True).mean, 0.0))) for a in slack]
    still = [a.lowest(relative=True) for a in tight]
    scatter = [float(np.degrees(s.high - s.low) / 2) for s in still]
    mismatched = [
        abs(
            float(
                np.degrees(
                    axial_difference(a.lowest(relative=True, gain=1 + GAIN_ERROR).mean, np.pi / 2)
                )
            )
        )
        for a in slack
    ]
    screw = _along_joint(loose[LOOSE])
    bench = np.std([m.probes[BENCH][0] for m in slack[0].records])
    slide = np.std([m.probes[SLIDE][0] for m in slack[0].records])
    return [
        "A shaker pushes a slide; on it sits the looseness joint, at an angle β to the motion, "
        "with a distal link and two accelerometers. The slide's acceleration is correlated with "
        "the link's. Angles are counted so that the joint lies at 270° (90° as an axis), as in "
        "the thesis.",
        "Tight, the link moves along the slide's motion and nowhere else, so the direction of "
        f"lowest correlation is its perpendicular ({_across_motion(tight):.1f}° off). Loose, it "
        f"turns to the joint: {_along_joint(slack):.0f}° off (RMS over the four angles), as the "
        "thesis found. Kurtosis along the joint is at least ten times as high as with preload at "
        f"{len(risen)} of {len(slack)} angles; the thesis says "
        f"{figures['kurtosis_poses_with_that_factor']}.",
        "With the slide's motion taken off (relative acceleration, 4.1.4) the direction of lowest "
        f"correlation lies {min(relative):.1f}° to {max(relative):.1f}° from the joint at all "
        f"{len(slack)} angles, loose. A constant angle is a perfect indicator: turned by 90° it is "
        "the joint. What remains is what the joint did not pass on; it lies along the joint and is "
        "correlated with the slide, so nothing correlated lies across it. That contradicts the "
        "thesis, which saw no clear change of this direction between preload and looseness. "
        f"Tight, only noise remains here, and single records scatter by {min(scatter):.0f}° to "
        f"{max(scatter):.0f}° (half of the 95 % interval). The difference is unexplained. A gain "
        f"error of {percent(GAIN_ERROR)} between the two accelerometers moves the loose direction "
        f"by only {min(mismatched):.0f}° to {max(mismatched):.0f}°.",
        "With the screw of the mounting plate loose too, the plate slides and turns, and the "
        f"direction is {screw:.0f}° off (RMS) instead of {_along_joint(slack):.0f}°"
        + (
            ": general looseness hides the direction, as in the thesis's first trials."
            if screw > 2 * _along_joint(slack)
            else "."
        ),
        f"The bench moves with {percent(bench / slide, 1)} of the slide's acceleration, too little "
        "to have to be taken off.",
    ]


def _direction_table(bolted: Trials) -> Table:
    joint = printed("experiment_four")["looseness_deg"] % 180
    rows = []
    for k, tight in enumerate(bolted[TIGHT]):
        finger, slack = bolted[FINGER][k], bolted[LOOSE][k]
        rows.append(
            (
                f"{np.degrees(tight.angle):.0f}°",
                f"{from_y(np.pi / 2 - tight.angle):.0f}°",
                axis_words(tight.lowest()),
                axis_words(finger.lowest()),
                f"{joint}°",
                axis_words(slack.lowest()),
                axis_words(tight.lowest(relative=True)),
                axis_words(slack.lowest(relative=True)),
                spread_words(tight.maximum()),
                spread_words(slack.maximum()),
            )
        )
    return Table(
        caption="Direction of lowest correlation and maximum correlation (figures 6.26 to 6.29)",
        columns=(
            "β",
            "across the motion",
            "tight",
            "finger-tight",
            "joint, printed",
            "loose",
            "tight, relative acceleration",
            "loose, relative acceleration",
            "C tight",
            "C loose",
        ),
        rows=tuple(rows),
    )


def _screw_table(loose: Trials) -> Table:
    rows = [
        (
            f"{np.degrees(tight.angle):.0f}°",
            axis_words(tight.lowest()),
            axis_words(slack.lowest()),
            spread_words(tight.maximum()),
            spread_words(slack.maximum()),
        )
        for tight, slack in zip(loose[TIGHT], loose[LOOSE], strict=True)
    ]
    return Table(
        caption="The trial in which the mounting screw had lost its preload too",
        columns=("β", "seat tight", "seat loose", "C seat tight", "C seat loose"),
        rows=tuple(rows),
    )


def _cards(bolted: Trials) -> list[FigureCard]:
    names = (TIGHT, LOOSE, FINGER)
    angles = [f"{np.degrees(t.angle):.0f}°" for t in bolted[TIGHT]]

    def loops(relative: bool) -> list[LoopPanel]:
        return [
            LoopPanel(
                title=f"β = {angle}",
                loops=[bolted[name][k].pairs(relative=relative)[0] for name in used],
                direction=0.0,
            )
            for k, angle in enumerate(angles)
        ]

    used: tuple[str, ...] = names
    absolute = loop_panels(loops(False), names, columns=4)
    used = (TIGHT, LOOSE)
    relative = loop_panels(loops(True), used, columns=4)

    def moments(third: bool) -> list[Points]:
        moment = skewness if third else kurtosis
        points = []
        for name in names:
            spreads = [
                Spread.of([float(moment(a, _ALONG[:2])) for _, a in trial.pairs()])
                for trial in bolted[name]
            ]
            points.append(
                Points(
                    name=name,
                    values=[s.mean for s in spreads],
                    low=[s.low for s in spreads],
                    high=[s.high for s in spreads],
                )
            )
        return points

    return [
        FigureCard(
            title="Absolute acceleration (figures 6.26 to 6.29, left)",
            image=absolute,
            caption="Correlation with the slide along every direction, first record of each case; "
            "the line lies along the looseness joint.",
        ),
        FigureCard(
            title="Relative acceleration (figures 6.27 to 6.29, right)",
            image=relative,
            caption="The same with the slide's own motion taken off the distal link's: loose, the "
            "lowest correlation lies across the joint. Tight, only noise is left.",
        ),
        FigureCard(
            title="Skewness along the joint (figure 6.30)",
            image=by_category(
                moments(True), angles, ylabel="skewness", xlabel="angle β", symlog=1.0
            ),
            caption="Skewness of the distal link's acceleration along the joint; the two stops "
            "differ in stiffness.",
        ),
        FigureCard(
            title="Kurtosis along the joint (figure 6.31)",
            image=by_category(
                moments(False), angles, ylabel="kurtosis", xlabel="angle β", symlog=1.0
            ),
            caption="Kurtosis along the joint: zero for Gaussian motion, high where the seat "
            "strikes its stops.",
        ),
    ]
