"""Sensor values at exact times: with commands that change within a step, and sensor delays.

A step is simulated with the mean of a command over it. An accelerometer reads the instantaneous
value: a servo's acceleration jumps with every command. A delayed one reads the value at an earlier
time, between two steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

from loose_env.gap.data.aligned_run import Channel
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.mjcf.sensor_columns import column_of, is_position_or_speed
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.simulation.applied_torque_terms import has_terms, torque_terms
from loose_env.gap.simulation.driven_effects import Driven
from loose_env.typing import Array

PARTS = 2
"""Parts of a step where commands change within it: a mean moves the speed rightly, and the place
only as far as the change lies in the middle."""
_AT_A_TIME = 1024
"""States at which sensors are worked out at a time."""


def changes_within(
    machine: NominalModel, hypothesis: Hypothesis, channels: Sequence[Channel]
) -> bool:
    """Return whether commands may change within a step, visible in a channel.

    Positions and speeds follow the mean of a command.
    """
    if all(is_position_or_speed(machine, channel.column) for channel in channels):
        return False
    return any(type(effect).command_at is not Effect.command_at for effect in hypothesis.stepping)


def late_sensors(hypothesis: Hypothesis, channels: Sequence[Channel]) -> dict[str, float]:
    """Delayed sensors among the channels, each with its delay [s]."""
    shown = {channel.column for channel in channels}
    found: dict[str, float] = {}
    for effect, own in hypothesis.pairs:
        late = effect.sensor_delay(own)
        if late is not None and late[1] > 0 and column_of(late[0]) in shown:
            found[late[0]] = found.get(late[0], 0.0) + late[1]
    return found


def states_before(states: Mapping[str, Array], at: Array, step: float) -> dict[str, Array]:
    """Interpolate the states of a simulation, for hinge and slide joints.

    Positions follow cubics through the positions and speeds at both ends of a step, within which
    commands are constant, and speeds their slopes; activations are linear.

    Examples
    --------
    >>> fallen = {"qpos": np.array([[0.0], [1.0]]), "qvel": np.array([[0.0], [2.0]])}
    >>> {name: float(v[0, 0]) for name, v in states_before(fallen, np.array([0.5]), 1.0).items()}
    {'qpos': 0.25, 'qvel': 1.0}
    """
    count = len(states["qpos"])
    steps = np.clip(at / step, 0.0, count - 1.0)
    low = np.minimum(np.floor(steps + 1e-9).astype(int), max(count - 2, 0))
    high = np.minimum(low + 1, count - 1)
    s = np.clip(steps - low, 0.0, 1.0)[:, None]
    found = {name: v[low] * (1 - s) + v[high] * s for name, v in states.items()}
    place, speed = states["qpos"], states["qvel"]
    if place.shape == speed.shape:
        way = place[high] - place[low]
        one, two = step * speed[low] - way, step * speed[high] - way
        found["qpos"] += s * (1 - s) * ((1 - s) * one - s * two)
        found["qvel"] = (way + one * (1 - s) * (1 - 3 * s) - two * s * (2 - 3 * s)) / step
    return found


def show_late_sensors(
    shown: Array,
    machine: NominalModel,
    hypothesis: Hypothesis,
    model: mujoco.MjModel,
    states: Mapping[str, Array],
    commands: Array,
    *,
    late: Mapping[str, float],
    step: float,
    parts: int = 1,
    first: int = 0,
    threads: int,
) -> None:
    """Replace the columns of delayed sensors (T, sensors) in place."""
    for name, delay in late.items():
        then: Array = np.arange(first, first + len(shown), dtype=float) * step - delay
        held = np.clip(np.floor(then / step + 1e-9).astype(int), 0, len(commands) - 1)
        before = states_before(states, then, step / parts)
        read = readings_at(machine, hypothesis, model, before, commands[held], threads)
        sensor = model.sensor(name)
        columns = slice(int(sensor.adr[0]), int(sensor.adr[0]) + int(sensor.dim[0]))
        shown[:, columns] = read[:, columns]


def commands_at(hypothesis: Hypothesis, clock: Array, controls: Array) -> Array:
    """Commands at the actuators at each step itself."""
    for effect, own in hypothesis.pairs:
        controls = effect.command_at(clock, controls, own)
    return controls


def readings_at(
    machine: NominalModel,
    hypothesis: Hypothesis,
    model: mujoco.MjModel,
    states: Mapping[str, Array],
    controls: Array,
    threads: int,
) -> Array:
    """Sensor values with instantaneous commands (T, sensors)."""
    batch = Batch(model, min(_AT_A_TIME, len(controls)), threads)
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
    sensed = batch.bind("sensordata")
    joints = [model.joint(name) for name in machine.joints]
    places = [int(joint.qposadr[0]) for joint in joints]
    dofs = [int(joint.dofadr[0]) for joint in joints]
    found = np.empty((len(controls), model.nsensordata))
    for first in range(0, len(controls), _AT_A_TIME):
        count = min(_AT_A_TIME, len(controls) - first)
        part = slice(first, first + count)
        for name, values in states.items():
            getattr(batch, name)[:count] = values[part]
        given = controls[part]
        if has_terms(hypothesis):
            at = states["qpos"][part][:, places], states["qvel"][part][:, dofs]
            given = Driven.of(hypothesis).commands(given, *at)
            batch.qfrc_applied[:count, dofs] = torque_terms(hypothesis, *at)
        batch.ctrl[:count, : controls.shape[1]] = given
        batch.forward()
        found[part] = sensed[:count]
    return found
