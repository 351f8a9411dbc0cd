"""The torque a motion needs, against the torque measured."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap import Hypothesis
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Run
from tests.gap.cases.effect_arms import PLANAR, SPATIAL
from tests.gap.cases.recorded_runs import compared, fitted, measurable, torque_run

NOTHING = Hypothesis()


def arm(xml: str) -> NominalModel:
    return NominalModel(measurable(mujoco.MjSpec.from_string(xml)))


def runs_of(
    machine: NominalModel, truth: mujoco.MjModel, count: int = 2, **given: object
) -> list[Run]:
    rng = np.random.default_rng(5)
    return [torque_run(machine, truth, rng, name=f"run-{k}", **given) for k in range(count)]  # type: ignore[arg-type]


@pytest.mark.parametrize("xml", [PLANAR, SPATIAL])
@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_nothing_is_left_of_the_true_model_but_noise(xml: str, rate: float) -> None:
    machine = arm(xml)
    comparison = compared(machine, runs_of(machine, machine.model, rate=rate))
    residual = comparison.residuals([NOTHING])[0]
    for channel in np.unique(comparison.rows.channel):
        own = residual[comparison.rows.channel == channel]
        assert len(own) > 30
        assert 0.6 < np.sqrt(np.mean(own**2)) < 1.35


@pytest.mark.parametrize(
    ("xml", "kind", "where", "values", "wrong"),
    [
        (PLANAR, "viscous_friction", "joint2", [1.5], ("rotor_inertia", "joint2")),
        (PLANAR, "payload", "tool", [0.5], ("viscous_friction", "joint1")),
        (PLANAR, "encoder_offset", "joint2", [0.05], ("viscous_friction", "joint2")),
        (PLANAR, "joint_spring", "joint3", [4.0, 0.3], ("coulomb_friction", "joint3")),
        (SPATIAL, "rotor_inertia", "reach", [3.0], ("viscous_friction", "reach")),
        (SPATIAL, "quadratic_drag", "lift", [2.0], ("coulomb_friction", "turn")),
    ],
)
def test_the_true_effect_is_found_and_a_wrong_one_is_not(
    xml: str, kind: str, where: str, values: list[float], wrong: tuple[str, str]
) -> None:
    machine = arm(xml)
    effect = CATALOGUE[kind](machine, where)
    values = values[: len(effect.parameters)] + list(effect.starts[0][len(values) :])
    spec = machine.fresh()
    effect.edit(spec, np.array(values))
    comparison = compared(machine, runs_of(machine, spec.compile()))
    right, found = fitted(comparison, [effect])
    false, _ = fitted(comparison, [CATALOGUE[wrong[0]](machine, wrong[1])])
    assert right.rms < 1.35  # the noise is that of the nominal model, whose inertias are smaller
    assert false.rms > 1.5 * right.rms
    assert abs(found[0][0] / values[0] - 1) < 0.1


def test_which_effects_an_inverse_comparison_shows() -> None:
    machine = arm(PLANAR)
    comparison = compared(machine, runs_of(machine, machine.model, 1))
    shown = {f"{e.kind}@{e.where}" for e in candidates(machine) if comparison.shows(e)}
    assert shown >= {
        "payload@tool", "coulomb_friction@joint2", "joint_compliance@joint1",
        "encoder_offset@joint2", "actuator_gain@servo1", "sensor_delay@joint1_pos",
    }  # fmt: skip
    assert not shown & {
        "command_delay@all", "actuator_lag@servo1", "sensor_gain@shake",
        "sensor_misalignment@shake", "sensor_bias@joint1_pos",
    }  # fmt: skip


def test_a_run_too_short_to_smooth_is_refused() -> None:
    machine = arm(PLANAR)
    run = torque_run(
        machine, machine.model, np.random.default_rng(0), duration=0.07, rate=200.0, speeds=None
    )
    with pytest.raises(InvalidData, match="too short"):
        compared(machine, [run])
