"""Transmission spectra of a diagnosis: measured, and by the hypotheses that explain them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from loose_env.errors import InvalidData
from loose_env.instrument import Diagnosis, TransmissionSpectrum
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from tests.instrument.arms.blind_arm import runs, write_model


def found(folder: Path, kind: str) -> Diagnosis:
    bench = Workbench(write_model(folder), DiagnoseSettings())
    for run in runs(kind, 2):
        bench.add(run)
    return bench.diagnosis(plan=False)


def error(spectrum: TransmissionSpectrum, hypothesis: str) -> float:
    """Rms log ratio of predicted and measured."""
    ratio = np.array(spectrum.predicted[hypothesis]) / np.array(spectrum.measured)
    return float(np.sqrt(np.mean(np.log(ratio) ** 2)))


def test_a_loose_link_transmits_as_its_own_hypothesis_predicts(tmp_path: Path) -> None:
    loose = found(tmp_path, "slide")
    assert [s.record for s in loose.spectra] == [0, 0, 0, 1, 1, 1]
    assert [s.channel[-1] for s in loose.spectra] == list("xyzxyz")
    for spectrum in loose.spectra:
        assert spectrum.joint == loose.records[spectrum.record].excited[0]
        if spectrum.channel.endswith("y"):
            continue  # the arm and the slide are in the plane of x and z
        own, healthy = (error(spectrum, h) for h in ("structural_looseness@link2", "healthy"))
        assert own < 0.8 * healthy
    assert loose.verdict == "faulty"
    assert loose.fault.hypothesis == "structural_looseness@link2"
    assert len(loose.severities) == len(loose.warnings)
    assert loose.version and len(loose.model_hash) == 16
    assert Diagnosis.from_json(loose.to_json()).spectra[0].joint == loose.spectra[0].joint


def test_a_healthy_arm_transmits_as_its_model_predicts(tmp_path: Path) -> None:
    healthy = found(tmp_path, "healthy")
    assert np.median([error(s, "healthy") for s in healthy.spectra]) < 0.1
    first = healthy.spectra[0]
    assert first.unit == "m/s² per N·m" and first.drive_rms > 0
    assert len(first.frequency_hz) > 16 and list(first.frequency_hz) == sorted(first.frequency_hz)


def test_amplitudes_that_are_none_are_refused() -> None:
    with pytest.raises(InvalidData, match="finite and not negative"):
        TransmissionSpectrum(
            record=0, joint="a", channel="t.x", unit="", drive_rms=1.0, frequency_hz=(1.0,),
            measured=(-1.0,),
        )  # fmt: skip
