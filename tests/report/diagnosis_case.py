"""Diagnoses to make pages of: every kind of fault, sure and unsure, in the plane and in space."""

from __future__ import annotations

import tempfile
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.arms import DESK_ARM, Arm, arm_from_file, planar
from loose_env.diagnosis import ToolFrames
from loose_env.envs import CorrelationByDirection
from loose_env.instrument import (
    Diagnosis,
    Fault,
    Loop,
    NextMeasurement,
    RecordSeen,
    TransmissionSpectrum,
    Verdict,
)

ANGLES = np.linspace(0.0, 180.0, 91)


def desk() -> Arm:
    return arm_from_file(DESK_ARM)


def flat() -> Arm:
    return planar(3)


LONG = "{}_of_the_left_arm_beside_the_conveyor_belt"
"""Joints and links as people name them: 44 letters and more."""


def lengthy() -> Arm:
    """The desk arm with long names."""
    text = Path(DESK_ARM).read_text(encoding="utf-8")
    arm = desk()
    for name in (*arm.joints, *arm.seat_bodies):
        text = text.replace(f'"{name}"', f'"{LONG.format(name)}"')
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "long.xml")
        file.write_text(text, encoding="utf-8")
        return arm_from_file(file)


def hypotheses(arm: Arm) -> list[str]:
    return [
        "healthy",
        *(f"structural_looseness@{body}" for body in arm.seat_bodies),
        *(f"backlash@{joint}" for joint in arm.joints),
    ]


def spread(arm: Arm, best: str, probability: float, rng: np.random.Generator) -> dict[str, float]:
    """A posterior with this best hypothesis; the others share what is left unevenly."""
    names = hypotheses(arm)
    rest = rng.dirichlet(np.full(len(names) - 1, 0.4)) * (1 - probability)
    others = iter(rest)
    return {name: probability if name == best else float(next(others)) for name in names}


def loops(arm: Arm, joint: str, lost: Any, rng: np.random.Generator) -> tuple[Loop, ...]:
    """Loops of a record that loses most of the motion along a direction of the tool frame."""
    d = len(arm.axes)
    sound = rng.normal(size=d)
    base = rng.normal(size=(d, d))
    noise = 0.05 * np.eye(d) + 0.02 * base @ base.T
    motion = sound if lost is None else sound - 0.8 * (sound @ lost) * lost
    wide = 0.0 if lost is None else 0.6
    loose = np.zeros((d, d)) if lost is None else np.outer(lost, lost)
    surfaces = [
        CorrelationByDirection(peak=motion, tool=np.outer(motion, motion) + noise + wide * loose),
        CorrelationByDirection(peak=sound, tool=np.outer(sound, sound) + noise),
    ]
    found = []
    for i, j in combinations(range(d), 2):
        ways = np.zeros((len(ANGLES), d))
        ways[:, i], ways[:, j] = np.cos(np.radians(ANGLES)), np.sin(np.radians(ANGLES))
        plane: Any = "xyz"[arm.axes[i]] + "xyz"[arm.axes[j]]
        measured, expected = (tuple(s.along(ways).tolist()) for s in surfaces)
        found.append(
            Loop(
                joint=joint,
                plane=plane,
                angle_deg=tuple(ANGLES.tolist()),
                correlation=measured,
                expected=expected,
            )
        )
    return tuple(found)


def spectra(
    records: list[RecordSeen], best: str, rng: np.random.Generator
) -> tuple[TransmissionSpectrum, ...]:
    """Transmissions of the runs: the measured one is that of the best hypothesis."""
    frequency = np.linspace(5.0, 120.0, 24)
    found = []
    for k, record in enumerate(records):
        for axis in "xyz":
            healthy = 1.0 / (1 + (frequency / rng.uniform(20, 60)) ** 2) + 0.05
            loose = healthy * (1 - 0.6 * np.exp(-(((frequency - 50) / 25) ** 2)))
            sound = best == "healthy" or record.condition == "healthy"
            predicted = {"healthy": tuple(healthy.tolist())}
            if best != "healthy":
                predicted[best] = tuple(loose.tolist())
            true = healthy if sound else loose
            found.append(
                TransmissionSpectrum(
                    record=k,
                    joint=record.excited[0],
                    channel=f"tool_acc.{axis}",
                    unit="m/s² per N·m",
                    drive_rms=1.0,
                    frequency_hz=tuple(frequency.tolist()),
                    measured=tuple((true * np.exp(0.05 * rng.normal(size=24))).tolist()),
                    predicted=predicted,
                )
            )
    return tuple(found)


def diagnosis(
    arm: Arm,
    *,
    kind: Any = "structural_looseness",
    place: int = 2,
    course: tuple[float, ...] = (0.35, 0.7, 0.985),
    healthy: int = 1,
    known: bool = True,
    following: bool = False,
    seed: int = 4,
    verdict: Verdict | None = None,
) -> Diagnosis:
    """A diagnosis whose best hypothesis became as probable as `course` says."""
    rng = np.random.default_rng(seed)
    frames = ToolFrames(arm)
    where = {
        "healthy": None,
        "structural_looseness": arm.seat_bodies[place - 1],
        "backlash": arm.joints[place - 1],
    }[kind]
    axis = np.zeros(3)
    axis[list(arm.axes)] = rng.normal(size=len(arm.axes))
    axis /= np.linalg.norm(axis)
    slides = kind == "structural_looseness" and known
    fault = Fault(
        kind=kind,
        where=where,
        direction=tuple(axis.tolist()) if slides else None,
        direction_half_angle_deg=6.0 if slides else None,
        gap_m=(1.2e-4 if kind == "structural_looseness" else 8e-4) if where and known else None,
        gap_interval_m=(0.8e-4, 2.1e-4) if slides else None,
    )
    best = "healthy" if where is None else f"{kind}@{where}"
    records = []
    for k in range(healthy + len(course)):
        pose = dict(zip(arm.joints, arm.random_pose(rng).round(3).tolist(), strict=True))
        joint = arm.joints[k % arm.n]
        suspect = k >= healthy
        lost = None
        if suspect and kind == "structural_looseness":
            del frames  # the direction of a link in the tool frame, by MuJoCo's own frames
            frames = ToolFrames(arm)
            lost = rng.normal(size=len(arm.axes))
            lost /= np.linalg.norm(lost)
        tool = None
        if lost is not None:
            tool = np.zeros(3)
            tool[list(arm.axes)] = lost
        records.append(
            RecordSeen(
                file=f"run-{k + 1:02d}.parquet",
                pose=pose,
                excited=(joint,),
                condition="suspect" if suspect else "healthy",
                probabilities=spread(arm, best, course[k - healthy], rng) if suspect else {},
                direction_tool=None if tool is None else tuple(tool.tolist()),
                half_angle_deg=None if tool is None else 9.0,
                loops=loops(arm, joint, lost, rng) if suspect else (),
                notes=("3 % of the samples are missing.",) if k == healthy else (),
            )
        )
    pose = dict(zip(arm.joints, arm.random_pose(rng).round(3).tolist(), strict=True))
    played = arm.joints[:2]
    settled = len(course) > 1 and course[-1] > 0.98 and verdict is None
    decided: Verdict = "healthy" if where is None else "faulty"
    return Diagnosis(
        fault=fault,
        probability=course[-1],
        posterior=spread(arm, best, course[-1], rng) if not records else records[-1].probabilities,
        next=NextMeasurement(
            pose=pose,
            joints=played,
            band_hz=(30.0, 150.0),
            levels=(4.2, 7.7),
            torques=(1.3, 0.62),
            seconds=1.2,
            rate_hz=2000.0,
            reason="there the two links still in question would show directions 62° apart",
            gain=0.83,
        )
        if following
        else None,
        warnings=("gravity keeps the seat of link 1 shut in 2 of 3 poses",) if following else (),
        records=tuple(records),
        settings={"seed": 7, "sure": 0.98},
        settled=settled,
        verdict=verdict or (decided if settled else "open"),
        open_because=("one run alone makes the fault probable",) if verdict else (),
        misfit=0.31 if verdict == "model_mismatch" else np.nan,
        severities=("warning",) if following else (),
        spectra=spectra(records, best, np.random.default_rng(seed)),
        date="2026-03-18T14:05:00+00:00",
        version="0.1.0",
        model_hash="0123456789abcdef",
    )


CASES: dict[str, Any] = {
    "loose link in space": lambda: (desk(), diagnosis(desk(), place=4)),
    "loose link in the plane": lambda: (flat(), diagnosis(flat())),
    "not decided": lambda: (
        desk(),
        diagnosis(desk(), course=(0.2, 0.45), following=True, healthy=0, known=False),
    ),
    "probable, in the plane": lambda: (
        flat(),
        diagnosis(flat(), course=(0.3, 0.8), following=True),
    ),
    "play in a joint": lambda: (desk(), diagnosis(desk(), kind="backlash", place=3)),
    "another model": lambda: (flat(), diagnosis(flat(), verdict="model_mismatch")),
    "long names": lambda: (lengthy(), diagnosis(lengthy(), place=4, following=True)),
    "healthy": lambda: (flat(), diagnosis(flat(), kind="healthy", course=(0.8, 0.99))),
}
