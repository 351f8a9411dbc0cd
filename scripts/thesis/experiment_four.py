"""Experiment Four, simulated: slide rig shaken at four angles of its joint, tight and loose."""

from __future__ import annotations

import numpy as np

from loose_env.excitation import Excitation
from loose_env.faults import Fault, Healthy
from loose_env.statistics import axial_difference
from scripts.thesis.page import Section, printed, section
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
    Case,
    from_y,
    loops_of,
    measure_case,
    moment_figures,
    turn_of,
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
"""States of the joint, the same figures at every angle; its direction is the link's x axis."""


def trials(seed: int, state: str, mount: Mount) -> list[Case]:
    """Measure one state at the four angles of the joint from the slide's motion (β)."""
    shake = Excitation(torque_rms=(0.0,), duration=1.2, band=SHAKEN_BAND, shaker_rms=FORCE)
    number, degrees = list(STATES).index(state), printed("experiment_four")["looseness_angle_deg"]
    return [
        measure_case(
            slide_rig(looseness_angle=float(np.radians(angle)), mount=mount),
            STATES[state],
            shake,
            (seed, 4, number, mount == "loose", k),
            angle=float(np.radians(angle)),
            pair=lambda m: (m.probes[SLIDE][0], m.tool),
            records=RECORDS,
        )
        for k, angle in enumerate(degrees)
    ]


def relative(case: Case, *, gain: float = 1.0) -> Case:
    """Take the acceleration of the slide, read with a gain [1], off the distal link's (4.1.4)."""
    c, s = np.cos(case.angle), np.sin(case.angle)
    turn = gain * np.array([[c, s], [-s, c]])
    pairs = [(m.probes[SLIDE][0], m.tool - turn @ m.probes[SLIDE][:2]) for m in case.records]
    return Case(angle=case.angle, pairs=pairs)


def experiment_four(seed: int) -> Section:
    """Shake the rig at the four angles, bolted down and with the mounting screw loose."""
    told, bolted = printed("experiment_four"), {s: trials(seed, s, "bolted") for s in STATES}
    screw = {state: trials(seed, state, "loose") for state in (TIGHT, LOOSE)}
    tight, finger, slack = bolted.values()
    joint = f"{told['looseness_deg'] % 180}°"
    off, off_screw = (
        turn_of([case.lowest.mean for case in cases], [0.0]) for cases in (slack, screw[LOOSE])
    )
    across = turn_of([t.lowest.mean for t in tight], [np.pi / 2 - t.angle for t in tight])
    part = told["kurtosis_factor_without_looseness"]
    risen = sum(
        np.mean(b.moments(0.0, third=False)) < part * np.mean(a.moments(0.0, third=False))
        for a, b in zip(slack, tight, strict=True)
    )
    still, moving = ([relative(case) for case in cases] for cases in (tight, slack))
    misread = [relative(case, gain=1 + GAIN_ERROR) for case in slack]
    scatter = [float(np.degrees(s.lowest.high - s.lowest.low) / 2) for s in still]
    shown, mismatched = (
        [abs(float(np.degrees(axial_difference(case.lowest.mean, to)))) for case in cases]
        for cases, to in ((moving, 0.0), (misread, np.pi / 2))
    )
    spans = [(min(values), max(values)) for values in (shown, scatter, mismatched)]
    bench, slide = (np.std([m.probes[p][0] for m in slack[0].records]) for p in (BENCH, SLIDE))
    moves = bench / slide
    expected = [from_y(np.pi / 2 - t.angle) for t in tight]
    names = (TIGHT, LOOSE, FINGER)
    return section(
        "experiment_four",
        locals(),
        [
            zip(tight, finger, slack, expected, still, moving, strict=True),
            zip(*screw.values(), strict=True),
        ],
        [
            loops_of(bolted, names, 0.0, "β", columns=4),
            loops_of({TIGHT: still, LOOSE: moving}, names[:2], 0.0, "β", columns=4),
            *moment_figures(bolted, names, 0.0, "angle β"),
        ],
    )
