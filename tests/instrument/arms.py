"""Arms to plan for, machines that stand in for real ones, and sessions made of numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from loose_env.instrument import (
    Diagnosis,
    Fault,
    InstrumentedArm,
    Plan,
    RecordSeen,
    TransmissionSpectrum,
)
from loose_env.recording import Run
from scripts.suites.diagnosis.cases import Case, motion, taken
from scripts.suites.gap.arms import model_xml, planar3
from scripts.suites.gap.dynamics import Factors
from scripts.suites.gap.effects import Effect, Place
from scripts.suites.gap.machine import Noise, TrueArm

# ------------------------------------------------------------------------- model files

# Three joints on position servos, one with a gear of 2 and a lag; its links collide.
SERVOED = """<mujoco model="servoed">
<option timestep="0.0002" integrator="implicitfast"/>
<worldbody><geom type="plane" size="3 3 .1"/>
<body name="post" pos="0 0 .25"><joint name="pan" axis="0 0 1" range="-170 170" armature=".05"/>
<geom type="capsule" fromto="0 0 0 0 0 .2" size=".05" density="900"/>
<body name="upper" pos="0 0 .25"><joint name="lift" axis="0 1 0" range="-120 120" armature=".05"/>
<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" density="900"/>
<body name="fore" pos=".4 0 0"><joint name="elbow" axis="0 1 0" range="-150 150" armature=".03"/>
<geom type="capsule" fromto="0 0 0 .35 0 0" size=".025" density="900"/>
<site name="tool" pos=".35 .03 0"/></body></body></body></worldbody>
<actuator>
<position name="pan_servo" joint="pan" kp="800" kv="30" forcerange="-80 80" ctrlrange="-3 3"/>
<position name="lift_servo" joint="lift" kp="900" kv="30" forcerange="-90 90" ctrlrange="-2.2 2.2"/>
<general name="elbow_servo" joint="elbow" dyntype="filter" dynprm=".002" gainprm="450"
 biastype="affine" biasprm="0 -450 -12" gear="2" forcerange="-25 25" ctrlrange="-5.3 5.3"/>
</actuator></mujoco>
"""

# Two joints with torque motors, an accelerometer and an encoder.
MOTORS = """<mujoco model="motors">
<worldbody>
<body name="upper" pos="0 0 1"><joint name="lift" axis="0 1 0" range="-60 60" armature=".02"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" density="900"/>
<body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="-90 90" armature=".02"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" density="900"/>
<site name="tip" pos=".25 0 0"/></body></body></worldbody>
<actuator><motor name="m1" joint="lift" gear="50" ctrlrange="-1 1"/>
<motor name="m2" joint="elbow" gear="20" ctrlrange="-1 1"/></actuator>
<sensor><accelerometer name="vibration" site="tip"/><jointpos name="q2" joint="elbow"/></sensor>
</mujoco>
"""

# Two joints, no actuators, meshes that are missing.
URDF = """<robot name="plain"><link name="base"/>
<link name="l1"><collision><geometry><mesh filename="package://x/l1.stl"/></geometry></collision>
<inertial><mass value="2"/><origin xyz="0 0 .2"/>
<inertia ixx=".02" iyy=".02" izz=".004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="l2"><inertial><mass value="1"/><origin xyz="0 0.02 .15"/>
<inertia ixx=".01" iyy=".01" izz=".002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="flange"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="80" velocity="2"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0 0 .4"/>
<axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" effort="30" velocity="2"/></joint>
<joint name="f" type="fixed"><parent link="l2"/><child link="flange"/><origin xyz="0 0 .3"/></joint>
</robot>
"""


def written(folder: Path, text: str, name: str = "arm.xml") -> Path:
    """Write a model into a folder."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def doubled(*further: str) -> str:
    """The servoed arm with further actuators before its own."""
    return SERVOED.replace("<actuator>", "<actuator>" + "".join(further))


# -------------------------------------------- a machine that MuJoCo never saw

STOPS = {"stop_mode": 110.0, "stop_damping_ratio": 0.3}
SLIDE = Effect(
    kind="structural_looseness",
    place=Place(name="link2", index=1),
    parameters={"gap": 2e-4, "direction": [0.6, 0.0, 0.8], "friction": 0.4, **STOPS},
)
PLAY = Effect(
    kind="backlash", place=Place(name="joint2", index=1), parameters={"gap": 2e-3, **STOPS}
)


@lru_cache(maxsize=4)
def case(kind: str) -> Case:
    """A planar arm whose figures are 1 to 3 % off: "healthy", "slide" or "play"."""
    rng = np.random.default_rng(11)
    figures = planar3()
    arm = TrueArm(figures=figures, factors=Factors.draw(figures.joints, rng))
    effects = {"healthy": (), "slide": (SLIDE,), "play": (PLAY,)}[kind]
    return Case(
        number=0,
        seed=11,
        arm=dataclasses.replace(arm, effects=effects),
        noise=Noise.draw(figures, rng),
        sensor=np.eye(3) + 0.02 * np.array([[0, 1, -1], [1, 0, 1], [-1, 1, 0]]),
        reference=False,
    )


@lru_cache(maxsize=8)
def runs(kind: str, count: int = 2, share: float = 0.2, *, sound: bool = False) -> tuple[Run, ...]:
    """Runs in fixed poses, joints in turn; `share` is the rms force over the drive's limit."""
    whole = case(kind)
    figures = whole.arm.figures
    poses = figures.home + figures.reach * np.array(
        [[0.5, -0.4, 0.3], [-0.6, 0.5, -0.5], [0.1, 0.7, 0.6]]
    )
    found = []
    for k in range(count):
        joint = (k + 1) % figures.joints
        link = figures.links[joint]
        played = motion(
            whole, poses[k], joint, share * link.limit / link.kp, (4.0, 100.0), 2.0,
            np.random.default_rng(k),
        )  # fmt: skip
        name = f"{'healthy' if sound else 'run'}-{k + 1}.parquet"
        found.append(taken(whole, played, name, np.random.default_rng(100 + k), sound=sound))
    return tuple(found)


def write_model(folder: Path) -> Path:
    """Write the nominal model."""
    path = folder / "model.xml"
    path.write_text(model_xml(planar3()), encoding="utf-8")
    return path


# ------------------------------------------ with MuJoCo alone: playing a plan, striking a tool


def held(model: mujoco.MjModel, pose: np.ndarray, commands: Mapping[str, float]) -> mujoco.MjData:
    """State of a model at rest in a pose under constant commands of its actuators."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    for a in range(model.nu):
        data.ctrl[a] = commands[model.actuator(a).name]
        if model.actuator_actadr[a] >= 0:
            data.act[model.actuator_actadr[a]] = data.ctrl[a]
    mujoco.mj_forward(model, data)
    return data


@dataclass(frozen=True, kw_only=True)
class Played:
    """Motion of the simulated arm."""

    tool_rms: float
    joint_rms: float
    torque_peaks: np.ndarray
    travel: np.ndarray
    standing: float
    """Largest acceleration of the tool before the noise begins, less gravity [m/s²]."""
    held_at: np.ndarray
    """Joint positions just before the noise begins [rad or m]."""
    columns: dict[str, np.ndarray]
    """The run, as a recording has it."""


def play(plan: Plan, *, step: float = 2e-4) -> Played:
    """Play the first signal; joints with motors are on the soft controller that is assumed."""
    machine, signal = plan.arm, plan.signals[0]
    made = machine.recording_model
    spec = mujoco.MjSpec.from_string(made.xml)
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    m = spec.compile()
    joints = [m.joint(name) for name in machine.joints]
    at, dofs = [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]
    for k, drive in enumerate(machine.drives):
        if drive is None or not drive.servo:
            m.jnt_stiffness[joints[k].id] += machine.nominal.centring.stiffness[k]
            m.dof_damping[dofs[k]] += machine.nominal.centring.damping[k]
            m.qpos_spring[at[k]] = plan.pose[k]
    data = held(m, plan.pose, {name: u[0] for name, u in signal.commands.items()})
    u = np.array([signal.commands[m.actuator(a).name] for a in range(m.nu)]).T
    mujoco.mj_step(m, data, round(1.5 / step))  # the arm stands under the first commands
    sensor = int(m.sensor(made.accelerometer).adr[0])
    each = round(1 / (step * plan.next.rate_hz))
    rows = []
    for t in range(len(u)):
        mujoco.mj_forward(m, data)
        tool = data.sensordata[sensor : sensor + 3]
        rows.append([tool, data.qpos[at], data.qfrc_actuator[dofs], data.qacc[dofs]])
        rows[-1] = [values.copy() for values in rows[-1]]
        for s in range(each):
            data.ctrl[:] = u[t] + (u[min(t + 1, len(u) - 1)] - u[t]) * s / each
            mujoco.mj_step(m, data)
    a, angle, torque, qacc = (np.array(column) for column in zip(*rows, strict=True))
    on = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    swells = signal.steady_s[0] - 0.25
    still = (signal.time > 0.8 * swells) & (signal.time < 0.9 * swells)
    shaken = (signal.time > 0.9 * swells) & (signal.time < signal.steady_s[1] + 0.25)
    around = a[on] - a[on].mean(axis=0)
    columns = {"time": signal.time, **{f"ctrl.{n}": v for n, v in signal.commands.items()}}
    columns |= {f"sensor.{made.accelerometer}.{axis}": a[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sensor.{s}": angle[:, k] for k, s in enumerate(made.positions)}
    return Played(
        tool_rms=float(np.sqrt((around**2).sum(axis=1).mean())),
        joint_rms=float(qacc[on][:, machine.joints.index(signal.joint)].std()),
        torque_peaks=np.abs(torque).max(axis=0),
        travel=np.abs(angle[shaken] - plan.pose).max(axis=0),
        standing=float(np.abs(a[still] - a[still][0]).max()),
        held_at=angle[still].mean(axis=0),
        columns=columns,
    )


RATE, STEP = 1000.0, 2e-5
"""Samples per second of the hammer's recorder [Hz], and the simulation's step [s]."""


def blows(seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Force of a hammer with a soft tip: half sines of 4 ms, some ten a second, at STEP [N]."""
    force = np.zeros(round(seconds / STEP))
    pulse = np.sin(np.pi * np.arange(round(4e-3 / STEP)) * STEP / 4e-3)
    at = 0.05
    while at < seconds - 0.05:
        k = round(at / STEP)
        force[k : k + len(pulse)] += 40.0 * rng.uniform(0.5, 1.0) * pulse
        at += rng.uniform(0.05, 0.15)
    return force


def strike(
    arm: InstrumentedArm,
    pose: np.ndarray,
    direction: Sequence[float],
    seed: int,
    *,
    loose: tuple[str, Sequence[float], float] | None = None,
) -> Run:
    """Run of 2 s of an arm on its servos whose tool is struck along a direction of its frame.

    Parameters
    ----------
    loose : tuple, optional
        Body, direction in its frame and clearance [m] of a loose seat.
    """
    rng, made = np.random.default_rng(seed), arm.recording_model
    spec = mujoco.MjSpec.from_string(made.xml)
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if loose is not None:
        body, axis, gap = loose
        spec.body(body).add_joint(
            name="seat", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(axis), limited=True,
            range=[-gap / 2, gap / 2], solref_limit=[-4e6, -400.0], frictionloss=0.5,
        )  # fmt: skip
    m = spec.compile()
    at = [int(m.joint(name).qposadr[0]) for name in arm.joints]
    where = np.zeros(m.nq)
    where[at] = pose
    drives = zip(arm.drives, pose, strict=True)
    data = held(m, where, {d.actuator: float(d.command(0.0, q)) for d, q in drives if d})
    site = m.site(made.site).id
    body, sensor = int(m.site_bodyid[site]), int(m.sensor(made.accelerometer).adr[0])
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    mujoco.mj_step(m, data, round(1.0 / STEP))
    pushed, tool, angle = [], [], []
    for k, force in enumerate(blows(2.0, rng)):
        data.qfrc_applied[:] = 0.0
        along = data.site_xmat[site].reshape(3, 3) @ (force * unit)
        mujoco.mj_applyFT(
            m, data, along, np.zeros(3), data.site_xpos[site], body, data.qfrc_applied
        )
        mujoco.mj_forward(m, data)
        if k % round(1 / (RATE * STEP)) == 0:
            pushed.append(force * unit)
            tool.append(data.sensordata[sensor : sensor + 3] + 0.01 * rng.standard_normal(3))
            angle.append(data.qpos[at] + 1e-5 * rng.standard_normal(len(at)))
        mujoco.mj_step(m, data)
    return Run(
        name=f"run-{seed}.csv",
        time=np.arange(len(tool)) / RATE,
        sensors={
            made.accelerometer: np.array(tool),
            str(arm.tool_force): np.array(pushed) + 0.002 * rng.standard_normal((len(tool), 3)),
            **dict(zip(made.positions, np.array(angle).T, strict=True)),
        },
        pose=arm.by_joint(pose),
    )


# -------------------------------------------- sessions of an arm of three joints

JOINTS, LINKS = ("base", "shoulder", "elbow"), ("column", "upper_arm", "forearm")
FREQUENCY = np.linspace(5.0, 100.0, 24)


def session(
    number: int,
    *,
    factor: dict[str, float] | None = None,
    scatter: float = 0.01,
    dated: bool = True,
    pose: float = 0.3,
    gap_m: float | None = None,
    faulty: float = 0.02,
) -> Diagnosis:
    """One session; `factor` multiplies the transmission of a joint above 50 Hz."""
    rng = np.random.default_rng(number)
    spectra, records = [], []
    for k, joint in enumerate(JOINTS):
        records.append(
            RecordSeen(
                file=f"run-{k}.csv", pose={j: pose + 0.1 * k for j in JOINTS}, excited=(joint,),
                condition="suspect", probabilities={},
            )
        )  # fmt: skip
        for axis in "xyz":
            level = np.exp(scatter * rng.normal()) * (1.0 + 20.0 / FREQUENCY)
            worn = np.where(FREQUENCY > 50, (factor or {}).get(joint, 1.0), 1.0)
            spectra.append(
                TransmissionSpectrum(
                    record=k, joint=joint, channel=f"tool.{axis}", unit="m/s² per N·m",
                    drive_rms=2.0 * np.exp(0.01 * rng.normal()),
                    frequency_hz=tuple(FREQUENCY.tolist()), measured=tuple((level * worn).tolist()),
                )
            )  # fmt: skip
    names = [f"structural_looseness@{x}" for x in LINKS] + [f"backlash@{x}" for x in JOINTS]
    posterior = {"healthy": 1 - faulty} | {name: faulty / 6 for name in names}
    fault = Fault(kind="healthy")
    if gap_m is not None:
        fault = Fault(kind="backlash", where="elbow", gap_m=gap_m)
    return Diagnosis(
        fault=fault, probability=posterior[fault.hypothesis], posterior=posterior,
        records=tuple(records), spectra=tuple(spectra),
        date=f"2025-{1 + number // 28:02d}-{1 + number % 28:02d}" if dated else "",
    )  # fmt: skip


def named(count: int) -> list[tuple[str, Diagnosis]]:
    """Healthy sessions and their names."""
    return [(f"session {k}", session(k)) for k in range(count)]
