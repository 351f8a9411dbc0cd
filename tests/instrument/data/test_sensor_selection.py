"""Sensors that are slow, that miss samples, that stand still, or that nobody asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.importing.timing.resampling import resampled
from loose_env.instrument.data.held_pose import run_setup
from loose_env.instrument.data.sensor_selection import readings_in
from loose_env.instrument.data.spectral_lines import Lines, lines_of
from loose_env.instrument.model.instrumented_arm import read_recorded_arm
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run
from tests.instrument.arms.blind_arm import runs, write_model

SETTINGS = DiagnoseSettings(poses=2, seconds=1.0)


def with_sensors(run: Run, change: Callable[[str, np.ndarray], np.ndarray]) -> Run:
    sensors = {name: change(name, values) for name, values in run.sensors.items()}
    return dataclasses.replace(run, sensors=sensors)


def slow_joints(run: Run, every: int, jitter: float = 0.0) -> Run:
    """Joint sensors read at a part of the rate, brought to the rows as an import does."""
    rng = np.random.default_rng(0)

    def slow(name: str, values: np.ndarray) -> np.ndarray:
        if name == "tool_acc":
            return values
        stamps = run.time[::every]
        stamps = stamps + jitter * rng.normal(size=len(stamps))
        read = np.interp(stamps, run.time, values)
        return resampled(stamps, read, run.time, 0.1).values

    return with_sensors(run, slow)


def lines(folder: Path, run: Run) -> Lines:
    machine = read_recorded_arm(write_model(folder))
    held = run_setup(machine, run)
    return lines_of(machine, run, held.pose, held.excited)


@pytest.mark.slow
@pytest.mark.parametrize(("every", "jitter"), [(8, 0.0), (8, 2e-4), (4, 0.0)])
def test_encoders_slower_than_the_rows_do_not_make_a_sound_arm_loose(
    tmp_path: Path, every: int, jitter: float
) -> None:
    bench = Workbench(write_model(tmp_path), SETTINGS)
    usual = Workbench(write_model(tmp_path), SETTINGS)
    for run in runs("healthy"):
        bench.add(slow_joints(run, every, jitter))
        usual.add(run)
    found, before = bench.diagnosis(plan=False), usual.diagnosis(plan=False)
    assert found.fault.kind == "healthy"
    assert found.probability > before.probability - 0.1
    assert not any("no sensor of the excited joint" in words for words in found.warnings)


def test_a_missing_sample_costs_no_sensor(tmp_path: Path) -> None:
    def missing(name: str, values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[700] = np.nan
        return values

    run = with_sensors(runs("healthy")[0], missing)
    assert [r.sensor for r, _ in lines(tmp_path, run).row] == [
        r.sensor for r, _ in lines(tmp_path, runs("healthy")[0]).row
    ]


def test_a_sensor_that_is_not_used_is_named(tmp_path: Path) -> None:
    def dead(name: str, values: np.ndarray) -> np.ndarray:
        return np.full_like(values, 0.25) if name == "joint2_vel" else values

    run = with_sensors(runs("healthy")[0], dead)
    machine = read_recorded_arm(write_model(tmp_path))
    used, notes = readings_in(machine, run)
    assert "joint2_vel" not in [reading.sensor for reading in used]
    assert any("joint2_vel is not used: it stands still" in note for note in notes)
    bench = Workbench(write_model(tmp_path), SETTINGS)
    bench.add(run)
    assert any("joint2_vel" in note for note in bench.diagnosis(plan=False).records[0].notes)
    assert readings_in(machine, runs("healthy")[0])[1] == ()


def test_a_sensor_of_numbers_that_no_arm_makes_is_refused(tmp_path: Path) -> None:
    run = with_sensors(runs("healthy")[0], lambda _, values: values * 1e9)
    with pytest.raises(InvalidData, match="no arm does"):
        readings_in(read_recorded_arm(write_model(tmp_path)), run)
