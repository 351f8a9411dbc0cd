"""Runs beside the same run of the healthy arm."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from loose_env.instrument.inference.response.pairing import beside_references
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run
from tests.instrument.arms.blind_arm import runs, write_model

SETTINGS = DiagnoseSettings(poses=2, seconds=1.0)


def bench_of(folder: Path, *sets: tuple[Run, ...]) -> Workbench:
    bench = Workbench(write_model(folder), SETTINGS)
    for each in sets:
        for run in each:
            bench.add(run)
    return bench


def pairs(bench: Workbench) -> list[int | None]:
    lines = beside_references(bench.uncertain, bench._held(), {})
    return [None if x.beside is None else x.beside.number for x in lines if not x.healthy]


def test_runs_are_paired_by_pose_joint_and_signal(tmp_path: Path) -> None:
    references = runs("slide", 3, sound=True)
    assert pairs(bench_of(tmp_path, references, runs("slide", 3))) == [0, 1, 2]
    assert pairs(bench_of(tmp_path, references[:1], runs("slide", 3))) == [0, None, None]


def test_another_signal_is_another_run(tmp_path: Path) -> None:
    reference = runs("slide", 1, sound=True)[0]
    name = f"motor{reference.excited[0][-1]}"
    other = {**reference.controls, name: reference.controls[name][::-1].copy()}
    assert pairs(
        bench_of(tmp_path, (dataclasses.replace(reference, controls=other),), runs("slide", 1))
    ) == [None]


def test_a_recorder_that_started_later_is_aligned(tmp_path: Path) -> None:
    reference = runs("slide", 1, sound=True)[0].part(slice(150, None))
    bench = bench_of(tmp_path, (reference,), runs("slide", 1))
    line = beside_references(bench.uncertain, bench._held(), {})[1]
    assert line.beside is not None
    both = np.abs(line.command - line.beside.command).max()
    assert both < 1e-6 * np.abs(line.command).max()


@pytest.mark.slow
def test_what_differs_by_noise_alone_is_healthy_whatever_the_model_says(tmp_path: Path) -> None:
    """The model's masses are far from the arm's; with references that does not matter."""
    path = write_model(tmp_path)
    text = path.read_text("utf-8").replace('mass="2.5"', 'mass="4"')
    assert text != path.read_text("utf-8")
    path.write_text(text, encoding="utf-8")
    bench = Workbench(path, SETTINGS)
    for run in (*runs("slide", 3, sound=True), *runs("healthy", 3)):
        bench.add(run)
    found = bench.diagnosis(plan=False)
    assert found.fault.kind == "healthy"
    assert found.misfit < 1e-3


@pytest.mark.slow
def test_a_fault_shows_in_the_difference(tmp_path: Path) -> None:
    found = bench_of(tmp_path, runs("slide", 3, sound=True), runs("slide", 3)).diagnosis(plan=False)
    assert found.fault.hypothesis == "structural_looseness@link2"
    assert found.verdict == "faulty"
