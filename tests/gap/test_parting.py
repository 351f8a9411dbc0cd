"""Runs whose stops are struck are compared by features, and the loose link is still named."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy import signal

from loose_env.gap.effects.structural_looseness import StructuralLooseness
from loose_env.gap.finding import GapSettings, find_gap, prepare
from loose_env.gap.machine import Machine
from loose_env.gap.reporting import gather, outputs_of, result_of
from loose_env.recording import Recording, Run, write_recording
from tests.gap.effect_arms import PLANAR

# The plane is level, so that nothing but the excitation holds the slide at its stops.
LEVEL = PLANAR.replace('gravity="0 -9.81 0"', 'gravity="0 0 -9.81"')
FINE, EVERY, COUNT = 2e-4, 5, 3000
NOISE = np.array([2e-5, 2e-5, 2e-5, 2e-3, 0.03, 0.03, 0.03])
POSES = ([0.3, 0.8, -0.5], [-0.4, 1.2, 0.6], [0.9, -0.9, 0.3])


def record(folder: Path, *, loose: bool, gap: float = 2e-4) -> Recording:
    """Held poses in which the first joint is shaken, with hard stops that ring or without."""
    spec = mujoco.MjSpec.from_string(LEVEL)
    spec.option.timestep = FINE
    if loose:
        machine = Machine(mujoco.MjSpec.from_string(LEVEL), step=FINE)
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
        shown = np.zeros((COUNT, model.nsensordata))
        for row, command in zip(shown, controls, strict=True):
            data.ctrl[:] = command
            mujoco.mj_forward(model, data)
            row[:] = data.sensordata
            mujoco.mj_step(model, data, EVERY)
        shown += rng.normal(0, NOISE, shown.shape)
        names = ("encoder1", "encoder2", "encoder3", "rate3")
        runs.append(
            Run(
                name=f"run-{k + 1:02d}.parquet",
                time=np.arange(COUNT) * FINE * EVERY,
                controls={f"servo{j + 1}": controls[:, j] for j in range(3)},
                sensors={n: shown[:, c] for c, n in enumerate(names)} | {"shake": shown[:, 4:]},
                excited=("joint1",),
            )
        )
    return write_recording(folder, model_xml=LEVEL, runs=runs)


def test_a_sound_arm_is_compared_sample_by_sample(tmp_path: Path) -> None:
    prepared = prepare(record(tmp_path / "sound", loose=False), GapSettings(threads=1))
    assert not prepared.search.parting
    assert not prepared.search.rows.white.any()
    assert not any("stops are struck" in warning for warning in prepared.warnings)


@pytest.fixture(scope="module")
def struck(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("struck") / "recording", loose=True)


def test_struck_stops_are_compared_by_features(struck: Recording) -> None:
    prepared = prepare(struck, GapSettings(threads=1))
    assert prepared.search.parting == {run.name for run in struck.runs}
    assert prepared.search.rows.white.all()
    assert any("stops are struck" in warning for warning in prepared.warnings)


def test_the_loose_link_is_named_by_features(struck: Recording) -> None:
    kinds = ("structural_looseness", "joint_compliance", "viscous_friction")
    settings = GapSettings(threads=1, kinds=kinds, most_effects=1)
    found = find_gap(struck, settings)
    assert found.verdict == "named"
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("structural_looseness", "link2")
    assert found.best.held_rms < 0.5 * found.base.held_rms
    outputs = outputs_of(found, struck, settings)
    result = result_of(outputs, gather(outputs))
    assert result.gap.after < 0.5 * result.gap.before
    assert result.effects[0].where == "link2"
