"""A simulation with one step a sample, against one of forty: what moves, and what sensors read."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.export_mjcf import corrected_spec
from loose_env.gap.simulation.simulator import Simulator
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR

STEP, INSIDE, COUNT = 0.001, 40, 1200
RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
CHANNELS = (
    *(Channel(f"sensor.encoder{k}") for k in (1, 2, 3)),
    *(Channel("sensor.shake", axis) for axis in range(2)),
    *(Channel(f"torque.joint{k}") for k in (1, 2, 3)),
)


def commands() -> Array:
    """Fast ramps: a held command jumps at every sample."""
    time = np.arange(COUNT) * STEP
    return np.sin(np.outer(time, [9.0, 13.0, 17.0])) * np.minimum(4 * time, 1.0)[:, None]


def fine(kind: str, where: str, value: float) -> Array:
    """Encoders and accelerometer at the samples, by steps of 25 microseconds."""
    spec = mujoco.MjSpec.from_string(PLANAR)
    spec.option.timestep, spec.option.integrator = STEP / INSIDE, RK4
    for drive in ("servo1", "servo2", "servo3"):  # read at the beginning of a step
        force, of = mujoco.mjtSensor.mjSENS_ACTUATORFRC, mujoco.mjtObj.mjOBJ_ACTUATOR
        spec.add_sensor(type=force, objtype=of, objname=drive)
    model = spec.compile()
    own = model.actuator(where).id if where in ("servo1", "servo2") else slice(None)
    data, controls = mujoco.MjData(model), commands()
    for _ in range(400 * INSIDE):
        mujoco.mj_step(model, data)
    state, share = controls[0, own], 1 - np.exp(-STEP / INSIDE / max(value, 1e-9))
    shown, shaken = np.zeros((COUNT, len(CHANNELS))), np.zeros((COUNT * INSIDE, 2))
    for k in range(COUNT * INSIDE):
        now = controls[k // INSIDE]
        data.ctrl[:] = now
        if kind == "command_delay":
            late = int(np.floor(k / INSIDE - value / STEP + 1e-9))
            data.ctrl[own] = controls[max(late, 0), own]
        elif kind == "actuator_lag":
            after = state + share * (now[own] - state)
            data.ctrl[own] = 0.5 * (state + after)
            state = after
        mujoco.mj_step(model, data)
        read = data.sensordata
        shaken[k] = read[4:6]
        if k % INSIDE == 0:
            shown[k // INSIDE] = [*read[:3], *read[4:6], *read[-3:]]
    if kind == "sensor_delay":
        then = np.arange(COUNT) * INSIDE - round(value / STEP * INSIDE)
        shown[:, 3:5] = shaken[np.maximum(then, 0)]
    return shown


def recorded() -> Trial:
    """The run, without readings."""
    return Trial(
        name="run-01.csv", form="forward", time=np.arange(COUNT) * STEP,
        measured=np.zeros((COUNT, len(CHANNELS))), step=STEP, steps=COUNT, controls=commands(),
        position=np.zeros(3), speed=np.zeros(3), resting=True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "where", "value"),
    [("command_delay", "all", 0.0024), ("command_delay", "servo1", 0.0007),
     ("actuator_lag", "servo2", 0.0017)],
)  # fmt: skip
def test_accelerations_are_read_at_the_sample_though_commands_change_within_the_step(
    kind: str, where: str, value: float
) -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=STEP, integrator=RK4)
    expected = fine(kind, where, value)
    trial = recorded()
    effect = CATALOGUE[kind](machine, where)
    simulator = Simulator(machine, [trial], CHANNELS, threads=1)
    late = Hypothesis(effects=(effect,), values=(np.array([value]),))
    (shown,), (rigid,) = simulator.predict([late, Hypothesis()])
    visible = np.sqrt(np.mean((rigid - expected) ** 2, axis=0))
    off = np.sqrt(np.mean((shown - expected) ** 2, axis=0))
    assert np.all(off[:3] < 0.001 * visible[:3]), (off / visible).round(3)
    assert np.all(off[3:] < 0.05 * visible[3:]), (off / visible).round(3)


@pytest.mark.parametrize("value", [0.0003, 0.00665])
def test_a_late_accelerometer_shows_what_was_between_two_samples(value: float) -> None:
    """Straight lines between samples do not: the acceleration jumps with every command."""
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=STEP, integrator=RK4)
    expected = fine("sensor_delay", "shake", value)
    effect = CATALOGUE["sensor_delay"](machine, "shake")
    simulator = Simulator(machine, [recorded()], CHANNELS, threads=1)
    hypotheses = [
        Hypothesis(effects=(effect,), values=(np.array([late]),)) for late in (value, 2 * value)
    ]
    none = Hypothesis()
    (shown,), (later,), (rigid,) = simulator.predict([*hypotheses, none])
    visible = np.sqrt(np.mean((rigid - expected) ** 2, axis=0))[3:5]
    off = np.sqrt(np.mean((shown - expected) ** 2, axis=0))[3:5]
    assert np.all(off < 0.03 * visible), (off / visible).round(4)
    assert np.all(np.abs(later - expected)[:, 3:5].max(axis=0) > 10 * off)
    others = [0, 1, 2, 5, 6, 7]
    assert np.array_equal(shown[:, others], rigid[:, others])


GEARED = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <site name="wall" pos="0 0.3 0.1"/>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="3"/><geom size=".1"/>
      <body name="fore" pos="0 0 0.3">
        <joint name="elbow" axis="0 1 0" damping="3"/><geom size=".1"/>
        <site name="wrist" pos="0 0 0.2"/>
        <body name="hand" pos="0 0 0.3">
          <joint name="rail" type="slide" axis="0 1 0" damping="3"/><geom size=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="shoulder" coef="2"/><joint joint="elbow" coef="-1"/></fixed>
    <spatial name="rope"><site site="wall"/><site site="wrist"/></spatial>
  </tendon>
  <actuator>
    <motor name="coupled" tendon="both" gear="3"/>
    <motor name="outer" jointinparent="shoulder" gear="5"/>
    <motor name="pusher" joint="rail" gear="7"/>
    {more}
  </actuator>
  <sensor><jointpos name="encoder" joint="shoulder"/></sensor>
</mujoco>
"""


def geared(more: str = "") -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(GEARED.format(more=more)))


def test_forces_of_tendons_count_as_torque_on_the_joints_they_pull() -> None:
    machine = geared()
    names = ("shoulder", "elbow", "rail")
    assert machine.pose_dependent_joints == ()
    assert machine.actuated_joint == {"outer": "shoulder", "pusher": "rail"}
    time = np.arange(200) * STEP
    controls = np.sin(np.outer(time, [9.0, 13.0, 17.0]))
    trial = Trial(
        name="run", form="forward", time=time, measured=np.zeros((200, 3)), step=STEP, steps=200,
        controls=controls, position=np.zeros(3), speed=np.zeros(3), resting=False,
    )  # fmt: skip
    channels = tuple(Channel(f"torque.{name}") for name in names)
    found = Simulator(machine, [trial], channels, threads=1).predict([Hypothesis()])[0][0]
    data = mujoco.MjData(machine.model)
    for k in range(200):
        data.ctrl[:] = controls[k]
        mujoco.mj_forward(machine.model, data)
        assert np.allclose(found[k], data.qfrc_actuator)
        mujoco.mj_step(machine.model, data)


def test_a_delay_of_the_model_stays_at_a_finer_step() -> None:
    late = '<position name="servo2" delay="0.01" nsample="12"'
    spec = mujoco.MjSpec.from_string(PLANAR.replace('<position name="servo2"', late))
    machine = NominalModel(spec, step=0.00025)
    model = Hypothesis().model(machine, 0.000125)
    data, shown = mujoco.MjData(model), []
    for _ in range(100):
        data.ctrl[1] = 1.0
        mujoco.mj_step(model, data)
        shown.append(abs(data.actuator_force[1]) > 100.0)
    assert shown.index(True) == pytest.approx(80, abs=1)
    assert corrected_spec(machine, Hypothesis()).actuators[1].nsample >= 40
