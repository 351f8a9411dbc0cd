"""Runs in which the recorder left something out, and stamps that no run has."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.instrument.data.dropouts import unbroken
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run
from tests.instrument.arms.blind_arm import runs, write_model

SETTINGS = DiagnoseSettings(poses=2, seconds=1.0)
Rows = np.ndarray


def rows(run: Run, kept: Rows) -> Run:
    """A run of which only some rows were written."""
    return dataclasses.replace(
        run,
        time=run.time[kept],
        controls={k: v[kept] for k, v in run.controls.items()},
        sensors={k: v[kept] for k, v in run.sensors.items()},
        torques={k: v[kept] for k, v in run.torques.items()},
    )


def missing(run: Run, sensor: str, where: slice | Rows) -> Run:
    """A run of which samples of a sensor are not there."""
    values = run.sensors[sensor].copy()
    values[where] = np.nan
    return dataclasses.replace(run, sensors={**run.sensors, sensor: values})


def later(run: Run, row: int, seconds: float) -> Run:
    """A run whose clock jumps."""
    return dataclasses.replace(run, time=run.time + seconds * (np.arange(run.samples) >= row))


def lasts(bench: Workbench, run: Run) -> float:
    bench.add(run)
    return bench.suspect[-1].seconds


def test_a_run_without_pauses_is_taken_whole(tmp_path: Path) -> None:
    bench, run = Workbench(write_model(tmp_path), SETTINGS), runs("slide")[0]
    assert lasts(bench, run) == pytest.approx(2.0, rel=0.01)
    scattered = np.random.default_rng(1).random(run.samples) < 0.15
    assert lasts(bench, missing(run, "tool_acc", scattered)) == pytest.approx(2.0, rel=0.01)
    assert not any("no sample of" in note for record in bench._taken for note in record.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "column"),
    [
        (lambda run: later(run, 600, 9.0), "sensor."),
        (lambda run: rows(run, np.r_[0:600, 900 : run.samples]), "sensor."),
        (lambda run: missing(run, "tool_acc", slice(600, 900)), "sensor.tool_acc.x"),
        (lambda run: missing(run, "joint2_pos", slice(0, 600)), "sensor.joint2_pos"),
    ],
)
def test_nothing_is_made_up_across_a_pause(
    tmp_path: Path, change: Callable[[Run], Run], column: str
) -> None:
    """The longest piece is used, as if the others had not been recorded, and the reader is told."""
    whole = runs("slide")[0]
    broken = change(whole)
    bench = Workbench(write_model(tmp_path), SETTINGS)
    assert lasts(bench, broken) < 1.45
    found = bench.diagnosis(plan=False)
    notes = [note for note in found.records[0].notes if "no sample of" in note]
    assert len(notes) == 1 and column in notes[0] and "are used" in notes[0]
    assert any("no sample of" in warning for warning in found.warnings)
    first = {600: 600, 900: 900}.get(whole.samples - round(1000 * bench.suspect[0].seconds), 0)
    alone = Workbench(write_model(tmp_path), SETTINGS)
    alone.add(rows(whole, np.arange(first, whole.samples)))
    assert found.posterior == pytest.approx(alone.diagnosis(plan=False).posterior, abs=1e-6)


def test_a_pause_in_a_column_that_is_not_used_costs_nothing(tmp_path: Path) -> None:
    run = runs("slide")[0]
    still = np.full(run.samples, 0.25)
    still[300:900] = np.nan
    run = dataclasses.replace(run, sensors={**run.sensors, "joint2_vel": still})
    bench = Workbench(write_model(tmp_path), SETTINGS)
    assert lasts(bench, run) == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("jump", [1e6, 1e12])
def test_a_stamp_of_another_clock_is_refused(tmp_path: Path, jump: float) -> None:
    run = runs("slide")[0]
    bench = Workbench(write_model(tmp_path), SETTINGS)
    with pytest.raises(InvalidData, match=r"run-1\.parquet: column 'time' goes from 1\.99.*row"):
        bench.add(later(run, run.samples - 1, jump))


def test_pieces_that_are_all_too_short_are_refused(tmp_path: Path) -> None:
    run = runs("slide")[0]
    bench = Workbench(write_model(tmp_path), SETTINGS)
    often = np.arange(run.samples) % 60 < 12  # a fifth may miss
    with pytest.raises(InvalidData, match=r"no sample of sensor\.tool_acc\.x.*no piece"):
        bench.add(missing(run, "tool_acc", often))


def test_stamps_that_do_not_increase_are_refused(tmp_path: Path) -> None:
    run = runs("slide")[0]
    for row, stamp in ((5, np.nan), (5, run.time[4]), (5, np.inf)):
        time = run.time.copy()
        time[row] = stamp
        with pytest.raises(InvalidData, match="increase strictly"):
            unbroken(dataclasses.replace(run, time=time), {})
    with pytest.raises(InvalidData, match="a run of 20 samples is too short"):
        unbroken(rows(run, np.arange(20)), {})
