"""A simulation with one step a sample, against one of forty: what moves, and what sensors read."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.gap.catalogue import CATALOGUE
from loose_env.gap.hypothesis import Hypothesis
from loose_env.gap.machine import Machine
from loose_env.gap.simulator import Simulator
from loose_env.gap.trial import Channel, Trial
from tests.gap.effect_arms import PLANAR

Array = NDArray[np.float64]
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
    own = slice(None) if where == "all" else model.actuator(where).id
    data, controls = mujoco.MjData(model), commands()
    for _ in range(400 * INSIDE):
        mujoco.mj_step(model, data)
    state, share = controls[0, own], 1 - np.exp(-STEP / INSIDE / max(value, 1e-9))
    shown = np.zeros((COUNT, len(CHANNELS)))
    for k in range(COUNT * INSIDE):
        now = controls[k // INSIDE]
        data.ctrl[:] = now
        if kind == "command_delay":
            late = int(np.floor(k / INSIDE - value / STEP + 1e-9))
            data.ctrl[own] = controls[max(late, 0), own]
        else:
            after = state + share * (now[own] - state)
            data.ctrl[own] = 0.5 * (state + after)
            state = after
        mujoco.mj_step(model, data)
        if k % INSIDE == 0:
            read = data.sensordata
            shown[k // INSIDE] = [*read[:3], *read[4:6], *read[-3:]]
    return shown


def recorded() -> Trial:
    """The run, without readings."""
    return Trial(
        name="run-01.csv", form="forward", time=np.arange(COUNT) * STEP,
        measured=np.zeros((COUNT, len(CHANNELS))), step=STEP, steps=COUNT, controls=commands(),
        position=np.zeros(3), speed=np.zeros(3), resting=True,
    )  # fmt: skip


def test_a_drive_shows_the_force_of_the_sample_not_that_at_the_end_of_its_step() -> None:
    machine = Machine(mujoco.MjSpec.from_string(PLANAR), step=STEP, integrator=RK4)
    expected = fine("command_delay", "all", 0.0)
    simulator = Simulator(machine, [recorded()], CHANNELS, threads=1)
    shown = simulator.predict([Hypothesis(effects=(), values=())])[0][0]
    moved = np.sqrt(np.mean(np.diff(expected, axis=0) ** 2, axis=0))
    off = np.sqrt(np.mean((shown - expected) ** 2, axis=0))
    assert np.all(off < 0.02 * moved), (off / moved).round(4)


@pytest.mark.parametrize(
    ("kind", "where", "value"),
    [("command_delay", "all", 0.0024), ("command_delay", "servo1", 0.0007),
     ("actuator_lag", "servo2", 0.0017)],
)  # fmt: skip
def test_accelerations_are_read_at_the_sample_though_commands_change_within_the_step(
    kind: str, where: str, value: float
) -> None:
    machine = Machine(mujoco.MjSpec.from_string(PLANAR), step=STEP, integrator=RK4)
    expected = fine(kind, where, value)
    trial = recorded()
    effect = CATALOGUE[kind](machine, where)
    simulator = Simulator(machine, [trial], CHANNELS, threads=1)
    late = Hypothesis(effects=(effect,), values=(np.array([value]),))
    (shown,), (rigid,) = simulator.predict([late, Hypothesis(effects=(), values=())])
    visible = np.sqrt(np.mean((rigid - expected) ** 2, axis=0))
    off = np.sqrt(np.mean((shown - expected) ** 2, axis=0))
    assert np.all(off[:3] < 0.001 * visible[:3]), (off / visible).round(3)
    assert np.all(off[3:] < 0.05 * visible[3:]), (off / visible).round(3)
