"""The torque a motion needs, against the torque measured."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Run
from tests.gap.cases.effect_arms import PLANAR, SHARED, SPATIAL
from tests.gap.cases.recorded_runs import compared, fitted, measurable, torque_run, waves

NOTHING = Hypothesis()


def arm(xml: str) -> NominalModel:
    return NominalModel(measurable(mujoco.MjSpec.from_string(xml)))


def edited(machine: NominalModel, kind: str, where: str, values: list[float]) -> mujoco.MjModel:
    spec = machine.fresh()
    CATALOGUE[kind](machine, where).edit(spec, np.array(values))
    return spec.compile()


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
    comparison = compared(machine, runs_of(machine, edited(machine, kind, where, values)))
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


def test_a_compliant_drive_is_found_from_its_motor_side() -> None:
    machine = arm(PLANAR)
    effect = CATALOGUE["joint_compliance"](machine, "joint2")
    spec = machine.fresh()
    effect.edit(spec, np.array([400.0, 0.1]))
    model = spec.compile()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER  # the force it shows is what acts
    rng = np.random.default_rng(2)
    data = mujoco.MjData(model)
    names = [model.joint(j).name for j in range(model.njnt)]
    measured = [names.index(j) for j in machine.joints]
    time = np.arange(8000) * 0.001
    goals = waves(machine, time, rng, 0.3)[0]
    goals = (goals - goals[0]) * np.clip((time[:, None] - 1.5) / 1.0, 0, 1) ** 2
    rows = np.zeros((len(time), 6))
    for k, goal in enumerate(goals):
        data.ctrl[:] = goal
        mujoco.mj_forward(model, data)
        rows[k] = [*data.qpos[measured], *data.actuator_force]
        mujoco.mj_step(model, data)
    rows = rows[1000:]
    sensors = {
        f"{j}_pos": rows[:, k] + rng.normal(0, 2e-5, len(rows))
        for k, j in enumerate(machine.joints)
    }
    torques = {
        j: rows[:, 3 + k] + rng.normal(0, 0.2, len(rows)) for k, j in enumerate(machine.joints)
    }
    run = Run(name="a", time=time[1000:], sensors=sensors, torques=torques)
    comparison = compared(machine, [run], step=0.001)
    true = Hypothesis(effects=(effect,), values=(np.array([400.0, 0.1]),))
    stiff = Hypothesis(effects=(effect,), values=(np.array([1600.0, 0.1]),))
    right, wrong, rigid = np.sqrt(
        np.mean(comparison.residuals([true, stiff, NOTHING]) ** 2, axis=1)
    )
    assert right < 1.5
    assert wrong > 1.3 * right
    assert rigid > 1.3 * right


def test_a_six_axis_arm_with_gravity_and_real_friction() -> None:
    file = SHARED / "ur5e_bare.xml"
    if not file.is_file():
        pytest.skip("the published arms are not beside the repository")
    machine = NominalModel(measurable(mujoco.MjSpec.from_file(str(file))))
    truth = machine.fresh()
    for joint in truth.joints:
        joint.damping = np.array([4.0, 0, 0])
    rates, loads = np.array([6.0, 6, 5, 2, 2, 2]), np.array([8.0, 9, 6, 2, 2, 2])

    def friction(speed: np.ndarray) -> np.ndarray:
        return (rates - 4.0) * speed + loads * np.tanh(speed / 0.01)

    for rate in (125.0, 500.0):
        comparison = compared(
            machine, runs_of(machine, truth.compile(), speeds=None, friction=friction, rate=rate,
                             duration=20.0, noise=0.03),
        )  # fmt: skip
        before, _ = fitted(comparison, [])
        effects = [
            CATALOGUE[kind](machine, joint)
            for kind in ("viscous_friction", "coulomb_friction")
            for joint in machine.joints
        ]
        after, found = fitted(comparison, effects)
        assert before.rms > 10
        assert after.rms < 1.4
        damping = np.array([v[0] for v in found[:6]]) + machine.model.dof_damping
        print(
            f"{rate:g} Hz: {before.rms:.1f} -> {after.rms:.2f}", np.concatenate(found[6:]).round(2)
        )
        assert np.allclose(np.concatenate(found[6:]), loads, rtol=0.1)
        assert np.all(damping < 2 * rates + 2)


def test_a_run_too_short_to_smooth_is_refused() -> None:
    machine = arm(PLANAR)
    run = torque_run(
        machine, machine.model, np.random.default_rng(0), duration=0.07, rate=200.0, speeds=None
    )
    with pytest.raises(InvalidData, match="too short"):
        compared(machine, [run])
