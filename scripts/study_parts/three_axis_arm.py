"""An arm of three joints with a spring in a drive that its model lacks, and its recording."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.io import Count
from loose_env.recording import Recording, Run, write_recording
from loose_env.typing import Array

__all__ = ["NOMINAL", "Settings", "record", "spring_of", "true_xml"]

NOMINAL = """<mujoco model="three_axis_arm">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.0005" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="column" pos="0 0 0.3">
      <joint name="base" axis="0 0 1" armature="0.5" damping="3" range="-3 3"/>
      <inertial pos="0 0.01 0.06" mass="6" diaginertia="0.04 0.04 0.03"/>
      <body name="upper_arm" pos="0 0.06 0.12">
        <joint name="shoulder" axis="0 1 0" armature="0.5" damping="3" range="-2.2 2.2"/>
        <inertial pos="0.16 0.01 0.01" mass="4" diaginertia="0.008 0.05 0.05"/>
        <body name="forearm" pos="0.35 -0.04 0">
          <joint name="elbow" axis="0 1 0" armature="0.15" damping="1" range="-2.5 2.5"/>
          <inertial pos="0.14 0 0.01" mass="2.5" diaginertia="0.004 0.022 0.022"/>
          <site name="tool" pos="0.32 0.03 0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hold_base" joint="base" kp="2000" kv="80" forcerange="-100 100"/>
    <position name="hold_shoulder" joint="shoulder" kp="3000" kv="100" forcerange="-120 120"/>
    <position name="hold_elbow" joint="elbow" kp="1000" kv="30" forcerange="-50 50"/>
    <motor name="push_base" joint="base" ctrlrange="-60 60"/>
    <motor name="push_shoulder" joint="shoulder" ctrlrange="-60 60"/>
    <motor name="push_elbow" joint="elbow" ctrlrange="-25 25"/>
  </actuator>
  <sensor>
    <jointpos name="encoder_base" joint="base"/>
    <jointpos name="encoder_shoulder" joint="shoulder"/>
    <jointpos name="encoder_elbow" joint="elbow"/>
    <accelerometer name="acceleration" site="tool"/>
  </sensor>
</mujoco>
"""
"""An arm of three joints and 1 m reach under gravity: position servos, torques added to theirs,
encoders on the motors and an accelerometer at the tool. Parameters are estimates for its class."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the true arm, its recording and the diagnosis."""

    joint: str = "shoulder"
    """Joint whose drive has a spring."""
    modes: tuple[float, ...] = (120.0, 60.0, 30.0, 15.0)
    """Mode of the spring with all that the joint carries, the arm stretched out [Hz]."""
    damping_ratio: float = 0.05
    """Damping ratio of that mode [1]."""
    off: float = 0.01
    """Masses, inertias and dampings of the true arm, relative to the nominal one, a deviation."""
    runs: Count = 4
    """Runs of the recording; one is held out."""
    run_seconds: float = 1.0
    """Length of each [s]."""
    kinds: tuple[str, ...] = ()
    """Effects that `loose gap` considers; none: all of its catalogue."""
    episodes: Count = 40
    """Hidden arms for each mode, the same for all models."""
    level: Count = 3
    """Level at which joints are shaken, from 1."""
    duration: float = 0.4
    """Length of a record of the diagnosis [s]."""
    lack_of_fit: float = 1.0
    """Lack of fit from which on the verdict is "unsure" [1]."""
    seed: int = 20_261_121
    """Seed of the true arms' parameters, of the recordings and of the hidden arms."""

    def __post_init__(self) -> None:
        """Check modes and episodes."""
        if min(self.modes, default=1.0) <= 0:
            raise InvalidSetting(f"modes must be above 0 Hz, got {self.modes}")
        if self.episodes < 2:
            raise InvalidSetting(f"episodes must be 2 or more, got {self.episodes}")


def carried_inertia(joint: str) -> float:
    """What a joint of the nominal arm carries without its rotor, at zero [kg·m²]."""
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    dof = int(model.joint(joint).dofadr[0])
    return float(mass[dof, dof] - model.dof_armature[dof])


def spring_of(settings: Settings, mode: float) -> tuple[float, float]:
    """Stiffness [N·m/rad] and damping [N·m·s/rad] of a spring with a mode [Hz]."""
    carried, omega = carried_inertia(settings.joint), 2 * np.pi * mode
    return carried * omega**2, 2 * settings.damping_ratio * carried * omega


def true_xml(settings: Settings, mode: float) -> str:
    """MJCF text of the true arm: a spring behind one drive, and parameters a little off."""
    spec = mujoco.MjSpec.from_string(NOMINAL)
    rng = np.random.default_rng([settings.seed, 0])  # the same arm but for its spring

    def factor() -> float:
        return float(1 + settings.off * np.clip(rng.standard_normal(), -2, 2))

    for body in spec.bodies[1:]:
        share = factor()
        body.mass *= share
        body.inertia = np.array(body.inertia) * share * factor()
    for joint in spec.joints:
        joint.damping = np.array(joint.damping) * factor()
    stiffness, damping = spring_of(settings, mode)
    joint = spec.joint(settings.joint)
    joint.parent.add_joint(
        name=f"{settings.joint}_gear",
        type=joint.type,
        axis=list(joint.axis),
        pos=list(joint.pos),
        stiffness=[stiffness, 0, 0],
        damping=[damping, 0, 0],
    )
    spec.compile()
    return spec.to_xml()  # type: ignore[no-any-return]


RATE = 2000
"""Samples a second of a recording."""
_STEP = 1e-4  # of the true arm's simulation [s]
_REST = 1.5  # in which it comes to rest before a run [s]
_PUSHED = (3.0, 200.0)  # band of the torques added to the servos' [Hz]
_PUSH = np.array([8.0, 8.0, 3.0])  # their root mean square [N·m]
_ENCODER = 2 * np.pi / 2**18  # step of an encoder [rad]
_NOISE = 0.03  # of each axis of the accelerometer [m/s²]


def motion(count: int, rng: np.random.Generator) -> Array:
    """Commands of a run (T, 6): slow sways of all servos, and random torques on top [rad, N·m]."""
    time, joints = np.arange(count) / RATE, len(_PUSH)
    rise = np.minimum(2 * time, 1.0)
    commands = np.zeros((count, 2 * joints))
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    band = (frequency > _PUSHED[0]) & (frequency < _PUSHED[1])
    for j in range(joints):
        middle = (0.0, -0.8, 1.2)[j] + 0.5 * rng.standard_normal()
        size, rate, phase = rng.uniform((0.05, 0.2, 0.0), (0.2, 1.5, 6.0), (3, 3)).T
        sway = size * (np.sin(2 * np.pi * rate * time[:, None] + phase) - np.sin(phase))
        commands[:, j] = middle + rise * sway.sum(1)
        noise = np.fft.irfft(band * np.exp(2j * np.pi * rng.random(len(frequency))), count)
        torque = _PUSH[j] * noise / noise.std()
        commands[:, joints + j] = rise * np.clip(torque, -3 * _PUSH[j], 3 * _PUSH[j])
    return commands


def recorded(model: mujoco.MjModel, commands: Array, rng: np.random.Generator) -> Array:
    """What the sensors show at every sample (T, S); the arm rests where the servos hold it."""
    data, joints = mujoco.MjData(model), len(_PUSH)
    for k in range(joints):  # a spring behind a drive stays at zero
        data.qpos[model.jnt_qposadr[model.actuator_trnid[k, 0]]] = commands[0, k]
    data.ctrl[:] = commands[0]
    mujoco.mj_step(model, data, nstep=round(_REST / _STEP))
    data.time = 0.0
    shown = np.zeros((len(commands), model.nsensordata))
    for row, command in zip(shown, commands, strict=True):
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        row[:] = data.sensordata
        mujoco.mj_step(model, data, nstep=round(1 / (RATE * _STEP)))
    angles = shown[:, :joints] + _ENCODER * rng.normal(0, 0.5, (len(commands), joints))
    shown[:, :joints] = _ENCODER * np.round(angles / _ENCODER)
    shown[:, joints:] += rng.normal(0, _NOISE, shown[:, joints:].shape)
    return shown


def record(settings: Settings, mode: float, folder: Path) -> Recording:
    """Record the sound true arm; the recording's model is the nominal one."""
    model = mujoco.MjModel.from_xml_string(true_xml(settings, mode))
    model.opt.timestep = _STEP
    count, runs = round(settings.run_seconds * RATE), []
    names = [model.actuator(k).name for k in range(model.nu)]
    sensors = [model.sensor(k).name for k in range(len(_PUSH))]
    for k in range(settings.runs):
        rng = np.random.default_rng([settings.seed, 1, k])  # the same motions for every mode
        commands = motion(count, rng)
        shown = recorded(model, commands, rng)
        runs.append(
            Run(
                name=f"run-{k + 1:02d}.csv",
                time=np.arange(count) / RATE,
                controls=dict(zip(names, commands.T, strict=True)),
                sensors=dict(zip(sensors, shown.T, strict=False))
                | {"acceleration": shown[:, len(_PUSH) :]},
            )
        )
    return write_recording(folder, model_xml=NOMINAL, runs=runs, file_format="csv", overwrite=True)
