"""Make a recording to try `loose gap` or `loose diagnose` on, of an arm with a hidden fault.

For `loose gap` a three-joint arm on position servos stands in for a machine. Its masses, dampings
and servo gains are 1 to 3 % off the model that goes with the recording, its sensors are noisy, and
the bearing of its second joint has run dry: 2 N·m of friction that the model does not have.

For `loose diagnose` a six-joint arm holds three poses while a joint is shaken. The parameters of
its model are a few per cent off, and its forearm slides by 0.1 mm on its joint.

Usage: python scripts/example_recording.py --out example
       python scripts/example_recording.py --for diagnose --out example
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from tyro.conf import arg

from loose_env.arms import DESK_ARM, Mismatch, arm_from_file
from loose_env.cli.command import command
from loose_env.excitation import Excitation
from loose_env.faults import StructuralLooseness
from loose_env.instrument import read_arm
from loose_env.recording import Recording, Run, write_recording
from loose_env.rig import SimulatedRig

LOOSE = StructuralLooseness(
    link=3,
    direction=(0.3, -0.95, -0.06),
    gap=1e-4,
    stiffness=(1e7, 1e7),
    damping=(900.0, 900.0),
    friction=0.7,
)
"""The loose forearm: a clearance of 0.1 mm."""
POSES = (
    ((0.0, 23.0, -52.0, 17.0, 29.0, 0.0), "shoulder", 18.0),
    ((29.0, -17.0, 63.0, -46.0, -23.0, 34.0), "shoulder", 18.0),
    ((-23.0, 52.0, 29.0, 69.0, 40.0, -29.0), "elbow", 10.0),
    ((46.0, 11.0, -34.0, -69.0, 52.0, 17.0), "shoulder", 18.0),
    ((-46.0, -6.0, 75.0, 57.0, -40.0, 0.0), "shoulder", 18.0),
)
"""Poses [degrees], the joint that is shaken in each and its rms torque [N·m]."""
SHAKEN_S, BAND_HZ = 1.2, (30.0, 150.0)
"""Length of such a run [s] and its band [Hz]."""
FRICTION = 2.0
"""Torque of the dry bearing [N·m]."""
STEP, SECONDS, RUNS = 0.001, 4.0, 4
"""Sample interval [s], length of a run [s], runs."""
NOISE = {"joint1_pos": 2e-5, "joint2_pos": 2e-5, "joint3_pos": 2e-5, "tool_acc": 0.03}
"""Standard deviations of the sensors' noise [rad, m/s²]."""
MODEL = """<mujoco model="three joints">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="RK4"/>
  <default><joint axis="0 -1 0" armature="0.3" damping="1"/></default>
  <worldbody>
    <body name="link1" pos="0 0 0.3">
      <joint name="joint1" axis="0 0 1"/>
      <inertial pos="0 0 0.1" mass="6" diaginertia="0.04 0.04 0.02"/>
      <body name="link2" pos="0 0 0.2">
        <joint name="joint2"/>
        <inertial pos="0.2 0 0" mass="4" diaginertia="0.01 0.06 0.06"/>
        <body name="link3" pos="0.4 0 0">
          <joint name="joint3" armature="0.1"/>
          <inertial pos="0.15 0 0" mass="2" diaginertia="0.004 0.02 0.02"/>
          <site name="tool" pos="0.3 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="motor1" joint="joint1" kp="3000" kv="90"/>
    <position name="motor2" joint="joint2" kp="3000" kv="90"/>
    <position name="motor3" joint="joint3" kp="800" kv="20"/>
  </actuator>
  <sensor>
    <jointpos name="joint1_pos" joint="joint1"/>
    <jointpos name="joint2_pos" joint="joint2"/>
    <jointpos name="joint3_pos" joint="joint3"/>
    <accelerometer name="tool_acc" site="tool"/>
  </sensor>
</mujoco>
"""


def machine(rng: np.random.Generator) -> mujoco.MjModel:
    """The machine: the model with other figures and a dry bearing, integrated more finely."""

    def off() -> float:
        return float(1 + rng.choice([-1, 1]) * rng.uniform(0.01, 0.03))

    spec = mujoco.MjSpec.from_string(MODEL)
    for body in spec.bodies[1:]:
        body.mass *= off()
    for joint in spec.joints:
        joint.damping = np.asarray(joint.damping) * off()
    for motor in spec.actuators:
        gain = off()
        motor.gainprm, motor.biasprm = (
            gain * np.array(motor.gainprm),
            gain * np.array(motor.biasprm),
        )
    dry = spec.joint("joint2")
    dry.frictionloss, dry.solref_friction = FRICTION, [5e-4, 1.0]
    dry.solimp_friction = [0.9999, 0.9999, 0.001, 0.5, 2]
    spec.option.timestep, spec.option.integrator = STEP / 2, mujoco.mjtIntegrator.mjINT_RK4
    return spec.compile()


def commands(time: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Smooth swings of all joints, of several frequencies, from rest (T, 3) [rad]."""
    waves = sum(
        rng.uniform(0.1, 0.4, 3) * np.sin(np.outer(time, rng.uniform(2.0, 9.0, 3)))
        for _ in range(3)
    )
    return np.asarray(waves * np.minimum(2 * time, 1.0)[:, None])


def example(folder: Path, *, seed: int = 1) -> Recording:
    """Record the machine and write the recording."""
    rng = np.random.default_rng(seed)
    model = machine(rng)
    time = STEP * np.arange(round(SECONDS / STEP), dtype=np.float64)
    runs = []
    for number in range(1, RUNS + 1):
        given = commands(time, rng)
        data = mujoco.MjData(model)
        for _ in range(4000):  # comes to rest
            mujoco.mj_step(model, data)
        shown = np.zeros((len(time), model.nsensordata))
        for row, control in zip(shown, given, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(model, data)
            row[:] = data.sensordata
            mujoco.mj_step(model, data)
        sensors = {}
        for name, noise in NOISE.items():
            sensor = model.sensor(name)
            columns = slice(int(sensor.adr[0]), int(sensor.adr[0]) + int(sensor.dim[0]))
            read = shown[:, columns] + rng.normal(0.0, noise, (len(time), int(sensor.dim[0])))
            sensors[name] = read if read.shape[1] > 1 else read[:, 0]
        controls = {f"motor{j + 1}": given[:, j] for j in range(3)}
        runs.append(
            Run(name=f"run-{number:02d}.parquet", time=time, controls=controls, sensors=sensors)
        )
    return write_recording(folder, model_xml=MODEL, runs=runs)


def loose_arm(folder: Path, *, seed: int = 1) -> Recording:
    """Record an arm with a loose forearm in a few poses and write the recording."""
    rng = np.random.default_rng(seed)
    arm, described = arm_from_file(DESK_ARM), read_arm(DESK_ARM).recording_model
    rig = SimulatedRig(arm)
    rig.mount(0, LOOSE, Mismatch().draw(arm, rng))
    runs = []
    for number, (pose, joint, torque) in enumerate(POSES, 1):
        torques = tuple(torque if name == joint else 0.0 for name in arm.joints)
        excitation = Excitation(torque_rms=torques, duration=SHAKEN_S, band=BAND_HZ)
        seen = rig.measure(np.radians(pose), excitation, rng=rng)
        angles = {name: seen.encoder[k, 1:-1] for k, name in enumerate(described.positions)}
        runs.append(
            Run(
                name=f"run-{number:02d}.parquet",
                time=np.arange(seen.tool.shape[1]) / seen.rate,
                sensors={described.accelerometer: seen.tool.T, **angles},
                torques={joint: seen.command[arm.joints.index(joint)]},
                excited=(joint,),
                pose=dict(zip(arm.joints, np.radians(pose).tolist(), strict=True)),
            )
        )
    return write_recording(folder, model_xml=described.xml, runs=runs)


MADE: dict[str, Callable[..., Recording]] = {"gap": example, "diagnose": loose_arm}
"""Command -> what makes a recording for it."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the recording."""

    out: Path = Path("example")
    """Folder; new or empty."""
    command: Annotated[Literal["gap", "diagnose"], arg(name="for")] = "gap"
    """Command that reads it."""
    seed: int = 1
    """Seed of parameters, motions and noise."""


def make(options: Options) -> None:
    """Make the recording and say what to do with it."""
    recording = MADE[options.command](options.out, seed=options.seed)
    seconds = recording.runs[0].time[-1] - recording.runs[0].time[0]
    print(f"{recording.folder}: {len(recording.runs)} runs of {seconds:.1f} s. Now:")
    given, name = recording.folder, options.command
    print(f"  loose {name} {given} --out {given}-{name}")


def main() -> None:
    """Make it, with errors in one line."""
    command("example_recording", __doc__, Options, make)


if __name__ == "__main__":
    main()
