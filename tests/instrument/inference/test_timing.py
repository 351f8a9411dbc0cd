"""Clock offsets, from the runs themselves."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from loose_env.instrument.inference.response.timing import clock_offset, clocks_of
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run
from tests.instrument.arms.blind_arm import runs, write_model

pytestmark = pytest.mark.slow

SETTINGS = DiagnoseSettings(poses=2, seconds=1.0)


def late(run: Run, seconds: float) -> Run:
    """The run with an accelerometer whose clock is late."""
    read = run.sensors["tool_acc"]
    moved = np.stack([np.interp(run.time - seconds, run.time, a) for a in read.T], axis=1)
    return dataclasses.replace(run, sensors={**run.sensors, "tool_acc": moved})


def bench_of(folder: Path, seconds: float, kind: str = "healthy") -> Workbench:
    bench = Workbench(write_model(folder), SETTINGS)
    for run in runs(kind, 3):
        bench.add(late(run, seconds) if seconds else run)
    return bench


@pytest.mark.parametrize("seconds", [5e-3, -5e-3])
def test_a_late_accelerometer_is_measured_and_named(tmp_path: Path, seconds: float) -> None:
    bench = bench_of(tmp_path, seconds)
    found = clock_offset(bench.uncertain, bench.suspect)
    assert found is not None and found.significant
    # Accelerometers of the suite are read half a sample early.
    assert found.seconds == pytest.approx(seconds, abs=6e-4)
    result = bench.diagnosis(plan=False)
    words = "late" if seconds > 0 else "early"
    assert any(f"ms {words}" in each for each in result.open_because)
    assert any("the accelerometers' clock is" in each for each in result.warnings)
    assert not result.settled


def test_a_late_accelerometer_names_no_fault(tmp_path: Path) -> None:
    assert bench_of(tmp_path, 5e-3).diagnosis(plan=False).fault.kind == "healthy"


def test_free_travel_is_estimated_on_one_clock(tmp_path: Path) -> None:
    whole = []
    for seconds in (0.0, 5e-3):
        bench = bench_of(tmp_path, seconds, "slide")
        clocks = clocks_of(bench.uncertain, bench.suspect)
        whole.append(bench._whole(clocks))
    for prompt, delayed in zip(*whole, strict=True):
        sites = [k for k, (r, _) in enumerate(prompt.row) if r.kind == "acceleration"]
        low = (prompt.frequency > 5) & (prompt.frequency < 60)  # linear interpolation is exact
        first, second = (x.readings[low][:, sites] for x in (prompt, delayed))
        assert np.linalg.norm(second - first) < 0.15 * np.linalg.norm(first)
