"""Commands, joint sensors and accelerometers whose clocks are apart, in every run otherwise."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from loose_env.instrument.inference.evidence import Evidence
from loose_env.instrument.inference.laplace_fit import seats_of
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run
from tests.instrument.arms.blind_arm import runs, write_model

pytestmark = pytest.mark.slow

SETTINGS = DiagnoseSettings(poses=2, seconds=1.0)
_PAD = 200


def late(values: np.ndarray, seconds: float) -> np.ndarray:
    """A column as a clock notes it that is behind."""
    ends = ((_PAD, _PAD), *((0, 0),) * (values.ndim - 1))
    padded = np.pad(values, ends, mode="edge")
    frequency = np.fft.rfftfreq(len(padded), 1e-3)
    turn = np.exp(-2j * np.pi * frequency * seconds).reshape(-1, *(1,) * (values.ndim - 1))
    moved = np.fft.irfft(np.fft.rfft(padded, axis=0) * turn, len(padded), axis=0)
    return np.asarray(moved[_PAD:-_PAD])


def late_commands(run: Run, seconds: float) -> Run:
    controls = {name: late(values, seconds) for name, values in run.controls.items()}
    return dataclasses.replace(run, controls=controls)


def late_tool(run: Run, seconds: float) -> Run:
    sensors = {**run.sensors, "tool_acc": late(run.sensors["tool_acc"], seconds)}
    return dataclasses.replace(run, sensors=sensors)


@pytest.mark.parametrize(
    ("moved", "seconds"), [(late_commands, 5e-4), (late_commands, 1e-3), (late_tool, 1e-4)]
)
def test_clocks_that_are_apart_otherwise_in_every_run_are_no_looseness(
    tmp_path: Path, moved: object, seconds: float
) -> None:
    assert callable(moved)
    bench = Workbench(write_model(tmp_path), SETTINGS)
    usual = Workbench(write_model(tmp_path), SETTINGS)
    for run, sign in zip(runs("healthy"), (1.0, -1.0), strict=True):
        bench.add(moved(run, sign * seconds))
        usual.add(run)
    found, before = bench.diagnosis(plan=False), usual.diagnosis(plan=False)
    assert found.fault.kind == "healthy"
    assert found.probability > before.probability - 0.1


def test_the_allowance_can_be_set(tmp_path: Path) -> None:
    none = dataclasses.replace(SETTINGS, command_delay=1e-6, sensor_delay=1e-6)
    assert none.tolerances.command_delay == none.tolerances.sensor_delay == 1e-6
    bench = Workbench(write_model(tmp_path), none)
    assert bench.uncertain.tolerances == none.tolerances


def test_a_servo_that_answers_late_is_named(tmp_path: Path) -> None:
    bench = Workbench(write_model(tmp_path), SETTINGS)
    for run in runs("healthy"):
        bench.add(late_commands(run, -5e-3))
    found = bench.diagnosis(plan=False)
    assert any("5.0 ms after what the model makes" in words for words in found.warnings)


def test_two_runs_of_one_name_are_two_runs(tmp_path: Path) -> None:
    terms = []
    for names in (("run", "run"), ("run-1", "run-2")):
        bench = Workbench(write_model(tmp_path), SETTINGS)
        for run, name in zip(runs("slide"), names, strict=True):
            bench.add(dataclasses.replace(run, name=name))
        seat = seats_of(bench.arm.hypotheses, bench.arm.n)["structural_looseness@link2"]
        assert seat is not None
        evidence = Evidence(uncertain=bench.uncertain, lines=bench.suspect)
        variances = evidence.index.scales**2
        pieces = evidence.pieces(bench.uncertain.nominal, variances)
        terms.append(evidence.seat_terms(pieces, seat, np.eye(3)))
    np.testing.assert_allclose(*terms)
