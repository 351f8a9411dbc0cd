"""Make a recording to try `loose gap` or `loose diagnose` on, of an arm with a hidden fault.

For `loose gap` a three-joint arm on position servos stands in for a machine. Its masses, dampings
and servo gains are 1 to 3 % off the model that goes with the recording, its sensors are noisy, and
the bearing of its second joint has run dry: 2 N·m of friction that the model does not have.

For `loose diagnose` a six-joint arm with servos and dry friction plays a session of `loose plan`.
Its masses are a few per cent off the model, and its third link slides by 0.2 mm on its joint.

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

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.cli.command import command
from loose_env.errors import InvalidSetting
from loose_env.instrument import PLAN, PlanSettings, SuspectArm, commands_of, plan
from loose_env.io import write_text
from loose_env.recording import Recording, Run, write_recording

LOOSE = ("link3", (0.0, 0.0, 1.0), 2e-4)
"""The loose link, the direction of its slide in its own frame, and its clearance [m]."""
SERVO_HZ, DRY = 25.0, 0.02
"""Bandwidth of the servos [Hz], and friction of a joint over its inertia's torque at 10 rad/s²."""
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


def loose_arm(
    folder: Path, *, seed: int = 1, loose: bool = True, reference: bool = False
) -> Recording:
    """Plan a session for an arm with a loose third link, play it, and write the recording.

    Parameters
    ----------
    folder : Path
        Recording; the plan goes into the folder above it.
    seed : int
        Of the machine and its noise.
    loose : bool
        False for a healthy arm.
    reference : bool
        True to play the session on the healthy arm too.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InvalidSetting(f"{folder} is not empty; give a new or empty folder")
    settings = PlanSettings(controller="ros2_jtc", rate_hz=1000.0, reference=reference)
    made, arm = plan(SIX_AXIS_SERVO_ARM, settings)
    home = folder if folder.name == "recording" else folder.parent
    runs = []
    for number, run in enumerate(made.runs):
        rng = np.random.default_rng([seed, number])
        model = suspect(np.random.default_rng(seed), loose and run.condition == "suspect")
        time, given = commands_of(made, arm, run)
        encoders, tool = played(model, arm, given)
        readings = {
            name: np.round((encoders[:, k]) / 2e-5) * 2e-5
            for k, name in enumerate(arm.recording_model.positions)
        }
        readings[arm.recording_model.accelerometer] = tool + rng.normal(0.0, 0.02, tool.shape)
        runs.append(
            Run(
                name=run.file,
                time=time,
                sensors=readings,
                pose=run.pose,
                condition="healthy" if run.condition == "healthy" else "suspect",
            )
        )
    recording = write_recording(folder, model_xml=arm.recording_model.xml, runs=runs)
    write_text(home / PLAN, made.to_json())
    return recording


def suspect(rng: np.random.Generator, loose: bool) -> mujoco.MjModel:
    """The arm with other masses, and a third link that may slide."""
    spec = mujoco.MjSpec.from_file(str(SIX_AXIS_SERVO_ARM))
    for body in spec.bodies[1:]:
        body.mass *= float(1 + 0.05 * rng.standard_normal())
    for element in (*spec.actuators, *spec.keys):
        spec.delete(element)
    if loose:
        link, direction, gap = LOOSE
        seat = spec.body(link).add_joint(
            name="seat", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(direction)
        )
        seat.range, seat.limited = [0.0, gap], True
        seat.solref_limit = [4e-4, 1.0]
        seat.frictionloss = 1.0
    spec.option.timestep = 1e-4
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


def played(
    model: mujoco.MjModel, arm: SuspectArm, given: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Joint positions (T, n) and proper acceleration of the tool (T, 3) under commands (T, n)."""
    data = mujoco.MjData(model)
    at = np.array([int(model.joint(j).qposadr[0]) for j in arm.joints])
    dofs = np.array([int(model.joint(j).dofadr[0]) for j in arm.joints])
    data.qpos[at] = given[0]
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    inertia, omega = np.diag(mass)[dofs], 2 * np.pi * SERVO_HZ
    weight = data.qfrc_bias[dofs].copy()
    site = model.site(arm.recording_model.site).id
    rest = round(0.5 / STEP)
    encoders, tool = np.zeros_like(given), np.zeros((len(given), 3))
    velocity, jacobian = np.zeros(3), np.zeros((3, model.nv))
    for k in range(-rest, len(given)):
        q, v = data.qpos[at], data.qvel[dofs]
        error = given[max(k, 0)] - q
        drive = inertia * (omega**2 * error - 1.4 * omega * v)
        data.qfrc_applied[dofs] = weight + drive - DRY * 10 * inertia * np.tanh(v / 0.01)
        mujoco.mj_step(model, data, nstep=round(STEP / model.opt.timestep))
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        before, velocity = velocity, jacobian @ data.qvel
        if k >= 0:
            turn = data.site_xmat[site].reshape(3, 3)
            encoders[k] = data.qpos[at]
            tool[k] = turn.T @ ((velocity - before) / STEP * (k > 0) - model.opt.gravity)
    return encoders, tool


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
