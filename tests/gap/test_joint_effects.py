"""What the effects at a joint do, against formulas that know nothing of the edits."""

from __future__ import annotations

from itertools import product
from math import exp, pi, sin, sqrt

import mujoco
import numpy as np
import pytest

from loose_env.arms import DESK_ARM
from loose_env.gap import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array
from tests.gap.cases.effect_arms import machine_of

INERTIA, STEP = 0.6, 1e-3

WHEEL = """
<mujoco>
  <compiler angle="{angle}"/>
  <option timestep="{step}" gravity="0 0 0" integrator="{integrator}"/>
  <worldbody>
    <body name="wheel">
      <joint name="axle" axis="0 0 1" armature="0.2" stiffness="{stiffness}" springref="{rest}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.4 0.4 0.4"/>
      <site name="tool" pos="0.1 0 0"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="axle"/></actuator>
  <sensor><jointpos name="encoder" joint="axle"/></sensor>
</mujoco>
"""
INTEGRATORS = ("Euler", "implicitfast")


def wheel(
    integrator: str = "implicitfast",
    *,
    step: float = STEP,
    angle: str = "radian",
    stiffness: float = 0.0,
    rest: float = 0.0,
    loads: Array | None = None,
) -> NominalModel:
    text = WHEEL.format(
        integrator=integrator, step=step, angle=angle, stiffness=stiffness, rest=rest
    )
    return NominalModel(mujoco.MjSpec.from_string(text), loads=loads)


def at(machine: NominalModel, kind: str, where: str = "axle") -> Effect:
    return CATALOGUE[kind](machine, where)


def edited(effect: Effect, *values: float) -> mujoco.MjModel:
    spec = effect.machine.fresh()
    effect.edit(spec, np.array(values))
    return spec.compile()


def run(
    model: mujoco.MjModel,
    seconds: float,
    *,
    torque: float = 0.0,
    speed: float = 0.0,
    ramp: float = 0.0,
) -> Array:
    """Position and speed of the first joint under a torque that comes within a ramp (T, 2)."""
    data = mujoco.MjData(model)
    data.qvel[0] = speed
    rows = np.zeros((round(seconds / model.opt.timestep), 2))
    for row in rows:
        data.ctrl[0] = torque * (1.0 if data.time >= ramp else data.time / ramp)
        mujoco.mj_step(model, data)
        row[:] = data.qpos[0], data.qvel[0]
    return rows


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_viscous_friction_lets_a_wheel_run_down_exponentially(integrator: str) -> None:
    model = edited(at(wheel(integrator), "viscous_friction"), 0.9)
    left = run(model, 1.0, speed=3.0)[-1, 1]
    assert left == pytest.approx(3.0 * exp(-0.9 / INERTIA), rel=2e-3)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_drag_lets_a_wheel_run_down_hyperbolically(integrator: str) -> None:
    model = edited(at(wheel(integrator), "quadratic_drag"), 0.5)
    for speed in (4.0, -4.0):
        left = run(model, 1.0, speed=speed)[-1, 1]
        assert left == pytest.approx(speed / (1 + 0.5 * 4.0 / INERTIA), rel=5e-3)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_coulomb_friction_sticks_below_its_torque_and_takes_it_above(integrator: str) -> None:
    model = edited(at(wheel(integrator), "coulomb_friction"), 1.5)
    held = run(model, 2.0, torque=1.4)
    assert abs(held[-1, 1]) < 1e-5
    assert abs(held[-1, 0]) < 1e-4
    slipping = run(model, 1.0, torque=2.1)
    assert slipping[-1, 1] == pytest.approx((2.1 - 1.5) / INERTIA, rel=2e-3)
    braked = run(model, 1.0, speed=5.0)
    assert braked[-1, 1] == pytest.approx(5.0 - 1.5 / INERTIA, rel=2e-3)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_stribeck_friction_holds_more_than_it_brakes(integrator: str) -> None:
    model = edited(at(wheel(integrator), "stribeck_friction"), 1.0, 1.6, 0.05)
    held = run(model, 2.0, torque=1.5, ramp=0.5)
    assert abs(held[-1, 0]) < 1e-3
    assert np.abs(held[-200:, 1]).max() < 1e-4
    assert run(model, 2.0, torque=1.7, ramp=0.5)[-1, 1] > 0.5
    braked = run(model, 1.0, speed=5.0)
    assert braked[-1, 1] == pytest.approx(5.0 - 1.0 / INERTIA, rel=0.01)
    # On the curve: what carries the wheel on at a low speed.
    data = mujoco.MjData(model)
    given = []
    for _ in range(4000):
        data.ctrl[0] = 200.0 * (0.05 - data.qvel[0]) + 1.2
        mujoco.mj_step(model, data)
        given.append(float(data.ctrl[0]))
    speed = float(data.qvel[0])
    wanted = 1.0 + 0.6 * exp(-((speed / 0.05) ** 2))
    assert np.mean(given[-500:]) == pytest.approx(wanted, abs=0.09 * 0.6)


def test_rotor_inertia_slows_the_wheel_alone() -> None:
    model = edited(at(wheel(), "rotor_inertia"), 0.3)
    assert run(model, 1.0, torque=2.0)[-1, 1] == pytest.approx(2.0 / (INERTIA + 0.3))


@pytest.mark.parametrize("angle", ["radian", "degree"])
def test_two_springs_pull_as_both_do(angle: str) -> None:
    unit = 180 / pi if angle == "degree" else 1.0
    machine = wheel(angle=angle, stiffness=3.0, rest=0.4 * unit)
    model = edited(at(machine, "joint_spring"), 5.0, -0.3)
    data = mujoco.MjData(model)
    for q in (-1.0, 0.2, 0.9):
        data.qpos[0] = q
        mujoco.mj_forward(model, data)
        assert data.qfrc_passive[0] == pytest.approx(-3 * (q - 0.4) - 5 * (q + 0.3))


def test_ripple_is_a_sine_of_the_angle() -> None:
    model = edited(at(wheel(), "torque_ripple"), 0.7, 12.5, 0.6)
    data = mujoco.MjData(model)
    data.qvel[0] = 7.0  # no back-EMF brakes it
    for q in np.linspace(-2, 2, 9):
        data.qpos[0] = q
        mujoco.mj_forward(model, data)
        assert data.qacc[0] * INERTIA == pytest.approx(0.7 * sin(12.5 * q + 0.6), abs=1e-9)


def test_periods_of_a_ripple_count_by_turn_or_by_metre() -> None:
    machine = machine_of("spatial")
    turning = CATALOGUE["torque_ripple"](machine, "turn")
    sliding = CATALOGUE["torque_ripple"](machine, "reach")
    assert [e.parameters[1].unit for e in (turning, sliding)] == ["1/turn", "1/m"]
    values = np.array([2.0, 40.0, 0.3])
    spec = machine.fresh()
    sliding.edit(spec, values)
    models = spec.compile(), machine.model
    for q in (0.01, 0.02, 0.035):  # a period of the slide is 25 mm
        shown = []
        for model in models:
            data = mujoco.MjData(model)
            data.joint("reach").qpos[0] = q
            mujoco.mj_forward(model, data)
            shown.append(data.joint("reach").qfrc_actuator[0])
        assert shown[0] - shown[1] == pytest.approx(2.0 * sin(2 * pi * 40 * q + 0.3))


def test_a_compliant_drive_rings_between_motor_and_link() -> None:
    effect = at(wheel(step=1e-4), "joint_compliance")
    stiffness = 40.0
    model = edited(effect, stiffness, 1e-3)
    data = mujoco.MjData(model)
    data.qpos[1] = 0.01
    rows = []
    for _ in range(20000):
        mujoco.mj_step(model, data)
        rows.append(data.qpos[1])
    crossings = np.flatnonzero(np.diff(np.sign(rows)) != 0)
    period = 2 * float(np.mean(np.diff(crossings))) * 1e-4
    wanted = 2 * pi / sqrt(stiffness * (1 / 0.2 + 1 / 0.4))
    assert period == pytest.approx(wanted, rel=2e-3)


def test_a_compliant_drive_sags_under_gravity_behind_its_encoder() -> None:
    machine = machine_of("planar")
    effect = at(machine, "joint_compliance", "joint3")
    model = edited(effect, 300.0, 1.0)
    data = mujoco.MjData(model)
    for _ in range(4000):
        mujoco.mj_step(model, data)
    total = float(data.qpos[[0, 1, 2, 3]].sum())
    torque = 2 * 9.81 * 0.15 * np.cos(total)
    assert data.joint("joint3_joint_compliance").qpos[0] == pytest.approx(-torque / 300, rel=1e-3)
    # The servo and the encoder stand on the motor side.
    assert data.joint("joint3").qpos[0] == pytest.approx(-torque / 400, rel=1e-3)
    assert data.sensor("encoder3").data[0] == pytest.approx(data.joint("joint3").qpos[0], abs=1e-9)


FINGER = ("desk", "left_finger")
SPLIT = [("planar", "joint2"), ("spatial", "reach"), FINGER]


@pytest.mark.parametrize(
    ("kind", "place"),
    [*product(("joint_compliance", "backlash"), SPLIT), ("structural_looseness", FINGER)],
)
def test_a_joint_without_rotor_stays_solvable_when_it_is_split(
    kind: str, place: tuple[str, str]
) -> None:
    arm, where = place
    if arm == "desk":
        spec = mujoco.MjSpec.from_file(str(DESK_ARM))
    else:
        spec = machine_of(arm).fresh()
        spec.joint(where).armature = 0.0
    effect = at(NominalModel(spec), kind, where)
    for start in effect.starts if arm != "desk" else effect.starts[:1]:
        along = (pi / 2, 0.0, *start[2:]) if kind == "structural_looseness" else start
        data = mujoco.MjData(edited(effect, *along))
        mujoco.mj_step(data.model, data, 500)
        assert np.isfinite(data.qpos).all()
        assert np.abs(data.qvel).max() < (10 if arm == "desk" else 2)


def test_backlash_leaves_a_dead_zone_between_its_stops() -> None:
    effect = at(wheel(loads=np.array([0.5])), "backlash")
    gap, stiffness = 0.02, effect.starts[0][1]
    model = edited(effect, gap, stiffness, 0.2)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data = mujoco.MjData(model)
    resting = []
    for torque in (0.5, -0.5, 2.0):
        for _ in range(4000):
            # The motor is pushed back as much as the link is pushed: neither runs away.
            data.qfrc_applied[:] = 0.0, torque
            data.qvel[0] -= 0.05 * (data.qvel[0] + data.qpos[0])
            mujoco.mj_step(model, data)
        resting.append(float(data.qpos[1]))
    # Hertz: a load presses by 1.5 of itself over the stiffness there, four times it by 4^(2/3) of
    # that.
    pressed = 1.5 * 0.5 / stiffness
    assert resting[0] - gap / 2 == pytest.approx(pressed, rel=0.07)
    assert resting[1] == pytest.approx(-resting[0], abs=1e-3 * pressed)
    assert resting[2] - gap / 2 == pytest.approx(4 ** (2 / 3) * pressed, rel=0.07)
    # Within the zone the link does not feel the motor.
    data = mujoco.MjData(model)
    data.qfrc_applied[:] = 0.0
    data.qvel[1] = 0.01
    mujoco.mj_step(model, data)
    assert model.joint("axle_backlash").range.tolist() == [-0.01, 0.01]
    assert data.nefc == 0


@pytest.mark.parametrize("arm", ["planar", "spatial"])
def test_an_encoder_s_offset_shows_in_its_reading_and_nowhere_else(arm: str) -> None:
    machine = machine_of(arm)
    for where in machine.joints:
        model, nominal = edited(at(machine, "encoder_offset", where), 0.03), machine.model
        rng = np.random.default_rng(1)
        true, wrong = mujoco.MjData(nominal), mujoco.MjData(model)
        true.qpos[:] = nominal.qpos0 + rng.uniform(-0.5, 0.5, nominal.nq)
        true.qvel[:] = wrong.qvel[:] = rng.normal(size=nominal.nv)
        wrong.qpos[:] = true.qpos
        wrong.qpos[machine.joint_number(where)] += 0.03
        mujoco.mj_forward(nominal, true)
        mujoco.mj_forward(model, wrong)
        # Gravity, springs and stops know where the link is; the servo believes its encoder.
        assert np.allclose(wrong.qfrc_bias, true.qfrc_bias, atol=1e-9)
        assert np.allclose(wrong.qfrc_passive, true.qfrc_passive, atol=1e-9)
        assert np.allclose(wrong.site("tool").xpos, true.site("tool").xpos, atol=1e-9)
        limited = nominal.jnt_limited.astype(bool)
        shift = np.where(np.array(machine.joints) == where, 0.03, 0.0)[:, None]
        assert np.allclose((model.jnt_range - nominal.jnt_range - shift)[limited], 0, atol=1e-9)
        moved = np.zeros(nominal.nv)
        gain = {"joint1": 2000, "joint2": 1000, "joint3": 400, "turn": 300, "lift": 300}.get(where)
        if gain and where != "lift":  # whose force is limited
            moved[machine.joint_number(where)] = -gain * 0.03
            assert np.allclose(wrong.qfrc_actuator - true.qfrc_actuator, moved, atol=1e-6)
