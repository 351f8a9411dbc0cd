"""A simulated arm of three joints, recorded in held poses while one joint is shaken."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from scipy import signal

from loose_env.recording import Recording, Run, read_recording, write_recording
from loose_env.typing import Array

STEP, SECONDS = 0.001, 2.0
POSES = ((0.3, 0.7, 0.9), (-0.4, 1.1, -0.8), (0.9, 0.4, 1.3))
JOINTS = ("base", "upper", "fore")
MOTORS = "".join(f'<motor name="m_{j}" joint="{j}"/>' for j in JOINTS)
SERVOS = "".join(f'<position name="m_{j}" joint="{j}" kp="900" kv="25"/>' for j in JOINTS)
MODEL = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><joint axis="0 1 0" armature="0.1" damping="1" range="-2.5 2.5"/></default>
<worldbody><body name="l1" pos="0 0 .3">
 <joint name="base" axis="0 0 1"/><inertial pos="0 0 .1" mass="5" diaginertia=".04 .04 .02"/>
 <body name="l2" pos="0 0 .2">
  <joint name="upper"/><inertial pos=".2 0 0" mass="4" diaginertia=".01 .06 .06"/>
  <body name="l3" pos=".4 0 0">
   <joint name="fore"/><inertial pos=".15 0 0" mass="2" diaginertia=".004 .02 .02"/>
   <site name="tool" pos=".3 .02 .01"/>
</body></body></body></worldbody>
<actuator>{actuators}</actuator>
<sensor>{sensors}<accelerometer name="acc" site="tool"/><gyro name="gyro" site="tool"/></sensor>
</mujoco>"""
SENSORS = "".join(
    f'<jointpos name="q_{j}" joint="{j}"/><jointvel name="v_{j}" joint="{j}"/>' for j in JOINTS
)
NOISE = {"q": 1e-6, "v": 1e-4, "acc": 0.02, "gyro": 1e-3}


def xml(actuators: str = SERVOS) -> str:
    """MJCF of the arm."""
    return MODEL.format(actuators=actuators, sensors=SENSORS)


def shaken(model: mujoco.MjModel, number: int) -> Run:
    """One run: a pose held by a servo or by a controller on torque motors, one joint shaken."""
    rng = np.random.default_rng(number)
    pose = np.array(POSES[number])
    servos = bool(model.actuator_biastype[0])
    count = round(SECONDS / STEP)
    band = signal.butter(2, (5.0, 60.0), "bandpass", fs=1 / STEP, output="sos")
    noise = signal.sosfilt(band, rng.normal(size=count + 500))
    noise *= (0.02 if servos else 12.0) / noise.std()
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    rows, commands = [], []
    for k in range(count + 500):
        if servos:
            data.ctrl[:] = pose
        else:
            data.ctrl[:] = data.qfrc_bias + 300 * (pose - data.qpos) - 15 * data.qvel
        data.ctrl[number] += noise[k]
        given = data.ctrl.copy()
        mujoco.mj_step(model, data)
        rows.append(data.sensordata.copy())
        commands.append(given)
    read, played = np.array(rows)[500:], np.array(commands)[500:]
    sensors: dict[str, Array] = {}
    for s in range(model.nsensor):
        name = model.sensor(s).name
        at, width = int(model.sensor_adr[s]), int(model.sensor_dim[s])
        sd = NOISE[name.partition("_")[0]]
        values = read[:, at : at + width] + rng.normal(0.0, sd, (count, width))
        sensors[name] = values if width > 1 else values[:, 0]
    return Run(
        name=f"run-{number}.parquet",
        time=STEP * np.arange(count),
        controls={f"m_{j}": played[:, i] for i, j in enumerate(JOINTS)},
        sensors=sensors,
        excited=(JOINTS[number],),
        pose=dict(zip(JOINTS, map(float, pose), strict=True)),
    )


def record(folder: Path, actuators: str = SERVOS) -> Recording:
    """Simulate, write and read a recording of three runs."""
    model = mujoco.MjModel.from_xml_string(xml(actuators))
    runs = [shaken(model, number) for number in range(len(POSES))]
    write_recording(folder, model_xml=xml(actuators), runs=runs)
    return read_recording(folder)


def each_run(recording: Recording, change: Callable[[Run], Run]) -> Recording:
    """Change every run of a recording."""
    return replace(recording, runs=tuple(change(run) for run in recording.runs))


def with_sensors(recording: Recording, prefix: str, change: Callable[[Array], Array]) -> Recording:
    """Change the columns of all sensors whose name begins with a prefix."""

    def changed(columns: Mapping[str, Array]) -> dict[str, Array]:
        return {n: change(v) if n.startswith(prefix) else v for n, v in columns.items()}

    return each_run(recording, lambda run: replace(run, sensors=changed(run.sensors)))


def with_controls(recording: Recording, change: Callable[[Array], Array]) -> Recording:
    """Change all commands of a recording."""
    return each_run(
        recording,
        lambda run: replace(run, controls={n: change(v) for n, v in run.controls.items()}),
    )


def late(values: Array, seconds: float) -> Array:
    """Column delayed by a time, by a phase shift of its spectrum."""
    count = len(values)
    frequency = np.fft.rfftfreq(count, STEP)
    turn = np.exp(-2j * np.pi * frequency * seconds)
    spectrum = np.fft.rfft(values, axis=0)
    return np.fft.irfft(spectrum * (turn if values.ndim == 1 else turn[:, None]), count, axis=0)
