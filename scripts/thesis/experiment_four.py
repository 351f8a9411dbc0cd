"""Experiment Four: the looseness joint on the slide rig at four angles (6.3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from loose_env.excitation import Excitation
from loose_env.faults import Fault, Healthy
from loose_env.rig import Measurement
from loose_env.statistics import axial_difference
from loose_env.typing import Array
from scripts.thesis.estimators import (
    kurtosis,
    lowest_correlation_direction,
    maximum_correlation,
    skewness,
)
from scripts.thesis.page import Section, printed, section
from scripts.thesis.plots import LoopPanel, by_category, loop_panels
from scripts.thesis.rigs import (
    BENCH,
    SHAKEN_BAND,
    SLIDE,
    Mount,
    finger_tight,
    loosened,
    slide_rig,
)
from scripts.thesis.shaken_vera import (
    FINGER,
    LOOSE,
    TIGHT,
    Spread,
    from_y,
    measure_states,
    points_of,
)

RECORDS = 12
FORCE = 3.0
"""Rms force of the shaker [N]: the slide then moves with about 3 m/s²."""
GAIN_ERROR = 0.05
"""Error of the gain of one accelerometer against the other [1], a large one for a calibrated pair:
tried as an explanation of what the thesis saw of relative acceleration."""
_ALONG = (1.0, 0.0, 0.0)
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

    @property
    def name(self) -> str:
        """The angle."""
        return f"{np.degrees(self.angle):.0f}°"

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
        return Spread.of([maximum_correlation(x, a) for x, a in self.pairs()])

    def moments(self, *, third: bool) -> list[float]:
        """Skewness or kurtosis along the joint, record by record."""
        moment = skewness if third else kurtosis
        return [moment(a, _ALONG[:2]) for _, a in self.pairs()]


@lru_cache(maxsize=8)
def trials(seed: int, state: str, mount: Mount, *, records: int = RECORDS) -> tuple[Trial, ...]:
    """Measure one state at the four angles; the first records are the same for any number."""
    shake = Excitation(torque_rms=(0.0,), duration=1.2, band=SHAKEN_BAND, shaker_rms=FORCE)
    number, found = list(STATES).index(state), []
    for k, degrees in enumerate(printed("experiment_four")["looseness_angle_deg"]):
        angle = float(np.radians(degrees))
        slots = [
            (STATES[state], np.zeros(1), (seed, 4, number, mount == "loose", k, record))
            for record in range(records)
        ]
        measured = measure_states(slide_rig(looseness_angle=angle, mount=mount), shake, slots)
        found.append(Trial(angle=angle, records=tuple(m for m in measured if m.failure is None)))
    return tuple(found)


def _rms_turn(turns: Sequence[float]) -> float:
    """RMS of angles between axes [deg]."""
    return float(np.degrees(np.sqrt(np.mean(np.square(turns)))))


def _along_joint(trials: Sequence[Trial]) -> float:
    """RMS angle between the direction found and the joint's, the link's x axis [deg]."""
    return _rms_turn([axial_difference(t.lowest().mean, 0.0) for t in trials])


def experiment_four(seed: int) -> Section:
    """Shake the rig at the four angles, bolted down and with the mounting screw loose."""
    told, bolted = printed("experiment_four"), {s: trials(seed, s, "bolted") for s in STATES}
    screw = {state: trials(seed, state, "loose") for state in (TIGHT, LOOSE)}
    tight, finger, slack = bolted.values()
    joint = f"{told['looseness_deg'] % 180}°"
    off, off_screw = _along_joint(slack), _along_joint(screw[LOOSE])
    across = _rms_turn([axial_difference(t.lowest().mean, np.pi / 2 - t.angle) for t in tight])
    part = told["kurtosis_factor_without_looseness"]
    risen = sum(
        np.mean(b.moments(third=False)) < part * np.mean(a.moments(third=False))
        for a, b in zip(slack, tight, strict=True)
    )
    relative, mismatched = (
        [
            abs(float(np.degrees(axial_difference(a.lowest(relative=True, gain=g).mean, to))))
            for a in slack
        ]
        for g, to in ((1.0, 0.0), (1 + GAIN_ERROR, np.pi / 2))
    )
    still = [t.lowest(relative=True) for t in tight]
    scatter = [float(np.degrees(s.high - s.low) / 2) for s in still]
    spans = [(min(values), max(values)) for values in (relative, scatter, mismatched)]
    bench, slide = (np.std([m.probes[p][0] for m in slack[0].records]) for p in (BENCH, SLIDE))
    moves = bench / slide

    direction_rows = [
        (
            t.name,
            f"{from_y(np.pi / 2 - t.angle):.0f}°",
            t.lowest().axis(),
            f.lowest().axis(),
            joint,
            s.lowest().axis(),
            t.lowest(relative=True).axis(),
            s.lowest(relative=True).axis(),
            t.maximum().words(),
            s.maximum().words(),
        )
        for t, f, s in zip(tight, finger, slack, strict=True)
    ]
    screw_rows = [
        (
            t.name,
            *(x.lowest().axis() for x in (t, s)),
            *(x.maximum().words() for x in (t, s)),
        )
        for t, s in zip(*screw.values(), strict=True)
    ]
    names, angles = (TIGHT, LOOSE, FINGER), [t.name for t in tight]
    loops = [
        loop_panels(
            [
                LoopPanel(f"β = {a}", [bolted[n][k].pairs(relative=rel)[0] for n in used], 0.0)
                for k, a in enumerate(angles)
            ],
            used,
            columns=4,
        )
        for rel, used in ((False, names), (True, (TIGHT, LOOSE)))
    ]
    moments = [
        by_category(
            [points_of(name, [t.moments(third=third) for t in bolted[name]]) for name in names],
            angles,
            ylabel="skewness" if third else "kurtosis",
            xlabel="angle β",
            symlog=1.0,
        )
        for third in (True, False)
    ]
    return section("experiment_four", locals(), [direction_rows, screw_rows], [*loops, *moments])
