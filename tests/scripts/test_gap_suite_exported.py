"""The model that is written does in plain MuJoCo what the tool says it does."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")

from loose_env.gap.effects.command_delay import CommandDelay
from loose_env.gap.effects.joint_compliance import JointCompliance
from loose_env.gap.effects.sensor_gain import SensorGain
from loose_env.gap.effects.viscous_friction import ViscousFriction
from loose_env.gap.judgement import Judge
from loose_env.gap.nominal import NominalFigures
from loose_env.gap.preparing import prepare
from loose_env.gap.settings import GapSettings
from loose_env.recording import Run, write_recording
from scripts.gap_suite.exported import exported_gap
from tests.gap.effect_arms import PLANAR
from tests.gap.gap_case import stated


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> object:
    """Runs that begin at rest under the first command, of an arm with friction of 3 N·m·s/rad."""

    spec = mujoco.MjSpec.from_string(PLANAR)
    spec.joint("joint2").damping = np.array([3.5, 0, 0])
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    time, rng, runs = 0.001 * np.arange(2000), np.random.default_rng(3), []
    for k in range(2):
        commands = 0.3 * np.sin(np.outer(np.maximum(time - 0.4, 0), [5.0 + k, 7.0, 9.0 - k]))
        data, shown = mujoco.MjData(model), np.zeros((2000, 3))
        mujoco.mj_step(model, data, 1500)
        for row, command in zip(shown, commands, strict=True):
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            row[:] = data.sensordata[:3]
        shown += rng.normal(0, 2e-5, shown.shape)
        runs.append(
            Run(
                name=f"r{k}.csv", time=time,
                controls={f"servo{j + 1}": commands[:, j] for j in range(3)},
                sensors={f"encoder{j + 1}": shown[:, j] for j in range(3)},
            )
        )  # fmt: skip
    folder = tmp_path_factory.mktemp("exported") / "r"
    recording = write_recording(folder, model_xml=PLANAR, runs=runs, file_format="csv")
    return prepare(recording, GapSettings(threads=1, kinds=("viscous_friction",)))


def found(prepared: object, effect: object, values: list[float]) -> SimpleNamespace:
    """As the tool would have found it."""
    comparison = prepared.fit  # type: ignore[attr-defined]
    nominal = NominalFigures(prepared.machine, tolerance=0.03)  # type: ignore[attr-defined]
    ones = np.ones(len(nominal.parameters))
    judge = Judge(comparison, prepared.whole_held)  # type: ignore[attr-defined]
    best = judge.judge(stated(comparison, [nominal, effect], [ones, np.array(values)]))  # type: ignore[list-item]
    return SimpleNamespace(prepared=prepared, best=best, effects=(effect,))


@pytest.mark.parametrize(
    ("kind", "where", "values"),
    [
        (ViscousFriction, "joint2", [3.0]),
        (CommandDelay, "all", [0.0123]),
        (JointCompliance, "joint2", [3000.0, 0.05]),
    ],
)
def test_a_written_model_leaves_what_the_fit_leaves(
    kind: type, where: str, values: list[float], prepared: object, tmp_path: Path
) -> None:
    case = found(prepared, kind(prepared.machine, where), values)  # type: ignore[attr-defined]
    gaps = exported_gap(case, tmp_path)
    assert gaps is not None
    assert gaps[0] == pytest.approx(gaps[1], rel=0.03)
    assert (gaps[1] < 1.1) == (kind is ViscousFriction)


def test_a_model_file_without_the_effect_is_found_out(
    prepared: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect = ViscousFriction(prepared.machine, "joint2")  # type: ignore[attr-defined]
    case = found(prepared, effect, [3.0])
    monkeypatch.setattr(ViscousFriction, "export", lambda *_: None)
    gaps = exported_gap(case, tmp_path)
    assert gaps is not None and gaps[0] > 3 * gaps[1]


def test_what_a_model_file_cannot_carry_is_not_checked(prepared: object, tmp_path: Path) -> None:
    effect = SensorGain(prepared.machine, "encoder1")  # type: ignore[attr-defined]
    assert exported_gap(found(prepared, effect, [1.1]), tmp_path) is None
    nothing = found(prepared, effect, [1.1])
    nothing.effects = ()
    assert exported_gap(nothing, tmp_path) is None
