"""Arms on which the effects are tried, and a plain simulation of them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.model.effect import DrivenEffect, Effect, Readings
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

SHARED = Path(__file__).parents[4] / "shared" / "models"

PLANAR = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 -9.81 0" integrator="implicitfast"/>
  <default><joint axis="0 0 1" armature="0.2" damping="0.5"/></default>
  <worldbody>
    <body name="link1">
      <joint name="joint1" range="-3 3" limited="true" stiffness="2" springref="0.4"/>
      <inertial pos="0.17 0.01 0" mass="4" diaginertia="0.01 0.04 0.04"/>
      <body name="link2" pos="0.3 0 0">
        <joint name="joint2"/>
        <inertial pos="0.16 0 0" mass="3" diaginertia="0.008 0.03 0.03"/>
        <body name="link3" pos="0.3 0 0">
          <joint name="joint3" armature="0.05"/>
          <inertial pos="0.15 0 0" mass="2" diaginertia="0.005 0.02 0.02"/>
          <geom name="boom" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
          <site name="tool" pos="0.3 0 0" euler="0 0 0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="servo1" joint="joint1" kp="2000" kv="80"/>
    <position name="servo2" joint="joint2" kp="1000" kv="40" ctrlrange="-2 2"/>
    <position name="servo3" joint="joint3" kp="400" kv="15"/>
  </actuator>
  <sensor>
    <jointpos name="encoder1" joint="joint1"/>
    <jointpos name="encoder2" joint="joint2"/>
    <jointpos name="encoder3" joint="joint3"/>
    <jointvel name="rate3" joint="joint3"/>
    <accelerometer name="shake" site="tool"/>
  </sensor>
</mujoco>
"""

# Degrees, a slide, a frame, masses from geoms, a body without name, motors without feedback.
SPATIAL = """
<mujoco>
  <compiler angle="degree" autolimits="true"/>
  <option timestep="0.001"/>
  <default><joint axis="0 1 0" damping="0.4" armature="0.05"/></default>
  <worldbody>
    <body name="column" pos="0 0 0.2">
      <joint name="turn" axis="0 0 1" range="-170 170"/>
      <geom type="cylinder" size="0.08 0.1" mass="3"/>
      <frame pos="0 0 0.1" euler="0 0 20">
        <body name="arm" euler="0 70 0">
          <joint name="lift" ref="10" range="-80 100" stiffness="3" springref="30"/>
          <geom type="capsule" fromto="0 0 0 0.05 0 0.4" size="0.03" mass="2"/>
          <site name="middle" pos="0.02 0 0.3"/>
          <body name="ram" pos="0.05 0 0.4">
            <joint name="reach" type="slide" axis="0 0 1" range="-0.1 0.2" damping="30"
                   armature="2"/>
            <geom type="box" size="0.03 0.02 0.15" pos="0 0 0.15" mass="1.2"/>
            <body pos="0 0 0.3">
              <geom type="sphere" size="0.03" mass="0.2"/>
              <body name="hand">
                <joint name="roll" axis="1 0 0"/>
                <inertial pos="0 0.02 0.06" mass="0.6"
                          fullinertia="0.0011 0.0012 0.0008 0.0001 0 0.00005"/>
                <site name="tool" pos="0 0.03 0.12"/>
              </body>
            </body>
          </body>
        </body>
      </frame>
    </body>
  </worldbody>
  <actuator>
    <position name="turn" joint="turn" kp="300" kv="20"/>
    <position name="lift" joint="lift" kp="300" kv="20" forcerange="-60 60"/>
    <position name="reach" joint="reach" kp="3000" kv="150"/>
    <motor name="roll" joint="roll" gear="2"/>
  </actuator>
  <sensor>
    <jointpos name="q_turn" joint="turn"/>
    <jointpos name="q_lift" joint="lift"/>
    <jointpos name="q_reach" joint="reach"/>
    <jointpos name="q_roll" joint="roll"/>
    <gyro name="spin" site="middle"/>
    <accelerometer name="shake" site="tool"/>
    <framepos name="place" objtype="site" objname="tool"/>
  </sensor>
</mujoco>
"""

ARMS = ("planar", "spatial", "so101")


@cache
def machine_of(name: str) -> NominalModel:
    """A machine by name; the test is skipped where its file is missing."""
    if name == "so101":
        file = SHARED / "so101_bare.xml"
        if not file.is_file():
            pytest.skip("the published arms are not beside the repository")
        return NominalModel(mujoco.MjSpec.from_file(str(file)))
    return NominalModel(mujoco.MjSpec.from_string({"planar": PLANAR, "spatial": SPATIAL}[name]))


def clock(machine: NominalModel, duration: float = 0.5) -> Array:
    step = machine.model.opt.timestep
    return np.arange(round(duration / step)) * step


def commands(machine: NominalModel, time: Array) -> Array:
    """Smooth commands that begin at rest (T, actuators)."""
    number = np.arange(1, len(machine.actuators) + 1)
    limits = np.where(machine.model.actuator_biasprm[: len(number), 1] != 0, 0.3, 0.05)
    limits = np.where(np.array(machine.actuators) == "reach", 0.05, limits)
    return np.asarray(limits * np.sin(np.outer(time, 3.0 + 2.0 * number)))


def simulate(
    model: mujoco.MjModel,
    controls: Array,
    effect: Effect | None = None,
    values: Array | None = None,
) -> Readings:
    """Readings of every sensor, one row a step; an effect of the drives acts step by step."""
    data = mujoco.MjData(model)
    rows = np.zeros((len(controls), model.nsensordata))
    base = model.dof_frictionloss.copy()
    for k, row in enumerate(controls):
        data.ctrl[: len(row)] = row
        if isinstance(effect, DrivenEffect) and values is not None:
            joints = [model.joint(name) for name in effect.machine.joints]
            dofs = [int(joint.dofadr[0]) for joint in joints]
            at, speed = data.qpos[[int(j.qposadr[0]) for j in joints]], data.qvel[dofs]
            data.ctrl[: len(row)] = effect.feedback(row, at, speed, values)
            mujoco.mj_forward(model, data)
            drive = data.qfrc_actuator[dofs]
            friction = effect.dry_friction(drive, -data.qfrc_bias[dofs], speed, values)
            model.dof_frictionloss[dofs] = base[dofs] + friction
        mujoco.mj_step(model, data)
        rows[k] = data.sensordata
    found: Readings = {}
    for k in range(model.nsensor):
        start, size = int(model.sensor_adr[k]), int(model.sensor_dim[k])
        column = f"sensor.{model.sensor(k).name}"
        found[column] = rows[:, start] if size == 1 else rows[:, start : start + size]
    return found


def with_effect(machine: NominalModel, effect: Effect, values: Array) -> Readings:
    """Readings of a machine that has an effect."""
    spec = machine.fresh()
    effect.edit(spec, values)
    time = clock(machine)
    controls = effect.command(time, commands(machine, time), values)
    return effect.read(time, simulate(spec.compile(), controls, effect, values), values)


def difference(first: Readings, second: Readings, start: int = 0) -> float:
    """Largest difference between readings."""
    return max(float(np.abs(first[c] - second[c])[start:].max()) for c in first)
