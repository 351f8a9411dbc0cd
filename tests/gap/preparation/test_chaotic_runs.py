"""Runs whose stops are struck are compared by features, and the loose link is still named."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy import signal

from loose_env.gap.diagnostics.feature_localisation import feature_channels
from loose_env.gap.diagnostics.joint_torque_residual import joint_motion
from loose_env.gap.model.effects.structural_looseness import StructuralLooseness
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.prepare import GapProblem, prepare
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.evidence import diagnose_residuals
from loose_env.gap.workflow.pipeline import find_gap
from loose_env.gap.workflow.summary import result_of
from loose_env.recording import Recording, Run, write_recording
from tests.gap.cases.level_arm import FINE, LEVEL, recorded

COUNT = 1800
POSES = ([0.3, 0.8, -0.5], [-0.4, 1.2, 0.6], [0.9, -0.9, 0.3])


def record(folder: Path, *, loose: bool, gap: float = 2e-4) -> Recording:
    """Held poses in which the first joint is shaken, with hard stops that ring or without."""
    spec = mujoco.MjSpec.from_string(LEVEL)
    spec.option.timestep = FINE
    if loose:
        machine = NominalModel(mujoco.MjSpec.from_string(LEVEL), step=FINE)
        effect = StructuralLooseness(machine, "link2")
        effect.edit(spec, np.array([1.0, gap, 1.0, 1e6, 0.03]))
    model = spec.compile()
    rng = np.random.default_rng(4)
    band = signal.butter(4, (10, 120), "bandpass", fs=1000, output="sos")
    runs = []
    for k, pose in enumerate(POSES):
        shake = signal.sosfilt(band, rng.normal(size=COUNT + 500))[500:]
        controls = np.tile(pose, (COUNT, 1))
        controls[:, 0] += 0.02 * shake / shake.std() * np.minimum(np.arange(COUNT) / 200, 1)
        data = mujoco.MjData(model)
        for j, angle in enumerate(pose):
            data.joint(f"joint{j + 1}").qpos[0] = angle
        data.ctrl[:] = pose
        mujoco.mj_step(model, data, 2000)
        runs.append(
            recorded(data, controls, rng, name=f"run-{k + 1:02d}.parquet", excited=("joint1",))
        )
    return write_recording(folder, model_xml=LEVEL, runs=runs)


def test_a_sound_arm_is_compared_sample_by_sample(tmp_path: Path) -> None:
    problem = prepare(record(tmp_path / "sound", loose=False), GapSettings(threads=1))
    assert not problem.search.chaotic
    assert not problem.search.rows.is_feature.any()
    assert not any("chaotic (impacts against stops)" in warning for warning in problem.warnings)


@pytest.fixture(scope="module")
def impact_fit(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("struck") / "recording", loose=True)


@pytest.fixture(scope="module")
def problem(impact_fit: Recording) -> GapProblem:
    return prepare(impact_fit, GapSettings(threads=1))


def shaken(name: str, count: int, rate: float, *, still: int = 0) -> Run:
    """A run of random commands to the first joint, the last ones all alike; no model made it."""
    rng = np.random.default_rng(len(name))
    command = 0.02 * rng.normal(size=count)
    command[count - still :] = 0.0
    read = {f"encoder{j}": rng.normal(0, 1e-2, count) for j in (1, 2, 3)}
    return Run(
        name=name, time=np.arange(count) / rate, controls={"servo1": command}, sensors=read,
        excited=("joint1",),
    )  # fmt: skip


def test_struck_stops_are_compared_by_features(impact_fit: Recording, problem: GapProblem) -> None:
    assert problem.search.chaotic == {run.name for run in impact_fit.runs}
    assert problem.search.rows.is_feature.all()
    assert any("chaotic (impacts against stops)" in warning for warning in problem.warnings)


@pytest.mark.slow
def test_the_loose_link_is_named_by_features(impact_fit: Recording) -> None:
    kinds = ("structural_looseness", "joint_compliance", "viscous_friction")
    settings = GapSettings(threads=1, kinds=kinds, most_effects=1)
    found = find_gap(impact_fit, settings)
    assert found.verdict == "named"
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("structural_looseness", "link2")
    assert found.best.held_out_rms < 0.5 * found.base.held_out_rms
    result = result_of(found, diagnose_residuals(found))
    assert result.gap.after < 0.5 * result.gap.before
    assert result.effects[0].where == "link2"
    names = {channel.name for channel in found.problem.held_out_whole.channels}
    assert set(result.gap.by_channel) == names
    before, after = result.gap.by_channel["sensor.shake.y"]
    assert before > 3 and after < 0.6 * before
    assert {left.channel for left in result.residual_tests} == names


def test_a_right_model_of_struck_stops_disagrees_nowhere(problem: GapProblem) -> None:
    """The simulation parts ways with the run, and its features, bands and motion do not."""
    held, machine = problem.held_out_whole, problem.machine
    looseness = StructuralLooseness(machine, "link2")
    right = Hypothesis(effects=(looseness,), values=(np.array([1.0, 2e-4, 1.0, 1e6, 0.03]),))
    motions = [joint_motion(machine, t, held.channels, held.floors) for t in held.trials]
    nothing = Hypothesis()
    good, bad = (feature_channels(held, h, motions) for h in (right, nothing))
    for one, other in zip(good, bad, strict=True):
        assert one.gap.rms < 2.5
        for a, b in zip(one.gap.bands, other.gap.bands, strict=True):
            assert a.rms < max(2.0, 0.7 * b.rms)
    assert max(one.gap.rms for one in bad) > 5
