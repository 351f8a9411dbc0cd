"""What the effects of actuators and sensors do, against formulas that know nothing of the edits."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.effects.sensors import delayed
from loose_env.gap.model.nominal_model import NominalModel
from tests.gap.cases.effect_arms import clock, commands, machine_of, simulate


def test_a_lag_answers_a_step_exponentially() -> None:
    machine = machine_of("planar")
    effect = CATALOGUE["actuator_lag"](machine, "servo3")
    time = clock(machine)
    controls = np.zeros((len(time), 3))
    controls[100:, 2] = 0.8
    reached = effect.command(time, controls, np.array([0.03]))
    left = np.exp(-(time[100:] - time[100]) / 0.03)
    # over a step its mean counts, here by the trapezoidal rule
    assert np.allclose(reached[100:-1, 2], 0.8 * (1 - (left[:-1] + left[1:]) / 2), atol=1e-4)
    assert not reached[:100].any()
    assert np.array_equal(reached[:, :2], controls[:, :2])
    # A command that holds from the start is there from the start.
    held = effect.command(time, np.full((len(time), 3), 0.5), np.array([0.03]))
    assert np.allclose(held, 0.5)


def test_a_delay_shifts_held_commands_by_parts_of_a_step() -> None:
    machine = machine_of("planar")
    time = clock(machine)
    controls = commands(machine, time) + 0.2
    for delay, whole, share in ((0.007, 7, 0.0), (0.0104, 10, 0.4)):
        for where, numbers in (("servo2", [1]), ("all", [0, 1, 2])):
            late = CATALOGUE["command_delay"](machine, where).command(
                time, controls, np.array([delay])
            )
            for number in range(3):
                own = controls[:, number]
                if number in numbers:
                    wanted = (1 - share) * own[1:-whole] + share * own[: -whole - 1]
                    assert np.allclose(late[whole + 1 :, number], wanted)
                    assert np.allclose(late[: whole - 1, number], own[0], atol=1e-12)
                else:
                    assert np.array_equal(late[:, number], own)
    assert CATALOGUE["command_delay"].locations(machine)[-1] == "all"
    spec = machine.fresh()
    for actuator in list(spec.actuators)[1:]:
        spec.delete(actuator)
    assert CATALOGUE["command_delay"].locations(NominalModel(spec)) == ("servo1",)


def test_a_gain_scales_the_force_or_the_command() -> None:
    machine = machine_of("spatial")
    found = {repr(effect): effect for effect in candidates(machine, ["actuator_gain"])}
    # A motor without feedback has one form only, a servo without a limit two.
    assert list(found) == [
        "actuator_gain@turn", "actuator_gain@turn (command)",
        "actuator_gain@lift", "actuator_gain@lift (command)", "actuator_gain@lift (servo)",
        "actuator_gain@reach", "actuator_gain@reach (command)",
        "actuator_gain@roll",
    ]  # fmt: skip
    for name, effect in found.items():
        spec = machine.fresh()
        effect.edit(spec, np.array([1.3]))
        model = spec.compile()
        for push in (0.3, 5.0):  # the second one saturates the lift
            before, after = mujoco.MjData(machine.model), mujoco.MjData(model)
            for data in (before, after):
                data.qpos[:] += 0.05
                data.qvel[:] = 0.1
                data.ctrl[:] = push
            if "command" in name:
                before.ctrl[machine.actuators.index(effect.where)] *= 1.3
            mujoco.mj_forward(machine.model, before)
            mujoco.mj_forward(model, after)
            if "servo" in name and push > 1:  # the limit is the same
                number = machine.actuators.index(effect.where)
                limit = machine.model.actuator_forcerange[number, 1]
                assert after.actuator_force[number] == before.actuator_force[number] == limit
                continue
            factors = [1.3 if n == effect.where and "command" not in name else 1.0
                       for n in machine.actuators]  # fmt: skip
            assert np.allclose(after.actuator_force, factors * before.actuator_force), name


def test_a_sensor_askew_shows_the_vector_in_its_own_axes() -> None:
    machine = machine_of("spatial")
    effect = CATALOGUE["sensor_misalignment"](machine, "shake")
    assert effect.locations(machine) == ("spin", "shake")
    turn = np.array([0.1, -0.2, 0.3])
    values = np.random.default_rng(0).normal(size=(7, 3))
    shown = effect.read(np.arange(7.0), {"sensor.shake": values}, turn)["sensor.shake"]
    axes = Rotation.from_rotvec(turn).as_matrix()  # columns: the sensor's axes in the site's
    assert np.allclose(shown, [[row @ axis for axis in axes.T] for row in values])
    assert np.allclose(np.linalg.norm(shown, axis=1), np.linalg.norm(values, axis=1))
    spec = machine.fresh()
    effect.export(spec, turn)
    # The site itself, and other sensors on it, stay.
    assert spec.sensor("place").objname == "tool"
    assert spec.sensor("shake").objname == "shake_sensor_misalignment"


def test_a_late_sensor_shows_what_was() -> None:
    machine = machine_of("planar")
    time = clock(machine)
    effect = CATALOGUE["sensor_delay"](machine, "rate3")
    late = effect.read(time, {"sensor.rate3": np.sin(40 * time)}, np.array([0.0123]))
    assert np.allclose(late["sensor.rate3"][13:], np.sin(40 * (time - 0.0123))[13:], atol=3e-4)
    assert not late["sensor.rate3"][:12].any()
    # Samples need not be evenly spaced, and there may be three axes.
    uneven = np.sort(np.random.default_rng(1).uniform(0, 0.5, 2000))
    shown = delayed(uneven, np.stack([uneven, 2 * uneven, -uneven], axis=-1), 0.05, axis=-2)
    assert np.allclose(shown[500:], np.outer(uneven[500:] - 0.05, [1, 2, -1]))


def test_gain_and_bias_leave_the_motion_alone() -> None:
    machine = machine_of("planar")
    readings = simulate(machine.model, commands(machine, clock(machine)))
    time = clock(machine)
    scaled = CATALOGUE["sensor_gain"](machine, "rate3").read(time, readings, np.array([1.2]))
    shifted = CATALOGUE["sensor_bias"](machine, "shake").read(
        time, readings, np.array([0.1, -0.2, 0.3])
    )
    assert np.allclose(scaled["sensor.rate3"], 1.2 * readings["sensor.rate3"])
    assert np.allclose(shifted["sensor.shake"] - readings["sensor.shake"], [0.1, -0.2, 0.3])
    for shown in (scaled, shifted):
        assert np.array_equal(shown["sensor.encoder1"], readings["sensor.encoder1"])


LATE = """
<mujoco>
  <option timestep="0.002" integrator="{integrator}" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="pan" axis="0 0 1" armature="0.1"/><geom size=".1" mass="1"/>
      <body pos="0.4 0 0"><joint name="nod" axis="0 0 1" armature="0.1"/>
        <geom size=".1" mass="1"/></body></body>
  </worldbody>
  <actuator>
    <position name="m1" joint="pan" kp="60" kv="4"/>
    <position name="m2" joint="nod" kp="40" kv="3" {motor}/>
  </actuator>
  <sensor>
    <jointpos name="q1" joint="pan"/><jointpos name="q2" joint="nod" {sensor}/>
  </sensor>
</mujoco>
"""
OWN = {
    "": 0.0,
    'delay="0.01" nsample="8"': 0.01,
    'delay="0.0101" nsample="8"': 0.012,  # held commands are late by whole steps
    'delay="0.0101" nsample="8" interp="linear"': 0.0101,
}


@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
@pytest.mark.parametrize("own", OWN)
def test_delays_add_up_in_the_written_model(own: str, integrator: str) -> None:
    xml = LATE.format(motor=own, sensor="", integrator=integrator)
    machine = NominalModel(mujoco.MjSpec.from_string(xml))
    several = [CATALOGUE["command_delay"](machine, where) for where in ("all", "m2")]
    time = np.arange(600) * 0.002
    controls = np.sin(np.outer(time, [7.0, 9.0])) * np.minimum(2 * time, 1.0)[:, None]
    late, spec = controls, machine.fresh()
    for effect, delay in zip(several, (0.02, 0.005), strict=True):
        late = effect.command(time, late, np.array([delay]))
        effect.export(spec, np.array([delay]))
    written = mujoco.MjModel.from_xml_string(spec.to_xml())
    half = 0.001 if integrator == "RK4" else 0.0
    if not own or integrator != "RK4":
        assert np.allclose(written.actuator_delay, [0.02 + half, OWN[own] + 0.025 + half])
    simulated, found = simulate(machine.model, late), simulate(written, controls)
    without = simulate(machine.model, controls)
    for name, column in simulated.items():
        visible = np.abs(column - without[name]).max()
        assert np.abs(column - found[name]).max() < 0.005 * visible, name


@pytest.mark.parametrize("own", OWN)
def test_delays_of_a_sensor_add_up_in_the_written_model(own: str) -> None:
    xml = LATE.format(motor="", sensor=own, integrator="implicitfast")
    machine = NominalModel(mujoco.MjSpec.from_string(xml))
    late = CATALOGUE["sensor_delay"](machine, "q2")
    time = np.arange(600) * 0.002
    controls = np.sin(np.outer(time, [7.0, 9.0]))
    simulated, spec = simulate(machine.model, controls), machine.fresh()
    for delay in (0.02, 0.0053):
        simulated = late.read(time, simulated, np.array([delay]))
        late.export(spec, np.array([delay]))
    assert spec.sensor("q2").delay == pytest.approx(OWN[own] + 0.0253)
    found = simulate(mujoco.MjModel.from_xml_string(spec.to_xml()), controls)
    off = np.abs(found["sensor.q2"] - simulated["sensor.q2"])[30:]
    assert off.max() < 1e-3 * np.abs(np.diff(simulated["sensor.q2"])).max() / 0.002 * 0.02
