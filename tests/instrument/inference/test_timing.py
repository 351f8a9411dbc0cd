"""Clock offsets, from the runs themselves."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from loose_env.instrument.inference.response.timing import clock_offset, on_one_clock
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run
from tests.instrument.arms.blind_arm import runs, write_model

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


def test_a_common_clock_is_left_alone(tmp_path: Path) -> None:
    result = bench_of(tmp_path, 0.0).diagnosis(plan=False)
    assert not any("clock" in each for each in (*result.open_because, *result.warnings))


def test_shifting_back_leaves_no_offset(tmp_path: Path) -> None:
    bench = bench_of(tmp_path, 5e-3)
    lines, clocks = on_one_clock(bench.uncertain, bench.suspect)
    assert len(clocks) == 1
    again = clock_offset(bench.uncertain, lines)
    assert again is not None and abs(again.seconds) < 1e-4
