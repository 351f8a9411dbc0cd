"""Sessions of an arm of three joints, made of numbers alone."""

from __future__ import annotations

import numpy as np

from loose_env.instrument import Diagnosis, Fault, RecordSeen, TransmissionSpectrum

JOINTS, LINKS = ("base", "shoulder", "elbow"), ("column", "upper_arm", "forearm")
FREQUENCY = np.linspace(5.0, 100.0, 24)


def session(
    number: int,
    *,
    factor: dict[str, float] | None = None,
    scatter: float = 0.01,
    dated: bool = True,
    pose: float = 0.3,
    gap_m: float | None = None,
    faulty: float = 0.02,
) -> Diagnosis:
    """One session; `factor` multiplies the transmission of a joint above 50 Hz."""
    rng = np.random.default_rng(number)
    spectra, records = [], []
    for k, joint in enumerate(JOINTS):
        records.append(
            RecordSeen(
                file=f"run-{k}.csv", pose={j: pose + 0.1 * k for j in JOINTS}, excited=(joint,),
                condition="suspect", probabilities={},
            )
        )  # fmt: skip
        for axis in "xyz":
            level = np.exp(scatter * rng.normal()) * (1.0 + 20.0 / FREQUENCY)
            worn = np.where(FREQUENCY > 50, (factor or {}).get(joint, 1.0), 1.0)
            spectra.append(
                TransmissionSpectrum(
                    record=k, joint=joint, channel=f"tool.{axis}", unit="m/s² per N·m",
                    drive_rms=2.0 * np.exp(0.01 * rng.normal()),
                    frequency_hz=tuple(FREQUENCY.tolist()), measured=tuple((level * worn).tolist()),
                )
            )  # fmt: skip
    names = [f"structural_looseness@{x}" for x in LINKS] + [f"backlash@{x}" for x in JOINTS]
    posterior = {"healthy": 1 - faulty} | {name: faulty / 6 for name in names}
    fault = Fault(kind="healthy")
    if gap_m is not None:
        fault = Fault(kind="backlash", where="elbow", gap_m=gap_m)
    return Diagnosis(
        fault=fault, probability=posterior[fault.hypothesis], posterior=posterior,
        records=tuple(records), spectra=tuple(spectra),
        date=f"2025-{1 + number // 28:02d}-{1 + number % 28:02d}" if dated else "",
    )  # fmt: skip


def named(count: int) -> list[tuple[str, Diagnosis]]:
    """Healthy sessions and their names."""
    return [(f"session {k}", session(k)) for k in range(count)]
