"""Machines that lack several things at once, of which no single one explains much."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.explain import explain_gap
from loose_env.recording import read_recording, write_recording
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.recorded_runs import PENDULUM, measurable, pendulum_run, torque_run

pytestmark = pytest.mark.slow

OIL, SEAL, AIR = 0.004, 0.012, 0.002
"""What slows a pendulum down: N·m·s/rad, N·m, N·m·s²/rad²."""
DAMPING = (30.0, 20.0, 8.0)
"""Damping of a model of which the machine has none [N·m·s/rad]."""


def test_oil_seals_and_air_at_one_joint_are_told_apart(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    runs = [
        pendulum_run(
            rng, viscous=OIL, coulomb=SEAL, drag=AIR, start=(angle, 0.0), name=f"drop-{k}.parquet"
        )
        for k, angle in enumerate((2.0, -1.2, 0.8, -1.7))
    ]  # fmt: skip
    recording = write_recording(tmp_path / "pendulum", model_xml=PENDULUM, runs=runs)
    found = explain_gap(recording, GapSettings(threads=1, held_out=("drop-3",)))
    values = {e.kind: next(iter(e.parameters.values())) for e in found.effects}
    assert found.verdict == "named"
    assert values == {
        "viscous_friction": pytest.approx(OIL, rel=0.1),
        "coulomb_friction": pytest.approx(SEAL, rel=0.1),
        "quadratic_drag": pytest.approx(AIR, rel=0.1),
    }
    assert found.gap.after < 1.25 and found.gap.before > 100


def damped(damping: tuple[float, ...]) -> mujoco.MjSpec:
    spec = measurable(mujoco.MjSpec.from_string(PLANAR))
    for joint, value in zip(spec.joints, damping, strict=True):
        joint.damping = np.array([value, 0.0, 0.0])
    return spec


def test_damping_far_above_that_of_the_machine_is_named_at_all_joints(tmp_path: Path) -> None:
    model = damped(DAMPING)
    machine, truth = NominalModel(model), damped((0.0, 0.0, 0.0)).compile()
    rng = np.random.default_rng(8)
    runs = [
        torque_run(machine, truth, rng, rate=200.0, duration=12.0, name=f"{n}.parquet")
        for n in ("slow-1", "slow-2", "fast-1", "fast-2")
    ]
    write_recording(tmp_path / "arm", model_xml=model.to_xml(), runs=runs)
    settings = GapSettings(threads=1, held_out=("fast-2",))
    found = explain_gap(read_recording(tmp_path / "arm"), settings)
    assert found.verdict == "named"
    assert {(e.kind, e.where) for e in found.effects} == {
        ("viscous_friction", joint) for joint in machine.joints
    }
    for effect in found.effects:
        nominal = DAMPING[machine.joint_number(effect.where)]
        assert effect.parameters["damping"] == pytest.approx(-nominal, rel=0.05)
