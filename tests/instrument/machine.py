"""A small arm with servos, simulated in MuJoCo alone: what a session of it records.

It shares no numerics with `loose_env`. Seats, play and springs of gears are joints of the simulated
arm that the nominal model does not have; encoders see the rotor.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from loose_env.instrument import Plan, PlanSettings, SuspectArm, commands_of, plan
from loose_env.io import write_text
from loose_env.recording import Recording, Run, write_recording

Array = NDArray[np.float64]

JOINTS, LINKS = ("turn", "lift", "bend"), ("column", "upper", "fore")
NOMINAL = """<mujoco model="bench">
  <compiler angle="radian"/>
  <worldbody>
   <body name="foot" pos="0 0 .3">
    <inertial pos="0 0 -.1" mass="15" diaginertia=".2 .2 .1"/>
    <body name="column">
      <joint name="turn" axis="0 0 1" range="-2.5 2.5" armature=".6"/>
      <inertial pos="0 0 .1" mass="9" diaginertia=".05 .05 .04"/>
      <body name="upper" pos="0 0 .25">
        <joint name="lift" axis="0 1 0" range="-1.6 1.2" armature=".6"/>
        <inertial pos=".2 0 .02" mass="6" diaginertia=".02 .1 .1"/>
        <body name="fore" pos=".45 0 0">
          <joint name="bend" axis="0 1 0" range="-2 2" armature=".2"/>
          <inertial pos=".18 .01 0" mass="3" diaginertia=".006 .03 .03"/>
          <site name="tool" pos=".38 0 0"/>
        </body>
      </body>
    </body>
   </body>
  </worldbody>
  <sensor><accelerometer name="acc" site="tool"/></sensor>
</mujoco>
"""
TWO = NOMINAL.replace(
    '<body name="fore"', '<site name="elbow" pos=".4 0 .03" euler=".4 -.3 1"/><body name="fore"'
).replace("</sensor>", '<accelerometer name="elbow_acc" site="elbow"/></sensor>')
"""The same arm with a second accelerometer, half-way up."""
RATE, STEP, REST = 1000.0, 2e-4, 0.6
"""Rate of the log [Hz], step of the simulation [s], time at rest before the commands [s]."""
SERVO_HZ, COULOMB = 22.0, 0.25
"""Bandwidth of the servos [Hz]; dry friction of each joint [N·m]."""
COUNT, NOISE = 1e-5, 0.02
"""Step of the encoders [rad] and noise of the accelerometer [m/s²]."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The simulated arm's faults and its gears."""

    seat: str = ""
    """Link whose seat is loose."""
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction of its slide, link frame."""
    clearance: float = 2e-4
    """Of the seat [m]."""
    play: str = ""
    """Joint with play."""
    travel: float = 2e-3
    """Free travel of it [rad]."""
    mode_hz: float = 0.0
    """Frequency of the gears' springs against the links [Hz]; 0 for stiff gears."""
    mass: float = 1.03
    """Mass of the links over the model's."""
    rocks: float = 0.0
    """Angle by which the foot rocks on its bolts [rad]."""
    payload: float = 0.0
    """Mass at the tool that the model lacks [kg]."""


def simulated(truth: Truth, nominal_xml: str = NOMINAL) -> mujoco.MjModel:
    """The arm itself: servos, friction, springs, and what is loose."""
    spec = mujoco.MjSpec.from_string(nominal_xml)
    nominal = spec.compile()
    data = mujoco.MjData(nominal)
    mujoco.mj_forward(nominal, data)
    full = np.zeros((nominal.nv, nominal.nv))
    mujoco.mj_fullM(nominal, data, full)
    for k, (joint, link) in enumerate(zip(JOINTS, LINKS, strict=True)):
        body, hinge = spec.body(link), spec.joint(joint)
        body.mass *= truth.mass
        hinge.frictionloss = COULOMB
        own = full[k, k] - nominal.dof_armature[k]
        if truth.mode_hz:
            spring = body.add_joint(name=f"{joint}_spring", axis=list(hinge.axis), armature=2e-3)
            stiff = own * (2 * np.pi * truth.mode_hz) ** 2
            spring.stiffness, spring.damping = [stiff, 0, 0], [0.06 * np.sqrt(stiff * own), 0, 0]
            spec.add_sensor(
                name=spring.name, type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=spring.name,
            )  # fmt: skip
        if truth.play == joint:
            teeth = body.add_joint(name="teeth", axis=list(hinge.axis))
            teeth.range, teeth.limited = [-truth.travel / 2, truth.travel / 2], True
            teeth.solref_limit, teeth.frictionloss = [8e-4, 0.5], 0.05
        if truth.seat == link:
            seat = body.add_joint(
                name="seat", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(truth.direction)
            )
            seat.range, seat.limited = [0, truth.clearance], True
            seat.solref_limit, seat.frictionloss = [8e-4, 0.5], 1.0
        total, omega = full[k, k], 2 * np.pi * SERVO_HZ
        servo = spec.add_actuator(
            name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED, biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
        servo.gainprm[0] = total * omega**2
        servo.biasprm[1:3] = [-total * omega**2, -1.4 * total * omega]
        spec.add_sensor(
            name=joint, type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint,
        )  # fmt: skip
    if truth.rocks:
        for name, axis in (("rock_x", [1, 0, 0]), ("rock_y", [0, 1, 0])):
            bolts = spec.body("foot").add_joint(name=name, axis=axis)
            bolts.range, bolts.limited = [-truth.rocks / 2, truth.rocks / 2], True
            bolts.solref_limit, bolts.frictionloss = [1.5e-3, 0.4], 1.0
    if truth.payload:
        held = spec.body("fore").add_body(name="held", pos=[0.38, 0, 0.02])
        held.mass, held.inertia, held.explicitinertial = truth.payload, [1e-3] * 3, True
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


def played(
    model: mujoco.MjModel, given: Array, rate: float, rng: np.random.Generator
) -> tuple[Array, dict[str, Array]]:
    """Times and readings of a run under position commands (T, n) at a rate [Hz]."""
    steps = round((REST + len(given) / rate) / STEP)
    rows = np.clip(((np.arange(steps) * STEP - REST) * rate + 1e-6).astype(int), 0, len(given) - 1)
    data = mujoco.MjData(model)
    at = [int(model.joint(j).qposadr[0]) for j in JOINTS]
    data.qpos[at] = given[0]
    data.ctrl[:] = given[0]
    mujoco.mj_forward(model, data)
    weight = data.qfrc_bias[[int(model.joint(j).dofadr[0]) for j in JOINTS]]
    lift = weight / model.actuator_gainprm[:, 0]  # servos carry the weight
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, state, full)
    sensed = rollout.rollout(model, data, state[None], (given[rows] + lift)[None])[1][0]
    every = round(1 / RATE / STEP)
    low = butter(4, 0.42 * RATE, fs=1 / STEP, output="sos")
    read = {
        j: np.round(sensed[::every, int(model.sensor(j).adr[0])] / COUNT) * COUNT for j in JOINTS
    }
    for sensor in map(model.sensor, range(model.nsensor)):
        if sensor.name.endswith("_spring"):
            read[sensor.name] = sensed[::every, int(sensor.adr[0])]
        elif sensor.type == mujoco.mjtSensor.mjSENS_ACCELEROMETER:
            felt = sensed[:, int(sensor.adr[0]) :][:, :3]
            smooth = (sosfilt(low, felt - felt[0], axis=0) + felt[0])[::every]
            read[sensor.name] = smooth + rng.normal(0, NOISE, smooth.shape)
    return np.arange(len(read["acc"])) / RATE, read


def session(
    folder: Path, made: Plan, arm: SuspectArm, truth: Truth, *, seed: int = 0,
    before: Truth | None = None,
) -> Recording:  # fmt: skip
    """Play a plan and write its recording; `before` is the arm on the healthy day."""
    runs = []
    for number, run in enumerate(made.runs):
        healthy = run.condition == "healthy"
        model = simulated((before or Truth()) if healthy else truth, arm.path.read_text())
        rng = np.random.default_rng([seed, number])
        _, given = commands_of(made, arm, run)
        time, read = played(model, given, made.settings.limits.rate_hz, rng)
        named = dict(zip(arm.recording_model.positions, JOINTS, strict=True))
        sensors = {column: read[joint] for column, joint in named.items()}
        runs.append(
            Run(
                name=run.file,
                time=time,
                sensors=sensors | {name: read[name] for name in arm.accelerometers},
                pose=run.pose,
                condition="healthy" if healthy else "suspect",
            )
        )
    recording = write_recording(
        folder / "recording", model_xml=arm.recording_model.xml, runs=runs, file_format="parquet"
    )
    write_text(folder / "plan.json", made.to_json())
    return recording


LOOSE = Truth(seat="fore", direction=(0.6, 0.0, 0.8), mode_hz=40)


def short_session(folder: Path, truth: Truth = LOOSE) -> Recording:
    """Plan three poses of the arm, play them and write the recording, ``bench.xml`` beside it."""
    write_text(folder / "bench.xml", NOMINAL)
    settings = PlanSettings(controller="ros2_jtc", poses=3)
    return session(folder, *plan(folder / "bench.xml", settings), truth)
