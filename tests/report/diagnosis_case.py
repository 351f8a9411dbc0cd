"""Diagnoses to make pages of: every kind of fault, sure and unsure, in the plane and in space."""

from __future__ import annotations

import tempfile
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.arms import DESK_ARM, Arm, arm_from_file, planar
from loose_env.instrument import (
    Diagnosis,
    Fault,
    Loop,
    NextMeasurement,
    RecordSeen,
    TransmissionSpectrum,
    Verdict,
)

LONG = "{}_of_the_left_arm_beside_the_conveyor_belt"
"""Joints and links as people name them: 44 letters and more."""


def desk() -> Arm:
    return arm_from_file(DESK_ARM)


def flat() -> Arm:
    return planar(3)


def lengthy() -> Arm:
    """The desk arm with long names."""
    text, arm = Path(DESK_ARM).read_text(encoding="utf-8"), desk()
    for name in (*arm.joints, *arm.seat_bodies):
        text = text.replace(f'"{name}"', f'"{LONG.format(name)}"')
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "long.xml")
        file.write_text(text, encoding="utf-8")
        return arm_from_file(file)


def spread(arm: Arm, best: str, probability: float, rng: np.random.Generator) -> dict[str, float]:
    """A posterior with this best hypothesis; the others share the rest unevenly."""
    names = ["healthy", *(f"structural_looseness@{body}" for body in arm.seat_bodies)]
    names += [f"backlash@{joint}" for joint in arm.joints]
    rest = iter(rng.dirichlet(np.full(len(names) - 1, 0.4)) * (1 - probability))
    return {name: probability if name == best else float(next(rest)) for name in names}


def loops(arm: Arm, joint: str, lost: Any, rng: np.random.Generator) -> tuple[Loop, ...]:
    """Loops of a record that loses most of the motion along a direction of the tool frame."""
    angles = np.linspace(0.0, 180.0, 91)
    sound = rng.normal(size=len(arm.axes))
    motion = sound if lost is None else sound - 0.8 * (sound @ lost) * lost
    found = []
    for i, j in combinations(range(len(arm.axes)), 2):
        ways = np.zeros((len(angles), len(arm.axes)))
        ways[:, i], ways[:, j] = np.cos(np.radians(angles)), np.sin(np.radians(angles))
        measured, expected = (ways @ m / np.sqrt((ways @ m) ** 2 + 0.1) for m in (motion, sound))
        plane: Any = "xyz"[arm.axes[i]] + "xyz"[arm.axes[j]]
        found.append(
            Loop(
                joint=joint,
                plane=plane,
                angle_deg=tuple(angles.tolist()),
                correlation=tuple(measured.tolist()),
                expected=tuple(expected.tolist()),
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
            predicted = {"healthy": tuple(healthy.tolist()), best: tuple(loose.tolist())}
            if best == "healthy":
                predicted[best] = tuple(healthy.tolist())
            true = healthy if "healthy" in (best, record.condition) else loose
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
    verdict: Verdict | None = None,
) -> Diagnosis:
    """A diagnosis whose best hypothesis became as probable as `course` says."""
    rng = np.random.default_rng(4)

    def pose() -> dict[str, float]:
        return dict(zip(arm.joints, arm.random_pose(rng).round(3).tolist(), strict=True))

    def direction() -> Any:
        axis = np.zeros(3)
        axis[list(arm.axes)] = rng.normal(size=len(arm.axes))
        return axis / np.linalg.norm(axis)

    link = kind == "structural_looseness"
    where = None if kind == "healthy" else (arm.seat_bodies if link else arm.joints)[place - 1]
    slides = link and known
    fault = Fault(
        kind=kind,
        where=where,
        direction=tuple(direction().tolist()) if slides else None,
        direction_half_angle_deg=6.0 if slides else None,
        gap_m=(1.2e-4 if link else 8e-4) if where and known else None,
        gap_interval_m=(0.8e-4, 2.1e-4) if slides else None,
    )
    best = "healthy" if where is None else f"{kind}@{where}"
    records = []
    for k in range(healthy + len(course)):
        joint, suspect = arm.joints[k % arm.n], k >= healthy
        lost = direction() if suspect and link else None
        own = None if lost is None else lost[list(arm.axes)]
        records.append(
            RecordSeen(
                file=f"run-{k + 1:02d}.parquet",
                pose=pose(),
                excited=(joint,),
                condition="suspect" if suspect else "healthy",
                probabilities=spread(arm, best, course[k - healthy], rng) if suspect else {},
                direction_tool=None if lost is None else tuple(lost.tolist()),
                half_angle_deg=None if lost is None else 9.0,
                loops=loops(arm, joint, own, rng) if suspect else (),
                notes=("3 % of the samples are missing.",) if k == healthy else (),
            )
        )
    settled = len(course) > 1 and course[-1] > 0.98 and verdict is None
    decided: Verdict = "healthy" if where is None else "faulty"
    planned = NextMeasurement(
        pose=pose(),
        joints=arm.joints[:2],
        band_hz=(30.0, 150.0),
        levels=(4.2, 7.7),
        torques=(1.3, 0.62),
        seconds=1.2,
        rate_hz=2000.0,
        reason="there the two links still in question would show directions 62° apart",
        gain=0.83,
    )
    return Diagnosis(
        fault=fault,
        probability=course[-1],
        posterior=records[-1].probabilities,
        next=planned if following else None,
        warnings=("gravity keeps the seat of link 1 shut in 2 of 3 poses",) if following else (),
        records=tuple(records),
        settings={"seed": 7, "sure": 0.98},
        settled=settled,
        verdict=verdict or (decided if settled else "open"),
        open_because=("one run alone makes the fault probable",) if verdict else (),
        misfit=0.31 if verdict == "model_mismatch" else np.nan,
        severities=("warning",) if following else (),
        spectra=spectra(records, best, np.random.default_rng(4)),
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
    "play in a joint": lambda: (desk(), diagnosis(desk(), kind="backlash", place=3)),
    "another model": lambda: (flat(), diagnosis(flat(), verdict="model_mismatch")),
    "long names": lambda: (lengthy(), diagnosis(lengthy(), place=4, following=True)),
    "healthy": lambda: (flat(), diagnosis(flat(), kind="healthy", course=(0.8, 0.99))),
}
