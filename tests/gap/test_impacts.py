"""A loose link that strikes its stops is told of, and named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy import signal

from loose_env.gap import GapSettings, find_gap, result_of
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.workflow.evidence import diagnose_residuals
from loose_env.recording import Recording, Run, write_recording
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR

# The plane is level, so that nothing but the motion throws a slide to and fro.
LEVEL = PLANAR.replace('gravity="0 -9.81 0"', 'gravity="0 0 -9.81"')
FINE, EVERY = 2e-4, 5
"""Step [s], and steps from one sample to the next."""
NOISE = np.array([2e-5, 2e-5, 2e-5, 2e-3, 0.03, 0.03, 0.03])


def with_effect(kind: str, where: str, values: Sequence[float]) -> mujoco.MjSpec:
    """The level arm in fine steps, with an effect."""
    spec = mujoco.MjSpec.from_string(LEVEL)
    spec.option.timestep = FINE
    machine = NominalModel(mujoco.MjSpec.from_string(LEVEL), step=FINE)
    CATALOGUE[kind](machine, where).edit(spec, np.array(values))
    return spec


def recorded(
    data: mujoco.MjData, controls: Array, rng: np.random.Generator, name: str, *excited: str
) -> Run:
    """A run of commands (T, 3) from the state in ``data`` on, its readings with noise."""
    shown = np.zeros((len(controls), data.model.nsensordata))
    for row, command in zip(shown, controls, strict=True):
        data.ctrl[:] = command
        mujoco.mj_forward(data.model, data)
        row[:] = data.sensordata
        mujoco.mj_step(data.model, data, EVERY)
    shown += rng.normal(0, NOISE, shown.shape)
    names = ("encoder1", "encoder2", "encoder3", "rate3")
    return Run(
        name=name,
        time=np.arange(len(controls)) * FINE * EVERY,
        controls={f"servo{j + 1}": controls[:, j] for j in range(3)},
        sensors={n: shown[:, c] for c, n in enumerate(names)} | {"shake": shown[:, 4:]},
        excited=excited,
    )


def shaken(folder: Path, spec: mujoco.MjSpec) -> Recording:
    """Poses that are kept while the first joint is shaken at random."""
    model, rng, count = spec.compile(), np.random.default_rng(4), 1800
    band = signal.butter(4, (10, 120), "bandpass", fs=1000, output="sos")
    runs = []
    for k, pose in enumerate(([0.3, 0.8, -0.5], [-0.4, 1.2, 0.6], [0.9, -0.9, 0.3])):
        shake = signal.sosfilt(band, rng.normal(size=count + 500))[500:]
        controls = np.tile(pose, (count, 1))
        controls[:, 0] += 0.02 * shake / shake.std() * np.minimum(np.arange(count) / 200, 1)
        data = mujoco.MjData(model)
        for j, angle in enumerate(pose):
            data.joint(f"joint{j + 1}").qpos[0] = angle
        data.ctrl[:] = pose
        mujoco.mj_step(model, data, 2000)
        runs.append(recorded(data, controls, rng, f"run-{k + 1:02d}.parquet", "joint1"))
    return write_recording(folder, model_xml=LEVEL, runs=runs)


@pytest.fixture(scope="module")
def struck(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Of a link with hard stops that ring."""
    spec = with_effect("structural_looseness", "link2", [1.0, 2e-4, 1.0, 1e6, 0.03])
    return shaken(tmp_path_factory.mktemp("struck") / "recording", spec)


def test_runs_that_impacts_make_chaotic_are_told_of(struck: Recording, tmp_path: Path) -> None:
    healthy = shaken(tmp_path / "healthy", with_effect("viscous_friction", "joint1", [0.0]))
    for recording, chaotic in ((struck, True), (healthy, False)):
        warnings = prepare(recording, GapSettings(threads=1)).warnings
        assert any("chaotic (impacts against stops)" in words for words in warnings) is chaotic


@pytest.mark.slow
def test_the_loose_link_is_named(struck: Recording) -> None:
    kinds = ("structural_looseness", "joint_compliance", "viscous_friction")
    found = find_gap(struck, GapSettings(threads=1, kinds=kinds, most_effects=1))
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
