"""Diagnosis by a measured force on the tool, of arms simulated with MuJoCo alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.instrument.data.held_pose import run_setup
from loose_env.instrument.data.spectral_lines import lines_of
from loose_env.instrument.inference.response.frequency_response import respond, with_leakage
from loose_env.instrument.model.instrumented_arm import InstrumentedArm, read_arm
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.result import Diagnosis
from loose_env.instrument.settings.arm_and_plan import ModelSettings
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from tests.instrument.arms.plan_arms import SERVOED, written
from tests.instrument.arms.struck import strike

pytestmark = pytest.mark.slow

POSES = (
    (np.array([0.3, -0.6, 0.9]), (0.9, 0.2, 0.5)),
    (np.array([-0.5, -0.9, 1.2]), (0.6, 0.3, -0.9)),
    (np.array([0.8, -0.3, 0.6]), (0.5, -0.4, 1.0)),
)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> InstrumentedArm:
    folder = tmp_path_factory.mktemp("arm")
    return read_arm(written(folder, SERVOED), ModelSettings(excitation="hammer"))


def bench_of(folder: Path, arm: InstrumentedArm) -> Workbench:
    (folder / "model.xml").write_text(arm.recording_model.xml, "utf-8")
    return Workbench(folder / "model.xml", DiagnoseSettings(poses=2, seconds=1.0))


def diagnosed(folder: Path, arm: InstrumentedArm, loose: tuple | None) -> Diagnosis:  # type: ignore[type-arg]
    bench = bench_of(folder, arm)
    for number, (pose, direction) in enumerate(POSES, start=1):
        bench.add(strike(arm, pose, direction, number, seconds=2.0, loose=loose))
    return bench.diagnosis(plan=False)


def test_the_healthy_arm_answers_a_blow_as_the_model_says(
    tmp_path: Path, arm: InstrumentedArm
) -> None:
    bench = bench_of(tmp_path, arm)
    pose, direction = POSES[0]
    run = strike(arm, pose, direction, 1, seconds=2.0)
    setup = run_setup(bench.arm, run)
    assert setup.excited.size == 0
    at = bench.uncertain.at(setup.pose)
    lines = with_leakage(at, lines_of(bench.arm, run, setup.pose, setup.excited))
    answer = respond(at, lines, bench.uncertain.nominal)
    tool = [k for k, (r, _) in enumerate(lines.row) if r.kind == "acceleration"]
    missed = np.linalg.norm(answer.residual[:, tool]) / np.linalg.norm(lines.readings[:, tool])
    assert missed < 0.06  # of it the filter that accelerometers have by the prior


def test_a_loose_link_is_found_by_a_hammer(tmp_path: Path, arm: InstrumentedArm) -> None:
    """Along the link: an elastic gear or a bending link moves the tool across it."""
    found = diagnosed(tmp_path, arm, ("fore", (0.0, 0.0, 1.0), 4e-4))
    assert found.fault.hypothesis == "structural_looseness@fore"
    assert found.probability > 0.95
    assert found.fault.direction is not None
    assert found.fault.direction_half_angle_deg is not None
    off = np.degrees(np.arccos(abs(found.fault.direction[2])))
    assert off < min(found.fault.direction_half_angle_deg, 15.0)
    assert not any("recorded and not used" in warning for warning in found.warnings)


def test_a_healthy_arm_that_is_struck_is_not_called_faulty(
    tmp_path: Path, arm: InstrumentedArm
) -> None:
    found = diagnosed(tmp_path, arm, None)
    assert found.verdict != "faulty"
    assert found.fault.hypothesis == "healthy" or found.probability < 0.6
